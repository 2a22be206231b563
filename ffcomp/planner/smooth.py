"""A planned motion whose ramps are S-curves: limited jerk, on the very lines of the moves, exact at any time.

A ramp of duration T between two speeds has the acceleration of a symmetric trapezoid: it rises linearly over the jerk
time τ, stays at its plateau A, and falls linearly again (the seven-segment profile, Biagiotti & Melchiorri, Trajectory
Planning for Automatic Machines and Robots, 2008, section 3.4). Since u ago it began, it has gained

    w(u) = A u² / 2τ          for u ≤ τ            X(u) = A u³ / 6τ
           A (u - τ/2)        up to the middle            A (u²/2 - u τ/2 + τ²/6)

in speed and in distance beyond that of its low speed, and its second half mirrors the first: it gains A (T - τ) in
speed, and lasts and reaches as far as constant acceleration between the same speeds over the same time. A ramp of
braking is one of speeding up, played backwards. A ramp may span many moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.planner.trajectory import ACCELERATION, POSITION, VELOCITY, PlannedMotion, move_near
from models.arrays import FloatArray
from models.compiled import kernel

LOW, PLATEAU, JERK_T, LASTING, GONE = range(5)  # columns of a ramp as a move sees it


@dataclass(frozen=True, slots=True)
class SmoothTrajectory(PlannedMotion):
    """n planned moves in time order, each with S-curves of speed. mm, s, mm/s, mm/s².

    A move speeds up for `accel_t` in its part of one ramp, cruises, and brakes for `decel_t` in its part of another.
    A ramp's columns: speed at its slow end mm/s, plateau A mm/s², jerk time τ s, duration T s, and how long it has gone
    on, counted from its slow end, outside this move.
    """

    start_t: FloatArray  # (n,) s, when the move begins
    accel_t: FloatArray  # (n,) s
    cruise_t: FloatArray  # (n,) s
    decel_t: FloatArray  # (n,) s
    cruise_v: FloatArray  # (n,) mm/s along the path, the highest of the move
    rise: FloatArray  # (n, 5) the ramp that the move speeds up in
    fall: FloatArray  # (n, 5) the ramp that it brakes in
    origin: FloatArray  # (n, 4) mm, columns X Y Z E: where the move begins
    direction: FloatArray  # (n, 4) mm per mm of path, columns X Y Z E; extruder-only: XYZ zero and E ±1

    @property
    def start_v(self) -> FloatArray:
        """(n,) mm/s along the path."""
        return np.where(self.accel_t > 0.0, speeds(self.rise, np.zeros(len(self))), self.cruise_v)

    @property
    def end_v(self) -> FloatArray:
        """(n,) mm/s along the path."""
        return np.where(self.decel_t > 0.0, speeds(self.fall, np.zeros(len(self))), self.cruise_v)

    def _sample(self, t: FloatArray, derivative: int) -> FloatArray:
        phases = (self.accel_t, self.cruise_t, self.decel_t, self.cruise_v)
        return _sample(t, derivative, self.start_t, phases, self.rise, self.fall, self.origin, self.direction)


@kernel
def gained_speed(u: float, plateau: float, jerk_t: float, lasting: float) -> float:
    """w(u) of a ramp, mm/s."""
    if u + u > lasting:
        return plateau * (lasting - jerk_t) - _gained_speed_first(max(lasting - u, 0.0), plateau, jerk_t)
    return _gained_speed_first(u, plateau, jerk_t)


@kernel
def _gained_speed_first(u: float, plateau: float, jerk_t: float) -> float:
    """w(u) in the first half."""
    return 0.5 * plateau * u * u / jerk_t if u < jerk_t else plateau * (u - 0.5 * jerk_t)


@kernel
def gained_distance(u: float, plateau: float, jerk_t: float, lasting: float) -> float:
    """X(u) of a ramp, mm."""
    if u + u > lasting:
        left = max(lasting - u, 0.0)
        return plateau * (lasting - jerk_t) * (0.5 * lasting - left) + _gained_distance_first(left, plateau, jerk_t)
    return _gained_distance_first(u, plateau, jerk_t)


@kernel
def _gained_distance_first(u: float, plateau: float, jerk_t: float) -> float:
    if u < jerk_t:
        return plateau * u * u * u / (6.0 * jerk_t)
    return plateau * (0.5 * u * (u - jerk_t) + jerk_t * jerk_t / 6.0)


@kernel
def _acceleration(u: float, plateau: float, jerk_t: float, lasting: float) -> float:
    edge = max(min(u, lasting - u), 0.0)
    return plateau * edge / jerk_t if edge < jerk_t else plateau


@kernel
def speeds(ramps: FloatArray, since: FloatArray) -> FloatArray:
    """Return the speed of each ramp (n, 5) at times (n,) s since its move entered it at the slow side, (n,) mm/s."""
    out = np.empty(len(ramps))
    for i in range(len(ramps)):
        u = ramps[i, GONE] + since[i]
        out[i] = ramps[i, LOW] + gained_speed(u, ramps[i, PLATEAU], ramps[i, JERK_T], ramps[i, LASTING])
    return out


@kernel
def _in_ramp(derivative: int, u: float, low: float, plateau: float, jerk_t: float, lasting: float) -> float:
    """Distance, speed or acceleration of a ramp, u after its slow end."""
    if derivative == POSITION:
        return low * u + gained_distance(u, plateau, jerk_t, lasting)
    if derivative == VELOCITY:
        return low + gained_speed(u, plateau, jerk_t, lasting)
    return _acceleration(u, plateau, jerk_t, lasting)


@kernel
def _sample(
    t: FloatArray,
    derivative: int,
    start_t: FloatArray,
    phases: tuple[FloatArray, ...],
    rise: FloatArray,
    fall: FloatArray,
    origin: FloatArray,
    direction: FloatArray,
) -> FloatArray:
    accel_t, cruise_t, decel_t, cruise_v = phases
    out = np.empty((len(t), 4))
    i = 0
    for k in range(len(t)):
        i = move_near(start_t, t[k], i)
        since = t[k] - start_t[i]
        up = (rise[i, LOW], rise[i, PLATEAU], rise[i, JERK_T], rise[i, LASTING])
        down = (fall[i, LOW], fall[i, PLATEAU], fall[i, JERK_T], fall[i, LASTING])
        lasting = (accel_t[i], cruise_t[i], decel_t[i])
        along = _along(derivative, since, lasting, cruise_v[i], rise[i, GONE], up, fall[i, GONE], down)
        for c in range(4):
            out[k, c] = direction[i, c] * along
            if derivative == POSITION:
                out[k, c] += origin[i, c]
    return out


@kernel
def _along(
    derivative: int,
    since: float,
    lasting: tuple[float, float, float],
    cruise_v: float,
    up_gone: float,
    up: tuple[float, float, float, float],
    down_gone: float,
    down: tuple[float, float, float, float],
) -> float:
    """Distance, speed or acceleration along a move at the time `since` its beginning."""
    accel_t, cruise_t, decel_t = lasting
    left = accel_t + cruise_t + decel_t - since
    if derivative == POSITION:
        t1, t3 = min(max(since, 0.0), accel_t), min(max(decel_t - left, 0.0), decel_t)
        along = cruise_v * min(max(since - accel_t, 0.0), cruise_t)
        if t1 > 0.0:
            along += _in_ramp(POSITION, up_gone + t1, *up) - _in_ramp(POSITION, up_gone, *up)
        if t3 > 0.0:
            whole = down_gone + decel_t
            along += _in_ramp(POSITION, whole, *down) - _in_ramp(POSITION, whole - t3, *down)
        return along
    if derivative == ACCELERATION and (since < 0.0 or left <= 0.0):
        return 0.0
    if since < accel_t:
        return _in_ramp(derivative, up_gone + max(since, 0.0), *up)
    if left <= decel_t and decel_t > 0.0:
        sign = -1.0 if derivative == ACCELERATION else 1.0
        return sign * _in_ramp(derivative, down_gone + max(left, 0.0), *down)
    return cruise_v if derivative == VELOCITY else 0.0
