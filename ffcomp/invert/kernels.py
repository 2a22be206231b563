"""Hot loops of the inversion, compiled: the response of the spline basis. mm, s."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


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
