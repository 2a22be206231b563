"""Positions on a program's path, and when a plan passes them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffcomp.planner.trajectory import Trajectory


class PathPosition(NamedTuple):
    """A position on a program's path, independent of its plan."""

    move: int
    along_mm: float  # from the move's beginning

    def time_in(self, plan: Trajectory) -> float:
        """Return when the plan passes the position, s on the plan's clock."""
        i, along = self.move, self.along_mm
        start, cruise, end = plan.start_v[i], plan.cruise_v[i], plan.end_v[i]
        rise, fall = 0.5 * (start + cruise) * plan.accel_t[i], 0.5 * (cruise + end) * plan.decel_t[i]
        left = rise + cruise * plan.cruise_t[i] + fall - along
        if along < rise:
            since = _ramp_s(along, start, plan.acceleration[i])
        elif left < fall:
            duration = plan.accel_t[i] + plan.cruise_t[i] + plan.decel_t[i]
            since = duration - _ramp_s(left, end, plan.acceleration[i])
        else:
            since = plan.accel_t[i] + (along - rise) / cruise
        return float(plan.start_t[i] + since)


def _ramp_s(length: float, v: float, acceleration: float) -> float:
    """Return how long a ramp takes for a length from a speed on; mm, mm/s, mm/s²."""
    return float(2.0 * length / (v + np.sqrt(v**2 + 2.0 * acceleration * length))) if length > 0.0 else 0.0
