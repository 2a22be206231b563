"""How far printers that differ a little are beside the path: which share of them is beyond a bound, and for how long.

The error of a printer is that of the machine file's printer and, nearly, a sum of changes, one for each direction in
which its parameters may be off, as often as it is off there. So many printers are drawn and added up, with no more
simulation than one for each direction. What counts is the print of a printer: its 99th percentile over time; and over
printers, the quantile that was asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.arrays import FloatArray, IntArray

ShortArray = NDArray[np.float32]

DRAWN = 127
BEYOND = 0.01  # share of the time that a printer's error may be above the bound
BIN, BINS = 0.02, 400  # times the bound: what errors are counted in
LEAST = 0.3  # times the bound: below it nothing is told apart
FARTHEST = 3.0  # standard deviations, in all directions together


def at_quantile(nominal: FloatArray, changes: ShortArray, scale: FloatArray, far: float) -> FloatArray:
    """Return the error at the quantile at each moment by itself, (m,) times the bound.

    Parameters
    ----------
    nominal : (m,) mm
        Of the machine file's printer.
    changes : (k, m, 3) mm
        Across the path, for one standard deviation in each direction.
    scale : (m,) 1/mm
        What errors are multiplied by: one over the bound.
    far : float
        Standard deviations of the quantile.
    """
    return np.asarray(_at_quantile(np.ascontiguousarray(nominal), changes, scale, far))


def counted(nominal: FloatArray, changes: ShortArray, scale: FloatArray) -> IntArray:
    """Count moments by the printer and its error, (drawn, BINS); arguments as `at_quantile`."""
    return np.asarray(_counted(np.ascontiguousarray(nominal), changes, scale, drawn(len(changes))))


def percentile(counts: Sequence[IntArray], still: float, safety: float) -> float:
    """Return the 99th percentile of the error over time at the printers' quantile, times the bound.

    still : moments besides, without an error
    """
    total = np.sum(counts, axis=0)
    may = BEYOND * (float(total[0].sum()) + still)
    above = np.cumsum(total[:, ::-1], axis=1)[:, ::-1]  # moments in this bin or above it
    at = np.maximum((above > may).sum(axis=1) - 1, 0)
    rows = np.arange(len(total))
    beyond = above[rows, at] - total[rows, at]
    share = np.clip((may - beyond) / np.maximum(total[rows, at], 1), 0.0, 1.0)
    return float(np.quantile(BIN * (at + 1.0 - share), 1.0 - safety))


@cache
def drawn(directions: int) -> ShortArray:
    """Return how far printers are off in each direction, (n, directions) standard deviations; one, if there is none.

    They lie evenly: a Kronecker sequence of the generalised golden ratio.
    """
    from scipy.special import ndtri

    if not directions:
        return np.zeros((1, 0), dtype=np.float32)
    ratio = 2.0
    for _ in range(30):
        ratio = (1.0 + ratio) ** (1.0 / (directions + 1))
    steps = ratio ** -np.arange(1.0, directions + 1.0)
    even = (0.5 + np.arange(1.0, DRAWN + 1.0)[:, None] * steps) % 1.0
    return np.asarray(ndtri(even), dtype=np.float32)


@njit(cache=True, nogil=True)
def _at_quantile(nominal: FloatArray, changes: ShortArray, scale: FloatArray, far: float) -> FloatArray:
    error = np.empty(len(nominal))
    for i in range(len(nominal)):
        total = 0.0
        for a in range(changes.shape[0]):
            for c in range(3):
                total += changes[a, i, c] * changes[a, i, c]
        error[i] = scale[i] * np.sqrt(nominal[i] * nominal[i] + far * far * total)
    return error


@njit(cache=True, nogil=True, fastmath=True)
def _counted(nominal: FloatArray, changes: ShortArray, scale: FloatArray, deviates: ShortArray) -> IntArray:
    directions, m, n = changes.shape[0], changes.shape[1], len(deviates)
    counts = np.zeros((n, BINS), np.int64)
    low = 0
    x, y, z = np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32)
    for i in range(m):
        square, total = nominal[i] * nominal[i], 0.0
        for a in range(directions):
            for c in range(3):
                total += changes[a, i, c] * changes[a, i, c]
        if scale[i] * np.sqrt(square + FARTHEST * FARTHEST * total) < LEAST:
            low += 1
            continue
        x[:], y[:], z[:] = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for a in range(directions):
            ex, ey, ez = changes[a, i, 0], changes[a, i, 1], changes[a, i, 2]
            for j in range(n):
                x[j] += deviates[j, a] * ex
                y[j] += deviates[j, a] * ey
                z[j] += deviates[j, a] * ez
        times = scale[i] / BIN
        for j in range(n):
            value = times * np.sqrt(square + x[j] * x[j] + y[j] * y[j] + z[j] * z[j])
            counts[j, min(int(value), BINS - 1)] += 1
    counts[:, 0] += low
    return counts
