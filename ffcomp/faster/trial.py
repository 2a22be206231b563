"""What a section's moves would demand, were they played."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.planner.trajectory import Trajectory
from models.arrays import FloatArray

FELT_S = (0.03, 0.012)  # moves are held responsible for what comes so much after them, or before them


@dataclass(frozen=True, slots=True)
class Demand:
    """What each move asks for, as a share of what it may, (n,)."""

    acceleration: FloatArray  # the error, acceleration and travel
    speed: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A section's plan, and the response of its command."""

    plan: Trajectory
    t0: float  # s on the plan's clock: the first knot
    step_s: float
    segment_s: float
    error: FloatArray  # (m,) times the bound, after each step
    by_acceleration: FloatArray  # (k,) of the carriages' limits, by the segment
    by_speed: FloatArray  # (k,)

    def demand(self, level: float) -> Demand:
        """Return what moves demand if the error may be so many times the bound."""
        error = self._largest(self.error, self.step_s) / level
        acceleration = np.maximum(error, self._largest(self.by_acceleration, self.segment_s))
        return Demand(acceleration, self._largest(self.by_speed, self.segment_s))

    def _largest(self, samples: FloatArray, step_s: float) -> FloatArray:
        """Return the largest of the samples (m,), a step apart, that each move is responsible for, (n,)."""
        plan, (after_s, before_s) = self.plan, FELT_S
        begin, end = plan.start_t - before_s - self.t0, plan.start_t + plan.duration + after_s - self.t0
        first = np.clip(np.floor(begin / step_s).astype(np.int64), 0, len(samples) - 1)
        last = np.clip(np.ceil(end / step_s).astype(np.int64), first + 1, len(samples))
        padded = np.append(samples, -np.inf)
        return np.asarray(np.maximum.reduceat(padded, np.column_stack([first, last]).ravel())[::2])
