"""Integrate printers in time by the classical Runge-Kutta method, and settle deltas at rest."""

from __future__ import annotations

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels import delta
from models.printer.kernels import record as r
from models.printer.kernels.friction import guide_friction, joint_friction
from models.printer.kernels.motors import (
    Commands,
    belts,
    cogging,
    command_times,
    motors,
    read_command,
    stiffness_by_length,
    torque_angle,
)
from models.printer.kernels.record import LANES, STATES, ZERO, ActiveEffects, Rows
from models.printer.kernels.vectors import at, compiled

PAGE = 64  # samples are copied by the page: a write at a time would touch too many cache lines
UNITS = np.array([1e3, 1.0, 1e3, 1.0, 1e3])  # of the samples, in their order


@compiled
def rate(m: FloatArray, has: ActiveEffects) -> None:
    """Evaluate RATE = d/dt of NOW under the command, and with it the nozzle's motion (X, XD, ACC)."""
    motors(m)
    if has.torque_angle:
        torque_angle(m)
    if has.guides:
        guide_friction(m, has)
    belts(m)
    delta.arm_kinematics(m)
    if has.joints:
        joint_friction(m)
    delta.holder_forces(m)
    if has.arms:
        delta.mass_along_arms(m)
    delta.solve_carriages(m)
    delta.effector_and_frame(m)


@compiled
def _advance(m: FloatArray, weight: float, by: float) -> None:
    """Add the rate with its weight to the step's sum, and move NOW `by` seconds along it."""
    for n in range(STATES * LANES):
        m[r.SUM * LANES + n] += weight * m[r.RATE * LANES + n]
        m[r.NOW * LANES + n] = m[r.BASE * LANES + n] + by * m[r.RATE * LANES + n]


@compiled
def _finish(m: FloatArray, by: float) -> None:
    """Move BASE and NOW to the end of the step."""
    for n in range(STATES * LANES):
        y = m[r.BASE * LANES + n] + by * (m[r.SUM * LANES + n] + m[r.RATE * LANES + n])
        m[r.BASE * LANES + n], m[r.NOW * LANES + n], m[r.SUM * LANES + n] = y, y, 0.0


@compiled
def _step(m: FloatArray, row: int, half: int, h: float, commands: Commands, has: ActiveEffects) -> None:
    """Step by the classical Runge-Kutta method of order 4; the rate at a row's beginning is already known."""
    if half != 0:
        rate(m, has)
    _advance(m, 1.0, 0.5 * h)
    read_command(m, row, half + 1, commands, has)
    rate(m, has)
    _advance(m, 2.0, 0.5 * h)
    rate(m, has)
    _advance(m, 2.0, h)
    read_command(m, row, half + 2, commands, has)
    rate(m, has)
    _finish(m, h / 6.0)


@compiled
def _sample(m: FloatArray, sample: FloatArray) -> None:
    """Copy the motion to sample : (5, 3 LANES), in the order of `integrate`."""
    for n in range(3 * LANES):
        sample[0, n], sample[1, n] = at(m, r.NOW + r.Q, n), at(m, r.RATE + r.QD, n)
        sample[2, n], sample[3, n], sample[4, n] = at(m, r.X, n), at(m, r.ACC, n), at(m, r.MOTOR, n)


@compiled
def copy_page(page: FloatArray, first: int, rows: int, samples: tuple[FloatArray, ...], begin: int) -> None:
    """Copy a page : (PAGE, 5, 3 LANES), each quantity in its unit, to samples : (k, n, 3) from row `first`.

    begin : the first quantity that is copied
    """
    for quantity, target in enumerate(samples):
        for l in range(len(target) if quantity >= begin else 0):
            for n in range(rows):
                for i in range(3):
                    target[l, first + n, i] = UNITS[quantity] * page[n, quantity, i * LANES + l]


@compiled
def empty_samples(k: int, rows: int) -> tuple[FloatArray, ...]:
    """Allocate separate arrays, so that a reference to one does not keep the others in memory."""
    size = (k, rows, 3)
    return np.empty(size), np.empty(size), np.empty(size), np.empty(size), np.empty(size)


