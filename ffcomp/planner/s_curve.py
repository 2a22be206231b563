"""The same path with limited jerk and gentler peaks, slower by no more than a share that is given.

What a machine is asked for is greatest on few ramps and corners: the hardest travels, the sharpest turns. All of them
are held under one `level` of carriage acceleration, the lowest for which the print takes no longer than allowed: of
all plans on this path and in this time, about the one whose highest peak is least. Ramps begin and end at the same
places and speeds as planned with constant acceleration, and become S-curves (`smooth.py`) in between.

    ramp     mean acceleration a ≤ (1 - edge) level / g, never above the file's
             plateau A ≤ level / g, a / (1 - edge), and the highest acceleration of all
    corner   v / span + a / 2 ≤ level / c      what one segment of the command sees, the ramps on both sides included
             v² ≤ level l / c                  what a curve of short moves adds up to

with g the carriages' acceleration per acceleration along the path, c the change of the carriages' speed at a corner per
mm/s of path speed, l the distance between the middles of the corner's moves. Ramps to which the file gives the highest
acceleration of all are lowered as well, by as much of the edge as a part of the time allows.

A ramp is a part of the path on which the speed only rises. Braking is the same seen from the other end: every kernel
here is called a second time with all arrays reversed. As in `lookahead.py` speeds are squared where nothing else is
said, for v² grows linearly along the path.

Lines, rests and filament are the given plan's. Ramps lie at or below its speeds everywhere. Rounded, a ramp over many
moves runs a little ahead in its second half; it passes no junction faster than is known to be allowed there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ffcomp.planner.smooth import (
    GONE,
    JERK_T,
    LASTING,
    LOW,
    PLATEAU,
    SmoothTrajectory,
    gained_distance,
    gained_speed,
    speeds,
)
from ffcomp.planner.trajectory import Trajectory
from models.arrays import FloatArray, IntArray
from models.compiled import kernel

ROUNDING_RTOL = 1e-9  # relative; below it speeds, distances and accelerations count as equal
NEWTON_STEPS = 60  # never needed: each at least halves what is uncertain


@kernel
def sweep(
    length: FloatArray, corner: FloatArray, top: FloatArray, up: FloatArray, down: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Find the fastest v² from rest to rest: at the junctions (m + 1,), and the highest of each move (m,).

    length : (m,) mm;  corner : (m + 1,) and top : (m,) mm²/s², bounds of v²;  up, down : (m,) mm/s²
    """
    m = len(length)
    start, peak = np.zeros(m + 1), np.empty(m)
    reachable = 0.0
    for i in range(m):
        start[i] = min(corner[i], reachable)
        reachable = start[i] + 2.0 * length[i] * up[i]
    for i in range(m - 1, -1, -1):
        start[i] = min(start[i], start[i + 1] + 2.0 * length[i] * down[i])
        rise, fall = up[i] / (up[i] + down[i]), down[i] / (up[i] + down[i])
        meet = start[i] * fall + start[i + 1] * rise + 2.0 * up[i] * fall * length[i]
        peak[i] = max(min(meet, top[i]), start[i], start[i + 1])
    return start, peak


@kernel
def held_down(
    level: float, low: FloatArray, gain: FloatArray, turn: FloatArray, apart: FloatArray, span_s: float, share: float
) -> tuple[FloatArray, FloatArray]:
    """Accelerations (m,) mm/s² and v² at the junctions (m + 1,) mm²/s² that keep the carriages under the level.

    low : (m,) mm/s², what the accelerations may be at most;  share : of the level that a ramp may have on average
    gain : (m,), turn : (m + 1,), apart : (m + 1,) mm, as in `s_curve.py`
    """
    m = len(low)
    mean, corner = low.copy(), np.full(m + 1, np.inf)
    for i in range(m):
        if gain[i] > 0.0:
            mean[i] = min(low[i], share * level / gain[i])
    for i in range(1, m):
        if turn[i] > 0.0:
            per_turn = level / turn[i]
            alone = span_s * max(per_turn - 0.5 * max(mean[i - 1], mean[i]), 0.0)
            corner[i] = min(alone * alone, per_turn * apart[i])
    return mean, corner


# NOTE: single numbers are handed to the two questions below: arrays would be reference-counted at every move.


@kernel
def _rises(start: float, peak: float) -> bool:
    return peak > start * (1.0 + ROUNDING_RTOL)


