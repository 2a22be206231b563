"""The result of a comparison: numbers for tables, samples for figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from ffcomp.inverse.robust import PLAIN, RobustChoice
from ffcomp.metrics import Track
from ffcomp.numerics.serialise import ALL_OF, keys
from ffcomp.simulation.expectation import Expectation
from models.arrays import BoolArray, FloatArray, IntArray
from models.machine import Machine

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
    weight: FloatArray  # (m,) how often it counts: 1 on average, and everywhere when the whole print is evaluated


@dataclass(frozen=True, slots=True)
class Error:
    """Contour error over some of the samples, µm."""

    rms_um: float  # contour error, root mean square
    p99_um: float  # 99 % of the samples are closer
    max_um: float  # the largest
    share: float  # of all samples


@dataclass(frozen=True, slots=True)
class Peaks:
    """The largest demand on any carriage, and whether the machine file allows it."""

    velocity_mm_per_s: float  # the highest demand on a carriage
    acceleration_mm_per_s2: float  # the same
    within_limits: bool  # of the machine file


@dataclass(frozen=True, slots=True)
class Spread:
    """Contour rms over the Monte-Carlo plants, one value a seed, µm; the tuning stays that of the machine file."""

    json_keys: ClassVar = keys("mean_um", "median_um", "worst_um", "contour_rms_um")

    contour_rms_um: tuple[float, ...]

    @property
    def median_um(self) -> float:
        """Median over the plants."""
        return float(np.median(self.contour_rms_um))

    @property
    def mean_um(self) -> float:
        """Mean over the plants."""
        return float(np.mean(self.contour_rms_um))

    @property
    def worst_um(self) -> float:
        """Maximum over the plants."""
        return max(self.contour_rms_um)


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
        *("label", "family", "tuning", "extruding", "by_layer", "by_feature"),
        *("residual_rms_um", "peaks", "equal_quality", "warnings"),
        mismatch="spread",
        mismatch_retuned="retuned",
        **{ALL_OF: "track"},
    )

    name: str  # the key in JSON: none, zv, …, zv-calibrated, …, fbs-lti, fbs-robust, fbs-lpv
    label: str  # for people
    family: Family
    tuning: str  # a sentence: the chosen parameters, and how
    track: Track  # over all samples
    extruding: Track  # where plastic flows
    by_layer: dict[int, Error]
    by_feature: dict[str, Error]
    residual_rms_um: float  # residual ringing while the nozzle should cruise in a straight line or rest
    peaks: Peaks
    samples: Samples
    spread: Spread | None = None
    retuned: Spread | None = None  # shapers only: retuned on every Monte-Carlo plant
    equal_quality: EqualQuality | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Layer:
    """An evaluated layer."""

    number: int  # from 0; those that were evaluated
    z_mm: float
    begin_t: float  # number [s]: on the plan's clock
    end_t: float  # number [s]


@dataclass(frozen=True, eq=False)
class Comparison:
    """A comparison: all that the JSON, the report and the figures are made of."""

    json_keys: ClassVar = keys(
        *("version", "machine", "plant", "sampling", "mismatch", "settings", "limits", "print_time_s"),
        *("acceleration_mm_per_s2", "layers", "best_fixed", "quality_bound_um", "predicted", "expected"),
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
    layers_total: int
    sampling: str  # a sentence: the part of the print that was evaluated
    machine: Machine  # the one that every method uses
    plant: Machine  # the one that evaluated them
    mismatch: str  # a sentence, empty without Monte-Carlo plants
    settings: dict[str, str]  # name → value, as used
    version: str
    layers: tuple[Layer, ...]  # those that were evaluated
    features: tuple[str, ...]
    methods: dict[str, Method]  # in the order of the table
    best_fixed: str  # names in `methods`: the fixed shaper with the least contour error
    compensated: str  # name of the method that `compensate` writes with this machine file
    sample_s: float  # time from sample to sample
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
