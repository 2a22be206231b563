"""The firmware's own plan: how fast each move begins, cruises and ends, looking ahead without a horizon.

Everything is solved in squared speeds: at constant acceleration a they grow linearly along the path,
v² = v0² + 2 a d. The rules are Klipper's and Kalico's, checked against the running host in the tests:

    corner   what the angle at a junction allows
    start    what is left of it when 2 a d is all a move can gain (sweep forwards) and lose (sweep backwards)
    ceiling  how high each hill of speed may rise: the top of the same profile under the smooth acceleration,
             which keeps a minimum of cruising on every hill
"""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ffcomp.plan.limits import Bounds, FirmwareLimits, Lines, bounds_of, lines_of
from ffcomp.plan.trajectory import Trajectory
from gcode.errors import GcodeError
from gcode.program import EventKind, Moves, Program

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
Columns = TypeVar("Columns", Moves, Lines)

_RESTS = (EventKind.STOP, EventKind.DWELL, EventKind.RAW_MOVE)


class Phases(NamedTuple):
    """Speeding up, cruising, braking: (n,) arrays, as in `Trajectory`."""

    accel_t: FloatArray
    cruise_t: FloatArray
    decel_t: FloatArray
    start_v: FloatArray
    cruise_v: FloatArray
    end_v: FloatArray
    acceleration: FloatArray


def stops_and_waits(program: Program) -> tuple[BoolArray, FloatArray]:
    """Before which moves the motion rests, and how long.

    Returns
    -------
    stop_before : (n,) bool
    wait_before : (n,) s, dwells before the same move added up. A rest after the last move has no place here.
    """
    n = len(program.moves)
    stop_before, wait_before = np.zeros(n, dtype=np.bool_), np.zeros(n)
    for event in program.events:
        if event.kind in _RESTS and event.move < n:
            stop_before[event.move] = True
            wait_before[event.move] += event.dwell_s
    return stop_before, wait_before


def plan_moves(
    moves: Moves,
    limits: FirmwareLimits,
    *,
    stop_before: BoolArray,
    wait_before: FloatArray,
    start_t: float = 0.0,
) -> Trajectory:
    """The motion the firmware makes of the moves, from rest to rest.

    Parameters
    ----------
    moves : n moves; those that go nowhere (neither nozzle nor filament) take no time and make no corner
    stop_before : (n,) the motion comes to rest before the move
    wait_before : (n,) s at rest before the move; more than zero implies a stop
    start_t : s, when the plan begins (with the first wait, if there is one)

    Raises
    ------
    GcodeError
        A move whose place, speed or limits no firmware can follow, with its line.
    """
    _check(moves)
    _check_waits(wait_before)
    lines = lines_of(moves)
    kept = np.flatnonzero(lines.length > 0.0)
    stops = _stops_of_kept(stop_before | (wait_before > 0.0), kept)
    planned = _plan(_pick(moves, kept), _pick(lines, kept), limits, stops)
    phases = Phases(*(_spread(phase, kept, len(moves)) for phase in planned))
    return _timed(moves, lines, phases, wait_before, start_t)


def _plan(moves: Moves, lines: Lines, limits: FirmwareLimits, stops: BoolArray) -> Phases:
    """The trapezoids of moves that all go somewhere, `stops` (n,) before some of them."""
    bounds = bounds_of(moves, lines, limits)
    gain = 2.0 * lines.length * bounds.acceleration
    smooth_gain = 2.0 * lines.length * bounds.smooth_acceleration
    corner = _corners(lines, bounds, gain, limits.instantaneous_corner_velocity_mm_per_s)
    corner[stops] = 0.0
    entry = _reached_from_rest(corner, gain)
    start = _stopping_at_the_end(entry, gain)
    smooth = _stopping_at_the_end(_reached_from_rest(entry, smooth_gain), smooth_gain)
    cap = bounds.speed**2
    ceiling = _ceilings(start, smooth, smooth_gain, cap)
    top = np.minimum(np.minimum(0.5 * (start[:-1] + (start[1:] + gain)), cap), ceiling)
    return _trapezoids(lines.length, bounds.acceleration, start, top)


