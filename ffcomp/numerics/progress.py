"""How far along a path each point of a motion is, whatever its clock, with the order kept.

The nearest segment of a whole path may belong to another line: to one that crosses, lies beside it or passes again a
layer later. So all points are assigned at once, to pieces of the path that never go back (Viterbi's algorithm): the sum
of squared distances is least, and a piece that is left out costs a little. Long motions are worked through in windows,
of which the first half is kept.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from models.arrays import FloatArray, IntArray

PIECE_MM = 1.0  # of a path: within one, a point may go back
SKIPPED_MM2 = 0.001  # cost of a mm of the path that no point lies on
WINDOW = 256  # points that are assigned at once; half of them are kept
AHEAD = 1.5  # times the way of a window's points, that its pieces reach ahead,
AHEAD_MM = 5.0  # and this much more


def progress_in_order(
    path: FloatArray, points: FloatArray, low: IntArray, high: IntArray
) -> tuple[IntArray, FloatArray]:
    """Return on which segment each point lies, and which share of the segment lies behind it, 0 to 1.

    Parameters
    ----------
    path : (n + 1, 3) array
        The path's corners in mm.
    points : (m, 3) array
        In the order in which they are passed, mm.
    low, high : (m,) arrays
        The segments low ≤ k < high that each point may lie on; neither ever falls.

    Returns
    -------
    (m,) and (m,) arrays
    """
    lengths = np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1))
    pieces = np.maximum(np.ceil(lengths / PIECE_MM), 1.0).astype(np.int64)
    first = np.concatenate([[0], np.cumsum(pieces)])
    corners = _cut(np.ascontiguousarray(path), pieces)
    along = np.concatenate([[0.0], np.cumsum(np.sqrt((np.diff(corners, axis=0) ** 2).sum(axis=1)))])
    piece, share = _assigned(
        corners, along, np.ascontiguousarray(points), first[low], np.maximum(first[high], first[low] + 1)
    )
    segment = np.searchsorted(first, piece, side="right") - 1
    return segment, (piece - first[segment] + share) / pieces[segment]


@njit(cache=True, nogil=True)
def _cut(path: FloatArray, pieces: IntArray) -> FloatArray:
    """Return the corners of the path's pieces."""
    out = np.empty((pieces.sum() + 1, 3))
    at = 0
    for k in range(len(pieces)):
        for i in range(pieces[k]):
            out[at] = path[k] + (path[k + 1] - path[k]) * (i / pieces[k])
            at += 1
    out[at] = path[-1]
    return out


@njit(nogil=True)
def _foot(path: FloatArray, k: int, point: FloatArray) -> tuple[float, float]:
    """Return the squared distance from piece k, and the share of it that lies before the nearest point."""
    dot = length2 = square = 0.0
    for c in range(3):
        u, d = path[k + 1, c] - path[k, c], point[c] - path[k, c]
        dot, length2, square = dot + u * d, length2 + u * u, square + d * d
    if length2 == 0.0:
        return square, 0.0
    share = min(1.0, max(0.0, dot / length2))
    return max(square - share * (2.0 * dot - share * length2), 0.0), share


@njit(cache=True, nogil=True)
def _assigned(
    path: FloatArray, along: FloatArray, points: FloatArray, low: IntArray, high: IntArray
) -> tuple[IntArray, FloatArray]:
    """Assign each point to a piece; as `progress_in_order`, of pieces."""
    m = len(points)
    piece, share = np.zeros(m, dtype=np.int64), np.zeros(m)
    begin, at = 0, low[0] if m else 0
    while begin < m:
        end = min(begin + WINDOW, m)
        _window(path, along, points, low, high, begin, end, at, piece)
        begin = end if end == m else begin + WINDOW // 2
        at = piece[begin - 1]
    for i in range(m):
        share[i] = _foot(path, piece[i], points[i])[1]
    return piece, share


@njit(cache=True, nogil=True)
def _window(
    path: FloatArray,
    along: FloatArray,
    points: FloatArray,
    low: IntArray,
    high: IntArray,
    begin: int,
    end: int,
    at: int,
    piece: IntArray,
) -> None:
    """Assign the points begin ≤ i < end to pieces from `at` on."""
    way = 0.0
    for i in range(begin + 1, end):
        way += np.sqrt(((points[i] - points[i - 1]) ** 2).sum())
    first = max(at, low[begin])
    last = int(np.searchsorted(along, along[first] + AHEAD * way + AHEAD_MM, side="right"))
    if begin == 0:  # the motion may begin anywhere
        last = high[end - 1]
    last = max(min(last, high[end - 1]), low[end - 1] + 1, first + 1)
    n = last - first
    cost, came = np.full(n, np.inf), np.zeros((end - begin, n), dtype=np.int32)
    for i in range(begin, end):
        best, best_from = np.inf, 0  # of an earlier piece, as if everything since had been left out
        for j in range(n):
            k = first + j
            stay = cost[j]
            if i == begin:
                reached, source = SKIPPED_MM2 * (along[k] - along[at]), j
            elif best + SKIPPED_MM2 * along[k] < stay:
                reached, source = best + SKIPPED_MM2 * along[k], best_from
            else:
                reached, source = stay, j
            if stay - SKIPPED_MM2 * along[k + 1] < best:
                best, best_from = stay - SKIPPED_MM2 * along[k + 1], j
            came[i - begin, j] = source
            inside = low[i] <= k < high[i]
            cost[j] = reached + _foot(path, k, points[i])[0] if inside else np.inf
    j = int(np.argmin(cost))
    for i in range(end - 1, begin - 1, -1):
        piece[i] = first + j
        j = came[i - begin, j]
