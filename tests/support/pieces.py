"""A plan as the pieces of a path: the path that steps and hosts are compared on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ffcomp.planner.trajectory import Trajectory
from ffcomp.steps.crossings import Pieces

CHUNK_MOVES = 4096


def trajectory_pieces(
    trajectory: Trajectory, shift_t: float = 0.0, first: int = 0, last: int | None = None
) -> Iterator[Pieces]:
    """Yield a plan's phases, in chunks; the plan's clock begins at `shift_t` s.

    first, last : the moves that are wanted
    """
    last = len(trajectory) if last is None else last
    for begin in range(first, last, CHUNK_MOVES):
        yield _phases(trajectory, slice(begin, min(begin + CHUNK_MOVES, last)), shift_t)


def _phases(trajectory: Trajectory, part: slice, shift_t: float) -> Pieces:
    """Speeding up, cruising and braking of each move, in this order; phases that take no time are left out."""
    moves = len(trajectory.start_t[part])
    duration = np.column_stack([trajectory.accel_t[part], trajectory.cruise_t[part], trajectory.decel_t[part]])
    speed = np.column_stack([trajectory.start_v[part], trajectory.cruise_v[part], trajectory.cruise_v[part]])
    gain = trajectory.acceleration[part, None] * np.array([1.0, 0.0, -1.0])
    path = (speed + 0.5 * gain * duration) * duration
    before = np.hstack([np.zeros((moves, 1)), np.cumsum(path, axis=1)[:, :2]])
    elapsed = np.hstack([np.zeros((moves, 1)), np.cumsum(duration, axis=1)[:, :2]])
    kept = (duration > 0.0).ravel()
    direction = np.repeat(trajectory.direction[part], 3, axis=0)[kept]
    return Pieces(
        start_t=(trajectory.start_t[part, None] + elapsed + shift_t).ravel()[kept],
        duration=duration.ravel()[kept],
        origin=np.repeat(trajectory.origin[part], 3, axis=0)[kept] + direction * before.ravel()[kept, None],
        direction=direction,
        start_v=speed.ravel()[kept],
        acceleration=gain.ravel()[kept],
    )
