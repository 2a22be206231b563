"""Step straight axes of at most two modes each, with neither frame nor gantry: a whole step of a lane in one loop.

The equations are those of `axes.py`, and so is the state. What a step reads and writes there in rows of arrays stays
in registers here, which is several times as quick. All that it needs is in rows of one array, after those of
`record.py`: only so does the compiler see that lanes do not disturb each other, and puts them side by side.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.axes import (
    BELT_DAMPING,
    CENTRE,
    COMPLIANCE,
    DAMPING,
    FIRST,
    FREQUENCY2,
    HALF_BACKLASH,
    HARDENING,
    LANDING,
    MOTOR_K,
    PART,
    PEAK_STRETCH,
    QUINTIC,
    SHARE,
    SLOPE,
    STRAIN,
    TO_AXES,
    TO_MOTORS,
    UNEVEN,
    WIDTH,
    AxesState,
)
from models.printer.kernels.friction import CREEP, DRY, FADING, HOLD, STICKING, strain_rate
from models.printer.kernels.jit import compiled, inlined
from models.printer.kernels.record import (
    COMMAND,
    COMMAND_RATE,
    CUBIC,
    LANES,
    RIPPLE,
    RIPPLE_RATE,
    ROWS,
    ActiveEffects,
    Row,
    Vector,
)
from models.printer.kernels.vectors import at, tanh

FEW_MODES, FIELDS = 2, 7
MODES = ROWS  # three rows a field
STATE = MODES + 3 * FEW_MODES * FIELDS  # the friction's strain, then p and ṗ of each mode
MOTORS = STATE + 3 * (1 + 2 * FEW_MODES)  # u and u̇ at the beginning, the middle and the end of a step
MOTION = MOTORS + 18  # of the axes at the step's beginning: place, velocity, acceleration
ALL_ROWS = MOTION + 9
Axis: TypeAlias = tuple[float, float, float, float, float]  # strain of its friction, p₁, ṗ₁, p₂, ṗ₂
Axes: TypeAlias = tuple[Axis, Axis, Axis]


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
    for n in range(WIDTH):
        m[STATE * LANES + n] = s.base[STRAIN * WIDTH + n]
    for n in range(2 * FEW_MODES * WIDTH):
        m[(STATE + 3) * LANES + n] = s.base[FIRST * WIDTH + n]


@compiled
def keep_state(m: FloatArray, l: int, states: FloatArray) -> None:
    """Copy the state of lane l to states : (k, rows, 3); neither gantry nor frame has moved."""
    for a in range(3):
        states[l, STRAIN, a] = at(m, STATE + a, l)
        for row in range(FIRST, states.shape[1]):
            states[l, row, a] = at(m, STATE + 3 * (1 + row - FIRST) + a, l)


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
def motors_at(m: FloatArray, half: int, t: float) -> None:
    """Evaluate the motors t seconds after the row whose cubics are loaded, for one of a step's three times."""
    for n in range(WIDTH):
        a, b, c = at(m, CUBIC, n), at(m, CUBIC + 3, n), at(m, CUBIC + 6, n)
        m[(MOTORS + 6 * half) * LANES + n] = ((a * t + b) * t + c) * t + at(m, CUBIC + 9, n)
        m[(MOTORS + 6 * half + 3) * LANES + n] = (3.0 * a * t + 2.0 * b) * t + c


@compiled
def step_lanes(m: FloatArray, h: float, has: ActiveEffects, springs: bool) -> None:
    """Step all lanes by h, by the classical Runge-Kutta method of order 4, and go on from the motors at its end.

    The motion at the step's beginning is left in MOTION. Without friction and `springs`, belts pull in proportion.
    """
    lanes = len(m) // ALL_ROWS  # LANES, which the compiler is not to know: it would write each lane out
    if has.sticking:
        _sticking(m, h, lanes)
    elif has.guides:
        _rubbing(m, h, lanes)
    elif springs:
        _smooth(m, h, lanes)
    else:
        _linear(m, h, lanes)
    for n in range(2 * WIDTH):
        m[MOTORS * LANES + n] = m[(MOTORS + 12) * LANES + n]


