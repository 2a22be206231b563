"""Integrate printers in time, and bring them to rest."""

from __future__ import annotations

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.axes import axes
from models.printer.kernels.delta import arms, coupled, followers, holder
from models.printer.kernels.friction import fading, guide_friction, joint_friction
from models.printer.kernels.jit import compiled
from models.printer.kernels.motors import Said, belts, cogging, late, listen, motors, sines
from models.printer.kernels.record import (
    ACC,
    BASE,
    COUNT,
    ETA,
    LANES,
    LEVEL,
    MOTOR,
    NOW,
    PRINTER,
    PULL,
    QD,
    RATE,
    ROWS,
    STATES,
    STRETCH,
    SUM,
    TOLD,
    XD,
    Acting,
    Q,
    Row,
    Rows,
    V,
    X,
    parameter_rows,
)
from models.printer.kernels.vectors import at

(ARMS_SQUARED,) = parameter_rows("arms_squared")
(BELT_K,) = parameter_rows("belt_k")
EXTRUDER_MASS, MOUNT_K = parameter_rows("extruder_mass", "mount_k")
GRAVITY, HARDENING, QUINTIC = parameter_rows("gravity", "cubic", "quintic")
SLOPE, CENTRE = parameter_rows("slope", "centre")
BEND, DELAY, COGGING = parameter_rows("bend", "delay", "ripple")
DRY, STICKING = parameter_rows("dry", "sticking")
(JOINT_DRY,) = parameter_rows("joint_dry")

PAGE = 64  # samples written at a time, or they would be strewn over too many places

REST_PASSES = 2000
REST_TOLERANCE_M = 1e-13


@compiled
def _any(m: FloatArray, row: Row, rows: int) -> bool:
    found = False
    for n in range(row * LANES, (row + rows) * LANES):
        found |= m[n] != 0.0
    return found


@compiled
def acting(m: FloatArray) -> Acting:
    sticking = _any(m, STICKING, 3)
    guides, joints = sticking or _any(m, DRY, 3), _any(m, JOINT_DRY, 1)
    return Acting(
        sticking, guides, joints, _any(m, BEND, 3), _any(m, COGGING, 3), _any(m, DELAY, 3), _any(m, ARMS_SQUARED, 3)
    )


@compiled
def rate(m: FloatArray, has: Acting) -> None:
    """The rows RATE = d/dt of NOW, as the motors are told; the nozzle's motion is kept."""
    motors(m)
    if has.bending:
        sines(m)
    if has.sticking:
        fading(m)
    if has.guides:
        guide_friction(m)
    if not has.arms:
        axes(m)
        return
    belts(m)
    arms(m)
    if has.joints:
        joint_friction(m)
    holder(m)
    coupled(m)
    followers(m)


@compiled
def laid_out(states: FloatArray, numbers: FloatArray) -> FloatArray:
    """m with these printers : (k, STATES) and (k, COUNT) in its first lanes. Idle lanes work on zeros and NaN."""
    m = np.zeros(ROWS * LANES)
    for l in range(len(states)):
        for n in range(STATES):
            m[(BASE + n) * LANES + l] = states[l, n]
            m[(NOW + n) * LANES + l] = states[l, n]
        for n in range(COUNT):
            m[(PRINTER + n) * LANES + l] = numbers[l, n]
    for n in range(3 * LANES):
        m[LEVEL * LANES + n] = m[DRY * LANES + n]
    return m


@compiled
def _lean(m: FloatArray, weight: float, by: float) -> None:
    """The rate counts so much in this step, and is followed so far to where it is asked for next."""
    for n in range(STATES * LANES):
        m[SUM * LANES + n] += weight * m[RATE * LANES + n]
        m[NOW * LANES + n] = m[BASE * LANES + n] + by * m[RATE * LANES + n]


@compiled
def _land(m: FloatArray, by: float) -> None:
    for n in range(STATES * LANES):
        y = m[BASE * LANES + n] + by * (m[SUM * LANES + n] + m[RATE * LANES + n])
        m[BASE * LANES + n], m[NOW * LANES + n], m[SUM * LANES + n] = y, y, 0.0


@compiled
def _step(m: FloatArray, row: int, half: int, h: float, said: Said, has: Acting) -> None:
    """Classical Runge-Kutta of order 4; the rate at a row's beginning is there already."""
    if half != 0:
        rate(m, has)
    _lean(m, 1.0, 0.5 * h)
    listen(m, row, half + 1, said, has)
    rate(m, has)
    _lean(m, 2.0, 0.5 * h)
    rate(m, has)
    _lean(m, 2.0, h)
    listen(m, row, half + 2, said, has)
    rate(m, has)
    _land(m, h / 6.0)


