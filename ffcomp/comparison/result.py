"""The result of a comparison: numbers for tables, samples for figures, and plain sentences.

The bad news is said as plainly as the good.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np

from ffcomp.inverse.robust import PLAIN, RobustChoice
from ffcomp.metrics import Track, Tracking, build_track, contour_statistics, rms
from ffcomp.numerics.digits import um
from ffcomp.numerics.serialise import ALL_OF, keys
from ffcomp.result import Fact, Result, clock
from ffcomp.simulation.expectation import Expectation, condition_of
from models.arrays import BoolArray, FloatArray, IntArray
from models.machine import Machine

FIGURES = ("methods", "close-up", "errors-by-layer", "errors-by-feature")
WORTH_RATIO, TIE_RATIO = 2.0, 1.05  # times less error than the best shaper: below the first, a shaper is enough
Family = Literal["none", "calibrated", "best fixed", "inversion"]


@dataclass(frozen=True, slots=True)
class Error:
    """Contour error over some of the samples, µm."""

    rms_um: float  # contour error, root mean square
    p99_um: float  # 99 % of the samples are closer
    max_um: float  # the largest
    share: float  # of the samples where plastic flows


@dataclass(frozen=True, eq=False)
class Samples:
    """One executed method at m evenly spaced instants (with a gap where the sampled print has one)."""

    due: FloatArray  # (m,) s, when on the reference plan's clock
    reference: FloatArray  # (m, 3) mm, where the nozzle should be then
    late: FloatArray  # (m, 3) mm, where it should have been `delay_s` earlier
    nozzle: FloatArray  # (m, 3) mm, where it is
    contour: FloatArray  # (m,) mm, distance to the reference path's segments
    layer: IntArray  # (m,) the layer's number in the print, from 0
    feature: IntArray  # (m,) index into Comparison.features: the slicer's ;TYPE:
    extruding: BoolArray  # (m,) plastic flows, so that it shows
    delay_s: float = 0.0  # the constant delay that explains most of the tracking error

    def error(self, which: BoolArray) -> Error:
        """Return the contour error of some of the samples: which : (m,)."""
        error = contour_statistics(self.contour[which])
        return Error(error.rms_um, error.p99_um, error.max_um, float(np.count_nonzero(which)) / max(len(which), 1))

    def by(self, labels: IntArray) -> dict[int, Error]:
        """Return the contour error by label of the samples where plastic flows, or of all if it flows nowhere."""
        shows = self.extruding if self.extruding.any() else np.ones(len(labels), dtype=np.bool_)
        errors = {int(k): self.error(shows & (labels == k)) for k in np.unique(labels[shows])}
        total = max(sum(each.share for each in errors.values()), 1e-12)
        return {k: replace(each, share=each.share / total) for k, each in errors.items()}

    def track(self, which: BoolArray, print_time_s: float, peak_acceleration: float) -> Track:
        """Build the TRACK of some of the samples: which : (m,)."""
        distance = np.linalg.norm((self.nozzle - self.reference)[which], axis=1)
        not_late = rms(np.linalg.norm((self.nozzle - self.late)[which], axis=1))
        at_equal_times = Tracking(rms(distance), float(distance.max(initial=0.0)), self.delay_s, not_late)
        return build_track(at_equal_times, self.contour[which], print_time_s, peak_acceleration)


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
    drawn_by: ClassVar = {name: f"ffcomp.report.compare:draw_{name.replace('-', '_')}" for name in FIGURES}
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
    compensated: str  # the one of `methods` that `compensate` writes with this machine file
    quality_bound_um: float = 25.0
    seconds: float = 0.0  # that the comparison took
    acceleration_mm_per_s2: float | None = None  # of the print: most of its outer walls, or of all that extrudes
    predicted: Mapping[str, Track] = field(default_factory=dict)  # of the whole print, as `compensate` states it
    robust: RobustChoice = PLAIN  # default of `compensate` with this machine file
    expected: Expectation | None = None  # of what `compensate` writes; None: no piece of the print could be simulated
    notes: tuple[str, ...] = ()  # sentences on the compared print, if it is not the file itself

    @property
    def limits(self) -> dict[str, float]:
        """The limits of the carriages."""
        names = ("carriage_velocity_mm_per_s", "carriage_acceleration_mm_per_s2")
        return {name: getattr(self.machine.limits, name) for name in names}

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
        """The fixed shaper with the least contour error."""
        return min((each for each in self.methods.values() if each.family == "best fixed"), key=self.rms_um)

    @property
    def best_fixed(self) -> str:
        """Its name in `methods`."""
        return self.best.name

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

    @property
    def headline(self) -> str:
        """Whether it is worth it: against the best fixed shaper, which owners have for nothing."""
        ours, stated = self.ours, self.acceleration_mm_per_s2
        at = "" if stated is None else f"at your {acceleration(stated)} "
        if not ours.peaks.within_limits:
            return f"Worth it? No: {at}ffcomp asks the carriages for more than the machine file allows."
        left, theirs, before, shaper, where = _weighed(self)
        if left > TIE_RATIO * before:
            return f"Worth it? No: {at}ffcomp makes this print worse{where}: {um(left)} µm, without it {um(before)}."
        if left >= theirs / TIE_RATIO:
            as_good = "as good" if left <= TIE_RATIO * theirs else "better"
            sentence = f"Worth it? No: {at}the best input shaper ({shaper}) is {as_good} on this print{where}"
            return f"{sentence}: {um(theirs)} µm against {um(left)}."
        gain = f"{at}ffcomp leaves {um(left)} µm, the best input shaper ({shaper}) {um(theirs)} and none {um(before)}"
        gain = f"{gain}{where}.{_speeds(self, ours)}"
        if theirs < WORTH_RATIO * left:
            return f"Worth it? Hardly: {gain} The difference is small: a shaper is enough."
        return f"Worth it? Yes: {gain}"

    @property
    def facts(self) -> Sequence[Fact]:
        """Each method's error and, where it was sought, its speed at equal quality; then what limits them."""
        methods = [(method.label, ", ".join(_numbers(self, method))) for method in self.methods.values()]
        findings = (
            ("Inverse", _written(self)),
            ("Limits", _limits(self)),
            ("Evaluated", self.sampling),
            ("Marlin", self.settings.get("Marlin", "")),
            ("Simulated", _plant(self)),
            ("Predicted", _predicted(self)),
        )
        return [*methods, *(each for each in findings if each[1])]

    @property
    def warnings(self) -> Sequence[str]:
        """Whether another file is compared, assumed modes, and warnings about the print."""
        assumed = [party.assumed for party in (self.machine, self.plant) if party.assumed]
        return list(dict.fromkeys([*self.notes, *assumed, *self.ours.warnings]))

    @property
    def next_steps(self) -> Sequence[str]:
        """A measurement, where the machine file is not known well enough."""
        return [self.expected.next_step] if self.expected and self.expected.next_step else []