def _trapezoids(length: FloatArray, acceleration: FloatArray, start: FloatArray, top: FloatArray) -> Phases:
    """Squared speeds at the junctions, `start` (n+1,), and on top of the moves, `top` (n,) → trapezoids."""
    begin, finish = np.minimum(start[:-1], top), np.minimum(start[1:], top)
    begin_v, top_v, finish_v = np.sqrt(begin), np.sqrt(top), np.sqrt(finish)
    cruise_d = np.maximum(length - (2.0 * top - begin - finish) / (2.0 * acceleration), 0.0)
    accel_t, decel_t = (top_v - begin_v) / acceleration, (top_v - finish_v) / acceleration
    return Phases(accel_t, cruise_d / top_v, decel_t, begin_v, top_v, finish_v, acceleration)


def _timed(moves: Moves, lines: Lines, phases: Phases, wait_before: FloatArray, start_t: float) -> Trajectory:
    """Put the moves one after the other, with their waits.

    NOTE: times are summed one by one, as the firmware does: a move begins exactly when its neighbour ends.
    """
    since_last = np.array(wait_before, dtype=np.float64)
    since_last[1:] += (phases.accel_t + phases.cruise_t + phases.decel_t)[:-1]
    since_last[:1] += start_t
    return Trajectory(np.cumsum(since_last), *phases, moves.start, lines.direction)


# Corners


def _corners(lines: Lines, bounds: Bounds, gain: FloatArray, filament_jump: float) -> FloatArray:
    """Highest v² at which each move may follow the last, (n,). Extruder-only moves begin and end at rest."""
    corner = np.zeros(len(gain))
    deviation, tangent = _turns(lines.direction)
    corner[1:] = np.minimum.reduce(
        (
            _lower_of_both(bounds.speed**2),
            _where_bent(deviation, _lower_of_both(bounds.junction_deviation * bounds.acceleration)),
            _where_bent(tangent, 0.25 * _lower_of_both(gain)),
            _filament_corner(lines.direction[:, 3], filament_jump),
        )
    )
    corner[1:][~(lines.travels[1:] & lines.travels[:-1])] = 0.0
    return corner


def _lower_of_both(value: FloatArray) -> FloatArray:
    """For each junction, the lower of its two moves' values: (n,) → (n-1,)."""
    return np.minimum(value[1:], value[:-1])


