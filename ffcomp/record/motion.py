"""The command of one experiment: moves from rest to rest, and the limits under which the firmware plans them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ffcomp.errors import LimitsError
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import plan_moves
from ffcomp.planner.segment_timing import SegmentLimits, SegmentSpeeds, segment_speeds
from ffcomp.planner.trajectory import Trajectory
from gcode.emit import F_COUNTS
from gcode.program import Moves
from models.arrays import BoolArray, FloatArray

LIMIT_COLUMNS = ("velocity_limit", "acceleration", "square_corner_velocity", "minimum_cruise_ratio")
"""Columns of `gcode.program.Moves` that state a single move's limits; NaN where it has none."""

LARGEST_DELAY_S = 5e-5  # of a knot: reached later, it demands too much
FEED_COUNTS = 60 * F_COUNTS  # of F, in one mm/s


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
    move_limits: FloatArray  # (n, 4) columns `LIMIT_COLUMNS`; NaN: as `limits`
    stop_before: BoolArray  # (n,) the motion rests before the move
    wait_before: FloatArray  # (n,) s at rest before the move

    @cached_property
    def trajectory(self) -> Trajectory:
        """The nozzle's motion as the firmware executes the moves; it begins at zero."""
        starts = np.vstack([self.start_mm[None], self.ends_mm[:-1]])
        zeros = np.zeros(len(self.speed), dtype=np.int64)
        moves = Moves(zeros, starts, self.ends_mm, self.speed, zeros, *np.ascontiguousarray(self.move_limits.T))
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
    """Build a motion without filament, waits and limits of single moves: through (n + 1, 3) mm at (n,) mm/s."""
    n = len(speed)
    places = np.column_stack([vertices_mm, np.zeros(n + 1)])
    nothing = np.full((n, len(LIMIT_COLUMNS)), np.nan)
    return Motion(places[0], places[1:], speed, limits, nothing, np.zeros(n, dtype=np.bool_), np.zeros(n))


# Segments of equal duration


def segment_motion(vertices_mm: FloatArray, segment_s: float, output: SegmentLimits) -> Motion:
    """Build the motion through (n + 1, 3) mm in which every segment lasts S, as the firmware executes it.

    Raises
    ------
    LimitsError
        Knots that the firmware's acceleration cannot reach in time.
    """
    n = len(vertices_mm) - 1
    speeds = segment_speeds(vertices_mm, np.zeros(n), np.full(n, segment_s), output)
    written = _as_written(np.linalg.norm(np.diff(vertices_mm, axis=0), axis=1), speeds)
    limits = PlannerLimits(
        velocity_mm_per_s=output.velocity_mm_per_s,
        acceleration_mm_per_s2=output.acceleration_mm_per_s2,
        square_corner_velocity_mm_per_s=output.square_corner_velocity_mm_per_s,
        minimum_cruise_ratio=0.0,
        z_acceleration_mm_per_s2=output.z_acceleration_mm_per_s2,
    )
    trajectory = plain_motion(vertices_mm, written, limits).trajectory
    delay = np.abs(trajectory.start_t + trajectory.duration - segment_s * np.arange(1, n + 1)).max()
    if delay > LARGEST_DELAY_S:
        raise LimitsError(
            f"Segments of {1e3 * segment_s:.2f} ms would come up to {1e3 * delay:.2f} ms late: the "
            f"firmware's own acceleration in Z, {output.z_acceleration_mm_per_s2:g} mm/s², is too low for them."
        )
    return plain_motion(vertices_mm, np.asarray(trajectory.cruise_v), limits)


def _as_written(length: FloatArray, speeds: SegmentSpeeds) -> FloatArray:
    """Round speeds to F, (n,) mm/s: each segment makes up for the delay that rounding gave the one before."""
    delay, written = 0.0, []
    columns = (length, speeds.cruise, speeds.acceleration, speeds.duration, speeds.junction[:-1], speeds.junction[1:])
    for d, cruise, a, duration, before, after in zip(*(column.tolist() for column in columns), strict=True):
        c = max(round(cruise * (1.0 + delay / duration) * FEED_COUNTS), 1) / FEED_COUNTS
        ramps = (c - min(before, c)) ** 2 + (c - min(after, c)) ** 2
        delay += (d + ramps / (2.0 * a)) / c - duration
        written.append(c)
    return np.array(written)
