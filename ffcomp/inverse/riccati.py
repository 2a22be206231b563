"""The preview inverse: the same least squares, solved by dynamic programming with gains that depend on place only.

In error coordinates q_d = q* + N γ the least squares of `windowed_qr.py` over a whole section is an optimal tracking
problem (linear-quadratic, with preview). Its state holds the answer x to γ and the last two coefficients, its control
is

    w_k = γ_{k+1} − 2 γ_k + γ_{k−1}          z_k = (x_k, γ_k, γ_{k−1})          z_{k+1} = 𝒜 z_k + ℬ w_k

and the cost of one interval ‖ē_k − C̄ z_k − D̄ w_k‖² + ρ ‖w_k + d_k‖², with ē the nozzle's error at the interval's
rows and d the second difference that the command already has. Because J depends on the place alone, the Riccati
equation is solved once for every place of a grid. What is left for each knot is one product with a 33 × 27 matrix
backwards (the preview: what the errors to come ask for now) and one with 27 × 24 forwards. At a section's end the
command must rest: there the gains are those of the finite problem, counted from the end, for the place where it ends.

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

from ffcomp.inverse.riccati_kernels import riccati_backwards
from models.arrays import FloatArray, IntArray
from models.vibration.state_space import DiscretePlant

Float32Array = NDArray[np.float32]
PlantAt = Callable[[FloatArray], tuple[DiscretePlant, FloatArray]]  # places (g, 2) mm -> plant, jacobian (g, 3, 3)

AXES = 3
# numbers of z that the sweeps are compiled for, states that a plant lacks are zero: one mode an axis, a delta, more
SIZES = (12, 24, 48)
VECTOR = 16  # the products of the backward gains are filled up to a multiple of it
PITCH_MM = 5.0  # of the grid: what the nearest node misses, the correction finds
AT_A_TIME = 256  # places
DOUBLINGS = 9  # 512 knots: a state is forgotten by then, whatever places are worked out together
TO_THE_END = 40  # knots before a section's end from which on the end is felt
ENDS_KEPT = 64  # places, 0.8 MB each
REST_ROWS = 24  # knots after the end whose ringing counts


@dataclass(frozen=True, slots=True)
class Problem:
    """One interval at g places: z⁺ = 𝒜 z + ℬ w, rows C̄ z + D̄ w of the nozzle."""

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

    def __init__(self, plant_at: PlantAt, states: int, reach_mm: float, rows_per_segment: int, effort: float) -> None:
        self._plant_at, self._rows, self.effort = plant_at, rows_per_segment, effort
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
        problem = self.problem(node)
        self._add(node, _gains(problem, _riccati(problem, self.effort), self.effort))

    def problem(self, node: IntArray) -> Problem:
        """Return the problem that is solved at nodes (g,) of the grid."""
        across = 2 * self._half + 1
        xy = PITCH_MM * (np.stack([node // across, node % across], axis=1) - self._half).astype(np.float64)
        return _problem(*self._plant_at(xy), self._rows)

    def _add(self, node: IntArray, found: Gains) -> None:
        known, now = len(self._node), len(self._node) + len(node)
        self._node = np.concatenate([self._node, node])
        self._steady = self._steady.with_room(now)
        self._steady.backward[known:now], self._steady.forward[known:now] = found.backward, found.forward
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
            found = self._ends[slot] = self._finite(self.problem(self._node[slot : slot + 1]))
            if len(self._ends) > ENDS_KEPT:
                self._ends.popitem(last=False)
            return found

    def _finite(self, p: Problem) -> Gains:
        """From the end on backwards: where the command rests already, then where it still has a choice."""
        states = self.size - 2 * AXES
        feedback = np.zeros((TO_THE_END + REST_ROWS, AXES, self.size))
        preview = np.zeros((TO_THE_END + REST_ROWS, AXES, self.size + 9))
        rests = feedback[TO_THE_END - 1 :]  # γ_{k+1} = 0: w = −2 γ_k + γ_{k−1}
        rests[:, :, states : states + AXES], rests[:, :, states + AXES :] = 2 * np.eye(AXES), -np.eye(AXES)
        interval = np.block([[p.a[0], p.b[0]], [p.c[0], p.d[0]]])
        riccati_backwards(interval, self.effort, len(rests), feedback, preview)
        return _packed(p, feedback, preview, self.effort)


def _problem(p: DiscretePlant, jacobian: FloatArray, rows: int) -> Problem:
    """Build the interval of `rows` steps of the plant, at all of its positions; jacobian (g, 3, 3)."""
    g, own = p.a.shape[:2]
    size = augmented(own)
    states = size - 2 * AXES
    x, now, before = slice(0, own), slice(states, states + AXES), slice(states + AXES, size)
    eye = np.eye(AXES)
    # the command at the interval's two ends, as rows of (z, w)
    first, last = np.zeros((AXES, size + AXES)), np.zeros((AXES, size + AXES))
    first[:, now] = eye
    last[:, now], last[:, before], last[:, size:] = 2 * eye, -eye, eye
    state = np.zeros((g, own, size + AXES))
    state[:, :, x] = np.eye(own)
    seen = []
    for row in range(rows):
        u0, u1 = (first + (last - first) * share for share in (row / rows, (row + 1) / rows))
        state = p.a @ state + p.b0 @ u0 + p.b1 @ u1
        seen.append(jacobian @ (p.carriage @ state))
    step = np.zeros((g, size, size + AXES))
    step[:, x], step[:, now], step[:, before] = state, last, first
    output = np.concatenate(seen, axis=1)
    return Problem(step[..., :size], step[..., size:], output[..., :size], output[..., size:])


def _riccati(p: Problem, effort: float) -> FloatArray:
    """P (g, 24, 24) of the problem without an end."""
    r = effort * np.eye(AXES) + _t(p.d) @ p.d
    cross = np.linalg.solve(r, _t(p.d) @ p.c)
    a = p.a - p.b @ cross
    h = _t(p.c) @ p.c - _t(p.c) @ p.d @ cross
    g = p.b @ np.linalg.solve(r, _t(p.b))
    size = p.a.shape[-1]
    eye = np.eye(size)
    for _ in range(DOUBLINGS):  # a: what is left of a state after 1, 2, 4, … knots
        solved = np.linalg.solve(eye + g @ h, np.concatenate([a, g @ _t(a)], axis=2))
        ahead, spread = solved[..., :size], solved[..., size:]
        h = h + _t(a) @ h @ ahead
        g = g + a @ spread
        a = a @ ahead
        h, g = 0.5 * (h + _t(h)), 0.5 * (g + _t(g))
    return h


def _gains(p: Problem, value: FloatArray, effort: float) -> Gains:
    """At g places, for what an interval's end is worth, P (g, 24, 24)."""
    ahead = _t(p.b) @ value
    r = effort * np.eye(AXES) + _t(p.d) @ p.d + ahead @ p.b
    f: Any = np.linalg.solve(r, _t(p.d) @ p.c + ahead @ p.a)
    weights = np.broadcast_to(-effort * np.eye(AXES), r.shape)
    psi: Any = np.linalg.solve(r, np.concatenate([_t(p.b), _t(p.d), weights], axis=-1))
    return _packed(p, f, psi, effort)


def _packed(p: Problem, f: FloatArray, psi: FloatArray, effort: float) -> Gains:
    """F (n, 3, 24) and the rows of ψ (n, 3, 33), each at its own place or all at one."""
    size = p.a.shape[-1]
    gains = no_gains(size, len(f))
    state, rows = slice(0, size), slice(size, size + p.c.shape[1])
    closed = p.a - p.b @ f
    gains.backward[:, state, state], gains.backward[:, rows, state] = closed, p.c - p.d @ f
    gains.backward[:, rows.stop :, state] = effort * f
    gains.backward[:, :, size : size + AXES] = _t(psi)
    gains.forward[:, state], gains.forward[:, size:] = _t(closed), _t(p.b)
    return gains


def _t(matrix: NDArray[Any]) -> NDArray[Any]:
    return np.swapaxes(matrix, -1, -2)
