"""The command of one experiment: moves from rest to rest, and the limits under which the firmware plans them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import plan_moves
from ffcomp.planner.trajectory import Trajectory
from gcode.program import Moves
from models.arrays import BoolArray, FloatArray

OWN = ("velocity_limit", "acceleration", "square_corner_velocity", "minimum_cruise_ratio")
"""Columns of `gcode.program.Moves` that state a move's own limits; NaN where it has none."""


class Commanded(Protocol):
    """A commanded motion of the nozzle from rest to rest, which begins at zero."""

    @property
    def duration_s(self) -> float:
        """From rest to rest."""

    def nozzle(self, t_s: FloatArray) -> FloatArray:
        """Return the nozzle at the times (k,) s: (k, 3) mm."""


@dataclass(frozen=True, eq=False)
class Motion:
    """n moves, each beginning where the one before ended. mm, mm/s, s."""

    start_mm: FloatArray  # (4,) columns X Y Z E
    ends_mm: FloatArray  # (n, 4) columns X Y Z E
    speed: FloatArray  # (n,) mm/s, as F states it
    limits: PlannerLimits  # of the firmware while it executes them
    own: FloatArray  # (n, 4) columns `OWN`; NaN: as `limits`
    stop_before: BoolArray  # (n,) the motion rests before the move
    wait_before: FloatArray  # (n,) s at rest before the move

    @cached_property
    def trajectory(self) -> Trajectory:
        """The nozzle's motion as the firmware executes the moves; it begins at zero."""
        starts = np.vstack([self.start_mm[None], self.ends_mm[:-1]])
        zeros = np.zeros(len(self.speed), dtype=np.int64)
        moves = Moves(zeros, starts, self.ends_mm, self.speed, zeros, *np.ascontiguousarray(self.own.T))
        return plan_moves(moves, self.limits, stop_before=self.stop_before, wait_before=self.wait_before)

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.trajectory.end_t

    def nozzle(self, t_s: FloatArray) -> FloatArray:
        """Return the nozzle's command at the times (k,) s: (k, 3) mm. It rests before and after."""
        return np.ascontiguousarray(self.trajectory.position(t_s)[:, :3])

    @property
    def vertices_mm(self) -> FloatArray:
        """The corners of the path, (n + 1, 3) mm."""
        return np.vstack([self.start_mm[None], self.ends_mm])[:, :3]


def plain_motion(vertices_mm: FloatArray, speed: FloatArray, limits: PlannerLimits) -> Motion:
    """Make a motion without filament, waits and limits of its own: through (n + 1, 3) mm at (n,) mm/s."""
    n = len(speed)
    places = np.column_stack([vertices_mm, np.zeros(n + 1)])
    nothing = np.full((n, len(OWN)), np.nan)
    return Motion(places[0], places[1:], speed, limits, nothing, np.zeros(n, dtype=np.bool_), np.zeros(n))
