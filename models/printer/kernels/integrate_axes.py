"""Integrate straight axes in time by the classical Runge-Kutta method, as `integrate.py` does deltas."""

from __future__ import annotations

from typing import Any

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.axes import (
    TO_AXES,
    TO_MOTORS,
    WIDTH,
    AxesState,
    axes_motion,
    axes_rate,
    depends_on_place,
    fill_rows,
    is_growing,
    is_swaying,
)
from models.printer.kernels.axes_step import (
    FEW_MODES,
    MOTION,
    MOTORS,
    in_rows,
    keep_motors,
    keep_state,
    motors_at,
    step_lanes,
)
from models.printer.kernels.friction import has_powers
from models.printer.kernels.integrate import PAGE, active_effects, copy_page, empty_samples, fill_lanes
from models.printer.kernels.motors import Commands, command_times, has_springs, read_command
from models.printer.kernels.record import (
    ACC,
    LANES,
    MOTOR,
    NOW,
    ONE,
    QD,
    RATE,
    STATES,
    THREE,
    TWO,
    XD,
    ZERO,
    ActiveEffects,
    Q,
    Rows,
    X,
)
from models.printer.kernels.vectors import any_nonzero, at, compiled, dot, vector


@compiled
def _in_lanes(m: FloatArray, states: FloatArray, modes: FloatArray) -> AxesState:
    """Return k printers' states (k, rows, 3) and modes (k, n, 7, 3) in the first lanes; idle lanes repeat the first."""
    rows = states.shape[1]
    base, table = np.zeros(rows * WIDTH), np.empty((modes.shape[1], 7, WIDTH))
    for l in range(LANES):
        source = l if l < len(states) else 0
        for a in range(3):
            for row in range(rows):
                base[row * WIDTH + a * LANES + l] = states[source, row, a]
            for i in range(modes.shape[1]):
                for field in range(7):
                    table[i, field, a * LANES + l] = modes[source, i, field, a]
    mixed = any_nonzero(m, TO_MOTORS + 1, THREE)
    now, rate, total = base.copy(), np.zeros(len(base)), np.zeros(len(base))
    return AxesState(base, now, rate, total, table, mixed, is_swaying(m), is_growing(m), depends_on_place(m))


@compiled
def _advance(s: AxesState, weight: float, by: float) -> None:
    for n in range(len(s.base)):
        s.sum[n] += weight * s.rate[n]
        s.now[n] = s.base[n] + by * s.rate[n]


@compiled
def _finish(s: AxesState, by: float) -> None:
    for n in range(len(s.base)):
        y = s.base[n] + by * (s.sum[n] + s.rate[n])
        s.base[n], s.now[n], s.sum[n] = y, y, 0.0


@compiled
def _step(m: FloatArray, s: AxesState, row: int, half: int, h: float, commands: Commands, has: ActiveEffects) -> None:
    """Step by the classical Runge-Kutta method of order 4; the rate at a row's beginning is already known."""
    if half != 0:
        axes_rate(m, s, has)
    _advance(s, 1.0, 0.5 * h)
    read_command(m, row, half + 1, commands, has)
    axes_rate(m, s, has)
    _advance(s, 2.0, 0.5 * h)
    axes_rate(m, s, has)
    _advance(s, 2.0, h)
    read_command(m, row, half + 2, commands, has)
    axes_rate(m, s, has)
    _finish(s, h / 6.0)


@compiled
def _sample(m: FloatArray, sample: FloatArray) -> None:
    """Copy the motion to sample : (7, 3 LANES), in the order of `integrate`; motors as the axes they stand for."""
    for n in range(WIDTH):
        sample[0, n], sample[1, n], sample[2, n] = at(m, NOW + Q, n), at(m, NOW + QD, n), at(m, RATE + QD, n)
        sample[3, n], sample[4, n], sample[5, n] = at(m, X, n), at(m, XD, n), at(m, ACC, n)
        sample[6, n] = 0.0
    for a in range(3):
        for b in range(3):
            for l in range(LANES):
                sample[6, a * LANES + l] += at(m, TO_AXES + 3 * a + b, l) * at(m, MOTOR + b, l)


@compiled
def _filled(parameters: FloatArray) -> FloatArray:
    """Return m with the parameters of k printers in its lanes; idle lanes repeat the last one's."""
    repeated = np.empty((LANES, parameters.shape[1]))
    for l in range(LANES):
        for n in range(parameters.shape[1]):
            repeated[l, n] = parameters[min(l, len(parameters) - 1), n]
    m = fill_lanes(np.zeros((LANES, STATES)), repeated)
    fill_rows(m)
    return m


