"""The planned motion: a trapezoid of speed per move, on the straight line of the move, exact at any time.

The inverse solves one section at a time, from rest to rest without an extruder-only move or a stop inside. Between
sections the command rests, exactly on the path, and the file's other lines (homing, waits, retractions, macros) are
executed there.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import kernel

POSITION, VELOCITY, ACCELERATION = 0, 1, 2  # which derivative is sampled
_NEAR_MOVES = 8  # how far to step through the moves before searching


@dataclass(frozen=True, slots=True)
class Trajectory:
    """n planned moves in time order, each a trapezoid of speed. mm, s, mm/s, mm/s².

    Between two moves there may be a gap (a dwell, a wait): the nozzle rests there at the end of the earlier
    move. Before the first move it rests at its origin, after the last one at its end. Speed and acceleration
    at an instant are those just after it.
    """

    start_t: FloatArray  # (n,) s, when the move begins
    accel_t: FloatArray  # (n,) s
    cruise_t: FloatArray  # (n,) s
    decel_t: FloatArray  # (n,) s
    start_v: FloatArray  # (n,) mm/s along the path
    cruise_v: FloatArray  # (n,)
    end_v: FloatArray  # (n,)
    acceleration: FloatArray  # (n,) mm/s² along the path, of the accel and decel phases
    origin: FloatArray  # (n, 4) mm, columns X Y Z E: where the move begins
    direction: FloatArray  # (n, 4) mm per mm of path, columns X Y Z E; extruder-only: XYZ zero and E ±1

    def __len__(self) -> int:
        return len(self.start_t)

    @property
    def duration(self) -> FloatArray:
        """How long each move takes, (n,) s."""
        return self.accel_t + self.cruise_t + self.decel_t

    @property
    def end_t(self) -> float:
        """When the last move ends, s; 0 if there is none."""
        return float(self.start_t[-1] + (self.accel_t[-1] + self.cruise_t[-1] + self.decel_t[-1])) if len(self) else 0.0

    @property
    def travels(self) -> BoolArray:
        """Which moves travel, (n,): the others are the extruder's alone."""
        return np.asarray(np.any(self.direction[:, :3] != 0.0, axis=1))

    @property
    def extrudes(self) -> BoolArray:
        """Which moves extrude along a path, (n,)."""
        return np.asarray(self.travels & (self.direction[:, 3] > 0.0))

    def part(self, which: slice | BoolArray) -> Trajectory:
        """Return some of the moves, on the same clock: nothing else has a place at any time."""
        return Trajectory(*(getattr(self, each.name)[which] for each in fields(Trajectory)))

    def move_at(self, t: ArrayLike) -> IntArray:
        """Return the move under way at each time t, or the last one before it; the first one before it has begun."""
        return np.maximum(np.searchsorted(self.start_t, t, side="right") - 1, 0)

    def position(self, t: ArrayLike) -> FloatArray:
        """Return positions (k, 4) mm, columns X Y Z E, at times t (k,) s, best sorted."""
        return self._sampled(t, POSITION)

    def velocity(self, t: ArrayLike) -> FloatArray:
        """Return velocities (k, 4) mm/s, columns X Y Z E, at times t (k,) s, best sorted."""
        return self._sampled(t, VELOCITY)

    def acceleration_at(self, t: ArrayLike) -> FloatArray:
        """Return accelerations (k, 4) mm/s², columns X Y Z E, at times t (k,) s, best sorted."""
        return self._sampled(t, ACCELERATION)

    def motion_within(self, t: FloatArray, begin_t: float, end_t: float) -> tuple[FloatArray, FloatArray]:
        """Return the nozzle and its velocity, (k, 3) mm and mm/s, as if it rested before `begin_t` and from `end_t` on.

        t : (k,) s, sorted
        """
        return _sample_within(t, begin_t, end_t, self.start_t, self._phases, self.origin, self.direction)

    def _sampled(self, t: ArrayLike, derivative: int) -> FloatArray:
        if not len(self):
            raise ValueError("A trajectory without moves has no place at any time; plan at least one move.")
        t = np.ascontiguousarray(t, dtype=np.float64)
        return _sample(t, derivative, self.start_t, self._phases, self.origin, self.direction)

    @property
    def _phases(self) -> tuple[FloatArray, ...]:
        return (self.accel_t, self.cruise_t, self.decel_t, self.start_v, self.cruise_v, self.end_v, self.acceleration)


