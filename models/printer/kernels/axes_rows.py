"""The rows in which the quick steps of straight axes keep all that they need, after those of `record.py`.

Only in one array does the compiler see that lanes do not disturb each other, and puts them side by side.
"""

from __future__ import annotations

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.axes import (
    FIRST,
    HALF_BACKLASH,
    HARDENING,
    LANDING,
    QUINTIC,
    SLOPE,
    WIDTH,
    AxesState,
)
from models.printer.kernels.jit import compiled
from models.printer.kernels.motors import rippled
from models.printer.kernels.record import COMMAND, COMMAND_RATE, CUBIC, LANES, RIPPLE, RIPPLE_RATE, ROWS
from models.printer.kernels.vectors import at

FEW_MODES, FIELDS = 2, 7
MODES = ROWS  # three rows a field
STATE = MODES + 3 * FEW_MODES * FIELDS  # as of `AxesState`
MODE = STATE + 3 * FIRST  # p and ṗ of each mode
MOTORS = MODE + 6 * FEW_MODES  # u and u̇ at the beginning, the middle and the end of a step
MOTION = MOTORS + 18  # at the step's beginning: place, velocity, acceleration of the nozzle, then of the axes
ALL_ROWS = MOTION + 18


@compiled
def with_modes(m: FloatArray, modes: FloatArray) -> FloatArray:
    """Return m with the rows of this file, the modes (n, 7, WIDTH) filled in."""
    found = np.zeros(ALL_ROWS * LANES)
    found[: len(m)] = m
    for i in range(FEW_MODES):
        for field in range(FIELDS):
            for n in range(WIDTH):
                found[(MODES + 3 * (FIELDS * i + field)) * LANES + n] = modes[i, field, n]
    return found


@compiled
def take_state(m: FloatArray, s: AxesState) -> None:
    """Take the state over from s."""
    for n in range(len(s.base)):
        m[STATE * LANES + n] = s.base[n]


@compiled
def keep_state(m: FloatArray, l: int, states: FloatArray) -> None:
    """Copy the state of lane l to states : (k, rows, 3)."""
    for row in range(states.shape[1]):
        for a in range(3):
            states[l, row, a] = at(m, STATE + 3 * row + a, l)


@compiled
def has_springs(m: FloatArray) -> bool:
    """Tell whether any belt has play, or pulls other than in proportion to its stretch."""
    found = False
    for n in range(WIDTH):
        found |= at(m, HALF_BACKLASH, n) != 0.0 or at(m, LANDING, n) != 0.0 or at(m, SLOPE, n) != 0.0
        found |= at(m, HARDENING, n) != 0.0 or at(m, QUINTIC, n) != 0.0
    return found


@compiled
def keep_motors(m: FloatArray, half: int) -> None:
    """Keep where the motors are and how fast, at one of a step's three times."""
    for n in range(WIDTH):
        m[(MOTORS + 6 * half) * LANES + n] = at(m, COMMAND, n) + at(m, RIPPLE, n)
        m[(MOTORS + 6 * half + 3) * LANES + n] = at(m, COMMAND_RATE, n) + at(m, RIPPLE_RATE, n)


@compiled
def motors_at(m: FloatArray, half: int, t: float, ripple: bool) -> None:
    """Evaluate the motors t seconds after the row whose cubics are loaded, for one of a step's three times."""
    for n in range(WIDTH):
        a, b, c = at(m, CUBIC, n), at(m, CUBIC + 3, n), at(m, CUBIC + 6, n)
        m[(MOTORS + 6 * half) * LANES + n] = ((a * t + b) * t + c) * t + at(m, CUBIC + 9, n)
        m[(MOTORS + 6 * half + 3) * LANES + n] = (3.0 * a * t + 2.0 * b) * t + c
    if ripple:
        for n in range(WIDTH):
            own = (MOTORS + 6 * half) * LANES + n
            more = rippled(m, n, m[own], m[own + 3 * LANES])
            m[own], m[own + 3 * LANES] = m[own] + more[0], m[own + 3 * LANES] + more[1]
