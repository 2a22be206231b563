"""Integrate straight axes in time by the classical Runge-Kutta method, as `integrate.py` does deltas."""

from __future__ import annotations

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels import axes
from models.printer.kernels import record as r
from models.printer.kernels.axes import MOTION, MOTORS, WIDTH, PerMode
from models.printer.kernels.integrate import PAGE, copy_page, empty_samples
from models.printer.kernels.motors import Commands, command_times, read_command
from models.printer.kernels.record import LANES, ONE, TWO, ZERO, ActiveEffects, Rows
from models.printer.kernels.vectors import at, compiled, dot, vector


@compiled
def integrate_axes(
    m: FloatArray, states: FloatArray, like: PerMode, has: ActiveEffects, cubics: FloatArray, ranges: Rows,
    first: int, dt: float, substeps: int,
) -> tuple[FloatArray, ...]:  # fmt: skip
    """Integrate k printers as `integrate` does, from `lanes_of_axes`, with states (k, rows, 3).

    like : a number for each mode of an axis
    """
    rows = ranges[:, 1] - ranges[:, 0] - first
    elapsed, rows_back = command_times(m, dt, substeps)
    commands, h = Commands(cubics, ranges, elapsed, rows_back), dt / substeps
    page, each = np.empty((PAGE, 5, WIDTH)), empty_samples(len(states), rows.max())
    samples = each if has.swaying else (*each[2:4], *each[2:])  # where nothing sways, carriages move as the nozzle does
    copied = ZERO if has.swaying else TWO  # the first of the quantities that are not those of another
    for n in range(rows.max()):
        for l in range(len(states)):
            if n == rows[l] - 1:
                axes.keep_state(m, l, states)
        read_command(m, first + n, ZERO, commands, has)
        axes.keep_motors(m, ZERO)
        _sample_motors(m, page[n % PAGE])
        for step in range(substeps):
            if not has.delay:
                axes.motors_at(m, ONE, (step + 0.5) * h, has.ripple)
                axes.motors_at(m, TWO, (step + 1) * h, has.ripple)
            else:
                for ahead in range(1, 3):
                    read_command(m, first + n, 2 * step + ahead, commands, has)
                    axes.keep_motors(m, ahead)
            axes.step_lanes(m, h, like, len(states), has)
            if step == 0:
                _sample_motion(m, page[n % PAGE])
        if n % PAGE == PAGE - 1 or n == rows.max() - 1:
            copy_page(page, n - n % PAGE, n % PAGE + 1, samples, copied)
    return samples


@compiled
def _sample_motion(m: FloatArray, sample: FloatArray) -> None:
    """Copy the motion at a row's beginning: of the axes and of the nozzle."""
    for n in range(WIDTH):
        sample[0, n], sample[1, n] = at(m, MOTION + 9, n), at(m, MOTION + 15, n)
        sample[2, n], sample[3, n] = at(m, MOTION, n), at(m, MOTION + 6, n)


@compiled
def _sample_motors(m: FloatArray, sample: FloatArray) -> None:
    """Copy where the motors are, as the axes they stand for."""
    for a in range(3):
        for l in range(LANES):
            sample[4, a * LANES + l] = dot(vector(m, r.axis_matrix + 3 * a, l), vector(m, MOTORS, l))
