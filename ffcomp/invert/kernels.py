"""Hot loops of the inversion, compiled: the response of the spline basis. mm, s."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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


@njit(cache=True, nogil=True)
def sweep_back(
    steady: FloatArray, ending: FloatArray, node: IntArray, error: FloatArray, bend: FloatArray, s: FloatArray
) -> FloatArray:
    """What the errors to come ask for now: ψ (n, 3) of `preview`, from the last interval to the first.

    steady (g, 33, 27), ending (m, 33, 27): gains.   node (n,): which of them; beyond g counts into `ending`.
    error (n, 6) mm, at the interval's rows; bend (n, 3) mm.   s (24,): at the last interval's end, overwritten.
    """
    n, g = len(node), len(steady)
    psi = np.empty((n, 3))
    out = np.empty(27)
    for k in range(n - 1, -1, -1):
        gain = steady[node[k]] if node[k] < g else ending[node[k] - g]
        for r in range(27):
            out[r] = 0.0
        for c in range(24):
            v = s[c]
            for r in range(27):
                out[r] += v * gain[c, r]
        for c in range(6):
            v = error[k, c]
            for r in range(27):
                out[r] += v * gain[24 + c, r]
        for c in range(3):
            v = bend[k, c]
            for r in range(27):
                out[r] += v * gain[30 + c, r]
        for r in range(24):
            s[r] = out[r]
        for r in range(3):
            psi[k, r] = out[24 + r]
    return psi


@njit(cache=True, nogil=True)
def sweep_forward(
    steady: FloatArray, ending: FloatArray, node: IntArray, psi: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The change of the command: γ (n, 3) at the ends of the intervals, and the plant's answers x (n, 18) there.

    z (24,): at the first knot, overwritten.
    """
    n, g = len(node), len(steady)
    gamma = np.empty((n, 3))
    states = np.empty((n, 18))
    out = np.empty(24)
    for k in range(n):
        gain = steady[node[k]] if node[k] < g else ending[node[k] - g]
        for r in range(24):
            out[r] = 0.0
        for c in range(24):
            v = z[c]
            for r in range(24):
                out[r] += v * gain[c, r]
        for c in range(3):
            v = psi[k, c]
            for r in range(24):
                out[r] += v * gain[24 + c, r]
        for r in range(24):
            z[r] = out[r]
        for r in range(18):
            states[k, r] = z[r]
        for r in range(3):
            gamma[k, r] = z[18 + r]
    return gamma, states
