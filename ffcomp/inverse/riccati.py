"""The preview inverse: the same least squares, solved by dynamic programming with gains that depend on place only.

In error coordinates q_d = q* + N γ the least squares of `limited_window.py` over a whole section is an optimal tracking
problem (linear-quadratic, with preview). Its state holds the answer x to γ and the last two coefficients, its control
is

    w_k = γ_{k+1} − 2 γ_k + γ_{k−1}          z_k = (x_k, γ_k, γ_{k−1})          z_{k+1} = 𝒜 z_k + ℬ w_k

and the cost of one interval ‖ē_k − C̄ z_k − D̄ w_k‖² + ρ ‖w_k + d_k‖², with ē the nozzle's error at the interval's
rows and d the second difference that the command already has. Because J depends on the place alone, the Riccati
equation is solved once for every place of a grid. Each knot then needs one product with a 33 × 27 matrix
backwards (the preview of the errors to come) and one with 27 × 24 forwards. At a section's end the
command must rest: there the gains are those of the finite problem, counted from the end, at its end position.

    s_k = (𝒜 − ℬF)ᵀ s_{k+1} + (C̄ − D̄F)ᵀ ē_k + ρ Fᵀ d_k         ψ_k = R⁻¹ (ℬᵀ s_{k+1} + D̄ᵀ ē_k − ρ d_k)
    w_k = ψ_k − F z_k                                           R = ρ I + D̄ᵀD̄ + ℬᵀPℬ,  F = R⁻¹ (D̄ᵀC̄ + ℬᵀP𝒜)

Anderson & Moore, Optimal Control: Linear Quadratic Methods, 1990, ch. 4 and 10; the Riccati equation by structured
doubling (Chu, Fan, Lin & Wang, Int. J. Control 77 (2004) 767-788).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

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


@kernel
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


@kernel
def riccati_backwards(
    interval: FloatArray, control_weight: float, resting: int, feedback: FloatArray, preview: FloatArray
) -> None:
    """Solve the finite problem of `riccati`, from its end on backwards: F and the rows of ψ for every interval.

    interval (N + 6, N + 3): z⁺ and the nozzle's rows from (z, w), 𝒜 ℬ over C̄ D̄.   In the last `resting` intervals F is
    given and there is no choice.   feedback (n, 3, N), preview (n, 3, N + 9): of all intervals, filled in before those.
    """
    rows, state = interval.shape[0], interval.shape[1] - 3
    both = state + 3
    value, weighed, value_matrix = np.zeros((state, state)), np.empty_like(interval), np.empty((both, both))
    for k in range(len(feedback) - 1, -1, -1):
        # what the interval's end and its rows cost, as a form of (z, w)
        for i in range(rows):
            for j in range(both):
                weighed[i, j] = 0.0 if i < state else interval[i, j]
        for i in range(state):
            for m in range(state):
                for j in range(both):
                    weighed[i, j] += value[i, m] * interval[m, j]
        value_matrix[:] = 0.0
        for m in range(rows):
            for i in range(both):
                for j in range(both):
                    value_matrix[i, j] += interval[m, i] * weighed[m, j]
        for i in range(state, both):
            value_matrix[i, i] += control_weight
        if k < len(feedback) - resting:
            _best_of(value_matrix, interval, control_weight, feedback[k], preview[k])
        for i in range(state):
            for j in range(state):
                left = value_matrix[i, j]
                for r in range(3):
                    ahead = value_matrix[state + r, j]
                    for q in range(3):
                        ahead -= value_matrix[state + r, state + q] * feedback[k, q, j]
                    left -= value_matrix[i, state + r] * feedback[k, r, j] + feedback[k, r, i] * ahead
                value[i, j] = left


@kernel
def _best_of(
    value_matrix: FloatArray, interval: FloatArray, control_weight: float, f: FloatArray, preview: FloatArray
) -> None:
    """Find F (3, N) and the rows of ψ (3, N + 9) that minimise a form (N + 3, N + 3) of (z, w)."""
    state = len(value_matrix) - 3
    r = value_matrix[state:, state:]
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
                f[i, j] += share * value_matrix[state + q, j]
            for j in range(len(interval)):
                preview[i, j] += share * interval[j, state + q]
            preview[i, len(interval) + q] = -control_weight * share


PlantAt = Callable[[FloatArray], tuple[DiscretePlant, FloatArray]]  # places (g, 2) mm -> plant, jacobian (g, 3, 3)

AXES = 3
# numbers of z that the sweeps are compiled for, states that a plant lacks are zero: one mode an axis, a delta, more
SIZES = (12, 24, 48)
VECTOR = 16  # the products of the backward gains are filled up to a multiple of it
PITCH_MM = 5.0  # of the grid: what the nearest node misses, the correction finds
AT_A_TIME = 256  # places
DOUBLINGS = 9  # 512 knots: a state is forgotten by then, whatever places are worked out together
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


@dataclass(frozen=True, slots=True)
class Gains:
    """What both sweeps multiply with, transposed so that every column of a product lies together in memory.

    In single precision: they only ever answer an error that is left, which is then measured again.
    """

    backward: Float32Array  # (g, 24 + rows + 3, 32): (s, ē, d) -> (s, ψ, nothing)
    forward: Float32Array  # (g, 24 + 3, 24): (z, ψ) -> z

    def with_room(self, places: int) -> Gains:
        """Return the same gains, with room for at least so many positions."""
        if places <= len(self.backward):
            return self
        more = max(places, 2 * len(self.backward)) - len(self.backward)
        return Gains(
            *(
                np.concatenate([each, np.zeros((more, *each.shape[1:]), np.float32)])
                for each in (self.backward, self.forward)
            )
        )


def augmented(states: int) -> int:
    """Return how many numbers z has for a plant of so many states."""
    return next(size for size in SIZES if size >= states + 2 * AXES)


def no_gains(size: int, positions: int = 0) -> Gains:
    """Return gains that are zero, for z of so many numbers."""
    rows = -(-(size + AXES) // VECTOR) * VECTOR
    return Gains(
        np.zeros((positions, size + 9, rows), np.float32), np.zeros((positions, size + AXES, size), np.float32)
    )


class PreviewGains:
    """The gains of one machine over its bed, worked out for the nodes that a path comes by."""

    def __init__(
        self, plant_at: PlantAt, states: int, reach_mm: float, rows_per_segment: int, control_weight: float
    ) -> None:
        self._plant_at, self._rows, self.control_weight = plant_at, rows_per_segment, control_weight
        self._half = int(np.ceil(reach_mm / PITCH_MM)) + (reach_mm > 0.0)
        self._node = np.empty(0, dtype=np.int64)  # of each slot
        self._slot = np.full((2 * self._half + 1) ** 2, -1)  # where in the arrays a node's gains are; -1: nowhere yet
        self.size = augmented(states)
        self._steady = no_gains(self.size)
        self._ends: OrderedDict[int, Gains] = OrderedDict()
        self._working = Lock()

    def at(self, place: FloatArray) -> tuple[IntArray, Gains]:
        """Which gains serve at places (n, 2) mm: numbers (n,) into those returned."""
        i, j = np.clip(np.rint(place / PITCH_MM), -self._half, self._half).astype(np.int64).T + self._half
        node = i * (2 * self._half + 1) + j
        with self._working:
            slot = self._slot[node]
            if slot.min(initial=0) < 0:
                missing = np.unique(node[slot < 0])
                for some in np.array_split(missing, np.ceil(len(missing) / AT_A_TIME)):
                    self._work_out(some)
                slot = self._slot[node]
            return slot, self._steady

    def _work_out(self, node: IntArray) -> None:
        problem = self.segment_plant(node)
        self._add(node, _gains(problem, _riccati(problem, self.control_weight), self.control_weight))

    def segment_plant(self, node: IntArray) -> SegmentPlant:
        """Return the problem that is solved at nodes (g,) of the grid."""
        across = 2 * self._half + 1
        xy = PITCH_MM * (np.stack([node // across, node % across], axis=1) - self._half).astype(np.float64)
        return _segment_plant(*self._plant_at(xy), self._rows)

    def _add(self, node: IntArray, gains: Gains) -> None:
        known, now = len(self._node), len(self._node) + len(node)
        self._node = np.concatenate([self._node, node])
        self._steady = self._steady.with_room(now)
        self._steady.backward[known:now], self._steady.forward[known:now] = gains.backward, gains.forward
        self._slot[node] = np.arange(known, now)

    def __len__(self) -> int:
        """Places whose gains are known."""
        return len(self._node)

    def known(self) -> dict[str, NDArray[Any]]:
        """All gains so far, to be taken up again."""
        with self._working:
            n = len(self._node)
            return {"node": self._node, "backward": self._steady.backward[:n], "forward": self._steady.forward[:n]}

    def take_up(self, known: Mapping[str, NDArray[Any]]) -> None:
        """Gains of the same machine that somebody else has worked out."""
        with self._working:
            new = self._slot[known["node"]] < 0
            self._add(known["node"][new], Gains(known["backward"][new], known["forward"][new]))

    def end(self, slot: int) -> Gains:
        """Return the gains of the last `TO_THE_END` intervals of a section that ends at a position, first to last.

        The interval that ends the section has no choice left, nor have those after it: their gains are zero.
        """
        with self._working:
            if slot in self._ends:
                self._ends.move_to_end(slot)
                return self._ends[slot]
            gains = self._ends[slot] = self._finite(self.segment_plant(self._node[slot : slot + 1]))
            if len(self._ends) > ENDS_KEPT:
                self._ends.popitem(last=False)
            return gains

    def _finite(self, p: SegmentPlant) -> Gains:
        """From the end on backwards: where the command rests already, then where it still has a choice."""
        states = self.size - 2 * AXES
        feedback = np.zeros((TO_THE_END + REST_ROWS, AXES, self.size))
        preview = np.zeros((TO_THE_END + REST_ROWS, AXES, self.size + 9))
        rests = feedback[TO_THE_END - 1 :]  # γ_{k+1} = 0: w = −2 γ_k + γ_{k−1}
        rests[:, :, states : states + AXES], rests[:, :, states + AXES :] = 2 * np.eye(AXES), -np.eye(AXES)
        interval = np.block([[p.a[0], p.b[0]], [p.c[0], p.d[0]]])
        riccati_backwards(interval, self.control_weight, len(rests), feedback, preview)
        return _packed(p, feedback, preview, self.control_weight)


def _segment_plant(p: DiscretePlant, jacobian: FloatArray, rows: int) -> SegmentPlant:
    """Build the interval of `rows` steps of the plant, at all of its positions; jacobian (g, 3, 3)."""
    g, plant_states = p.a.shape[:2]
    size = augmented(plant_states)
    states = size - 2 * AXES
    x, now, before = slice(0, plant_states), slice(states, states + AXES), slice(states + AXES, size)
    eye = np.eye(AXES)
    # the command at the interval's two ends, as rows of (z, w)
    first, last = np.zeros((AXES, size + AXES)), np.zeros((AXES, size + AXES))
    first[:, now] = eye
    last[:, now], last[:, before], last[:, size:] = 2 * eye, -eye, eye
    state = np.zeros((g, plant_states, size + AXES))
    state[:, :, x] = np.eye(plant_states)
    seen = []
    for row in range(rows):
        u0, u1 = (first + (last - first) * share for share in (row / rows, (row + 1) / rows))
        state = p.a @ state + p.b0 @ u0 + p.b1 @ u1
        seen.append(jacobian @ (p.carriage @ state))
    step = np.zeros((g, size, size + AXES))
    step[:, x], step[:, now], step[:, before] = state, last, first
    output = np.concatenate(seen, axis=1)
    return SegmentPlant(step[..., :size], step[..., size:], output[..., :size], output[..., size:])


def _riccati(p: SegmentPlant, control_weight: float) -> FloatArray:
    """P (g, 24, 24) of the problem without an end."""
    r = control_weight * np.eye(AXES) + _t(p.d) @ p.d
    cross = np.linalg.solve(r, _t(p.d) @ p.c)
    a = p.a - p.b @ cross
    h = _t(p.c) @ p.c - _t(p.c) @ p.d @ cross
    g = p.b @ np.linalg.solve(r, _t(p.b))
    size = p.a.shape[-1]
    eye = np.eye(size)
    for _ in range(DOUBLINGS):  # a: the remainder of a state after 1, 2, 4, … knots
        solved = np.linalg.solve(eye + g @ h, np.concatenate([a, g @ _t(a)], axis=2))
        ahead, spread = solved[..., :size], solved[..., size:]
        h = h + _t(a) @ h @ ahead
        g = g + a @ spread
        a = a @ ahead
        h, g = 0.5 * (h + _t(h)), 0.5 * (g + _t(g))
    return h


def _gains(p: SegmentPlant, value: FloatArray, control_weight: float) -> Gains:
    """Return the gains at g places for the terminal cost P (g, 24, 24)."""
    ahead = _t(p.b) @ value
    r = control_weight * np.eye(AXES) + _t(p.d) @ p.d + ahead @ p.b
    f: Any = np.linalg.solve(r, _t(p.d) @ p.c + ahead @ p.a)
    weights = np.broadcast_to(-control_weight * np.eye(AXES), r.shape)
    psi: Any = np.linalg.solve(r, np.concatenate([_t(p.b), _t(p.d), weights], axis=-1))
    return _packed(p, f, psi, control_weight)


def _packed(p: SegmentPlant, f: FloatArray, psi: FloatArray, control_weight: float) -> Gains:
    """F (n, 3, 24) and the rows of ψ (n, 3, 33), each at its own place or all at one."""
    size = p.a.shape[-1]
    gains = no_gains(size, len(f))
    state, rows = slice(0, size), slice(size, size + p.c.shape[1])
    closed = p.a - p.b @ f
    gains.backward[:, state, state], gains.backward[:, rows, state] = closed, p.c - p.d @ f
    gains.backward[:, rows.stop :, state] = control_weight * f
    gains.backward[:, :, size : size + AXES] = _t(psi)
    gains.forward[:, state], gains.forward[:, size:] = _t(closed), _t(p.b)
    return gains


def _t(matrix: NDArray[Any]) -> NDArray[Any]:
    return np.swapaxes(matrix, -1, -2)
