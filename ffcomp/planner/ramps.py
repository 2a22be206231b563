"""Ramps of speed over many moves: planned with constant acceleration, then rounded to S-curves without moving an end.

A ramp is a part of the path on which the speed only rises. Braking is the same seen from the other end: every
function here is called a second time with all arrays reversed. As in `lookahead.py` speeds are squared where nothing
else is said, for v² grows linearly along the path.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ffcomp.planner.smooth import GONE, JERK_T, LASTING, LOW, PLATEAU, gained_distance, gained_speed
from models.arrays import FloatArray

ROUNDING = 1e-9  # relative; below it speeds, distances and accelerations count as equal
NEWTON_STEPS = 60  # never needed: each at least halves what is uncertain


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _rises(start: float, peak: float) -> bool:
    return peak > start * (1.0 + ROUNDING)


@njit(cache=True, nogil=True)
def _rises_to_its_end(length: float, start: float, peak: float, up: float, end: float) -> bool:
    return end >= peak * (1.0 - ROUNDING) and peak - start >= 2.0 * length * up * (1.0 - ROUNDING)


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def cruise_times(
    length: FloatArray, start: FloatArray, peak: FloatArray, up: FloatArray, down: FloatArray
) -> FloatArray:
    """How long each move cruises, (m,) s."""
    out = np.empty(len(length))
    for i in range(len(length)):
        ramps = (peak[i] - start[i]) / (2.0 * up[i]) + (peak[i] - start[i + 1]) / (2.0 * down[i])
        left = length[i] - ramps
        out[i] = left / math.sqrt(peak[i]) if left > ROUNDING * length[i] else 0.0
    return out


@njit(cache=True, nogil=True)
def total_time(length: FloatArray, start: FloatArray, peak: FloatArray, up: FloatArray, down: FloatArray) -> float:
    """Return the duration of all moves together, s: rounding the ramps does not change it."""
    total = 0.0
    for i in range(len(length)):
        ramps = (peak[i] - start[i]) / (2.0 * up[i]) + (peak[i] - start[i + 1]) / (2.0 * down[i])
        v = math.sqrt(peak[i])
        total += (v - math.sqrt(start[i])) / up[i] + (v - math.sqrt(start[i + 1])) / down[i]
        total += max(length[i] - ramps, 0.0) / v
    return total


@njit(cache=True, nogil=True)
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
            and abs(up[last + 1] - up[i]) <= ROUNDING * up[i]
        ):
            last += 1
        too_fast = last
        while too_fast >= 0:
            last = too_fast
            too_fast = _round(length, start, peak, up, highest, corner, ramps, lasting, i, last)
        i = last + 1
    return ramps, lasting


@njit(cache=True, nogil=True)
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
        if i < last and v * v > corner[i + 1] * (1.0 + ROUNDING):
            return i
        lasting[i] = u - gone
        gone = u
    return -1


@njit(cache=True, nogil=True)
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
