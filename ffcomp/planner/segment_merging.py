"""Which points of a command become the ends of segments: as few as the accuracy allows.

Between two kept points, the written command is straight and has one speed. Its error has two parts: across the
direction it bends the path; along it the nozzle is only early or late.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import kernel

KNOT_ROUNDING = 1e-9  # of a knot


class MergeLimits(NamedTuple):
    """What a segment may be."""

    across_mm: float  # error allowed across the command's direction,
    along_mm: float  # and along it
    filament_mm: float
    longest: float  # in knots


@kernel
def merge(at: FloatArray, points: FloatArray, e: FloatArray, pinned: BoolArray, limits: MergeLimits) -> IntArray:
    """Choose the points to keep: between two of them the command runs straight and evenly, so one segment will do.

    Parameters
    ----------
    at : (n,) times of the points, in knots
    points : (n, 3) mm;  e : (n,) mm of filament
    pinned : (n,) points that must stay; the choice after one is independent of earlier ones
    limits : bounds of a segment

    Returns
    -------
    (m,) indices of the points to keep, first and last among them
    """
    n = len(points) - 1
    kept = np.empty(n + 1, dtype=np.int64)
    kept[0] = 0
    count, first = 1, kept[0]  # a literal 0 would compile the callees once more
    while first < n:
        last = first + 1
        while last < n and not pinned[last] and at[last + 1] - at[first] <= limits.longest:
            if not _straight(at, points, e, first, last + 1, limits):
                break
            last += 1
        kept[count] = last
        count += 1
        first = last
    return kept[:count].copy()


@kernel
def refit(at: FloatArray, points: FloatArray, kept: IntArray, fixed: BoolArray) -> FloatArray:
    """Place the ends of the segments so that these miss the command to both sides alike: the least squares over time.

    A chord of a bend lies on its inner side everywhere, an error as slow as the bend, and the machine follows it. What
    the least squares leave changes sides within every segment, too fast for the machine.

    kept : (m,) what `merge` returns; other parameters as there
    fixed : (m,) which of those must stay where they are

    Returns their places, (m, 3) mm.
    """
    m = len(kept)
    weight, beside, missed = np.zeros(m), np.zeros(m), np.zeros((m, 3))
    for j in range(m - 1):
        first, last = kept[j], kept[j + 1]
        span = at[last] - at[first]
        weight[j] += span / 3.0
        weight[j + 1] += span / 3.0
        beside[j] = span / 6.0
        for i in range(3):
            left, right = _missed(at[first : last + 1], points[first : last + 1, i])
            missed[j, i] += left
            missed[j + 1, i] += right
    for j in range(m):
        if fixed[j] or weight[j] <= 0.0:
            weight[j], beside[j], beside[j - 1] = 1.0, 0.0, 0.0  # the last one has no neighbour: j - 1 of the first
            missed[j, 0], missed[j, 1], missed[j, 2] = 0.0, 0.0, 0.0
    _solve_tridiagonal(weight, beside, missed)
    for j in range(m):
        for i in range(3):
            missed[j, i] += points[kept[j], i]
    return missed


@kernel
def at_most(at: FloatArray, points: FloatArray, kept: IntArray, pinned: BoolArray, most: int) -> IntArray:
    """Leave out points where `most` segments or more would begin within as many knots: lines of the file cut some.

    Of those that may go, the one goes that the path between its neighbours misses least.

    kept : (m,) what `merge` returns; other parameters as there

    Returns the indices of the points that stay, (k,).
    """
    stays, count, first = kept.copy(), len(kept), 0
    while first < count - 1:
        end = first + most
        if end < count and at[stays[end]] - at[stays[first]] < most + 1.0 - KNOT_ROUNDING:
            fewer = _leave_out(at, points, stays, count, pinned, first + 1, end)
        else:
            fewer = count
        first += fewer == count
        count = fewer
    return stays[:count].copy()


@kernel
def _leave_out(
    at: FloatArray, points: FloatArray, stays: IntArray, count: int, pinned: BoolArray, first: int, last: int
) -> int:
    """Leave one point from `first` to `last` out of the first `count` that stay, if one may; return how many do."""
    worst, least = -1, np.inf
    for j in range(first, min(last + 1, count - 1)):
        if not pinned[stays[j]]:
            missed = _misses(at, points, stays[j - 1], stays[j], stays[j + 1])
            if missed < least:
                worst, least = j, missed
    if worst < 0:
        return count
    for j in range(worst, count - 1):
        stays[j] = stays[j + 1]
    return count - 1


@kernel
def _misses(at: FloatArray, points: FloatArray, before: int, k: int, after: int) -> float:
    """How far a point lies from where the segment between two others is at its time, mm."""
    share, missed = (at[k] - at[before]) / (at[after] - at[before]), 0.0
    for i in range(3):
        between = points[before, i] + share * (points[after, i] - points[before, i])
        missed += (points[k, i] - between) ** 2
    return float(np.sqrt(missed))


@kernel
def _missed(at: FloatArray, x: FloatArray) -> tuple[float, float]:
    """Return what the chord of points (n,) misses, integrated with a weight that falls to its end, and that rises."""
    n = len(at) - 1
    left = right = ahead = f = 0.0
    span, rise = at[n] - at[0], x[n] - x[0]
    if span <= 0.0:
        return 0.0, 0.0
    for k in range(1, n + 1):
        g = (at[k] - at[0]) / span
        here, ahead = ahead, x[k] - x[0] - g * rise
        step = at[k] - at[k - 1]
        rising = step / 6.0 * (here * (2.0 * f + g) + ahead * (f + 2.0 * g))
        right += rising
        left += 0.5 * step * (here + ahead) - rising
        f = g
    return left, right


@kernel
def _solve_tridiagonal(diagonal: FloatArray, beside: FloatArray, right: FloatArray) -> None:
    """Solve a symmetric tridiagonal system (m,) for the columns of `right` (m, 3), in place."""
    for j in range(1, len(diagonal)):
        share = beside[j - 1] / diagonal[j - 1]
        diagonal[j] -= share * beside[j - 1]
        for i in range(3):
            right[j, i] -= share * right[j - 1, i]
    for j in range(len(diagonal) - 1, -1, -1):
        for i in range(3):
            if j + 1 < len(diagonal):
                right[j, i] -= beside[j] * right[j + 1, i]
            right[j, i] /= diagonal[j]


@kernel
def _straight(at: FloatArray, points: FloatArray, e: FloatArray, first: int, last: int, limits: MergeLimits) -> bool:
    """Whether one segment stays so close to all points between: across its direction, along it, and in filament."""
    x, y, z = points[first, 0], points[first, 1], points[first, 2]
    dx, dy, dz = points[last, 0] - x, points[last, 1] - y, points[last, 2] - z
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    per_mm = 1.0 / length if length > 0.0 else 0.0
    across, along, filament = limits.across_mm, limits.along_mm, limits.filament_mm
    for k in range(last - 1, first, -1):
        f = (at[k] - at[first]) / (at[last] - at[first])
        rx, ry, rz = points[k, 0] - x - f * dx, points[k, 1] - y - f * dy, points[k, 2] - z - f * dz
        late = (rx * dx + ry * dy + rz * dz) * per_mm
        if abs(late) > along or rx * rx + ry * ry + rz * rz - late * late > across * across:
            return False
        if abs(e[first] + f * (e[last] - e[first]) - e[k]) > filament:
            return False
    return True
