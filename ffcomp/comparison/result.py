"""The result of a comparison: numbers for tables, samples for figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal

from ffcomp.errors import missing_extras_explained
from ffcomp.inverse.robust import PLAIN, RobustChoice
from ffcomp.metrics import Track
from ffcomp.numerics.serialise import ALL_OF, keys
from ffcomp.result import Answer, Fact, Result, named
from ffcomp.simulation.expectation import Expectation
from models.arrays import BoolArray, FloatArray, IntArray
from models.machine import Machine

FIGURES = ("close-up", "errors-by-layer", "errors-by-feature", "methods")
Family = Literal["none", "calibrated", "best fixed", "inversion"]


@dataclass(frozen=True, eq=False)
class Samples:
    """One executed method at m evenly spaced instants (with a gap where the sampled print has one)."""

    due: FloatArray  # (m,) s, when on the reference plan's clock
    reference: FloatArray  # (m, 3) mm, where the nozzle should be then
    nozzle: FloatArray  # (m, 3) mm, where it is
    contour: FloatArray  # (m,) mm, distance to the reference path's segments
    layer: IntArray  # (m,) the layer's number in the print, from 0
    feature: IntArray  # (m,) index into Comparison.features: the slicer's ;TYPE:
    extruding: BoolArray  # (m,) plastic flows, so that it shows


@dataclass(frozen=True, slots=True)
class Error:
    """Contour error over some of the samples, µm."""

    rms_um: float  # contour error, root mean square
    p99_um: float  # 99 % of the samples are closer
    max_um: float  # the largest
    share: float  # of the samples where plastic flows


@dataclass(frozen=True, slots=True)
class Peaks:
    """The largest demand on any carriage, and whether the machine file allows it."""

    velocity_mm_per_s: float  # the highest demand on a carriage
    acceleration_mm_per_s2: float  # the same
    within_limits: bool  # of the machine file


@dataclass(frozen=True, slots=True)
class EqualQuality:
    """The highest acceleration that keeps the contour error's p99 below a bound, and the print time then."""

    acceleration_mm_per_s2: float  # the highest with 99 % of the contour error below the bound
    print_time_s: float  # of the whole print at that acceleration
    p99_um: float  # at that acceleration
    capped: bool  # it was still good at the highest that was tried
    reached: bool = True  # false: above the bound even at the lowest that was tried


@dataclass(frozen=True, eq=False)
class Method:
    """One method, evaluated."""

    json_keys: ClassVar = keys(
        *("label", "family", "tuning", "extruding", "by_layer", "by_feature", "peaks", "equal_quality", "warnings"),
        **{ALL_OF: "track"},
    )

    name: str  # the key in JSON: none, zv, …, zv-calibrated, …, fbs-lti, fbs-robust, fbs-lpv
    label: str  # for people
    family: Family
    tuning: str  # a sentence: the chosen parameters, and how
    track: Track  # over all samples
    extruding: Track  # where plastic flows
    by_layer: dict[int, Error]  # where plastic flows, or everywhere if it flows nowhere
    by_feature: dict[str, Error]  # the same samples
    peaks: Peaks
    samples: Samples
    equal_quality: EqualQuality | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """Every method on one print."""

    schema = "ffcomp-compare/1"
    page_by = "ffcomp.report.compare:page_of"
    json_keys: ClassVar = keys(
        *("version", "machine", "plant", "sampling", "settings", "limits", "print_time_s"),
        *("acceleration_mm_per_s2", "best_fixed", "quality_bound_um", "predicted", "expected"),
        *("methods", "seconds"),
        input="print_name",
        input_sha256="print_sha256",
        ours="compensated",
        robust_by_default="robust.robust",
        robust_reason="robust.reason",
    )

    print_name: str
    print_sha256: str
    print_time_s: float  # of the whole print, as the firmware plans it
    sampling: str  # a sentence: the part of the print that was evaluated
    machine: Machine  # the one that every method uses
    plant: Machine  # the one that evaluated them
    settings: dict[str, str]  # name → value, as used
    version: str
    features: tuple[str, ...]
    methods: dict[str, Method]  # in the order of the table
    best_fixed: str  # names in `methods`: the fixed shaper with the least contour error
    compensated: str  # name of the method that `compensate` writes with this machine file
    limits: dict[str, float] = field(
        default_factory=dict
    )  # carriage_velocity_mm_per_s, carriage_acceleration_mm_per_s2
    quality_bound_um: float = 25.0
    seconds: float = 0.0  # that the comparison took
    acceleration_mm_per_s2: float | None = None  # of the print: most of its outer walls, or of all that extrudes
    whole: bool = False  # the evaluated part is the whole print, in one piece
    predicted: Mapping[str, Track] = field(default_factory=dict)  # of the whole print, as `compensate` states it
    robust: RobustChoice = PLAIN  # default of `compensate` with this machine file
    expected: Expectation | None = None  # of what `compensate` writes; None: no piece of the print could be simulated
    notes: tuple[str, ...] = ()  # sentences on the compared print, if it is not the file itself

    @property
    def tracks(self) -> dict[str, Track]:
        """Errors by method."""
        return {name: method.track for name, method in self.methods.items()}

    @property
    def ours(self) -> Method:
        """The compensated print."""
        return self.methods[self.compensated]

    @property
    def none(self) -> Method:
        """The print without compensation."""
        return self.methods["none"]

    @property
    def best(self) -> Method:
        """The best fixed shaper."""
        return self.methods[self.best_fixed]

    @property
    def fastest_shaper(self) -> Method | None:
        """The fastest shaper at equal quality; at the print's own speed another may have the least error."""
        fixed = [each for each in self.methods.values() if each.family in ("calibrated", "best fixed")]
        sought = [(each.equal_quality, each) for each in fixed if each.equal_quality is not None]
        first = sorted(sought, key=lambda each: (not each[0].reached, each[0].print_time_s))[:1]
        return first[0][1] if first else None

    @property
    def extrudes(self) -> bool:
        """Whether the evaluated part extrudes."""
        return bool(self.ours.samples.extruding.any())

    @property
    def where(self) -> str:
        """Which samples show on the print."""
        return "where plastic flows" if self.extrudes else "over all moves"

    def seen(self, method: Method) -> Track:
        """Return the errors that show on the print: where plastic flows, or everywhere if it flows nowhere."""
        return method.extruding if self.extrudes else method.track

    def rms_um(self, method: Method) -> float:
        """Return the contour rms of the same."""
        return self.seen(method).contour_rms_um

    @cached_property
    def answer(self) -> Answer:
        """Whether it is worth it and why, the findings, each method's errors, and the limits of the result."""
        answer: Answer = named("ffcomp.comparison.sentences:answer_of")(self)
        return answer

    @property
    def headline(self) -> str:
        """Whether it is worth it, and why."""
        return self.answer.headline

    @property
    def facts(self) -> Sequence[Fact]:
        """The findings, and each method's errors."""
        return self.answer.facts

    @property
    def warnings(self) -> Sequence[str]:
        """Whether another file is compared, and the limits of the result."""
        return self.answer.warnings

    @property
    def next_steps(self) -> Sequence[str]:
        """A measurement, where the machine file is not known well enough."""
        return self.answer.next_steps

    def figures(self) -> Sequence[str]:
        """Return the names of the figures that `plot` draws."""
        return FIGURES

    @missing_extras_explained()
    def plot(self, name: str = "methods", **options: Any) -> Any:
        """Draw one of the figures; RequestError if there is none of that name."""
        return named("ffcomp.report.compare:figure")(self, name or "methods")
