"""The plant scheduled along a path, and what it answers to a command.

Models are looked up once an interval (4 ms: the nozzle moves less than a millimetre) and interpolated on the table over
the bed; inside an interval the discrete model is exact for a command that is linear between samples. mm, s.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from models.arrays import FloatArray
from models.machine import Machine
from models.vibration.small_matvec import recursion
from models.vibration.state_space import QD, STATES, WD, PlantTable, Q, W

SAME_MM = 1.0  # so near to a place its model still serves

_advance = recursion(rows=12, of_state=12, of_input=15)


def rest_state(machine: Machine, nozzle: FloatArray) -> FloatArray:
    """The state (18,) at rest with the nozzle at (3,) mm."""
    q = machine.kinematics.inverse(nozzle[None])[0]
    state = np.zeros(STATES)
    drive = machine.carriage.drive
    state[W] = q / drive.d0_per_s2 if drive else 0.0
    state[Q] = q
    return state


def moving_state(machine: Machine, nozzle: FloatArray, velocity: FloatArray, delay_s: float) -> FloatArray:
    """The state (18,) in steady motion: the carriages are on the path, their command leads it by the delay."""
    step = 1e-4  # s, for the carriages' velocities
    q, ahead, later = machine.kinematics.inverse(nozzle + np.array([[0.0], [delay_s], [step]]) * velocity)
    rate = (later - q) / step
    state = np.zeros(STATES)
    state[Q], state[QD] = q, rate
    drive = machine.carriage.drive
    if drive:
        state[WD] = rate / drive.d0_per_s2
        state[W] = (ahead - drive.d2_per_s * state[WD]) / drive.d0_per_s2
    return state


class Schedule:
    """The plant over the bed, packed for the loop that plays commands on it."""

    def __init__(self, machine: Machine, table: PlantTable) -> None:
        self.delta, self.table = machine.kinematics.compiled(), table
        self._mechanics, self._drive = _packed(table)

    def play(
        self,
        place: FloatArray,
        centripetal: FloatArray,
        command: FloatArray,
        state: FloatArray,
        substeps: int,
    ) -> tuple[FloatArray, FloatArray]:
        """What the carriages do under a command while the nozzle goes by.

        Parameters
        ----------
        place : (n, 2) mm, where the nozzle is meant to be in the middle of each knot interval
        centripetal : (n·substeps + 1, 3) mm/s², J̇ q̇ of the motion that is meant, at the table's steps
        command : (n·substeps + 1, 3) mm, carriage heights, linear between the steps
        state : (18,) at the first sample
        substeps : steps for which one model serves

        Returns
        -------
        carriages (n·substeps, 3) mm after every step; states (n + 1, 18) at the knots
        """
        grid = (self.table.x0_mm, self.table.pitch_mm, self.table.nodes)
        return simulate(self._mechanics, self._drive, *grid, place, substeps, state, command, centripetal)

    def respond(
        self, nozzle: FloatArray, velocity: FloatArray, state: FloatArray, substeps: int
    ) -> tuple[FloatArray, FloatArray]:
        """Where the nozzle goes when it is told to go along `nozzle`, (n·substeps, 3) mm, and the state it ends in."""
        nozzle = np.ascontiguousarray(nozzle)
        centripetal = self.delta.rate_term(nozzle, np.ascontiguousarray(velocity))
        place = np.ascontiguousarray(nozzle[substeps // 2 :: substeps, :2][: (len(nozzle) - 1) // substeps])
        q, states = self.play(place, centripetal, self.delta.inverse(nozzle), state, substeps)
        return self.delta.forward(q), states[-1]


def _packed(table: PlantTable) -> tuple[FloatArray, FloatArray]:
    """The table as the loop wants it: what depends on place, and the drives, which do not.

    Returns
    -------
    (nodes², 27, 12): for the twelve states behind the drives, the columns of the other states (behind the drives first,
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
    """A (n, 18, 18), B₀, B₁ and B_f (n, 18, 3) at the places (n, 2) mm of n intervals."""
    p, grid = table.plant, (table.x0_mm, table.pitch_mm, table.nodes, np.ascontiguousarray(place))
    return (
        interpolate(p.a, *grid),
        interpolate(p.b0, *grid),
        interpolate(p.b1, *grid),
        interpolate(p.b_centripetal, *grid),
    )


@njit(cache=True, inline="always")
def _corner(x: float, x0: float, pitch: float, nodes: int) -> tuple[int, float]:
    """Grid index below x and the fraction to the next node, kept inside the grid."""
    s = min(max((x - x0) / pitch, 0.0), nodes - 1.000001)
    i = int(s)
    return i, s - i


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def simulate(
    mechanics: FloatArray,
    drive: FloatArray,
    x0: float,
    pitch: float,
    nodes: int,
    place: FloatArray,
    substeps: int,
    state: FloatArray,
    command: FloatArray,
    centripetal: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Run the scheduled plant over n intervals of `substeps` steps each.

    mechanics (nodes², 27, 12), drive (3, 8): see `_packed`.   place (n, 2) mm, of the intervals.
    state (18,): at the first sample.   command (n·substeps + 1, 3) mm: carriage heights asked for, linear between.
    centripetal (n·substeps + 1, 3) mm/s²: J̇ q̇ of the planned motion.
    Returns carriages (n·substeps, 3) mm after every step, and the states (n + 1, 18) at the knots.
    """
    n = len(place)
    x, model = state[6:].copy(), np.empty((1, 27, 12))
    entries, flat = model.reshape(27 * 12), mechanics.reshape(len(mechanics), 27 * 12)
    given = np.empty((1, 15))  # w, u(t), u(t + h), J̇ q̇
    given[0, :6] = state[:6]
    kept, knots = np.empty((n * substeps, 3)), np.empty((n + 1, 18))
    knots[0] = state
    at_x, at_y = np.inf, np.inf
    step = 0
    for k in range(n):
        if not (abs(place[k, 0] - at_x) < SAME_MM and abs(place[k, 1] - at_y) < SAME_MM):
            at_x, at_y = place[k, 0], place[k, 1]
            i, fx = _corner(at_x, x0, pitch, nodes)
            j, fy = _corner(at_y, x0, pitch, nodes)
            at = i * nodes + j
            w00, w01, w10, w11 = (1 - fx) * (1 - fy), (1 - fx) * fy, fx * (1 - fy), fx * fy
            for e in range(len(entries)):
                entries[e] = (
                    w00 * flat[at, e]
                    + w01 * flat[at + 1, e]
                    + w10 * flat[at + nodes, e]
                    + w11 * flat[at + nodes + 1, e]
                )
        for _ in range(substeps):
            for c in range(3):
                given[0, 6 + c], given[0, 9 + c] = command[step, c], command[step + 1, c]
                given[0, 12 + c] = 0.5 * (centripetal[step, c] + centripetal[step + 1, c])
            _advance(model, 0, x, given, 0)
            for c in range(3):
                before, after, w0, w1 = given[0, 6 + c], given[0, 9 + c], given[0, c], given[0, 3 + c]
                given[0, c] = drive[c, 0] * w0 + drive[c, 1] * w1 + drive[c, 4] * before + drive[c, 6] * after
                given[0, 3 + c] = drive[c, 2] * w0 + drive[c, 3] * w1 + drive[c, 5] * before + drive[c, 7] * after
                kept[step, c] = x[c]
            step += 1
        for r in range(6):
            knots[k + 1, r] = given[0, r]
        for r in range(12):
            knots[k + 1, 6 + r] = x[r]
    return kept, knots