@compiled
def store_state(m: FloatArray, l: int, states: FloatArray) -> None:
    """Copy the state of lane l to states : (k, STATES)."""
    for n in range(STATES):
        states[l, n] = at(m, r.NOW + n, l)


@compiled
def integrate(
    m: FloatArray, states: FloatArray, has: ActiveEffects, cubics: FloatArray, ranges: Rows,
    first: int, dt: float, substeps: int,
) -> tuple[FloatArray, ...]:  # fmt: skip
    """Integrate k printers, one in each lane, from row `first` of their commands to the last.

    Parameters
    ----------
    m, has : of the printers, from `lanes` and `active_effects`.
    states : (k, STATES) SI, overwritten by the last ones.
    cubics, ranges : see `Commands`. Of a command's last cubic only the first point is reached.
    first : the row of the commands to begin with.
    dt : s, from row to row.
    substeps : integration steps from row to row.

    Returns
    -------
    Five of (k, rows of the longest, 3): carriages' and nozzle's position and acceleration, and the motors' position,
    mm and m/s², at each row's beginning. Values after a command's last row are meaningless.
    """
    rows = ranges[:, 1] - ranges[:, 0] - first
    elapsed, rows_back = command_times(m, dt, substeps)
    commands = Commands(cubics, ranges, elapsed, rows_back)
    page, samples = np.empty((PAGE, 5, 3 * LANES)), empty_samples(len(states), rows.max())
    for n in range(rows.max()):
        read_command(m, first + n, ZERO, commands, has)
        rate(m, has)
        _sample(m, page[n % PAGE])
        if n % PAGE == PAGE - 1 or n == rows.max() - 1:
            copy_page(page, n - n % PAGE, n % PAGE + 1, samples, ZERO)
        for l in range(len(states)):
            if n == rows[l] - 1:
                store_state(m, l, states)
        for half in range(0, 2 * substeps, 2):
            _step(m, first + n, half, dt / substeps, commands, has)
    return samples


PASSES = 2000
TOLERANCE_M = 1e-13


@compiled
def _relax(m: FloatArray, l: int) -> float:
    """Move every carriage by its unbalanced force over its belt's stiffness; return the largest displacement, m."""
    moved = 0.0
    for i in range(3):
        shorter = stiffness_by_length(m, i * LANES + l, at(m, r.NOW + r.Q + i, l))
        squared = at(m, r.STRETCH + i, l) ** 2
        harder = (3.0 * at(m, r.cubic + i, l) + 5.0 * at(m, r.quintic + i, l) * squared) * squared
        move = at(m, r.PULL + i, l) / (at(m, r.belt_k + i, l) * max(shorter, 1.0) + max(harder, 0.0))
        m[(r.NOW + r.Q + i) * LANES + l] += move
        if not abs(move) <= moved:  # NaN too
            moved = abs(move)
    return moved


@compiled
def find_equilibrium(m: FloatArray, states: FloatArray, has: ActiveEffects) -> FloatArray:
    """Relax belts and extruder, from `lanes` with the drives at their command, until the forces balance.

    Returns
    -------
    (k,) m, the largest displacement of a carriage in the last pass; states : (k, STATES) are then the equilibria.
    """
    moved = np.full(len(states), np.inf)
    for n in range(3 * LANES):
        m[r.COMMAND * LANES + n] = m[(r.NOW + r.V) * LANES + n]
    cogging(m)
    for l in range(len(states)):
        m[(r.NOW + r.ETA + 2) * LANES + l] = -at(m, r.extruder_mass, l) * at(m, r.gravity, l) / at(m, r.mount_k + 2, l)
    for _ in range(PASSES):
        rate(m, has)
        for l in range(len(states)):
            if not moved[l] < TOLERANCE_M:
                moved[l] = _relax(m, l)
        if moved.max() < TOLERANCE_M:
            break
    for l in range(len(states)):
        store_state(m, l, states)
    return moved
