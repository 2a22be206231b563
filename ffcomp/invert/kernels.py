"""Hot loops of the inversion, compiled: the response of the spline basis, and the sweeps of the fast inverse. mm, s."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ffcomp.products import recursion

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]

# (s, ψ) ← (s, ē, d), five numbers of 32 unused; z ← (z, ψ)
_back = recursion(rows=32, of_state=24, of_input=9)
_forward = recursion(rows=24, of_state=24, of_input=3)


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
    steady: Float32Array, ending: Float32Array, node: IntArray, error: FloatArray, gamma: FloatArray
) -> Float32Array:
    """What the errors to come ask for now: ψ (n, 3) of `preview`, from the last interval to the first.

    steady (g, 33, 32), ending (m, 33, 32): gains.   node (n,): which of them; beyond g counts into `ending`.
    error (n, 6) mm, at the interval's rows.   gamma (n + 2, 3) mm: the command's coefficients, from the knot before on.
    """
    n, g = len(node), len(steady)
    psi, s, given = np.empty((n, 3), np.float32), np.zeros(32, np.float32), np.empty((1, 9), np.float32)
    for k in range(n - 1, -1, -1):
        for r in range(6):
            given[0, r] = error[k, r]
        for r in range(3):
            given[0, 6 + r] = gamma[k + 2, r] - 2 * gamma[k + 1, r] + gamma[k, r]
        if node[k] < g:
            _back(steady, node[k], s, given, 0)
        else:
            _back(ending, node[k] - g, s, given, 0)
        for r in range(3):
            psi[k, r] = s[24 + r]
    return psi


@njit(cache=True, nogil=True)
def sweep_forward(
    steady: Float32Array, ending: Float32Array, node: IntArray, psi: Float32Array, kept: int
) -> tuple[FloatArray, FloatArray]:
    """The change of the command: γ (n, 3) at the ends of the intervals, and the plant's answer x (18,) after `kept`.

    steady (g, 27, 24), ending (m, 27, 24): gains.   psi (n, 3): see `sweep_back`.
    """
    n, g = len(node), len(steady)
    gamma, state, z = np.empty((n, 3)), np.zeros(18), np.zeros(24, np.float32)
    for k in range(n):
        if node[k] < g:
            _forward(steady, node[k], z, psi, k)
        else:
            _forward(ending, node[k] - g, z, psi, k)
        for r in range(3):
            gamma[k, r] = z[18 + r]
        if k == kept - 1:
            for r in range(18):
                state[r] = z[r]
    return gamma, state


@njit(cache=True, nogil=True)
def riccati_backwards(
    a: FloatArray,
    b: FloatArray,
    c: FloatArray,
    d: FloatArray,
    effort: float,
    resting: int,
    feedback: FloatArray,
    preview: FloatArray,
) -> None:
    """The finite problem of `preview`, from its end on backwards: F and the rows of ψ for every interval.

    a (24, 24), b (24, 3), c (6, 24), d (6, 3).   In the last `resting` intervals F is given and there is no choice.
    feedback (n, 3, 24), preview (n, 3, 33): of all intervals, filled in before those.
    """
    value = np.zeros((24, 24))
    for k in range(len(feedback) - 1, -1, -1):
        f = feedback[k]
        if k < len(feedback) - resting:
            ahead = _product(b.T, value)
            inverse = _inverse_of_three(_product(d.T, d) + _product(ahead, b) + effort * np.eye(3))
            f[:] = _product(inverse, _product(d.T, c) + _product(ahead, a))
            preview[k, :, :24] = _product(inverse, b.T)
            preview[k, :, 24:30] = _product(inverse, d.T)
            preview[k, :, 30:] = -effort * inverse
        closed, seen = a - _product(b, f), c - _product(d, f)
        value = _product(seen.T, seen) + effort * _product(f.T, f) + _product(closed.T, _product(value, closed))


@njit(cache=True, nogil=True)
def _product(x: FloatArray, y: FloatArray) -> FloatArray:
    """x y, without the library that numba would load for it."""
    out = np.zeros((x.shape[0], y.shape[1]))
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            for j in range(y.shape[1]):
                out[i, j] += x[i, k] * y[k, j]
    return out


@njit(cache=True, nogil=True)
def _inverse_of_three(m: FloatArray) -> FloatArray:
    """m⁻¹ (3, 3) by cofactors."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            p, q, r, s = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            out[i, j] = m[p, r] * m[q, s] - m[p, s] * m[q, r]
    return out / (m[0, 0] * out[0, 0] + m[0, 1] * out[1, 0] + m[0, 2] * out[2, 0])
