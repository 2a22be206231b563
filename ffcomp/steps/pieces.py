"""What steps are made from: straight pieces of path, each with one acceleration.

A piece goes from its origin o along d, by s(τ) = v τ + a τ²/2 after the time τ: the nozzle is at o + d s, and so is the
filament. Nothing but the product counts, so s need not be a length: for knots it is the time itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ffcomp.planner.trajectory import Trajectory
from models.arrays import FloatArray

CHUNK_MOVES = 4096
GRID_MM = 2.0**-13  # 0.12 µm, a hundredth of a microstep: a command's knots lie on it, whatever is written of them


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """n pieces in order of time; between two of them the nozzle rests. It never moves backwards along a piece."""

    start_t: FloatArray  # (n,) s
    duration: FloatArray  # (n,) s
    origin: FloatArray  # (n, 4) mm, columns X Y Z E
    direction: FloatArray  # (n, 4) mm per unit of path
    start_v: FloatArray  # (n,) units of path per s
    acceleration: FloatArray  # (n,) units of path per s²

    def __len__(self) -> int:
        return len(self.start_t)

    def __getitem__(self, part: slice) -> Pieces:
        return Pieces(*(column[part] for column in self.columns))

    @property
    def columns(self) -> tuple[FloatArray, ...]:
        """All of them, in their order."""
        return self.start_t, self.duration, self.origin, self.direction, self.start_v, self.acceleration

    @property
    def path(self) -> FloatArray:
        """How far each piece goes, (n,) units of path."""
        return (self.start_v + 0.5 * self.acceleration * self.duration) * self.duration

    @property
    def end(self) -> FloatArray:
        """Where each piece ends, (n, 4) mm."""
        return self.origin + self.direction * self.path[:, None]


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


def on_grid(places: FloatArray) -> FloatArray:
    """Round coordinates to the grid of commands: a file of motion and step timings then tell of the same path."""
    return np.rint(places / GRID_MM) * GRID_MM


def knot_pieces(start_t: float, spacing_s: float, vertices: FloatArray, filament: FloatArray) -> Pieces:
    """Straight lines at constant speed from knot to knot, `spacing_s` apart in time.

    vertices : (n + 1, 3) mm, columns X Y Z;  filament : (n + 1,) mm
    """
    corners = np.column_stack([vertices, filament])
    n = len(corners) - 1
    return Pieces(
        start_t=start_t + spacing_s * np.arange(n, dtype=np.float64),
        duration=np.full(n, spacing_s),
        origin=corners[:-1],
        direction=np.diff(corners, axis=0) / spacing_s,  # the path is counted in seconds
        start_v=np.ones(n),
        acceleration=np.zeros(n),
    )