@kernel
def move_near(start_t: FloatArray, t: float, i: int) -> int:
    """Find the last move that begins at or before t (the first one if none does), from move i on."""
    if t < start_t[i] or (i + _NEAR_MOVES < len(start_t) and start_t[i + _NEAR_MOVES] <= t):
        return max(int(np.searchsorted(start_t, t, side="right")) - 1, 0)
    while i + 1 < len(start_t) and start_t[i + 1] <= t:
        i += 1
    return i


@kernel
def _along(
    derivative: int,
    since: float,
    accel_t: float,
    cruise_t: float,
    decel_t: float,
    start_v: float,
    cruise_v: float,
    end_v: float,
    acceleration: float,
) -> float:
    """Distance, speed or acceleration along a move at the time `since` its beginning."""
    t1 = min(max(since, 0.0), accel_t)
    t2 = min(max(since - accel_t, 0.0), cruise_t)
    t3 = min(max(since - accel_t - cruise_t, 0.0), decel_t)
    if derivative == POSITION:
        rise = (start_v + 0.5 * acceleration * t1) * t1
        return rise + cruise_v * (t2 + t3) - 0.5 * acceleration * t3 * t3
    over = since >= accel_t + cruise_t + decel_t
    if derivative == VELOCITY:
        return end_v if over else start_v + acceleration * (t1 - t3)
    if over or since < 0.0 or (since >= accel_t and since < accel_t + cruise_t):
        return 0.0
    return acceleration if since < accel_t else -acceleration


@kernel
def _sample(
    t: FloatArray,
    derivative: int,
    start_t: FloatArray,
    phases: tuple[FloatArray, ...],
    origin: FloatArray,
    direction: FloatArray,
) -> FloatArray:
    # NOTE: single numbers are handed to `_along`: arrays would be reference-counted at every sample.
    accel_t, cruise_t, decel_t, start_v, cruise_v, end_v, acceleration = phases
    out = np.empty((len(t), 4))
    i = np.int64(0)
    for k in range(len(t)):
        i = move_near(start_t, t[k], i)
        phase = (accel_t[i], cruise_t[i], decel_t[i], start_v[i], cruise_v[i], end_v[i], acceleration[i])
        along = _along(derivative, t[k] - start_t[i], *phase)
        for c in range(4):
            out[k, c] = direction[i, c] * along
            if derivative == POSITION:
                out[k, c] += origin[i, c]
    return out


@kernel
def _sample_within(
    t: FloatArray,
    begin_t: float,
    end_t: float,
    start_t: FloatArray,
    phases: tuple[FloatArray, ...],
    origin: FloatArray,
    direction: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    accel_t, cruise_t, decel_t, start_v, cruise_v, end_v, acceleration = phases
    nozzle, velocity = np.empty((len(t), 3)), np.zeros((len(t), 3))
    last = np.nextafter(end_t, -np.inf)  # at end_t itself another motion may have begun, somewhere else
    i = 0
    for k in range(len(t)):
        at = min(max(t[k], begin_t), last)
        i = move_near(start_t, at, i)
        phase = (accel_t[i], cruise_t[i], decel_t[i], start_v[i], cruise_v[i], end_v[i], acceleration[i])
        along = _along(POSITION, at - start_t[i], *phase)
        for c in range(3):
            nozzle[k, c] = direction[i, c] * along + origin[i, c]
        if t[k] >= begin_t and t[k] < end_t:
            speed = _along(VELOCITY, at - start_t[i], *phase)
            for c in range(3):
                velocity[k, c] = direction[i, c] * speed
    return nozzle, velocity


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


@dataclass(frozen=True, slots=True)
class Section:
    """Consecutive moves of a plan, from rest to rest."""

    first: int  # moves first..last-1
    last: int
    travels: bool  # False: one extruder-only move
    begin_t: float  # s, on the plan's clock
    end_t: float


def split_sections(trajectory: Trajectory, stop_before: BoolArray) -> list[Section]:
    """Return the plan's sections in order; moves that go nowhere and take no time belong to the one they stand in."""
    travels = trajectory.travels
    extrudes = ~travels & (trajectory.direction[:, 3] != 0.0)
    edge = stop_before | extrudes
    edge[1:] |= extrudes[:-1]
    edge[:1] = True
    starts = np.flatnonzero(edge)
    ends = np.append(starts[1:], len(trajectory))
    end_t = trajectory.start_t + trajectory.duration
    return [
        Section(int(a), int(b), bool(travels[a:b].any()), float(trajectory.start_t[a]), float(end_t[b - 1]))
        for a, b in zip(starts, ends, strict=True)
        if travels[a:b].any() or extrudes[a]
    ]
