"""Hot loops of the inversion, compiled: the response of the spline basis, and the sweeps of the fast inverse. mm, s."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.arrays import FloatArray, IntArray
from models.vibration.small_matvec import sized_recursion

Float32Array = NDArray[np.float32]

# (s, ψ) ← (s, ē, d), of a delta five numbers of 32 unused; z ← (z, ψ)
_back = sized_recursion(of_input=9)
_forward = sized_recursion(of_input=3)


@njit(cache=True)
def basis_response(
    a: FloatArray,
    b0: FloatArray,
    b1: FloatArray,
    carriage: FloatArray,
    jacobian: FloatArray,
    unknowns: int,
    per_knot: int,
) -> FloatArray:
    """Φ: the nozzle's response to each coefficient of the degree-1 spline, through the scheduled plant.

    a (n, s, s), b0 b1 (n, s, 3): models of the n intervals for steps of S/per_knot.   carriage (3, s): actuators of the
    states.   jacobian (n, 3, 3).
    Unknown coefficient u (0-based) is the hat centred on knot u + 1 of the window; knot 0 is given.
    Returns (3 n per_knot, 3 unknowns) mm per mm: rows by step (X Y Z inside), columns by knot (A B C inside).
    """
    n, states = a.shape[0], a.shape[1]
    columns = 3 * unknowns
    x = np.zeros((columns, states))
    phi, of_states = np.zeros((3 * n * per_knot, columns)), np.ascontiguousarray(carriage.T)
    for k in range(n):
        live = 3 * min(k + 1, unknowns)
        at, t0, t1 = np.ascontiguousarray(a[k].T), b0[k], b1[k]
        for s in range(per_knot):
            x[:live] = np.dot(x[:live], at)
            before, after = s / per_knot, (s + 1) / per_knot
            if k < unknowns:  # the rising half of the hat on knot k + 1
                for c in range(3):
                    for r in range(states):
                        x[3 * k + c, r] += before * t0[r, c] + after * t1[r, c]
            if 0 < k <= unknowns:  # the falling half of the hat on knot k
                for c in range(3):
                    for r in range(states):
                        x[3 * k - 3 + c, r] += (1 - before) * t0[r, c] + (1 - after) * t1[r, c]
            row = 3 * (k * per_knot + s)
            q = np.dot(x[:live], of_states)
            for i in range(3):
                for col in range(live):
                    phi[row + i, col] = (
                        jacobian[k, i, 0] * q[col, 0] + jacobian[k, i, 1] * q[col, 1] + jacobian[k, i, 2] * q[col, 2]
                    )
    return phi


def sweep_back(
    steady: Float32Array, ending: Float32Array, node: IntArray, error: FloatArray, gamma: FloatArray
) -> Float32Array:
    """Sweep backwards: ψ (n, 3) of `riccati`, what the errors to come demand now, from the last interval on.

    steady (g, N + 9, M), ending (m, N + 9, M): gains; N: numbers of z, M: N + 3 filled up to a vector's length.
    node (n,): which of them; beyond g counts into `ending`.   error (n, 6) mm, at the interval's rows.
    gamma (n + 2, 3) mm: the command's coefficients, from the knot before on.
    """
    return np.asarray(_sweep_back(steady, ending, node, error, gamma, *_sizes(steady, 9)))


def sweep_forward(
    steady: Float32Array, ending: Float32Array, node: IntArray, psi: Float32Array, kept: int
) -> tuple[FloatArray, FloatArray]:
    """Sweep forwards: the change of the command and the plant's response to it.

    steady (g, N + 3, N), ending (m, N + 3, N): gains.   psi (n, 3): see `sweep_back`.
    Returns γ (n, 3) at the ends of the intervals, and the response x (N − 6,) after `kept`.
    """
    gamma, state = _sweep_forward(steady, ending, node, psi, kept, *_sizes(steady, 3))
    return gamma, state


def _sizes(gains: Float32Array, of_input: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return tuples as long as a gain has rows and numbers of state, see `sized_recursion`."""
    return (0,) * gains.shape[2], (0,) * (gains.shape[1] - of_input)


