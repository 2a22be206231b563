"""How the inversion is discretised and how much command it may spend."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from ffcomp.planner.segment_timing import OutputLimits

Backend = Literal["osqp", "piqp", "clarabel"]  # solvers of quadratic programmes


@dataclass(frozen=True, slots=True)
class Settings:
    segment_s: float = 0.004  # S, one G1
    rows_per_segment: int = 2  # where the error is weighed
    substeps: int = 4  # of the simulation, per segment
    commit: int = 64  # segments kept of each window of the exact inverse
    preview: int = 24  # segments looked ahead there, thrown away
    bandwidth_hz: float = 100.0  # where accuracy is given up for a gentler command
    lead_s: float = 0.008  # how long before the path's start the command may begin
    tail_s: float = 0.004  # how long after the path's end the command comes to rest
    corrections: int = 1  # of the exact inverse, by the segments as they are played
    inverse: Literal["fast", "exact"] = "fast"
    robust: bool = False  # what is best over the machine file's uncertainties is wanted, not the path
    memory: int = 60  # segments after which the plant has forgotten (1 % is left after 240 ms)
    slow_down: bool = True  # where limits do not let the nozzle follow, the plan becomes slower
    tolerance_um: float = 25.0  # by which a held limit may take the nozzle off its path before that
    strict: bool = False  # an error instead
    s_curve: bool = False  # the plan's ramps with limited jerk
    solver: Backend = "osqp"  # of the quadratic programmes where a limit binds
    one_model: bool = False  # the bed's middle everywhere, as methods do that know no place
    merge_um: float = 0.2  # segments are joined while what is played stays this close to what was solved
    longest_merged_s: float = 0.1  # and no longer than this, so that the firmware's clock is kept in short steps
    output: OutputLimits = field(default_factory=OutputLimits)
