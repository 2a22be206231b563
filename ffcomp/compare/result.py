"""What a comparison found: numbers for tables, samples for pictures. No physics, no drawing."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ffcomp.metrics import Track
from models.arrays import BoolArray, FloatArray, IntArray

Family = Literal["none", "calibrated", "best fixed", "scheduled", "inversion"]


@dataclass(frozen=True, eq=False)
class Samples:
    """What one method made of the print, at m evenly spaced instants (with a gap where the sampled print has one)."""

    due: FloatArray  # (m,) s, when on the wanted plan's clock
    wanted: FloatArray  # (m, 3) mm, where the nozzle should be then
    nozzle: FloatArray  # (m, 3) mm, where it is
    contour: FloatArray  # (m,) mm, distance to the wanted path's segments
    layer: IntArray  # (m,) the layer's number in the print, from 0
    feature: IntArray  # (m,) index into Comparison.features: the slicer's ;TYPE:
    extruding: BoolArray  # (m,) plastic flows, so that it shows


@dataclass(frozen=True, slots=True)
class Error:
    """Contour error over some of the samples, µm."""

    rms_um: float
    p99_um: float
    max_um: float
    share: float  # of all samples


@dataclass(frozen=True, slots=True)
class Peaks:
    """The most that any carriage is asked for, and whether the machine file allows it."""

    velocity_mm_per_s: float
    acceleration_mm_per_s2: float
    within_limits: bool


@dataclass(frozen=True, slots=True)
class Spread:
    """Contour rms over the drawn plants, one value a seed, µm; the tuning stays that of the machine file."""

    contour_rms_um: tuple[float, ...]

    @property
    def median_um(self) -> float:
        return float(np.median(self.contour_rms_um))

    @property
    def worst_um(self) -> float:
        return max(self.contour_rms_um)


@dataclass(frozen=True, slots=True)
class EqualQuality:
    """The highest acceleration at which the contour error's p99 stays below a bound, and what it gains."""

    acceleration_mm_per_s2: float
    print_time_s: float  # of the whole print at that acceleration
    p99_um: float  # at that acceleration
    capped: bool  # good even at the highest acceleration that was tried
    reached: bool = True  # False: above the bound even at the lowest that was tried


@dataclass(frozen=True, eq=False)
class Method:
    """One way of driving the printer, judged."""

    name: str  # the key in JSON: none, zv, …, zv-calibrated, …, zv-scheduled, …, fbs-lti, fbs-robust, fbs-lpv
    label: str  # for people
    family: Family
    tuning: str  # a sentence: what was chosen, and how
    track: Track  # over all samples
    extruding: Track  # where plastic flows
    by_layer: dict[int, Error]
    by_feature: dict[str, Error]
    residual_rms_um: float  # what still rings while the nozzle should cruise in a straight line
    peaks: Peaks
    samples: Samples
    spread: Spread | None = None
    retuned: Spread | None = None  # shapers only: frequencies sought again on every drawn plant
    equal_quality: EqualQuality | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Layer:
    number: int  # from 0
    z_mm: float
    begin_t: float  # s, on the wanted plan's clock
    end_t: float


@dataclass(frozen=True, slots=True)
class Party:
    """A machine file that took part."""

    name: str
    sha256: str
    effects: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class BedMap:
    """The lowest well excited resonance along x and y over the bed of the plant."""

    x_mm: FloatArray  # (n,)
    y_mm: FloatArray  # (n,)
    frequency_hz: FloatArray  # (n, n, 2), [iy, ix, axis]; NaN outside the bed

    @property
    def is_round(self) -> bool:
        """Of a delta; a machine with straight axes has the same resonances all over a bed with corners."""
        return bool(np.isnan(self.frequency_hz).any())


@dataclass(frozen=True, eq=False)
class Comparison:
    """Everything that the JSON, the report and the figures are made of."""

    print_name: str
    print_sha256: str
    print_time_s: float  # of the whole print, as the firmware plans it
    layers_total: int
    sampling: str  # a sentence: what part of the print was judged
    machine: Party  # what every method believes
    plant: Party  # what judged them
    mismatch: str  # a sentence, empty when no plants were drawn
    settings: dict[str, str]  # name → value, as they were used
    version: str
    layers: tuple[Layer, ...]  # those that were judged
    features: tuple[str, ...]
    methods: dict[str, Method]  # in the order of the table
    best_fixed: str  # names in `methods`: the fixed shaper with the least contour error
    ours: str  # our method
    sample_s: float  # time from sample to sample
    bed: BedMap | None = None
    limits: dict[str, float] = field(
        default_factory=dict
    )  # carriage_velocity_mm_per_s, carriage_acceleration_mm_per_s2
    quality_bound_um: float = 25.0
    seconds: float = 0.0  # that the comparison took
