"""The plant scheduled along a path, and its response to a command.

Models are looked up every interval (4 ms: the nozzle moves less than a millimetre) and interpolated on the table over
the bed; inside an interval the discrete model is exact for a command that is linear between samples. mm, s.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.arrays import FloatArray, IntArray
from models.compiled import kernel, with_numba
from models.kinematics.base import Kinematics
from models.vibration.base import VibrationModel
from models.vibration.state_space import DiscretePlant, discretise

PITCH_MM = 10.0  # of the table over the bed
SAME_MM = 1.0  # a model is valid within this distance


@with_numba
def _advance() -> Any:
    from models.vibration.recursion import recursion

    return recursion(rows=12, of_state=12, of_input=15)


@dataclass(frozen=True, slots=True)
class PlantTable:
    """Discrete plants on a square grid over the bed; everything between is interpolated bilinearly."""

    x0_mm: float  # the grid's first node, both axes
    pitch_mm: float
    nodes: int  # per axis; node (ix, iy) is place ix * nodes + iy
    plant: DiscretePlant
    jacobian: FloatArray  # (nodes², 3, 3)

    def frozen(self) -> PlantTable:
        """Return the table with the plant of the middle of the bed everywhere; the kinematics are unchanged."""
        middle, p = len(self.jacobian) // 2, self.plant
        matrices = {name: getattr(p, name) for name in ("a", "b0", "b1", "b_centripetal")}
        same: Any = {name: np.repeat(x[middle : middle + 1], len(p.a), axis=0) for name, x in matrices.items()}
        return replace(self, plant=replace(p, **same))


def table_positions(kinematics: Kinematics, pitch_mm: float = PITCH_MM) -> tuple[FloatArray, FloatArray]:
    """Return the nodes' places along one axis (k,) and all nodes (k², 2) mm, those beyond the rim moved back to it."""
    reach = kinematics.model_reach_mm
    half = int(np.ceil(reach / pitch_mm)) + 1
    axis = pitch_mm * np.arange(-half, half + 1)
    xy = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    radius = np.hypot(*xy.T)
    rim = reach + min(pitch_mm, 0.9 * kinematics.spare_reach_mm)
    return axis.astype(np.float64), xy * np.minimum(1.0, rim / np.maximum(radius, 1e-9))[:, None]


def plant_table(
    kinematics: Kinematics, vibration: VibrationModel, step_s: float, pitch_mm: float = PITCH_MM
) -> PlantTable:
    """Return the plant over the whole bed. Nodes outside the print radius repeat the rim's plant."""
    axis, xy = table_positions(kinematics, pitch_mm)
    plant = discretise(vibration.state_space(xy), step_s)
    return PlantTable(float(axis[0]), pitch_mm, len(axis), plant, kinematics.jacobian(xy))