def _turns(direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How the angle theta between two moves bounds the circle that replaces their corner.

    Returns
    -------
    per_deviation : (n-1,) radius over the circle's distance from the corner, s/(1 - s) with s = sin(theta/2)
    tangent : (n-1,) tan(theta/2): radius over the distance from the corner to where the circle touches the
        moves, which must stay within half of either. Both are infinite where the path goes straight on.
    """
    ahead, behind = direction[1:], direction[:-1]
    along = ahead[:, 0] * behind[:, 0] + ahead[:, 1] * behind[:, 1] + ahead[:, 2] * behind[:, 2]
    sine = np.sqrt(np.maximum(0.5 * (1.0 + along), 0.0))
    cosine = np.sqrt(np.maximum(0.5 * (1.0 - along), 0.0))
    bent = (sine < 1.0) & (cosine > 0.0)
    per_deviation, tangent = np.full_like(sine, np.inf), np.full_like(sine, np.inf)
    np.divide(sine, 1.0 - sine, out=per_deviation, where=bent)
    np.divide(sine, cosine, out=tangent, where=bent)
    return per_deviation, tangent


def _where_bent(ratio: FloatArray, value: FloatArray) -> FloatArray:
    """ratio * value, and infinite where the path goes straight on, even if `value` is zero."""
    return np.multiply(ratio, value, out=np.full_like(ratio, np.inf), where=np.isfinite(ratio))


def _filament_corner(filament: FloatArray, jump: float) -> FloatArray:
    """Highest v² at which the filament's speed steps by at most `jump`; `filament` (n,) mm per mm of path."""
    step = np.abs(np.diff(filament))
    return np.divide(jump, step, out=np.full_like(step, np.inf), where=step > 0.0) ** 2


# Sweeps


@njit(cache=True)
def _reached_from_rest(limit: FloatArray, gain: FloatArray) -> FloatArray:
    """Highest v² at the start of each move under `limit`, when move i can add at most gain[i]; from rest."""
    reached = np.empty_like(limit)
    reachable = 0.0
    for i in range(len(limit)):
        reached[i] = min(limit[i], reachable)
        reachable = reached[i] + gain[i]
    return reached


@njit(cache=True)
def _stopping_at_the_end(limit: FloatArray, gain: FloatArray) -> FloatArray:
    """The same from the other side, (n+1,): move i can take away at most gain[i]; rest after the last one."""
    n = len(limit)
    start = np.zeros(n + 1)
    for i in range(n - 1, -1, -1):
        start[i] = min(limit[i], start[i + 1] + gain[i])
    return start


@njit(cache=True)
def _ceilings(start: FloatArray, smooth: FloatArray, smooth_gain: FloatArray, cap: FloatArray) -> FloatArray:
    """Highest v² on each move, (n,): the top of the smooth profile's hill that the move belongs to.

    Backwards: moves that brake all along wait (`braking` counts them) until the top before them is known, and
    rise above no junction since then. Moves that speed up all along take the top that follows.
    """
    n = len(cap)
    ceiling = np.empty(n)
    top, braking = 0.0, 0
    for i in range(n - 1, -1, -1):
        reachable = smooth[i + 1] + smooth_gain[i]
        if smooth[i] >= reachable:
            braking += 1
            continue
        if braking > 0 or smooth[i] + smooth_gain[i] > smooth[i + 1]:
            top = min(cap[i], 0.5 * (smooth[i] + reachable))
        ceiling[i] = top
        for j in range(i + 1, i + 1 + braking):
            ceiling[j] = min(ceiling[j - 1], start[j])
        braking = 0
    return ceiling


# Moves that go nowhere are planned as if they were not there


def _stops_of_kept(stop: BoolArray, kept: IntArray) -> BoolArray:
    """A stop before any move since the last kept one is a stop before this one."""
    stops_so_far = np.cumsum(stop)[kept]
    return np.diff(stops_so_far, prepend=0) > 0


def _pick(columns: Columns, kept: IntArray) -> Columns:
    return type(columns)(*(getattr(columns, field.name)[kept] for field in fields(columns)))


def _spread(values: FloatArray, kept: IntArray, n: int) -> FloatArray:
    whole = np.zeros(n)
    whole[kept] = values
    return whole


# Complaints


def _check(moves: Moves) -> None:
    place = np.linalg.norm(moves.end - moves.start, axis=1)
    _refuse(moves, ~np.isfinite(place), place, "travels {} mm; a distance is finite")
    _refuse(moves, ~(moves.speed > 0.0), moves.speed, "has the speed {} mm/s; it must be above zero")
    for name in ("velocity_limit", "acceleration"):
        value = getattr(moves, name)
        _refuse(moves, value <= 0.0, value, f"has the {name.replace('_', ' ')} {{}}; it must be above zero")
    corner, ratio = moves.square_corner_velocity, moves.minimum_cruise_ratio
    _refuse(moves, corner < 0.0, corner, "has the square corner velocity {} mm/s; it cannot be negative")
    _refuse(moves, (ratio < 0.0) | (ratio >= 1.0), ratio, "has the minimum cruise ratio {}; it is in [0, 1)")


def _refuse(moves: Moves, wrong: BoolArray, value: FloatArray, rule: str) -> None:
    if wrong.any():
        i = int(np.argmax(wrong))
        raise GcodeError(f"The move {rule.format(value[i])}.", int(moves.line[i]) + 1)


def _check_waits(wait_before: FloatArray) -> None:
    wrong = ~(np.isfinite(wait_before) & (wait_before >= 0.0))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise ValueError(f"The wait before move {i} is {wait_before[i]} s; it must be finite and not negative.")