# ---- in words ----------------------------------------------------------------------------------


def _weighed(comparison: Comparison) -> tuple[float, float, float, str, str]:
    """Return the contour error, µm, of ffcomp, of the best shaper and of none, which shaper that is, and on what.

    Those to expect by the machine file's `[uncertainty]`, or else those of the virtual printer.
    """
    expected = comparison.expected
    if expected is not None:
        condition = condition_of(expected.uncertainty, expected.assumed)
        left, theirs, before = expected.compensated_um, expected.shaper_um, expected.uncompensated_um
        return left, theirs, before, expected.shaper_name, f" (expected {condition})"
    left, theirs, before = map(comparison.rms_um, (comparison.ours, comparison.best, comparison.none))
    return left, theirs, before, nick(comparison.best), f", {comparison.where}"


def _speeds(comparison: Comparison, ours: Method) -> str:
    quality, rival = ours.equal_quality, comparison.fastest_shaper
    if quality is None or not quality.reached:
        return ""
    quality_text = f" It keeps 99 % within {comparison.quality_bound_um:g} µm up to {_highest(quality)}"
    if rival is None or rival.equal_quality is None:
        return f"{quality_text}."
    if not rival.equal_quality.reached:
        return f"{quality_text}, which no shaper manages."
    return f"{quality_text}, the fastest shaper ({nick(rival)}) up to {_highest(rival.equal_quality)}."