class OnCarriages:
    """Rows of the nozzle on the carriages: once for all printers of one geometry that play the same rows in turn."""

    def __init__(self, kinematics: Kinematics) -> None:
        self.delta = kinematics.compiled()
        self._nozzle = self._velocity = self._command = self._centripetal = np.empty((0, 3))

    def of(self, nozzle: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return carriages mm, and J̇ q̇ mm/s², of the nozzle's positions mm and velocities mm/s; all (n, 3)."""
        if nozzle is not self._nozzle or velocity is not self._velocity:
            self._nozzle, self._velocity, self._command = nozzle, velocity, self.delta.inverse(nozzle)
            self._centripetal = self.delta.rate_term(np.ascontiguousarray(nozzle), np.ascontiguousarray(velocity))
        return self._command, self._centripetal


class Schedule:
    """The plant over the bed, packed for the loop that plays commands on it."""

    def __init__(self, kinematics: Kinematics, table: PlantTable, carriages: OnCarriages | None = None) -> None:
        """Pack the table; carriages : shared by several schedules of one geometry."""
        self.carriages, self.table = carriages or OnCarriages(kinematics), table
        self._coupled = None if len(table.plant.oscillators) else _packed(table)
        self._exchanging = _exchanging(table.plant)

    def play(
        self, place: FloatArray, centripetal: FloatArray, command: FloatArray, state: FloatArray, substeps: int
    ) -> tuple[FloatArray, FloatArray]:
        """Compute the carriages under a command while the nozzle passes along its path.

        Parameters
        ----------
        place : (n, 2) mm, planned nozzle position in the middle of each knot interval
        centripetal : (n·substeps + 1, 3) mm/s², J̇ q̇ of the planned motion, at the table's steps
        command : (n·substeps + 1, 3) mm, carriage heights, linear between the steps
        state : (s,) at the first sample
        substeps : steps per model

        Returns
        -------
        carriages (n·substeps, 3) mm after every step; states (n + 1, s) at the knots
        """
        if self._coupled is None:
            p = self.table.plant
            plant = p.a[0], p.b0[0], p.b1[0], len(place), substeps, state, command
            if self._exchanging:
                return simulate_constant(p.carriage, *plant)
            return simulate_oscillators(p.oscillators, *plant)
        mechanics, drive = self._coupled
        grid = (self.table.x0_mm, self.table.pitch_mm, self.table.nodes)
        return simulate(mechanics, drive, *grid, place, substeps, state, command, centripetal)

    def respond(
        self, nozzle: FloatArray, velocity: FloatArray, state: FloatArray, substeps: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return the nozzle's actual path under the command `nozzle`, (n·substeps, 3) mm, and the final state."""
        command, centripetal = self.carriages.of(nozzle, velocity)
        place = np.ascontiguousarray(nozzle[substeps // 2 :: substeps, :2][: (len(nozzle) - 1) // substeps])
        q, states = self.play(place, centripetal, command, state, substeps)
        return self.carriages.delta.forward(q), states[-1]


def _exchanging(plant: DiscretePlant) -> bool:
    """Whether oscillators are coupled."""
    diagonal = np.kron(np.eye(len(plant.oscillators)), np.ones((2, 2))) == 1.0
    return bool(len(plant.oscillators)) and bool(np.any(plant.a[0][~diagonal] != 0.0))


def _packed(table: PlantTable) -> tuple[FloatArray, FloatArray]:
    """Pack the table for the loop: what depends on position, and the drives, which do not.

    Returns
    -------
    (nodes², 27, 12): for the twelve states after the drives, the columns of the states (after the drives first,
        then the drives'), of u(t), u(t + h) and J̇ q̇
    (3, 8): of each tower's drive (w, ẇ): both rows of A, then of B₀ and B₁
    """
    p = table.plant
    columns = (p.a[:, 6:, 6:], p.a[:, 6:, :6], p.b0[:, 6:], p.b1[:, 6:], p.b_centripetal[:, 6:])
    mechanics = np.concatenate([np.swapaxes(each, 1, 2) for each in columns], axis=1)
    drive = np.empty((3, 8))
    for i in range(3):
        pair = [i, 3 + i]
        drive[i] = np.concatenate([p.a[0][np.ix_(pair, pair)].ravel(), p.b0[0][pair, i], p.b1[0][pair, i]])
    return np.ascontiguousarray(mechanics), drive


def models_along(table: PlantTable, place: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return A (n, s, s), B₀, B₁ and B_f (n, s, 3) at the places (n, 2) mm of n intervals."""
    p, grid = table.plant, (table.x0_mm, table.pitch_mm, table.nodes, np.ascontiguousarray(place))
    a, b0, b1, b_f = (interpolate(each, *grid) for each in (p.a, p.b0, p.b1, p.b_centripetal))
    return a, b0, b1, b_f


@kernel
def _corner(x: float, x0: float, pitch: float, nodes: int) -> tuple[int, float]:
    """Grid index below x and the fraction to the next node, kept inside the grid."""
    s = min(max((x - x0) / pitch, 0.0), nodes - 1.000001)
    i = int(s)
    return i, s - i


@kernel
def _blend(table: FloatArray, x0: float, pitch: float, nodes: int, x: float, y: float, out: FloatArray) -> None:
    """Interpolate rows of a table (nodes², e) bilinearly at one place, to out (e,)."""
    i, fx = _corner(x, x0, pitch, nodes)
    j, fy = _corner(y, x0, pitch, nodes)
    at = i * nodes + j
    w00, w01, w10, w11 = (1 - fx) * (1 - fy), (1 - fx) * fy, fx * (1 - fy), fx * fy
    for e in range(len(out)):
        near, far = w00 * table[at, e] + w01 * table[at + 1, e], table[at + nodes, e]
        out[e] = near + w10 * far + w11 * table[at + nodes + 1, e]


@kernel
def interpolate(table: FloatArray, x0: float, pitch: float, nodes: int, place: FloatArray) -> FloatArray:
    """Bilinear interpolation of matrices: table (nodes², r, c), place (n, 2) mm -> (n, r, c)."""
    rows, columns = table.shape[1], table.shape[2]
    out, flat = np.empty((len(place), rows * columns)), table.reshape(len(table), rows * columns)
    for n in range(len(place)):
        _blend(flat, x0, pitch, nodes, place[n, 0], place[n, 1], out[n])
    return out.reshape(len(place), rows, columns)


@kernel
def simulate(
    mechanics: FloatArray, drive: FloatArray, x0: float, pitch: float, nodes: int, place: FloatArray,
    substeps: int, state: FloatArray, command: FloatArray, centripetal: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Run the scheduled plant over n intervals of `substeps` steps each.

    mechanics (nodes², 27, 12), drive (3, 8): see `_packed`.   place (n, 2) mm, of the intervals.
    state (18,): at the first sample.   command (n·substeps + 1, 3) mm: commanded carriage heights.
    centripetal (n·substeps + 1, 3) mm/s²: J̇ q̇ of the planned motion.
    Returns carriages (n·substeps, 3) mm after every step, and the states (n + 1, 18) at the knots.
    """
    n = len(place)
    x, model = state[6:].copy(), np.empty((1, 27, 12))
    entries, flat = model.reshape(27 * 12), mechanics.reshape(len(mechanics), 27 * 12)
    inputs = np.empty((1, 15))  # w, u(t), u(t + h), J̇ q̇
    for r in range(6):
        inputs[0, r] = state[r]
    kept, knots = np.empty((n * substeps, 3)), np.empty((n + 1, 18))
    for r in range(18):
        knots[0, r] = state[r]
    at_x, at_y = np.inf, np.inf
    step = 0
    for k in range(n):
        if not (abs(place[k, 0] - at_x) < SAME_MM and abs(place[k, 1] - at_y) < SAME_MM):
            at_x, at_y = place[k, 0], place[k, 1]
            _blend(flat, x0, pitch, nodes, at_x, at_y, entries)
        for _ in range(substeps):
            for c in range(3):
                inputs[0, 6 + c], inputs[0, 9 + c] = command[step, c], command[step + 1, c]
                inputs[0, 12 + c] = 0.5 * (centripetal[step, c] + centripetal[step + 1, c])
            _advance(model, 0, x, inputs, 0)
            for c in range(3):
                before, after, w0, w1 = inputs[0, 6 + c], inputs[0, 9 + c], inputs[0, c], inputs[0, 3 + c]
                inputs[0, c] = drive[c, 0] * w0 + drive[c, 1] * w1 + drive[c, 4] * before + drive[c, 6] * after
                inputs[0, 3 + c] = drive[c, 2] * w0 + drive[c, 3] * w1 + drive[c, 5] * before + drive[c, 7] * after
                kept[step, c] = x[c]
            step += 1
        for r in range(6):
            knots[k + 1, r] = inputs[0, r]
        for r in range(12):
            knots[k + 1, 6 + r] = x[r]
    return kept, knots


@kernel
def simulate_constant(
    carriage: FloatArray, a: FloatArray, b0: FloatArray, b1: FloatArray,
    n: int, substeps: int, state: FloatArray, command: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Run a plant (s, s) that is the same at every position, as `simulate_oscillators` does."""
    kept, knots, x = np.empty((n * substeps, 3)), np.empty((n + 1, len(state))), state.copy()
    knots[0] = state
    for step in range(n * substeps):
        x = a @ x + b0 @ command[step] + b1 @ command[step + 1]
        kept[step] = carriage @ x
        if (step + 1) % substeps == 0:
            knots[(step + 1) // substeps] = x
    return kept, knots


@kernel
def simulate_oscillators(
    axes: IntArray, a: FloatArray, b0: FloatArray, b1: FloatArray,
    n: int, substeps: int, state: FloatArray, command: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Run uncoupled oscillators over n intervals of `substeps` steps each, the same at every position.

    axes (m,): of each pair of states.   a (2 m, 2 m), b0 b1 (2 m, 3): the discrete plant.   state (2 m,).
    command (n·substeps + 1, 3) mm: commanded positions, linear between samples.
    Returns axes (n·substeps, 3) mm after every step, and the states (n + 1, 2 m) at the knots.
    """
    kept, knots = np.zeros((n * substeps, 3)), np.empty((n + 1, len(state)))
    for r in range(len(state)):
        knots[0, r] = state[r]
    for m in range(len(axes)):
        axis, i = axes[m], 2 * m
        a00, a01, a10, a11 = a[i, i], a[i, i + 1], a[i + 1, i], a[i + 1, i + 1]
        p0, v0, p1, v1 = b0[i, axis], b0[i + 1, axis], b1[i, axis], b1[i + 1, axis]
        p, v, after, step = state[i], state[i + 1], command[0, axis], 0
        for k in range(n):
            for _ in range(substeps):
                before, after = after, command[step + 1, axis]
                p, v = a00 * p + a01 * v + (p0 * before + p1 * after), a10 * p + a11 * v + (v0 * before + v1 * after)
                kept[step, axis] += p
                step += 1
            knots[k + 1, i], knots[k + 1, i + 1] = p, v
    return kept, knots
