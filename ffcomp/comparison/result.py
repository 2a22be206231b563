"""The result of a comparison: numbers for tables, samples for figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from ffcomp.inverse.robust import PLAIN, RobustChoice
from ffcomp.metrics import Track
from ffcomp.numerics.serialise import to_json
from ffcomp.simulation.expectation import Expectation
from models.arrays import BoolArray, FloatArray, IntArray
from models.machine import Machine, assumed_modes

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

    def to_dict(self) -> dict[str, Any]:
        """Return its JSON object."""
        return {
            "mean_um": self.mean_um,  # over the Monte-Carlo plants
            "median_um": self.median_um,  # over the Monte-Carlo plants
            "worst_um": self.worst_um,  # of the Monte-Carlo plants
            "contour_rms_um": list(self.contour_rms_um),  # list of numbers: one for each
        }


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

    def to_dict(self) -> dict[str, Any]:
        """Return the method's object in the JSON of `ffcomp compare`."""
        values = {
            **to_json(self.track),  # … TRACK: its keys stand here too, of all samples
            "label": self.label,  # for people
            "family": self.family,  # none, calibrated, best fixed or inversion
            "tuning": self.tuning,  # the chosen parameters, and how
            "extruding": self.extruding,  # TRACK: where plastic flows only
            "by_layer": self.by_layer,  # .* ERROR: by the layer's number
            "by_feature": self.by_feature,  # .* ERROR: by the slicer's feature names
            # number or null: residual ringing while the reference cruises straight
            "residual_rms_um": self.residual_rms_um,
            "peaks": self.peaks,
            # SPREAD or null: on printers that are not as the file says; null without `--mismatch`
            "mismatch": None if self.spread is None else self.spread.to_dict(),
            # SPREAD or null: the same with a shaper's frequencies sought again on each
            "mismatch_retuned": None if self.retuned is None else self.retuned.to_dict(),
            # QUALITY or null: how fast the method could go; null with `--quality-um 0`
            "equal_quality": self.equal_quality,
            "warnings": self.warnings,  # list of text
        }
        return dict(to_json(values))


@dataclass(frozen=True, slots=True)
class Layer:
    """An evaluated layer."""

    number: int  # from 0; those that were evaluated
    z_mm: float
    begin_t: float  # number [s]: on the plan's clock
    end_t: float  # number [s]


@dataclass(frozen=True, slots=True)
class Party:
    """A machine file of the comparison."""

    name: str  # the machine file's `name`
    sha256: str  # of the file's bytes
    effects: tuple[str, ...] = ()  # its effects
    assumed: str | None = None  # as of a MACHINE

    @classmethod
    def of(cls, machine: Machine) -> Party:
        """Copy a machine file's identity."""
        return cls(machine.name, machine.sha256, tuple(machine.effects), assumed_modes(machine))


@dataclass(frozen=True, eq=False)
class Comparison:
    """A comparison: all that the JSON, the report and the figures are made of."""

    print_name: str
    print_sha256: str
    print_time_s: float  # of the whole print, as the firmware plans it
    layers_total: int
    sampling: str  # a sentence: the part of the print that was evaluated
    machine: Party  # the one that every method uses
    plant: Party  # the one that evaluated them
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

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object of `ffcomp compare`, without samples (ffcomp-compare/1)."""
        values = {
            "schema": "ffcomp-compare/1",
            "input": self.print_name,
            "input_sha256": self.print_sha256,  # of the print
            "version": self.version,  # of ffcomp
            "machine": self.machine,  # PARTY: what every method believes
            "plant": self.plant,  # PARTY: what evaluated them
            "sampling": self.sampling,  # what part of the print was evaluated
            "mismatch": self.mismatch,  # which Monte-Carlo plants; empty without `--mismatch`
            "settings": self.settings,  # .* text: as used
            "limits": self.limits,  # .* number [mm/s, mm/s²]: of the carriages' commands
            "print_time_s": self.print_time_s,  # of the whole print
            # number or null: of most of the outer walls, or of all that extrudes; null if the print sets none
            "acceleration_mm_per_s2": self.acceleration_mm_per_s2,
            "layers": self.layers,
            # the fixed shaper with the least contour error where plastic flows, a name in `methods`
            "best_fixed": self.best_fixed,
            # the name in `methods` of what `compensate` writes with this machine file: fbs-robust or fbs-lpv
            "ours": self.compensated,
            "quality_bound_um": self.quality_bound_um,  # what `equal_quality` holds
            **(
                {
                    # .* TRACK: uncompensated and compensated: of the whole print on the design model, the numbers of
                    # `compensate` and `show`; missing for prints beyond 10 minutes and with effects that are not in the
                    # linear model
                    "predicted": self.predicted
                }
                if self.predicted
                else {}
            ),
            # EXPECTATION or null: on printers that the machine file's `[uncertainty]` allows
            "expected": self.expected,
            # true or false: whether `compensate` inverts robustly by default with this machine file
            "robust_by_default": self.robust.robust,
            "robust_reason": self.robust.reason,  # why, or why not
            # .* METHOD: by name: none, zv, …, zv-calibrated, …, fbs-lti, fbs-robust, fbs-lpv
            "methods": {name: method.to_dict() for name, method in self.methods.items()},
            "seconds": self.seconds,  # number [s]: that it took
        }
        return dict(to_json(values))
