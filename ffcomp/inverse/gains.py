"""The preview inverse: least squares, solved by dynamic programming with gains that depend on place only.

The firmware executes our G1 segments, so the command is a spline of degree 1 with a knot at the end of every segment.
In error coordinates q_d = q* + N γ (q*: the reference carriage path, N: the hats of the spline) it is the γ of the
least ‖ e₀ − Φ γ ‖² + ρ ‖ D² γ ‖², with Φ the hats' response and e₀ the error without them. Over a whole section this is
an optimal tracking problem (linear-quadratic, with preview). Its state holds the answer x to γ and the last two
coefficients, its control is

    w_k = γ_{k+1} − 2 γ_k + γ_{k−1}          z_k = (x_k, γ_k, γ_{k−1})          z_{k+1} = 𝒜 z_k + ℬ w_k

and the cost of one interval ‖ē_k − C̄ z_k − D̄ w_k‖² + ρ ‖w_k + d_k‖², with ē the nozzle's error at the interval's
rows and d the second difference that the command already has. Because J depends on the place alone, the Riccati
equation is solved once for every place of a grid. Each knot then needs one product with a 33 × 27 matrix
backwards (the preview of the errors to come) and one with 27 × 24 forwards. At a section's end the
command must rest: there the gains are those of the finite problem, counted from the end, at its end position.

    s_k = (𝒜 − ℬF)ᵀ s_{k+1} + (C̄ − D̄F)ᵀ ē_k + ρ Fᵀ d_k         ψ_k = S⁻¹ (ℬᵀ s_{k+1} + D̄ᵀ ē_k − ρ d_k)
    w_k = ψ_k − F z_k                                           S = R + ℬᵀPℬ,  F = S⁻¹ (Nᵀ + ℬᵀP𝒜)

with Q = C̄ᵀC̄, R = ρ I + D̄ᵀD̄ and N = C̄ᵀD̄ (`riccati.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffcomp.inverse.riccati import LinearQuadratic, transposed
from models.arrays import FloatArray, IntArray
from models.compiled import kernel, with_numba
from models.vibration.state_space import DiscretePlant

Float32Array = NDArray[np.float32]


# (s, ψ) ← (s, ē, d), of a delta five numbers of 32 unused; z ← (z, ψ)
@with_numba
def _back() -> Any:
    from models.vibration.recursion import sized_recursion

    return sized_recursion(of_input=9)


@with_numba
def _forward() -> Any:
    from models.vibration.recursion import sized_recursion

    return sized_recursion(of_input=3)


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


@kernel
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
    psi, s, inputs = np.empty((n, 3), np.float32), np.zeros(len(rows), np.float32), np.empty((1, 9), np.float32)
    for k in range(n - 1, -1, -1):
        for r in range(6):
            inputs[0, r] = error[k, r]
        for r in range(3):
            inputs[0, 6 + r] = gamma[k + 2, r] - 2 * gamma[k + 1, r] + gamma[k, r]
        if node[k] < g:
            _back(rows, of_state, steady, node[k], s, inputs, 0)
        else:
            _back(rows, of_state, ending, node[k] - g, s, inputs, 0)
        for r in range(3):
            psi[k, r] = s[first + r]
    return psi


@kernel
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


PlantAt = Callable[[FloatArray], tuple[DiscretePlant, FloatArray]]  # places (g, 2) mm -> plant, jacobian (g, 3, 3)

AXES = 3
# numbers of z that the sweeps are compiled for, states that a plant lacks are zero: one mode an axis, a delta, more
SIZES = (12, 24, 48)
VECTOR = 16  # the products of the backward gains are filled up to a multiple of it
PITCH_MM = 5.0  # of the grid: what the nearest node misses, the correction finds
AT_A_TIME = 256  # places
TO_THE_END = 40  # knots before a section's end that the end affects
ENDS_KEPT = 64  # places, 0.8 MB each
REST_ROWS = 24  # knots after the end whose ringing counts


@dataclass(frozen=True, slots=True)
class SegmentPlant:
    """The plant over one segment at g places: z⁺ = 𝒜 z + ℬ w, rows C̄ z + D̄ w of the nozzle."""

    a: FloatArray  # (g, 24, 24)
    b: FloatArray  # (g, 24, 3)
    c: FloatArray  # (g, rows, 24)
    d: FloatArray  # (g, rows, 3)

    def problem(self, control_weight: float) -> LinearQuadratic:
        """Return the least squares of its rows and of w."""
        c, d = transposed(self.c), transposed(self.d)
        return LinearQuadratic(self.a, self.b, c @ self.c, control_weight * np.eye(AXES) + d @ self.d, c @ self.d)

    def preview(self, curvature: FloatArray, control_weight: float) -> FloatArray:
        """Return the rows of ψ (g, 3, 33), from R + ℬᵀPℬ (g, 3, 3)."""
        weights = np.broadcast_to(-control_weight * np.eye(AXES), (*self.b.shape[:-2], AXES, AXES))
        return np.linalg.solve(curvature, np.concatenate([transposed(self.b), transposed(self.d), weights], axis=-1))


@dataclass(frozen=True, slots=True)
class Gains:
    """What both sweeps multiply with, transposed so that every column of a product lies together in memory.

    In single precision: they only ever answer an error that is left, which is then measured again.
    """

    backward: Float32Array  # (g, 24 + rows + 3, 32): (s, ē, d) -> (s, ψ, nothing)
    forward: Float32Array  # (g, 24 + 3, 24): (z, ψ) -> z


def augmented(states: int) -> int:
    """Return how many numbers z has for a plant of so many states."""
    return next(size for size in SIZES if size >= states + 2 * AXES)


def no_gains(size: int, positions: int) -> Gains:
    """Return gains that are zero, for z of so many numbers."""
    rows = -(-(size + AXES) // VECTOR) * VECTOR
    return Gains(
        np.zeros((positions, size + 9, rows), np.float32), np.zeros((positions, size + AXES, size), np.float32)
    )


class PreviewGains:
    """The gains of one machine over its bed, worked out for the nodes that a path comes by.

    The arrays have room for every node; memory is taken where they are filled.
    """

    def __init__(
        self, plant_at: PlantAt, states: int, reach_mm: float, rows_per_segment: int, control_weight: float
    ) -> None:
        self._plant_at, self._rows, self.control_weight = plant_at, rows_per_segment, control_weight
        self._half = int(np.ceil(reach_mm / PITCH_MM)) + (reach_mm > 0.0)
        self._known = np.zeros((2 * self._half + 1) ** 2, dtype=np.bool_)  # of each node
        self.size = augmented(states)
        self._steady = no_gains(self.size, len(self._known))
        self.end = lru_cache(ENDS_KEPT)(self._end)

    def at(self, place: FloatArray) -> tuple[IntArray, Gains]:
        """Which gains serve at places (n, 2) mm: nodes (n,), which count those returned."""
        i, j = np.clip(np.rint(place / PITCH_MM), -self._half, self._half).astype(np.int64).T + self._half
        node = i * (2 * self._half + 1) + j
        known = self._known[node]
        if not known.all():
            missing = np.unique(node[~known])
            for some in np.array_split(missing, np.ceil(len(missing) / AT_A_TIME)):
                p = self.segment_plant(some)
                problem = p.problem(self.control_weight)
                feedback, curvature = problem.feedback(problem.stationary_value())
                preview = p.preview(curvature, self.control_weight)
                gains = _packed(p, feedback, preview, self.control_weight)
                self._steady.backward[some], self._steady.forward[some] = gains.backward, gains.forward
                self._known[some] = True
        return node, self._steady

    def along(self, place: FloatArray) -> tuple[IntArray, Gains, Gains]:
        """Which gains serve at places (n, 2) mm on the way to rest: nodes (n,), which count the steady and the last."""
        node, steady = self.at(place)
        affected = TO_THE_END + REST_ROWS
        n, ending = min(affected, len(node)), self.end(int(node[-1]))
        node[len(node) - n :] = len(steady.backward) + np.arange(affected - n, affected)
        return node, steady, ending

    def segment_plant(self, node: IntArray) -> SegmentPlant:
        """Return the problem that is solved at nodes (g,) of the grid."""
        across = 2 * self._half + 1
        xy = PITCH_MM * (np.stack([node // across, node % across], axis=1) - self._half).astype(np.float64)
        return _segment_plant(*self._plant_at(xy), self._rows)

    def _end(self, node: int) -> Gains:
        """Return the gains of the last `TO_THE_END` intervals of a section that ends at a node, first to last.

        The interval that ends the section has no choice left, nor have those after it: their gains are zero.
        """
        at, n, states = self.segment_plant(np.array([node])), TO_THE_END + REST_ROWS, self.size - 2 * AXES
        p = SegmentPlant(at.a[0], at.b[0], at.c[0], at.d[0])
        feedback, preview = np.zeros((n, AXES, self.size)), np.zeros((n, AXES, self.size + 9))
        rests = feedback[TO_THE_END - 1 :]  # γ_{k+1} = 0: w = −2 γ_k + γ_{k−1}
        rests[:, :, states : states + AXES], rests[:, :, states + AXES :] = 2 * np.eye(AXES), -np.eye(AXES)
        problem, value = p.problem(self.control_weight), np.zeros((self.size, self.size))
        curvature = np.empty((TO_THE_END - 1, AXES, AXES))
        for k in reversed(range(n)):
            if k < TO_THE_END - 1:
                feedback[k], curvature[k] = problem.feedback(value)
            value = problem.value_before(value, feedback[k])
        preview[: TO_THE_END - 1] = p.preview(curvature, self.control_weight)
        return _packed(p, feedback, preview, self.control_weight)


def segment_response(p: DiscretePlant, jacobian: FloatArray, rows: int) -> tuple[FloatArray, FloatArray]:
    """Return what the command's coefficients at a segment's two ends do, at all places of the plant.

    Parameters
    ----------
    p : for `rows` steps a segment;  jacobian : (g, 3, 3)

    Returns
    -------
    the state after the segment (g, s, s + 6), and the nozzle at its rows (g, 3 rows, s + 6), from the state before it
    and the coefficients at both ends
    """
    g, states = p.a.shape[:2]
    first, last = np.eye(2 * AXES, states + 2 * AXES, states).reshape(2, AXES, -1)
    state, seen = np.broadcast_to(np.eye(states, states + 2 * AXES), (g, states, states + 2 * AXES)), []
    for row in range(rows):
        u0, u1 = (first + (last - first) * share for share in (row / rows, (row + 1) / rows))
        state = p.a @ state + p.b0 @ u0 + p.b1 @ u1
        seen.append(jacobian @ (p.carriage @ state))
    return state, np.concatenate(seen, axis=1)


def _segment_plant(p: DiscretePlant, jacobian: FloatArray, rows: int) -> SegmentPlant:
    """Build the segment of `rows` steps of the plant, at all of its positions; jacobian (g, 3, 3)."""
    g, states = p.a.shape[:2]
    size = augmented(states)
    now, before = slice(size - 2 * AXES, size - AXES), slice(size - AXES, size)
    # of (z, w): the state, and the coefficients at the segment's two ends
    known, eye = np.eye(states + 2 * AXES, size + AXES), np.eye(AXES)
    first, last = known[states : states + AXES], known[states + AXES :]
    first[:], last[:] = 0.0, 0.0
    first[:, now] = eye
    last[:, now], last[:, before], last[:, size:] = 2 * eye, -eye, eye
    state, seen = (each @ known for each in segment_response(p, jacobian, rows))
    step = np.zeros((g, size, size + AXES))
    step[:, :states], step[:, now], step[:, before] = state, last, first
    return SegmentPlant(step[..., :size], step[..., size:], seen[..., :size], seen[..., size:])


def _packed(p: SegmentPlant, f: FloatArray, psi: FloatArray, control_weight: float) -> Gains:
    """F (n, 3, 24) and the rows of ψ (n, 3, 33), each at its own place or all at one."""
    size = p.a.shape[-1]
    gains = no_gains(size, len(f))
    state, rows = slice(0, size), slice(size, size + p.c.shape[-2])
    closed = p.a - p.b @ f
    gains.backward[:, state, state], gains.backward[:, rows, state] = closed, p.c - p.d @ f
    gains.backward[:, rows.stop :, state] = control_weight * f
    gains.backward[:, :, size : size + AXES] = transposed(psi)
    gains.forward[:, state], gains.forward[:, size:] = transposed(closed), transposed(p.b)
    return gains
