"""The firmware's own plan: how fast each move begins, cruises and ends, looking ahead without a horizon.

Everything is solved in squared speeds: at constant acceleration a they grow linearly along the path,
v² = v0² + 2 a d. The rules are Klipper's and Kalico's, checked against the running host in the tests:

    corner   what the angle at a junction allows
    start    the same, limited by 2 a d, the most that a move can gain (forward sweep) and lose (backward sweep)
    ceiling  how high each hill of speed may rise: the top of the same profile under the smooth acceleration,
             which keeps a minimum of cruising on every hill
"""

from __future__ import annotations

import numpy as np

from ffcomp.planner.limits import Bounds, Lines, PlannerLimits, bounds_of, lines_of
from ffcomp.planner.trajectory import Trajectory
from gcode.program import EventKind, Moves, Program
from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import kernel

FILAMENT_MM_PER_S = 1.0  # step in the filament's speed at a corner: Klipper's default `instantaneous_corner_velocity`


@kernel
def corner_v2(along: float, deviation: float, length: float, jump: float) -> float:
    """Return the highest v² at a corner: by junction deviation, centripetal, and by the filament.

    A circle replaces the corner. Its radius is s/(1 - s) of its distance from the corner, s = sin(theta/2), and
    tan(theta/2) of the distance from the corner to where it touches the segments, which stays within half of either.

    along : cosine of the angle between the two directions
    deviation, length : of a segment, times its acceleration; the smaller one of the two segments
    jump : of the filament per path
    """
    v2 = (FILAMENT_MM_PER_S / jump) ** 2 if jump > 0.0 else np.inf
    sine = np.sqrt(max(0.5 * (1.0 + along), 0.0))
    cosine = np.sqrt(max(0.5 * (1.0 - along), 0.0))
    if sine < 1.0 and cosine > 0.0:
        v2 = min(v2, sine / (1.0 - sine) * deviation, sine / cosine * (0.5 * length))
    return v2


_RESTS = (EventKind.STOP, EventKind.DWELL, EventKind.RAW_MOVE)


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
    moves: Moves, limits: PlannerLimits, *, stop_before: BoolArray, wait_before: FloatArray, start_t: float = 0.0
) -> Trajectory:
    """Plan the motion that the firmware makes of the moves, from rest to rest.

    Parameters
    ----------
    moves : n moves; those that go nowhere (neither nozzle nor filament) take no time and make no corner
    stop_before : (n,) the motion comes to rest before the move
    wait_before : (n,) s at rest before the move; more than zero implies a stop
    start_t : s, when the plan begins (with the first wait, if there is one)
    """
    lines = lines_of(moves)
    bounds = bounds_of(moves, lines, limits)
    stops = stop_before | (wait_before > 0.0)
    kept, corner = _corners(lines, bounds, stops)
    ramps = bounds.acceleration, bounds.smooth_acceleration
    phases = phases_from_corners(kept, corner, lines.length, bounds.speed, *ramps)
    return timed(moves, lines, phases, wait_before, start_t)


@kernel
def phases_from_corners(
    kept: IntArray,
    corner: FloatArray,
    length: FloatArray,
    speed: FloatArray,
    acceleration: FloatArray,
    smooth_acceleration: FloatArray,
) -> FloatArray:
    """Return the trapezoids of n moves that pass their corners as fast as looking ahead allows.

    (7, n), rows as the columns `accel_t` to `acceleration` of `Trajectory`.

    kept, corner : (m,) indices of the moves with a length, and the highest v² at their starts
    """
    # NOTE: loops, not expressions of whole arrays: those take seconds to compile
    m = len(kept)
    gain, smooth_gain, cap = np.empty(m), np.empty(m), np.empty(m)
    for k in range(m):
        i = kept[k]
        gain[k], smooth_gain[k] = 2.0 * length[i] * acceleration[i], 2.0 * length[i] * smooth_acceleration[i]
        cap[k] = speed[i] ** 2
    entry = _reached_from_rest(corner, gain)
    start = _stopping_at_the_end(entry, gain)
    smooth = _stopping_at_the_end(_reached_from_rest(entry, smooth_gain), smooth_gain)
    ceiling = _ceilings(start, smooth, smooth_gain, cap)
    phases = np.zeros((7, len(length)))
    for k in range(m):
        i = kept[k]
        a = acceleration[i]
        top = min(0.5 * (start[k] + (start[k + 1] + gain[k])), cap[k], ceiling[k])
        begin, finish = min(start[k], top), min(start[k + 1], top)
        begin_v, top_v, finish_v = np.sqrt(begin), np.sqrt(top), np.sqrt(finish)
        phases[0, i], phases[2, i] = (top_v - begin_v) / a, (top_v - finish_v) / a
        phases[1, i] = max(length[i] - (2.0 * top - begin - finish) / (2.0 * a), 0.0) / top_v
        phases[3, i], phases[4, i], phases[5, i], phases[6, i] = begin_v, top_v, finish_v, a
    return phases


