"""The result of a comparison at equal error: how long each method takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ffcomp.compare.result import Family, Party
from ffcomp.numerics.serialise import to_json
from models.arrays import FloatArray

FASTER, KNOWN = "faster", "faster-known"  # names of the prints that ffcomp makes quicker: the second trusts the file


@dataclass(frozen=True, eq=False)
class Piece:
    """One evaluated slice of the print, k samples along its path."""

    begin_s: float  # on the clock of the print as sliced
    seconds: float
    p99_um: float
    distance_mm: FloatArray  # (k,)
    speed_mm_per_s: FloatArray  # (k,)
    error_um: FloatArray  # (k,)


@dataclass(frozen=True, eq=False)
class Contender:
    """One method at the error that all may have."""

    name: str
    label: str
    family: Family
    tuning: str
    print_time_s: float  # of the whole print
    by_feature_s: dict[str, float]  # where it goes
    contour_rms_um: float
    contour_p99_um: float
    contour_max_um: float
    reached: bool  # the bound
    pieces: tuple[Piece, ...]
    feed: float | None = None  # times the slicer's
    acceleration_mm_per_s2: float | None = None
    limited_by: dict[str, float] = field(default_factory=dict)  # s
    off_p99_um: tuple[float, ...] = ()  # on each Monte-Carlo plant
    by_feature_p99_um: dict[str, float] = field(default_factory=dict)  # where plastic flows
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return its object in the JSON of `ffcomp compare --equal-quality`."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "pieces"}
        found: dict[str, Any] = to_json(values)
        return found


@dataclass(frozen=True, eq=False)
class Quickest:
    """What a print takes at equal error."""

    print_name: str
    print_sha256: str
    machine: Party
    plant: Party
    version: str
    bound_um: float
    max_flow_mm3_per_s: float | None  # None: no move of the print names a flow
    min_layer_time_s: float
    sampling: str  # a sentence: the part of the print that was evaluated
    whole: bool  # all of it was
    sliced: Contender  # as it is, without compensation
    contenders: dict[str, Contender]
    actuator_limit_s: float
    seconds: float
    mismatch: str = ""  # a sentence, empty without Monte-Carlo plants

    @property
    def faster(self) -> Contender:
        """The print that ffcomp makes quicker."""
        return self.contenders[FASTER]

    @property
    def known(self) -> Contender:
        """The same for a machine that is just as its file says."""
        return self.contenders[KNOWN]

    @property
    def best_shaper(self) -> Contender:
        """The shaper that is quickest at that error; if none keeps it, the one that comes nearest."""
        shapers = [each for each in self.contenders.values() if each.family == "best fixed"]
        return min(shapers, key=lambda each: each.print_time_s if each.reached else 1e9 + each.contour_p99_um)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object ffcomp-equal-quality/1."""
        values = {
            "schema": "ffcomp-equal-quality/1",
            "input": self.print_name,
            "input_sha256": self.print_sha256,
            "version": self.version,
            "machine": self.machine,
            "plant": self.plant,
            "bound_um": self.bound_um,
            "max_flow_mm3_per_s": self.max_flow_mm3_per_s,
            "min_layer_time_s": self.min_layer_time_s,
            "sampling": self.sampling,
            "mismatch": self.mismatch,
            "whole": self.whole,
            "print_time_s": self.sliced.print_time_s,
            "actuator_limit_s": self.actuator_limit_s,
            "best_shaper": self.best_shaper.name,
            "sliced": self.sliced.to_dict(),
            "methods": {name: each.to_dict() for name, each in self.contenders.items()},
            "seconds": self.seconds,
        }
        found: dict[str, Any] = to_json(values)
        return found
