"""Hot loops of the inversion, compiled: scheduling, the response of the spline basis, simulation of the scheduled plant.

Shapes: a run has knots every S seconds; `place` is the (x, y) at which an interval's model is frozen. mm, s.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@njit(cache=True, inline="always")
def _corner(x: float, x0: float, pitch: float, nodes: int) -> tuple[int, float]:
    """Grid index below x and the fraction to the next node, kept inside the grid."""
    s = min(max((x - x0) / pitch, 0.0), nodes - 1.000001)
    i = int(s)
    return i, s - i


@njit(cache=True)
def interpolate(table: FloatArray, x0: float, pitch: float, nodes: int, place: FloatArray) -> FloatArray:
    """Bilinear interpolation of matrices: table (nodes², r, c), place (n, 2) mm -> (n, r, c)."""
    out = np.empty((len(place), table.shape[1], table.shape[2]))
    for n in range(len(place)):
        i, fx = _corner(place[n, 0], x0, pitch, nodes)
        j, fy = _corner(place[n, 1], x0, pitch, nodes)
        at = i * nodes + j
        w00, w01, w10, w11 = (1 - fx) * (1 - fy), (1 - fx) * fy, fx * (1 - fy), fx * fy
        for r in range(table.shape[1]):
            for c in range(table.shape[2]):
                out[n, r, c] = (
                    w00 * table[at, r, c]
                    + w01 * table[at + 1, r, c]
                    + w10 * table[at + nodes, r, c]
                    + w11 * table[at + nodes + 1, r, c]
                )
    return out


@njit(cache=True)
def simulate(
    a: FloatArray,
    b0: FloatArray,
    b1: FloatArray,
    bf: FloatArray,
    substeps: int,
    state: FloatArray,
    command: FloatArray,
    centripetal: FloatArray,
    keep_every: int,
) -> tuple[FloatArray, FloatArray]:
    """Run the scheduled plant over n intervals of `substeps` steps each.

    a (n, 18, 18), b0 b1 bf (n, 18, 3): one discrete model an interval.   state (18,): at the first sample.
    command (n·substeps + 1, 3) mm: carriage heights asked for, linear between samples.
    centripetal (n·substeps + 1, 3) mm/s²: J̇ q̇ of the planned motion.
    Returns carriages (m, 3) mm after every `keep_every`-th step, and the states (n + 1, 18) at the knots.
    """
    n = len(a)
    x = state.copy()
    y = np.empty(18)
    knots = np.empty((n + 1, 18))
    knots[0] = x
    kept = np.empty((n * substeps // keep_every, 3))
    step = 0
    for k in range(n):
        ak, p0, p1, pf = a[k], b0[k], b1[k], bf[k]
        for _ in range(substeps):
            for r in range(18):
                s = 0.0
                for c in range(18):
                    s += ak[r, c] * x[c]
                for c in range(3):
                    s += p0[r, c] * command[step, c] + p1[r, c] * command[step + 1, c]
                    s += 0.5 * pf[r, c] * (centripetal[step, c] + centripetal[step + 1, c])
                y[r] = s
            x, y = y, x
            step += 1
            if step % keep_every == 0:
                for c in range(3):
                    kept[step // keep_every - 1, c] = x[6 + c]
        knots[k + 1] = x
    return kept, knots


@njit(cache=True)
def basis_response(
    a: FloatArray, b0: FloatArray, b1: FloatArray, jacobian: FloatArray, unknowns: int, per_knot: int
) -> FloatArray:
    """Φ: the nozzle's response to each coefficient of the degree-1 spline, through the scheduled plant.

    a (n, 18, 18), b0 b1 (n, 18, 3): models of the n intervals for steps of S/per_knot.   jacobian (n, 3, 3).
    Unknown coefficient u (0-based) is the hat centred on knot u + 1 of the window; knot 0 is given.
    Returns (3 n per_knot, 3 unknowns) mm per mm: rows by step (X Y Z inside), columns by knot (A B C inside).
    """
    n = len(a)
    columns = 3 * unknowns
    x = np.zeros((columns, 18))
    phi = np.zeros((3 * n * per_knot, columns))
    for k in range(n):
        live = 3 * min(k + 1, unknowns)
        at, t0, t1 = np.ascontiguousarray(a[k].T), b0[k], b1[k]
        for s in range(per_knot):
            x[:live] = np.dot(x[:live], at)
            before, after = s / per_knot, (s + 1) / per_knot
            if k < unknowns:  # the rising half of the hat on knot k + 1
                for c in range(3):
                    for r in range(18):
                        x[3 * k + c, r] += before * t0[r, c] + after * t1[r, c]
            if 0 < k <= unknowns:  # the falling half of the hat on knot k
                for c in range(3):
                    for r in range(18):
                        x[3 * k - 3 + c, r] += (1 - before) * t0[r, c] + (1 - after) * t1[r, c]
            row = 3 * (k * per_knot + s)
            for i in range(3):
                for col in range(live):
                    phi[row + i, col] = (
                        jacobian[k, i, 0] * x[col, 6] + jacobian[k, i, 1] * x[col, 7] + jacobian[k, i, 2] * x[col, 8]
                    )
    return phi