def timed(moves: Moves, lines: Lines, phases: FloatArray, wait_before: FloatArray, start_t: float) -> Trajectory:
    """Put the moves one after the other, with their waits; phases (7, n) as of `phases_from_corners`.

    NOTE: times are summed one by one, as the firmware does: a move begins exactly when its neighbour ends.
    """
    since_last = np.array(wait_before, dtype=np.float64)
    accel_t, cruise_t, decel_t, start_v, cruise_v, end_v, acceleration = phases
    since_last[1:] += (accel_t + cruise_t + decel_t)[:-1]
    since_last[:1] += start_t
    times, speeds = (np.cumsum(since_last), accel_t, cruise_t, decel_t), (start_v, cruise_v, end_v)
    return Trajectory(*times, *speeds, acceleration, moves.start, lines.direction)


# Corners


@kernel
def _corners(lines: Lines, bounds: Bounds, stop_before: BoolArray) -> tuple[IntArray, FloatArray]:
    """Return the moves with a length, (m,), and the highest v² at their starts, (m,).

    stop_before : (n,) the motion comes to rest before the move, or before what goes nowhere in front of it
    """
    length, direction, travels = lines.length, lines.direction, lines.travels
    speed, acceleration, deviation = bounds.speed, bounds.acceleration, bounds.junction_deviation
    kept, corner = np.empty(len(length), dtype=np.int64), np.zeros(len(length))
    m, last, stops = 0, 0, True
    for i in range(len(length)):
        stops |= stop_before[i]
        if length[i] > 0.0:
            if not stops and travels[i] and travels[last]:  # extruder-only moves begin and end at rest
                by_deviation = min(deviation[i] * acceleration[i], deviation[last] * acceleration[last])
                by_length = min(length[i] * acceleration[i], length[last] * acceleration[last])
                ahead, behind = direction[i], direction[last]
                along = ahead[0] * behind[0] + ahead[1] * behind[1] + ahead[2] * behind[2]
                v2 = corner_v2(along, by_deviation, by_length, abs(ahead[3] - behind[3]))
                corner[m] = min(speed[i] ** 2, speed[last] ** 2, v2)
            kept[m] = i
            m, last, stops = m + 1, i, False
    return kept[:m], corner[:m]


# Sweeps


@kernel
def _reached_from_rest(limit: FloatArray, gain: FloatArray) -> FloatArray:
    """Highest v² at the start of each move under `limit`, when move i can add at most gain[i]; from rest."""
    reached = np.empty_like(limit)
    reachable = 0.0
    for i in range(len(limit)):
        reached[i] = min(limit[i], reachable)
        reachable = reached[i] + gain[i]
    return reached


@kernel
def _stopping_at_the_end(limit: FloatArray, gain: FloatArray) -> FloatArray:
    """Do the same from the other side, (n+1,): move i can take away at most gain[i]; rest after the last one."""
    n = len(limit)
    start = np.zeros(n + 1)
    for i in range(n - 1, -1, -1):
        start[i] = min(limit[i], start[i + 1] + gain[i])
    return start


@kernel
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
