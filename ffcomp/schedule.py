"""The plant scheduled along a path, and what it answers to a command.

Models are looked up once an interval (4 ms: the nozzle moves less than a millimetre) and interpolated on the table over
the bed; inside an interval the discrete model is exact for a command that is linear between samples. mm, s.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from models.kinematics.delta import inverse
from models.kinematics.kernels import FastDelta
from models.machine import Machine
from models.plant import QD, STATES, WD, PlantTable, Q, W

FloatArray = NDArray[np.float64]


def rest_state(machine: Machine, nozzle: FloatArray) -> FloatArray:
    """The state (18,) at rest with the nozzle at (3,) mm."""
    q = inverse(machine.kinematics, nozzle[None])[0]
    state = np.zeros(STATES)
    drive = machine.carriage.drive
    state[W] = q / drive.d0_per_s2 if drive else 0.0
    state[Q] = q
    return state


def moving_state(machine: Machine, nozzle: FloatArray, velocity: FloatArray, delay_s: float) -> FloatArray:
    """The state (18,) in steady motion: the carriages are on the path, their command leads it by the delay."""
    step = 1e-4  # s, for the carriages' velocities
    q, ahead, later = inverse(machine.kinematics, nozzle + np.array([[0.0], [delay_s], [step]]) * velocity)
    rate = (later - q) / step
    state = np.zeros(STATES)
    state[Q], state[QD] = q, rate
    drive = machine.carriage.drive
    if drive:
        state[WD] = rate / drive.d0_per_s2
        state[W] = (ahead - drive.d2_per_s * state[WD]) / drive.d0_per_s2
    return state


def models_along(table: PlantTable, place: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A (n, 18, 18), B₀, B₁ and B_f (n, 18, 3) at the places (n, 2) mm of n intervals."""
    p, grid = table.plant, (table.x0_mm, table.pitch_mm, table.nodes, np.ascontiguousarray(place))
    return (
        interpolate(p.a, *grid),
        interpolate(p.b0, *grid),
        interpolate(p.b1, *grid),
        interpolate(p.b_centripetal, *grid),
    )


def respond(
    machine: Machine,
    table: PlantTable,
    nozzle: FloatArray,
    velocity: FloatArray,
    state: FloatArray,
    substeps: int,
) -> tuple[FloatArray, FloatArray]:
    """Where the nozzle goes when it is told to go along `nozzle`, and the state it ends in.

    Parameters
    ----------
    nozzle, velocity : (n·substeps + 1, 3) mm and mm/s at the table's steps
    state : (18,) at the first sample
    substeps : steps for which one model serves

    Returns
    -------
    (n·substeps, 3) mm after every step;  (18,)
    """
    delta = FastDelta(machine.kinematics)
    nozzle = np.ascontiguousarray(nozzle)
    n = (len(nozzle) - 1) // substeps
    middle = nozzle[substeps // 2 :: substeps, :2][:n]
    centripetal = delta.rate_term(nozzle, np.ascontiguousarray(velocity))
    q, states = simulate(*models_along(table, middle), substeps, state, delta.inverse(nozzle), centripetal, 1)
    return delta.forward(q), states[-1]


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