@compiled
def _integrate_any(
    states: FloatArray,
    modes: FloatArray,
    parameters: FloatArray,
    cubics: FloatArray,
    ranges: Rows,
    first: int,
    dt: float,
    substeps: int,
    units: FloatArray,
) -> tuple[FloatArray, ...]:
    """Integrate axes of any number of modes."""
    k, rows, m = len(states), ranges[:, 1] - ranges[:, 0] - first, _filled(parameters)
    s = _in_lanes(m, states, modes)
    elapsed, rows_back = command_times(m, dt, substeps)
    commands, has = Commands(cubics, ranges, elapsed, rows_back), active_effects(m)
    page, samples = np.empty((PAGE, 7, WIDTH)), empty_samples(k, rows.max())
    for n in range(rows.max()):
        read_command(m, first + n, ZERO, commands, has)
        axes_rate(m, s, has)
        axes_motion(m, s)
        _sample(m, page[n % PAGE])
        if n % PAGE == PAGE - 1 or n == rows.max() - 1:
            copy_page(page, n - n % PAGE, n % PAGE + 1, units, samples, ZERO)
        for l in range(k):
            if n == rows[l] - 1:
                _store_state(s.now, l, states)
        for half in range(0, 2 * substeps, 2):
            _step(m, s, first + n, half, dt / substeps, commands, has)
    return samples


@compiled
def _integrate_few(
    states: FloatArray,
    modes: FloatArray,
    parameters: FloatArray,
    cubics: FloatArray,
    ranges: Rows,
    first: int,
    dt: float,
    substeps: int,
    units: FloatArray,
) -> tuple[FloatArray, ...]:
    """Integrate axes of few modes, by `step_lanes`."""
    rows, m = ranges[:, 1] - ranges[:, 0] - first, in_rows(_filled(parameters), states, modes)
    elapsed, rows_back = command_times(m, dt, substeps)
    commands, has = Commands(cubics, ranges, elapsed, rows_back), active_effects(m)
    h, straight, springs = dt / substeps, not has.delay, has_springs(m)
    swaying = is_swaying(m) or is_growing(m) or depends_on_place(m)
    odd = has.torque_angle or (has.sticking and has_powers(m))
    page, samples = np.empty((PAGE, 7, WIDTH)), _samples(len(states), rows.max(), swaying)
    copied = ZERO if swaying else THREE  # the first of the quantities that are not those of another
    for n in range(rows.max()):
        for l in range(len(states)):
            if n == rows[l] - 1:
                keep_state(m, l, states)
        read_command(m, first + n, ZERO, commands, has)
        keep_motors(m, ZERO)
        _sample_motors(m, page[n % PAGE])
        for step in range(substeps):
            if straight:
                motors_at(m, ONE, (step + 0.5) * h, has.ripple)
                motors_at(m, TWO, (step + 1) * h, has.ripple)
            else:
                for ahead in range(1, 3):
                    read_command(m, first + n, 2 * step + ahead, commands, has)
                    keep_motors(m, ahead)
            step_lanes(m, h, has, springs, swaying, odd)
            if step == 0:
                _sample_motion(m, page[n % PAGE])
        if n % PAGE == PAGE - 1 or n == rows.max() - 1:
            copy_page(page, n - n % PAGE, n % PAGE + 1, units, samples, copied)
    return samples


def integrate_axes(
    states: FloatArray, modes: FloatArray, parameters: FloatArray, *commands_and_steps: Any
) -> tuple[FloatArray, ...]:
    """Integrate k printers of straight axes: as `integrate` does, with states (k, rows, 3) and modes (k, n, 7, 3).

    Chosen here so that axes of few modes, as most are, do not wait for the others' loops to be compiled.
    """
    chosen = _integrate_few if modes.shape[1] <= FEW_MODES else _integrate_any
    samples: tuple[FloatArray, ...] = chosen(states, modes, parameters, *commands_and_steps)
    return samples


@compiled
def _samples(k: int, rows: int, swaying: bool) -> tuple[FloatArray, ...]:
    """Allocate what `integrate_axes` returns; where nothing sways, carriages move as the nozzle does."""
    size = (k, rows, 3)
    place, velocity, acceleration, motor = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    if swaying:
        return np.empty(size), np.empty(size), np.empty(size), place, velocity, acceleration, motor
    return place, velocity, acceleration, place, velocity, acceleration, motor


@compiled
def _sample_motion(m: FloatArray, sample: FloatArray) -> None:
    """Copy the motion at a row's beginning: of the axes and of the nozzle."""
    for quantity in range(3):
        for n in range(WIDTH):
            sample[quantity, n] = at(m, MOTION + 9 + 3 * quantity, n)
            sample[3 + quantity, n] = at(m, MOTION + 3 * quantity, n)


@compiled
def _sample_motors(m: FloatArray, sample: FloatArray) -> None:
    """Copy where the motors are, as the axes they stand for."""
    for a in range(3):
        for l in range(LANES):
            sample[6, a * LANES + l] = dot(vector(m, TO_AXES + 3 * a, l), vector(m, MOTORS, l))


@compiled
def _store_state(values: FloatArray, l: int, states: FloatArray) -> None:
    """Copy the state of lane l to states : (k, rows, 3)."""
    for row in range(states.shape[1]):
        for a in range(3):
            states[l, row, a] = values[row * WIDTH + a * LANES + l]