def _highest(quality: EqualQuality) -> str:
    return f"{acceleration(quality.acceleration_mm_per_s2)}{' and more' if quality.capped else ''}"


def _numbers(comparison: Comparison, method: Method) -> Iterator[str]:
    errors = comparison.seen(method)
    yield f"{um(errors.contour_rms_um)} µm rms"
    yield f"99 % within {um(errors.contour_p99_um)}"
    yield f"largest {um(errors.contour_max_um)}"
    if method.equal_quality is not None:
        yield _speed(method.equal_quality)
    if not method.peaks.within_limits:
        yield "beyond the carriages' limits"


def _written(comparison: Comparison) -> str:
    """State which inverse `compensate` uses with this machine file, if not the plain one, and the plain one's error."""
    plain = comparison.methods.get("fbs-lpv")
    if not comparison.robust.robust or plain is None:
        return ""
    exact = comparison.plant.sha256 == comparison.machine.sha256
    return (
        f"The row “ffcomp” is the file that `ffcomp compensate` writes. {comparison.robust.reason} The plain inverse "
        f"(“{plain.label}”) leaves {um(comparison.rms_um(plain))} µm here"
        f"{', where the printer is exactly as the file says' if exact else ''}."
    )


def _speed(quality: EqualQuality) -> str:
    highest, whole = acceleration(quality.acceleration_mm_per_s2), clock(quality.print_time_s)
    if not quality.reached:
        return f"misses it even at {highest}"
    if quality.capped:
        return f"keeps it even at {highest}, the highest that was tried (whole print {whole})"
    return f"keeps it up to {highest} (whole print {whole})"


def _limits(comparison: Comparison) -> str:
    ours, beyond = comparison.ours, [m for m in comparison.methods.values() if not m.peaks.within_limits]
    velocity, most = comparison.limits.values()
    allowed = f" ({velocity:.0f} mm/s, {acceleration(most)})"
    if ours in beyond:
        return (
            f"ffcomp asks the carriages for {ours.peaks.velocity_mm_per_s:.0f} mm/s and "
            f"{acceleration(ours.peaks.acceleration_mm_per_s2)}, more than the machine file allows{allowed}: "
            "the real printer cannot reach this accuracy; lower the print's speed or acceleration."
        )
    if beyond:
        names = f"{allowed}: {', '.join(method.label for method in beyond)}"
        return f"Beyond the limits of the carriages{names}. A real printer cannot reach their accuracy."
    return ""


def _predicted(comparison: Comparison) -> str:
    if not comparison.predicted:
        return ""
    before, after = (um(comparison.predicted[name].contour_rms_um) for name in ("uncompensated", "compensated"))
    return (
        f"`ffcomp compensate` and `ffcomp show` predict {before} → {after} µm rms for this print, with the linear "
        "model that ffcomp plans with and over all moves, travel included. The errors above come from the "
        f"nonlinear virtual printer, {comparison.where}."
    )


def _plant(comparison: Comparison) -> str:
    effects = f", with {', '.join(comparison.plant.effects)}" if comparison.plant.effects else ""
    if comparison.plant.sha256 == comparison.machine.sha256:
        return (
            "All of this is simulated, and the virtual printer has exactly the parameters of the machine "
            f"file{effects}. A real printer differs from its file, so expect larger errors."
        )
    return (
        f"All of this is simulated: every method uses the model of {comparison.machine.name}, and the virtual printer "
        f"that evaluates them is {comparison.plant.name}{effects}."
    )


def nick(method: Method) -> str:
    """Return the label without its family, where that is known: `MZV`, `MZV, z too`, `ffcomp`."""
    return method.label.removesuffix(f", {method.family}")


def acceleration(mm_per_s2: float) -> str:
    """Format an acceleration in the firmware's unit and in metres: `12,400 mm/s² (12.4 m/s²)`."""
    return f"{float(f'{mm_per_s2:.3g}'):,.0f} mm/s² ({mm_per_s2 / 1e3:.3g} m/s²)"