@kernel
def _rises_to_its_end(length: float, start: float, peak: float, up: float, end: float) -> bool:
    return end >= peak * (1.0 - ROUNDING_RTOL) and peak - start >= 2.0 * length * up * (1.0 - ROUNDING_RTOL)


@kernel
def even(length: FloatArray, start: FloatArray, peak: FloatArray, up: FloatArray) -> FloatArray:
    """One acceleration for each ramp, (m,) mm/s²: the lowest `up` of its moves.

    Moves after a ramp that cruise take its acceleration too, where it is lower than theirs: the ramp may reach further.
    """
    m = len(length)
    out = up.copy()
    first, lowest, rising = 0, np.inf, False  # the ramp at hand, and whether the move before rises to its end
    for i in range(m + 1):
        rises = i < m and _rises(start[i], peak[i])
        if i == m or (rises and not rising):
            for k in range(first, i):
                out[k] = min(up[k], lowest)
            first, lowest = i, np.inf
        if rises:
            lowest = min(lowest, up[i])
        rising = rises and _rises_to_its_end(length[i], start[i], peak[i], up[i], start[i + 1])
    return out


@kernel
def cruise_times(
    length: FloatArray, start: FloatArray, peak: FloatArray, up: FloatArray, down: FloatArray
) -> FloatArray:
    """How long each move cruises, (m,) s."""
    out = np.empty(len(length))
    for i in range(len(length)):
        ramps = (peak[i] - start[i]) / (2.0 * up[i]) + (peak[i] - start[i + 1]) / (2.0 * down[i])
        left = length[i] - ramps
        out[i] = left / math.sqrt(peak[i]) if left > ROUNDING_RTOL * length[i] else 0.0
    return out


@kernel
def total_time(length: FloatArray, start: FloatArray, peak: FloatArray, up: FloatArray, down: FloatArray) -> float:
    """Return the duration of all moves together, s: rounding the ramps does not change it."""
    total = 0.0
    for i in range(len(length)):
        ramps = (peak[i] - start[i]) / (2.0 * up[i]) + (peak[i] - start[i + 1]) / (2.0 * down[i])
        v = math.sqrt(peak[i])
        total += (v - math.sqrt(start[i])) / up[i] + (v - math.sqrt(start[i + 1])) / down[i]
        total += max(length[i] - ramps, 0.0) / v
    return total