@njit(cache=True, nogil=True)
def _sweep_back(
    steady: Float32Array,
    ending: Float32Array,
    node: IntArray,
    error: FloatArray,
    gamma: FloatArray,
    rows: tuple[int, ...],
    of_state: tuple[int, ...],
) -> Float32Array:
    n, g, first = len(node), len(steady), len(of_state)
    psi, s, given = np.empty((n, 3), np.float32), np.zeros(len(rows), np.float32), np.empty((1, 9), np.float32)
    for k in range(n - 1, -1, -1):
        for r in range(6):
            given[0, r] = error[k, r]
        for r in range(3):
            given[0, 6 + r] = gamma[k + 2, r] - 2 * gamma[k + 1, r] + gamma[k, r]
        if node[k] < g:
            _back(rows, of_state, steady, node[k], s, given, 0)
        else:
            _back(rows, of_state, ending, node[k] - g, s, given, 0)
        for r in range(3):
            psi[k, r] = s[first + r]
    return psi


@njit(cache=True, nogil=True)
def _sweep_forward(
    steady: Float32Array,
    ending: Float32Array,
    node: IntArray,
    psi: Float32Array,
    kept: int,
    rows: tuple[int, ...],
    of_state: tuple[int, ...],
) -> tuple[FloatArray, FloatArray]:
    n, g, states = len(node), len(steady), len(of_state) - 6
    gamma, state, z = np.empty((n, 3)), np.zeros(states), np.zeros(len(rows), np.float32)
    for k in range(n):
        if node[k] < g:
            _forward(rows, of_state, steady, node[k], z, psi, k)
        else:
            _forward(rows, of_state, ending, node[k] - g, z, psi, k)
        for r in range(3):
            gamma[k, r] = z[states + r]
        if k == kept - 1:
            for r in range(states):
                state[r] = z[r]
    return gamma, state


@njit(cache=True, nogil=True)
def riccati_backwards(
    interval: FloatArray, effort: float, resting: int, feedback: FloatArray, preview: FloatArray
) -> None:
    """Solve the finite problem of `riccati`, from its end on backwards: F and the rows of ψ for every interval.

    interval (N + 6, N + 3): z⁺ and the nozzle's rows from (z, w), 𝒜 ℬ over C̄ D̄.   In the last `resting` intervals F is
    given and there is no choice.   feedback (n, 3, N), preview (n, 3, N + 9): of all intervals, filled in before those.
    """
    rows, state = interval.shape[0], interval.shape[1] - 3
    both = state + 3
    value, weighed, worth = np.zeros((state, state)), np.empty_like(interval), np.empty((both, both))
    for k in range(len(feedback) - 1, -1, -1):
        # what the interval's end and its rows cost, as a form of (z, w)
        for i in range(rows):
            for j in range(both):
                weighed[i, j] = 0.0 if i < state else interval[i, j]
        for i in range(state):
            for m in range(state):
                for j in range(both):
                    weighed[i, j] += value[i, m] * interval[m, j]
        worth[:] = 0.0
        for m in range(rows):
            for i in range(both):
                for j in range(both):
                    worth[i, j] += interval[m, i] * weighed[m, j]
        for i in range(state, both):
            worth[i, i] += effort
        if k < len(feedback) - resting:
            _best_of(worth, interval, effort, feedback[k], preview[k])
        for i in range(state):
            for j in range(state):
                left = worth[i, j]
                for r in range(3):
                    ahead = worth[state + r, j]
                    for q in range(3):
                        ahead -= worth[state + r, state + q] * feedback[k, q, j]
                    left -= worth[i, state + r] * feedback[k, r, j] + feedback[k, r, i] * ahead
                value[i, j] = left


@njit(cache=True, nogil=True)
def _best_of(worth: FloatArray, interval: FloatArray, effort: float, f: FloatArray, preview: FloatArray) -> None:
    """Find F (3, N) and the rows of ψ (3, N + 9) for which a form (N + 3, N + 3) of (z, w) is least."""
    state = len(worth) - 3
    r = worth[state:, state:]
    inverse, determinant = np.empty((3, 3)), 0.0
    for i in range(3):
        for j in range(3):
            a, b, c, d = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            inverse[i, j] = r[a, c] * r[b, d] - r[a, d] * r[b, c]
        determinant += r[0, i] * inverse[i, 0]
    for i in range(3):
        for q in range(3):
            share = inverse[i, q] / determinant
            for j in range(state):
                f[i, j] += share * worth[state + q, j]
            for j in range(len(interval)):
                preview[i, j] += share * interval[j, state + q]
            preview[i, len(interval) + q] = -effort * share