@compiled
def _note(m: FloatArray, note: FloatArray) -> None:
    """note : (7, 3 LANES), see `run`."""
    for n in range(3 * LANES):
        note[0, n], note[1, n], note[2, n] = at(m, NOW + Q, n), at(m, NOW + QD, n), at(m, RATE + QD, n)
        note[3, n], note[4, n], note[5, n] = at(m, X, n), at(m, XD, n), at(m, ACC, n)
        note[6, n] = at(m, MOTOR, n)


@compiled
def _write_up(notes: FloatArray, first: int, rows: int, scale: FloatArray, samples: tuple[FloatArray, ...]) -> None:
    """The first of the notes : (PAGE, 7, 3 LANES), each quantity scaled, as samples : (k, n, 3) from row `first`."""
    for part, kept in enumerate(samples):
        for l in range(len(kept)):
            for n in range(rows):
                for i in range(3):
                    kept[l, first + n, i] = scale[part] * notes[n, part, i * LANES + l]


@compiled
def _blank(k: int, rows: int) -> tuple[FloatArray, ...]:
    """Arrays of their own, so that who keeps one does not keep them all."""
    size = (k, rows, 3)
    a, b, c, d = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    return a, b, c, d, np.empty(size), np.empty(size), np.empty(size)


@compiled
def _leave(m: FloatArray, l: int, states: FloatArray) -> None:
    """States : (k, STATES) of lane l."""
    for n in range(STATES):
        states[l, n] = at(m, NOW + n, l)


@compiled
def run(
    states: FloatArray,
    numbers: FloatArray,
    pieces: FloatArray,
    spans: Rows,
    first: int,
    dt: float,
    substeps: int,
    scale: FloatArray,
) -> tuple[FloatArray, ...]:
    """Integrate k printers side by side, from row `first` of their commands to the last.

    Parameters
    ----------
    states : (k, STATES) SI, left as the last ones.
    numbers : (k, COUNT), from `table`.
    pieces, spans : see `Said`. A command's last piece is only begun.
    scale : (7,), what the results are multiplied by.

    Returns
    -------
    Seven of (k, rows of the longest, 3): carriages' and nozzle's position, velocity, acceleration, and the motors'
    positions at each row's beginning. What follows a command's last row means nothing.
    """
    m, rows = laid_out(states, numbers), spans[:, 1] - spans[:, 0] - first
    since, ago = late(m, dt, substeps)
    said, has = Said(pieces, spans, since, ago), acting(m)
    notes, samples = np.empty((PAGE, 7, 3 * LANES)), _blank(len(states), rows.max())
    for n in range(rows.max()):
        listen(m, first + n, 0, said, has)
        rate(m, has)
        _note(m, notes[n % PAGE])
        if n % PAGE == PAGE - 1 or n == rows.max() - 1:
            _write_up(notes, n - n % PAGE, n % PAGE + 1, scale, samples)
        for l in range(len(states)):
            if n == rows[l] - 1:
                _leave(m, l, states)
        for half in range(0, 2 * substeps, 2):
            _step(m, first + n, half, dt / substeps, said, has)
    return samples


@compiled
def _yield(m: FloatArray, l: int) -> float:
    """Every carriage gives way by what its forces leave over, divided by its belt's stiffness. The longest way, m."""
    moved = 0.0
    for i in range(3):
        above = at(m, SLOPE + i, l) * (at(m, NOW + Q + i, l) - at(m, CENTRE + i, l))
        squared = at(m, STRETCH + i, l) ** 2
        harder = (3.0 * at(m, HARDENING + i, l) + 5.0 * at(m, QUINTIC + i, l) * squared) * squared
        move = at(m, PULL + i, l) / (at(m, BELT_K + i, l) * (1.0 + max(above, 0.0)) + max(harder, 0.0))
        m[(NOW + Q + i) * LANES + l] += move
        if not abs(move) <= moved:  # NaN too
            moved = abs(move)
    return moved


@compiled
def rest(states: FloatArray, numbers: FloatArray) -> FloatArray:
    """From states : (k, STATES) with the drives at their command: let belts and extruder give way until all balance.

    Returns
    -------
    (k,) m, how far the last pass still moved a carriage.
    """
    m, moved = laid_out(states, numbers), np.full(len(states), np.inf)
    has = acting(m)
    for n in range(3 * LANES):
        m[TOLD * LANES + n] = m[(NOW + V) * LANES + n]
    cogging(m)
    for l in range(len(states)):
        m[(NOW + ETA + 2) * LANES + l] = -at(m, EXTRUDER_MASS, l) * at(m, GRAVITY, l) / at(m, MOUNT_K + 2, l)
    for _ in range(REST_PASSES):
        rate(m, has)
        for l in range(len(states)):
            if not moved[l] < REST_TOLERANCE_M:
                moved[l] = _yield(m, l)
        if moved.max() < REST_TOLERANCE_M:
            break
    for l in range(len(states)):
        _leave(m, l, states)
    return moved