@kernel
def rounded(
    length: FloatArray, start: FloatArray, peak: FloatArray, up: FloatArray, highest: FloatArray, corner: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Round the ramps to S-curves: (m, 5) as `SmoothTrajectory` holds them, and each move's time in one, (m,) s.

    highest : (m,) mm/s², what the plateau may be;  corner : (m + 1,) mm²/s², bounds of v² at the junctions
    An S-curve runs ahead in its second half. One that would pass a junction too fast ends there, and another begins.
    """
    ramps, lasting = np.zeros((len(length), 5)), np.zeros(len(length))
    i = 0
    while i < len(length):
        if not _rises(start[i], peak[i]):
            i += 1
            continue
        last = i
        while (
            last + 1 < len(length)
            and _rises_to_its_end(length[last], start[last], peak[last], up[last], start[last + 1])
            and _rises(start[last + 1], peak[last + 1])
            and abs(up[last + 1] - up[i]) <= ROUNDING_RTOL * up[i]
        ):
            last += 1
        too_fast = last
        while too_fast >= 0:
            last = too_fast
            too_fast = _round(length, start, peak, up, highest, corner, ramps, lasting, i, last)
        i = last + 1
    return ramps, lasting


@kernel
def _round(
    length: FloatArray,
    start: FloatArray,
    peak: FloatArray,
    up: FloatArray,
    highest: FloatArray,
    corner: FloatArray,
    ramps: FloatArray,
    lasting: FloatArray,
    first: int,
    last: int,
) -> int:
    """Make one S-curve of the moves `first` to `last`; returns the first move whose end it passes too fast, or -1."""
    low = math.sqrt(start[first])
    gain = math.sqrt(peak[last]) - low
    whole = gain / up[first]
    lowest = highest[first]
    for i in range(first + 1, last + 1):
        lowest = min(lowest, highest[i])
    room = 1.0 - up[first] / lowest
    jerk_t = whole * min(max(room, 0.0), 0.5)
    plateau = gain / (whole - jerk_t)
    x, gone = 0.0, 0.0
    for i in range(first, last + 1):
        ramps[i, LOW], ramps[i, PLATEAU], ramps[i, JERK_T], ramps[i, LASTING] = low, plateau, jerk_t, whole
        ramps[i, GONE] = gone
        x += length[i]
        u = whole if i == last else _time_to(x, gone, low, plateau, jerk_t, whole)
        v = low + gained_speed(u, plateau, jerk_t, whole)
        if i < last and v * v > corner[i + 1] * (1.0 + ROUNDING_RTOL):
            return i
        lasting[i] = u - gone
        gone = u
    return -1


@kernel
def _time_to(x: float, after: float, low: float, plateau: float, jerk_t: float, whole: float) -> float:
    """When a ramp has come as far as x mm, s: Newton's steps, kept between bounds."""
    below, above = after, whole
    u = 0.5 * (below + above)
    for _ in range(NEWTON_STEPS):
        miss = low * u + gained_distance(u, plateau, jerk_t, whole) - x
        below, above = (below, u) if miss > 0.0 else (u, above)
        v = low + gained_speed(u, plateau, jerk_t, whole)
        better = u - miss / v if v > 0.0 else -1.0
        if not (below <= better <= above):
            better = 0.5 * (below + above)
        if abs(better - u) <= 1e-15 * whole:
            break
        u = better
    return u


Carriages = Callable[[FloatArray], FloatArray]  # nozzle (n, 3) mm → carriages (n, k) mm

PROBE_MM = 1e-3  # step of the difference quotients
HALVINGS = 6  # of the edge, where the file's acceleration leaves no room for it
SEARCH_STEPS = 10  # for the level; each halves the ratio that is uncertain
WIDEST_SEARCH = 64.0  # how far the level may lie below what the file asks for
SHORTEST_REST_S = 1e-9  # shorter ones are rounding


@dataclass(frozen=True, slots=True)
class SCurve:
    """What may change, and by how much."""

    slower: float = 0.009  # the share by which the motion may take longer
    for_edges: float = 0.4  # of that, what may be spent on the edges of ramps that have no room for them
    edge: float = 0.1  # share of a ramp's duration in which its acceleration builds up, and again in which it ends
    least_edge: float = 0.01  # what is left of it in tight curves, where a higher plateau adds to what they ask for
    span_s: float = 0.004  # in which a corner's change of speed is felt: one segment of the command
    limit_mm_per_s2: float | None = None  # what no plateau may exceed; None: the plan's own highest acceleration

    def __post_init__(self) -> None:
        if not self.slower >= 0.0:
            raise ValueError(f"A motion cannot be asked to be slower by {self.slower:g}; the share is zero or more.")
        if not 0.0 <= self.edge <= 0.5:
            raise ValueError(f"The edge of an S-curve is {self.edge:g} of its duration; it must be from 0 to 0.5.")


@dataclass(frozen=True, slots=True)
class _Held:
    """What a motion is held under."""

    level: float = np.inf  # mm/s², of the carriages
    reserve: float = 0.0  # the edge of ramps whose acceleration is at the limit


_AS_PLANNED = _Held()  # where the time allows nothing else: every ramp with the accelerations that its moves have


@dataclass(frozen=True, slots=True)
class _Path:
    """The m moves that take time, and what the given plan does on them."""

    moves: IntArray  # (m,) index of each
    length: FloatArray  # (m,) mm
    corner: FloatArray  # (m + 1,) mm²/s², v² at the junctions
    top: FloatArray  # (m,) mm²/s², highest v² of the moves
    acceleration: FloatArray  # (m,) mm/s²
    limit: FloatArray  # (m,) mm/s², what no plateau may exceed
    gain: FloatArray  # (m,) g; zero where the nozzle does not move
    turn: FloatArray  # (m + 1,) c
    apart: FloatArray  # (m + 1,) mm, l
    time_s: float


@dataclass(frozen=True, slots=True)
class _Profile:
    """Squared speeds along the path with their accelerations."""

    start: FloatArray  # (m + 1,) mm²/s²
    peak: FloatArray  # (m,) mm²/s²
    up: FloatArray  # (m,) mm/s²
    down: FloatArray  # (m,) mm/s²
    mean: FloatArray  # (m,) mm/s², what a ramp's mean acceleration may be
    corner: FloatArray  # (m + 1,) mm²/s², what the level allows v² to be at the junctions


def s_curve(
    plan: Trajectory,
    carriages: Carriages | None = None,
    settings: SCurve | None = None,
    *,
    allowed_v: FloatArray | None = None,
) -> SmoothTrajectory:
    """Plan the same path with S-curves.

    Parameters
    ----------
    plan : from rest to rest
    carriages : where the carriages are for places of the nozzle; None: the nozzle itself is what is accelerated
    allowed_v : (n,) mm/s, how fast each move may begin at most (`junctions.py`); None: not faster than in the plan
    """
    settings = settings or SCurve()
    path = _path_of(plan, carriages, settings.limit_mm_per_s2)
    held = _hold(path, settings)
    allowed_v = plan.start_v if allowed_v is None else allowed_v
    profile = _profile(path, settings, held)
    return _timed(plan, path, profile, _plateaus(path, settings, held.level, profile), allowed_v)


def _hold(path: _Path, settings: SCurve) -> _Held:
    """Find the lowest level under which the path takes no longer than allowed."""
    if not len(path.moves):
        return _AS_PLANNED
    reserve = _reserve(path, settings)
    high = 2.0 * float((path.acceleration * path.gain).max(initial=0.0))
    low, best = high / WIDEST_SEARCH, np.inf
    for _ in range(SEARCH_STEPS):
        level = float(np.sqrt(low * high))
        if _slower(path, settings, _Held(level, reserve)) <= settings.slower:
            best = high = level
        else:
            low = level
    return _Held(best, reserve)


def _reserve(path: _Path, settings: SCurve) -> float:
    """As much of the edge as ramps at the limit can be given for their share of the time."""
    for halvings in range(HALVINGS):
        reserve = settings.edge * 0.5**halvings
        if _slower(path, settings, _Held(np.inf, reserve)) <= settings.slower * settings.for_edges:
            return reserve
    return 0.0


def _slower(path: _Path, settings: SCurve, held: _Held) -> float:
    """By which share the motion takes longer."""
    profile = _profile(path, settings, held)
    return total_time(path.length, profile.start, profile.peak, profile.up, profile.down) / path.time_s - 1.0


# What the given plan does, and what the carriages feel of it


def _path_of(plan: Trajectory, carriages: Carriages | None, limit_mm_per_s2: float | None) -> _Path:
    duration = plan.duration
    moves = np.flatnonzero(duration > 0.0)
    accel_d = 0.5 * (plan.start_v + plan.cruise_v) * plan.accel_t
    decel_d = 0.5 * (plan.end_v + plan.cruise_v) * plan.decel_t
    length = (accel_d + plan.cruise_v * plan.cruise_t + decel_d)[moves]
    direction, place = plan.direction[moves, :3], plan.origin[moves, :3]
    ends = place + (length - PROBE_MM)[:, None] * direction
    gain = np.maximum(_rates(carriages, place, direction), _rates(carriages, ends, direction))
    turn, apart = np.zeros(len(moves) + 1), np.ones(len(moves) + 1)
    turn[1:-1] = _rates(carriages, place[1:], np.diff(direction, axis=0))
    apart[1:-1] = 0.5 * (length[1:] + length[:-1])
    corner = np.append(plan.start_v[moves] ** 2, 0.0)
    file, top = plan.acceleration[moves], plan.cruise_v[moves] ** 2
    limit = np.maximum(file, limit_mm_per_s2 or float(file[gain > 0.0].max(initial=0.0)))
    return _Path(moves, length, corner, top, file, limit, gain, turn, apart, float(duration.sum()))


def _rates(carriages: Carriages | None, places: FloatArray, steps: FloatArray) -> FloatArray:
    """How far the carriage that goes farthest goes for small steps (n, 3) of the nozzle, per unit of them, (n,).

    On a straight line the carriages of a delta are fastest at one of its ends.
    """
    if carriages is None:
        return np.asarray(np.sqrt((steps**2).sum(axis=1)))
    moved = np.abs(carriages(places + PROBE_MM * steps) - carriages(places)).T / PROBE_MM
    return np.asarray(np.maximum.reduce([*moved]))


# The gentler plan


def _profile(path: _Path, settings: SCurve, held: _Held) -> _Profile:
    low = np.where(path.gain > 0.0, np.minimum(path.acceleration, (1.0 - held.reserve) * path.limit), path.acceleration)
    shared = (path.gain, path.turn, path.apart, settings.span_s, 1.0 - settings.edge)
    mean, gentle = held_down(held.level, low, *shared)
    corner = np.minimum(path.corner, gentle)
    start, peak = sweep(path.length, corner, path.top, mean, mean)
    if held == _AS_PLANNED:
        return _Profile(start, peak, mean, mean, mean, gentle)
    down = _reversed(even(*(_reversed(values) for values in (path.length, start, peak, mean))))
    up = even(path.length, start, peak, mean)
    start, peak = sweep(path.length, corner, path.top, up, down)
    return _Profile(start, peak, up, down, mean, gentle)


def _plateaus(path: _Path, settings: SCurve, level: float, profile: _Profile) -> FloatArray:
    """Return the plateaus' upper bounds, (m,) mm/s². Extruder-only moves keep their ramps: no carriage feels them."""
    moving = path.gain > 0.0
    under = np.divide(level, path.gain, out=np.full_like(path.gain, np.inf), where=moving)
    beside = _beside_curves(path, settings, level, profile.start)
    least = profile.mean / (1.0 - settings.least_edge)
    file = path.acceleration / (1.0 - settings.edge)
    highest = np.minimum.reduce([under, path.limit, file, np.maximum(beside, least)])
    return np.where(moving, highest, path.acceleration)


def _beside_curves(path: _Path, settings: SCurve, level: float, start: FloatArray) -> FloatArray:
    """Bound the plateaus so that each and the curve that its move lies in are under the level together, (m,) mm/s².

    Only edges, which ask for higher plateaus, are held back by it: lowering the ramps of a curved print themselves
    would take the time that its corners need.
    """
    junction = path.turn * np.minimum(start / path.apart, np.sqrt(start) / settings.span_s)
    curve = np.maximum(junction[1:], junction[:-1])
    taken = np.divide(curve, level, out=np.zeros_like(curve), where=curve > 0.0)  # the level is 0 where nothing moves
    left = level * np.sqrt(np.maximum(1.0 - taken**2, 0.0))
    return np.divide(left, path.gain, out=np.full_like(left, np.inf), where=path.gain > 0.0)


def _reversed(values: FloatArray) -> FloatArray:
    return np.ascontiguousarray(values[::-1])


# S-curves on the clock


def _timed(
    plan: Trajectory, path: _Path, profile: _Profile, highest: FloatArray, allowed_v: FloatArray
) -> SmoothTrajectory:
    """Round the ramps and put the moves one after the other, with the given plan's rests between them."""
    allowed = np.minimum(profile.corner, np.append(allowed_v[path.moves] ** 2, 0.0))
    rise, accel_t = rounded(path.length, profile.start, profile.peak, profile.up, highest, allowed)
    back = (path.length, profile.start, profile.peak, profile.down, highest, allowed)
    fall, decel_t = rounded(*(_reversed(values) for values in back))
    cruise_t = cruise_times(path.length, profile.start, profile.peak, profile.up, profile.down)
    fall, decel_t = _reversed(fall), _reversed(decel_t)
    highest_v = _highest_v(profile.peak, rise, accel_t, fall, decel_t)
    lasting = _spread(accel_t + cruise_t + decel_t, path.moves, len(plan))
    return SmoothTrajectory(
        start_t=np.cumsum(_rests(plan) + np.append(0.0, lasting)[:-1]),
        accel_t=_spread(accel_t, path.moves, len(plan)),
        cruise_t=_spread(cruise_t, path.moves, len(plan)),
        decel_t=_spread(decel_t, path.moves, len(plan)),
        cruise_v=_spread(highest_v, path.moves, len(plan)),
        rise=_spread(rise, path.moves, len(plan)),
        fall=_spread(fall, path.moves, len(plan)),
        origin=plan.origin,
        direction=plan.direction,
    )


def _highest_v(
    peak: FloatArray, rise: FloatArray, accel_t: FloatArray, fall: FloatArray, decel_t: FloatArray
) -> FloatArray:
    """Return the highest speed of each move, (m,) mm/s: inside a rounded ramp it is not quite the planned one."""
    brakes = np.where(decel_t > 0.0, speeds(fall, decel_t), np.sqrt(peak))
    return np.where(accel_t > 0.0, speeds(rise, accel_t), brakes)


def _rests(plan: Trajectory) -> FloatArray:
    """How long the nozzle rests before each move, (n,) s; before the first one since the clock's zero."""
    rests = plan.start_t.copy()
    rests[1:] -= (plan.start_t + plan.duration)[:-1]
    rests[1:][rests[1:] < SHORTEST_REST_S] = 0.0
    return rests


def _spread(values: FloatArray, moves: IntArray, n: int) -> FloatArray:
    if len(values) == n:
        return values
    whole = np.zeros((n, *values.shape[1:]))
    whole[moves] = values
    return whole