@compiled
def _linear(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, False, False, False)


@compiled
def _smooth(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, True, False, False)


@compiled
def _rubbing(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, True, True, False)


@compiled
def _sticking(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, True, True, True)


@inlined
def _step(m: FloatArray, l: int, h: float, springs: bool, rubbing: bool, sticking: bool) -> None:
    """Step one lane."""
    y = _axis(m, l), _axis(m, LANES + l), _axis(m, 2 * LANES + l)
    k1 = _rates(m, y, 0, l, springs, rubbing, sticking)
    _sample(m, l, y[0], k1[0])
    _sample(m, LANES + l, y[1], k1[1])
    _sample(m, 2 * LANES + l, y[2], k1[2])
    k2 = _rates(m, _moved(y, k1, 0.5 * h), 1, l, springs, rubbing, sticking)
    k3 = _rates(m, _moved(y, k2, 0.5 * h), 1, l, springs, rubbing, sticking)
    k4 = _rates(m, _moved(y, k3, h), 2, l, springs, rubbing, sticking)
    end = _moved(_moved(_moved(_moved(y, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0)
    _put(m, l, end[0])
    _put(m, LANES + l, end[1])
    _put(m, 2 * LANES + l, end[2])


@inlined
def _sample(m: FloatArray, n: int, y: Axis, rates: Axis) -> None:
    m[MOTION * LANES + n], m[(MOTION + 3) * LANES + n] = y[1] + y[3], y[2] + y[4]
    m[(MOTION + 6) * LANES + n] = rates[2] + rates[4]


@inlined
def _axis(m: FloatArray, n: int) -> Axis:
    return at(m, STATE, n), at(m, STATE + 3, n), at(m, STATE + 6, n), at(m, STATE + 9, n), at(m, STATE + 12, n)


@inlined
def _put(m: FloatArray, n: int, axis: Axis) -> None:
    m[STATE * LANES + n] = axis[0]
    m[(STATE + 3) * LANES + n], m[(STATE + 6) * LANES + n] = axis[1], axis[2]
    m[(STATE + 9) * LANES + n], m[(STATE + 12) * LANES + n] = axis[3], axis[4]


@inlined
def _moved(y: Axes, k: Axes, by: float) -> Axes:
    return _moved_axis(y[0], k[0], by), _moved_axis(y[1], k[1], by), _moved_axis(y[2], k[2], by)


@inlined
def _moved_axis(y: Axis, k: Axis, by: float) -> Axis:
    return y[0] + by * k[0], y[1] + by * k[1], y[2] + by * k[2], y[3] + by * k[3], y[4] + by * k[4]


@inlined
def _rates(m: FloatArray, y: Axes, half: int, l: int, springs: bool, rubbing: bool, sticking: bool) -> Axes:
    """Evaluate the rates of one lane's axes with the motors at one half step."""
    a, b, c = l, LANES + l, 2 * LANES + l
    q = _driven(m, a, y[0][1], y[0][3]), _driven(m, b, y[1][1], y[1][3]), _driven(m, c, y[2][1], y[2][3])
    qd = _driven(m, a, y[0][2], y[0][4]), _driven(m, b, y[1][2], y[1][4]), _driven(m, c, y[2][2], y[2][4])
    u, ud = _mixed(m, TO_MOTORS, l, q), _mixed(m, TO_MOTORS, l, qd)
    pull_a = _pull(m, a, _motor(m, half, 0, a), _motor(m, half, 1, a), u[0], ud[0], springs)
    pull_b = _pull(m, b, _motor(m, half, 0, b), _motor(m, half, 1, b), u[1], ud[1], springs)
    pull_c = _pull(m, c, _motor(m, half, 0, c), _motor(m, half, 1, c), u[2], ud[2], springs)
    drive = _mixed(m, TO_AXES, l, (pull_a[0], pull_b[0], pull_c[0]))
    rate = _mixed(m, TO_AXES, l, (pull_a[1], pull_b[1], pull_c[1]))
    return (
        _axis_rate(m, a, y[0], drive[0], rate[0], qd[0], rubbing, sticking),
        _axis_rate(m, b, y[1], drive[1], rate[1], qd[1], rubbing, sticking),
        _axis_rate(m, c, y[2], drive[2], rate[2], qd[2], rubbing, sticking),
    )


@inlined
def _driven(m: FloatArray, n: int, first: float, second: float) -> float:
    return _mode(m, 0, PART, n) * first + _mode(m, 1, PART, n) * second


@inlined
def _mode(m: FloatArray, i: int, field: int, n: int) -> float:
    return at(m, MODES + 3 * (FIELDS * i + field), n)


@inlined
def _motor(m: FloatArray, half: int, rate: int, n: int) -> float:
    return at(m, MOTORS + 6 * half + 3 * rate, n)


@inlined
def _mixed(m: FloatArray, matrix: Row, l: int, x: Vector) -> Vector:
    a, b, c = x
    return (
        at(m, matrix, l) * a + at(m, matrix + 1, l) * b + at(m, matrix + 2, l) * c,
        at(m, matrix + 3, l) * a + at(m, matrix + 4, l) * b + at(m, matrix + 5, l) * c,
        at(m, matrix + 6, l) * a + at(m, matrix + 7, l) * b + at(m, matrix + 8, l) * c,
    )


@inlined
def _pull(
    m: FloatArray, n: int, motor: float, motor_rate: float, q: float, qd: float, springs: bool
) -> tuple[float, float]:
    """Return what one belt adds to w, and to ẇ less that of its driven point."""
    if not springs:
        return motor + at(m, UNEVEN, n) * (motor - q), motor_rate - qd
    half, peak, slip = at(m, HALF_BACKLASH, n), at(m, PEAK_STRETCH, n), motor_rate - qd
    stretch = motor - q
    stretch = stretch - min(max(stretch, -half), half)
    stretch = min(max(stretch, -peak), peak)
    k = 1.0 + at(m, UNEVEN, n) + at(m, SLOPE, n) * (q - at(m, CENTRE, n))
    squared = stretch * stretch
    harder = (at(m, HARDENING, n) + at(m, QUINTIC, n) * squared) * squared * stretch / at(m, MOTOR_K, n)
    force = k * (stretch + abs(stretch) * at(m, LANDING, n) * slip) + harder
    slack = abs(motor - q) < half
    return q + (0.0 if slack else force), 0.0 if slack else slip


@inlined
def _axis_rate(
    m: FloatArray,
    n: int,
    y: Axis,
    drive: float,
    drive_rate: float,
    qd: float,
    rubbing: bool,
    sticking: bool,
) -> Axis:
    """Evaluate the rate of one axis: its modes, driven by w and ẇ − q̇_d, and its friction."""
    strain = 0.0
    if rubbing:
        level = at(m, DRY, n)
        if sticking:
            faded = tanh(0.5 * (qd * at(m, FADING, n)) ** 2)
            level += at(m, STICKING, n) * (1.0 - faded) / (1.0 + faded)
        ratio = qd / at(m, CREEP, n)
        drive -= level * tanh(ratio + y[0]) * at(m, COMPLIANCE, n)
        strain = strain_rate(at(m, HOLD, n), ratio, abs(ratio), y[0])
    follow = drive_rate + qd
    return strain, y[2], _force(m, 0, n, drive, follow, y[1], y[2]), y[4], _force(m, 1, n, drive, follow, y[3], y[4])


@inlined
def _force(m: FloatArray, i: int, n: int, drive: float, follow: float, place: float, rate: float) -> float:
    """Evaluate the acceleration of one mode."""
    share, belt = _mode(m, i, SHARE, n), _mode(m, i, BELT_DAMPING, n)
    return (
        _mode(m, i, FREQUENCY2, n) * (share * drive - place)
        - _mode(m, i, DAMPING, n) * rate
        + belt * (share * follow - rate)
    )
