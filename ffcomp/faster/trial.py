"""What a section's moves would demand, were they played."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ffcomp.planner.trajectory import Trajectory
from models.arrays import FloatArray, IntArray

FELT_S = (0.03, 0.012)  # moves are held responsible for what comes so much after them, or before them


def _not_known() -> FloatArray:
    return np.empty(0)


def _no_counts() -> IntArray:
    return np.empty((0, 0), dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Demand:
    """What each move asks for, as a share of what it may, (n,)."""

    acceleration: FloatArray  # the error, acceleration and travel
    speed: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A section's plan, and the response of its command."""

    plan: Trajectory
    t0: float  # s on the plan's clock: the first moment
    step_s: float
    error: FloatArray  # (m,) times the bound, at the quantile at each moment by itself
    counts: IntArray = field(default_factory=_no_counts)  # of moments, by the printer and its error
    limits_t0: float = 0.0  # s: the beginning of the first segment
    segment_s: float = 1.0
    by_acceleration: FloatArray = field(default_factory=_not_known)  # (k,) of the carriages' limits, by the segment
    by_speed: FloatArray = field(default_factory=_not_known)  # (k,)

    @property
    def errors(self) -> FloatArray:
        """The largest error that each move is responsible for, times the bound, (n,)."""
        return self._largest(self.error, self.step_s, self.t0)

    @property
    def acceleration_limits(self) -> FloatArray:
        """What each move demands of the carriages' acceleration and travel, (n,)."""
        return self._largest(self.by_acceleration, self.segment_s, self.limits_t0)

    def demand(self, level: float) -> Demand:
        """Return what moves demand if the error may be so many times the bound."""
        error, nothing = self.errors / level, np.zeros(len(self.plan))
        if not len(self.by_speed):
            return Demand(error, nothing)
        by_speed = self._largest(self.by_speed, self.segment_s, self.limits_t0)
        return Demand(np.maximum(error, self.acceleration_limits), by_speed)

    def _largest(self, samples: FloatArray, step_s: float, t0: float) -> FloatArray:
        """Return the largest of the samples (m,), a step apart, that each move is responsible for, (n,)."""
        plan, (after_s, before_s) = self.plan, FELT_S
        begin, end = plan.start_t - before_s - t0, plan.start_t + plan.duration + after_s - t0
        first = np.clip(np.floor(begin / step_s).astype(np.int64), 0, len(samples) - 1)
        last = np.clip(np.ceil(end / step_s).astype(np.int64), first + 1, len(samples))
        padded = np.append(samples, -np.inf)
        return np.asarray(np.maximum.reduceat(padded, np.column_stack([first, last]).ravel())[::2])
