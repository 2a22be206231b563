"""Step straight axes of at most two modes each: a whole step of a lane in one loop.

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
    BY_X,
    BY_X_CENTRE,
    BY_X_SQUARED,
    COMPLIANCE,
    DAMPING,
    DIRECTIONS,
    FIRST,
    FRAME,
    FRAME_B,
    FRAME_K,
    FREQUENCY2,
    GROWTH,
    HIGHEST,
    LEAST_STIFFER,
    PART,
    REACTION,
    SHARE,
    SWAY,
    SWAY_RATE,
    TO_AXES,
    TO_MOTORS,
    WIDTH,
    YAW,
    YAW_ARM,
    YAW_B,
    YAW_CENTRE,
    YAW_INERTIA,
    YAW_K,
    YAW_SHARE,
)
from models.printer.kernels.friction import DRY, FADING, FADING_POWER, STICKING, guide_force, sliding_level
from models.printer.kernels.motors import UNEVEN, drive_of_axes, effective_stretch, rippled, torque
from models.printer.kernels.record import (
    COMMAND,
    COMMAND_RATE,
    CUBIC,
    LANES,
    NO,
    ONE,
    RIPPLE,
    RIPPLE_RATE,
    ROWS,
    TWO,
    YES,
    ZERO,
    ActiveEffects,
    Row,
    Vector,
)
from models.printer.kernels.vectors import at, compiled, inlined, power

FEW_MODES, FIELDS = 2, 7
MODES = np.int64(ROWS)  # three rows a field
STATE = MODES + 3 * FEW_MODES * FIELDS  # as of `axes.AxesState`
MODE = STATE + 3 * FIRST  # p and ṗ of each mode
MOTORS = MODE + 6 * FEW_MODES  # u and u̇ at the beginning, the middle and the end of a step
MOTION = MOTORS + 18  # at the step's beginning: place, velocity, acceleration of the nozzle, then of the axes
ALL_ROWS = MOTION + 18


@compiled
def in_rows(m: FloatArray, states: FloatArray, modes: FloatArray) -> FloatArray:
    """Return m with the rows of this file: k printers' states (k, rows, 3) and modes (k, n, 7, 3).

    Idle lanes repeat the first printer. A mode of zeros stays at rest.
    """
    rows = np.zeros(ALL_ROWS * LANES)
    for n in range(len(m)):
        rows[n] = m[n]
    for l in range(LANES):
        source = l if l < len(states) else 0
        for a in range(3):
            for row in range(states.shape[1]):
                rows[(STATE + 3 * row + a) * LANES + l] = states[source, row, a]
            for i in range(modes.shape[1]):
                for field in range(FIELDS):
                    rows[(MODES + 3 * (FIELDS * i + field) + a) * LANES + l] = modes[source, i, field, a]
    return rows


@compiled
def keep_state(m: FloatArray, l: int, states: FloatArray) -> None:
    """Copy the state of lane l to states : (k, rows, 3)."""
    for row in range(states.shape[1]):
        for a in range(3):
            states[l, row, a] = at(m, STATE + 3 * row + a, l)


@compiled
def keep_motors(m: FloatArray, half: Row) -> None:
    """Keep where the motors are and how fast, at one of a step's three times."""
    for n in range(WIDTH):
        m[(MOTORS + 6 * half) * LANES + n] = at(m, COMMAND, n) + at(m, RIPPLE, n)
        m[(MOTORS + 6 * half + 3) * LANES + n] = at(m, COMMAND_RATE, n) + at(m, RIPPLE_RATE, n)


@compiled
def motors_at(m: FloatArray, half: Row, t: float, ripple: bool) -> None:
    """Evaluate the motors t seconds after the row whose cubics are loaded, for one of a step's three times."""
    for n in range(WIDTH):
        a, b, c = at(m, CUBIC, n), at(m, CUBIC + 3, n), at(m, CUBIC + 6, n)
        m[(MOTORS + 6 * half) * LANES + n] = ((a * t + b) * t + c) * t + at(m, CUBIC + 9, n)
        m[(MOTORS + 6 * half + 3) * LANES + n] = (3.0 * a * t + 2.0 * b) * t + c
    if ripple:
        for n in range(WIDTH):
            place = (MOTORS + 6 * half) * LANES + n
            more = rippled(m, n, m[place], m[place + 3 * LANES])
            m[place], m[place + 3 * LANES] = m[place] + more[0], m[place + 3 * LANES] + more[1]


Sway: TypeAlias = tuple[float, float, float, float, float, float]  # θ, θ̇; d and ḋ of the frame's two directions
Pull: TypeAlias = tuple[float, float]  # m/s², what they take off the modes of x and y
Two: TypeAlias = tuple[float, float]


@inlined
def sway_rates(m: FloatArray, l: int, sway: Sway, forces: Two, driven: Two, x: float) -> Sway:
    """Evaluate the rates of frame and gantry.

    Parameters
    ----------
    forces : Σ N f of x and y.
    driven : accelerations of the driven points of x and y.
    x : of the driven point, m.
    """
    theta, turning, d0, d1, dd0, dd1 = sway
    off, inertia = x - at(m, YAW_CENTRE, l), at(m, YAW_INERTIA, l)
    torque = at(m, YAW_ARM, l) * driven[0] - off * driven[1]
    torque -= inertia * (at(m, YAW_K, l) * theta + at(m, YAW_B, l) * turning)
    whole = inertia + (1.0 - at(m, YAW_SHARE, l)) * off * off
    turn = torque / whole if inertia > 0.0 else 0.0
    return turning, turn, dd0, dd1, _swayed(m, ZERO, l, d0, dd0, forces), _swayed(m, ONE, l, d1, dd1, forces)


@inlined
def _swayed(m: FloatArray, j: Row, l: int, d: float, dd: float, forces: Two) -> float:
    force = at(m, DIRECTIONS + 2 * j, l) * forces[0] + at(m, DIRECTIONS + 2 * j + 1, l) * forces[1]
    return -at(m, FRAME_K, l) * d - at(m, FRAME_B, l) * dd - at(m, FRAME, l) * force


@inlined
def pull_of(m: FloatArray, l: int, rates: Sway, x: float) -> Pull:
    """Return what the accelerations of frame and gantry take off the modes."""
    along = at(m, DIRECTIONS, l) * rates[4] + at(m, DIRECTIONS + 2, l) * rates[5]
    across = at(m, DIRECTIONS + 1, l) * rates[4] + at(m, DIRECTIONS + 3, l) * rates[5]
    return along, across + at(m, YAW_SHARE, l) * (x - at(m, YAW_CENTRE, l)) * rates[1]


@inlined
def lighter(m: FloatArray, n: int, height: float) -> float:
    """Return the mass at the bed over that at this height."""
    return 1.0 / (1.0 + at(m, GROWTH, n) * height)


@inlined
def stiffer(m: FloatArray, n: int, x: float) -> float:
    """Return what x adds to ω² of the highest mode, relative to it."""
    off = x - at(m, BY_X_CENTRE, n % LANES)
    return max((at(m, BY_X, n) + at(m, BY_X_SQUARED, n) * off) * off, LEAST_STIFFER)


Axis: TypeAlias = tuple[float, float, float, float, float]  # strain of its friction, p₁, ṗ₁, p₂, ṗ₂
Axes: TypeAlias = tuple[Axis, Axis, Axis, Sway]


@compiled
def step_lanes(m: FloatArray, h: float, has: ActiveEffects, springs: bool, swaying: bool, odd: bool) -> None:
    """Step all lanes by h, by the classical Runge-Kutta method of order 4, and go on from the motors at its end.

    The motion at the step's beginning is left in MOTION. Without friction and `springs`, belts are linear. Unless
    `swaying`, neither frame nor gantry moves, and modes do not depend on position. `odd` enables sines and powers: the
    motors' torque, and friction that fades with another power than the square.
    """
    lanes = len(m) // ALL_ROWS  # LANES, which the compiler is not to know: it would write each lane out
    if odd and not (swaying or has.guides):
        _electric(m, h, lanes)
    elif odd:
        _everything(m, h, lanes)
    elif swaying and (springs or has.guides):
        _most(m, h, lanes)
    elif swaying:
        _swaying(m, h, lanes)
    elif has.sticking:
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
        _step(m, l, h, NO, NO, NO, NO, NO)


@compiled
def _smooth(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, YES, NO, NO, NO, NO)


@compiled
def _electric(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, YES, NO, NO, NO, YES)


@compiled
def _rubbing(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, YES, YES, NO, NO, NO)


@compiled
def _sticking(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, YES, YES, YES, NO, NO)


@compiled
def _swaying(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, NO, NO, NO, YES, NO)


@compiled
def _most(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, YES, YES, YES, YES, NO)


@compiled
def _everything(m: FloatArray, h: float, lanes: int) -> None:
    for l in range(min(lanes, LANES)):
        _step(m, l, h, YES, YES, YES, YES, YES)


@inlined
def _step(
    m: FloatArray, l: int, h: float, springs: bool, rubbing: bool, sticking: bool, swaying: bool, odd: bool
) -> None:
    """Step one lane."""
    sway = _sway(m, l) if swaying else (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    y = _axis(m, l), _axis(m, LANES + l), _axis(m, 2 * LANES + l), sway
    k1 = _rates(m, y, ZERO, l, springs, rubbing, sticking, swaying, odd)
    _sample(m, l, ZERO, y[0], k1[0])
    _sample(m, l, ONE, y[1], k1[1])
    _sample(m, l, TWO, y[2], k1[2])
    if swaying:
        _sample_sway(m, l, y, k1)
    k2 = _rates(m, _moved(y, k1, 0.5 * h), ONE, l, springs, rubbing, sticking, swaying, odd)
    k3 = _rates(m, _moved(y, k2, 0.5 * h), ONE, l, springs, rubbing, sticking, swaying, odd)
    k4 = _rates(m, _moved(y, k3, h), TWO, l, springs, rubbing, sticking, swaying, odd)
    end = _moved(_moved(_moved(_moved(y, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0)
    _put(m, l, end[0])
    _put(m, LANES + l, end[1])
    _put(m, 2 * LANES + l, end[2])
    if swaying:
        _put_sway(m, l, end[3])


@inlined
def _sample(m: FloatArray, l: int, a: Row, y: Axis, rates: Axis) -> None:
    m[(MOTION + a) * LANES + l], m[(MOTION + 3 + a) * LANES + l] = y[1] + y[3], y[2] + y[4]
    m[(MOTION + 6 + a) * LANES + l] = rates[2] + rates[4]


@inlined
def _sample_sway(m: FloatArray, l: int, y: Axes, rates: Axes) -> None:
    """Keep the axes' motion, which is seen from the frame, and add to the nozzle's what frame and gantry do."""
    for n in range(9):
        m[(MOTION + 9 + n) * LANES + l] = at(m, MOTION + n, l)
    q = _driven(m, l, y[0][1], y[0][3])
    pull = pull_of(m, l, rates[3], q)
    shares = (
        _mode(m, ZERO, SHARE, l) + _mode(m, ONE, SHARE, l),
        _mode(m, ZERO, SHARE, l + LANES) + _mode(m, ONE, SHARE, l + LANES),
    )
    theta, turning, turn = y[3][0], y[3][1], rates[3][1]
    x, xd, xdd = at(m, MOTION, l) - at(m, YAW_CENTRE, l), at(m, MOTION + 3, l), at(m, MOTION + 6, l)
    m[(MOTION + 1) * LANES + l] += x * theta
    m[(MOTION + 4) * LANES + l] += x * turning + xd * theta
    m[(MOTION + 6) * LANES + l] += shares[0] * pull[0]
    # the share of its own reaction is in the axis' acceleration seen from the frame
    swung = x * turn + 2.0 * xd * turning + xdd * theta - at(m, YAW_SHARE, l) * x * turn
    m[(MOTION + 7) * LANES + l] += shares[1] * pull[1] + (swung if at(m, YAW_INERTIA, l) > 0.0 else 0.0)


@inlined
def _axis(m: FloatArray, n: int) -> Axis:
    return at(m, STATE, n), at(m, MODE, n), at(m, MODE + 3, n), at(m, MODE + 6, n), at(m, MODE + 9, n)


@inlined
def _put(m: FloatArray, n: int, axis: Axis) -> None:
    m[STATE * LANES + n] = axis[0]
    m[MODE * LANES + n], m[(MODE + 3) * LANES + n] = axis[1], axis[2]
    m[(MODE + 6) * LANES + n], m[(MODE + 9) * LANES + n] = axis[3], axis[4]


@inlined
def _sway(m: FloatArray, l: int) -> Sway:
    yaw, d, dd = STATE + 3 * YAW, STATE + 3 * SWAY, STATE + 3 * SWAY_RATE
    return at(m, yaw, l), at(m, yaw + 1, l), at(m, d, l), at(m, d + 1, l), at(m, dd, l), at(m, dd + 1, l)


@inlined
def _put_sway(m: FloatArray, l: int, sway: Sway) -> None:
    yaw, d, dd = STATE + 3 * YAW, STATE + 3 * SWAY, STATE + 3 * SWAY_RATE
    m[yaw * LANES + l], m[(yaw + 1) * LANES + l] = sway[0], sway[1]
    m[d * LANES + l], m[(d + 1) * LANES + l] = sway[2], sway[3]
    m[dd * LANES + l], m[(dd + 1) * LANES + l] = sway[4], sway[5]


@inlined
def _moved(y: Axes, k: Axes, by: float) -> Axes:
    a, b, s, t = _moved_axis(y[0], k[0], by), _moved_axis(y[1], k[1], by), y[3], k[3]
    first, second = (s[0] + by * t[0], s[1] + by * t[1]), (s[2] + by * t[2], s[3] + by * t[3])
    return a, b, _moved_axis(y[2], k[2], by), (*first, *second, s[4] + by * t[4], s[5] + by * t[5])


@inlined
def _moved_axis(y: Axis, k: Axis, by: float) -> Axis:
    return y[0] + by * k[0], y[1] + by * k[1], y[2] + by * k[2], y[3] + by * k[3], y[4] + by * k[4]


@inlined
def _rates(
    m: FloatArray, y: Axes, half: Row, l: int, springs: bool, rubbing: bool, sticking: bool, swaying: bool, odd: bool
) -> Axes:
    """Evaluate the rates of one lane's axes with the motors at one half step."""
    a, b, c = l, LANES + l, 2 * LANES + l
    q = _driven(m, a, y[0][1], y[0][3]), _driven(m, b, y[1][1], y[1][3]), _driven(m, c, y[2][1], y[2][3])
    qd = _driven(m, a, y[0][2], y[0][4]), _driven(m, b, y[1][2], y[1][4]), _driven(m, c, y[2][2], y[2][4])
    u, ud = _mixed(m, TO_MOTORS, l, q), _mixed(m, TO_MOTORS, l, qd)
    pull_a = _pull(m, a, _motor(m, half, ZERO, a), _motor(m, half, ONE, a), u[0], ud[0], springs, odd)
    pull_b = _pull(m, b, _motor(m, half, ZERO, b), _motor(m, half, ONE, b), u[1], ud[1], springs, odd)
    pull_c = _pull(m, c, _motor(m, half, ZERO, c), _motor(m, half, ONE, c), u[2], ud[2], springs, odd)
    drive = _mixed(m, TO_AXES, l, (pull_a[0], pull_b[0], pull_c[0]))
    rate = _mixed(m, TO_AXES, l, (pull_a[1], pull_b[1], pull_c[1]))
    x = _axis_rate(m, a, q[0], y[0], drive[0], rate[0], qd[0], rubbing, sticking, swaying, odd)
    y_rate = _axis_rate(m, b, q[0], y[1], drive[1], rate[1], qd[1], rubbing, sticking, swaying, odd)
    z = _axis_rate(m, c, q[0], y[2], drive[2], rate[2], qd[2], rubbing, sticking, swaying, odd)
    if not swaying:
        return x, y_rate, z, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    forces = _reaction(m, a, x), _reaction(m, b, y_rate)
    x, y_rate, z = _lightened(m, a, q[2], x), _lightened(m, b, q[2], y_rate), _lightened(m, c, q[2], z)
    driven = _driven(m, a, x[2], x[4]), _driven(m, b, y_rate[2], y_rate[4])
    sway = sway_rates(m, l, y[3], forces, driven, q[0])
    pull = pull_of(m, l, sway, q[0])
    return _less(m, a, x, pull[0]), _less(m, b, y_rate, pull[1]), z, sway


@inlined
def _reaction(m: FloatArray, n: int, rates: Axis) -> float:
    return _mode(m, ZERO, REACTION, n) * rates[2] + _mode(m, ONE, REACTION, n) * rates[4]


@inlined
def _lightened(m: FloatArray, n: int, height: float, rates: Axis) -> Axis:
    by = lighter(m, n, height)
    return rates[0], rates[1], by * rates[2], rates[3], by * rates[4]


@inlined
def _less(m: FloatArray, n: int, rates: Axis, pull: float) -> Axis:
    first, second = rates[2] - _mode(m, ZERO, SHARE, n) * pull, rates[4] - _mode(m, ONE, SHARE, n) * pull
    return rates[0], rates[1], first, rates[3], second


@inlined
def _driven(m: FloatArray, n: int, first: float, second: float) -> float:
    return _mode(m, ZERO, PART, n) * first + _mode(m, ONE, PART, n) * second


@inlined
def _mode(m: FloatArray, i: Row, field: Row, n: int) -> float:
    return at(m, MODES + 3 * (FIELDS * i + field), n)


@inlined
def _motor(m: FloatArray, half: Row, rate: Row, n: int) -> float:
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
    m: FloatArray, n: int, motor: float, motor_rate: float, q: float, qd: float, springs: bool, odd: bool
) -> tuple[float, float]:
    """Return what one belt adds to w, and to ẇ less that of its driven point."""
    if not springs:
        return motor + at(m, UNEVEN, n) * (motor - q), motor_rate - qd
    stretch, slip = effective_stretch(m, n, motor - q), motor_rate - qd
    return drive_of_axes(m, n, motor, q, stretch, torque(m, n, stretch) if odd else stretch, slip)


@inlined
def _axis_rate(
    m: FloatArray,
    n: int,
    x: float,
    y: Axis,
    drive: float,
    drive_rate: float,
    qd: float,
    rubbing: bool,
    sticking: bool,
    swaying: bool,
    odd: bool,
) -> Axis:
    """Evaluate the rate of one axis: its modes, driven by w and ẇ − q̇_d, and its friction."""
    strain = 0.0
    if rubbing:
        level = at(m, DRY, n)
        if sticking:
            squared = (qd * at(m, FADING, n)) ** 2
            faded = power(squared, at(m, FADING_POWER, n)) if odd else squared
            level = sliding_level(level, at(m, STICKING, n), faded)
        force, strain = guide_force(m, n, level, qd, y[0])
        drive -= force * at(m, COMPLIANCE, n)
    follow, more = drive_rate + qd, stiffer(m, n, x) if swaying else 0.0
    first = _force(m, ZERO, n, more, drive, follow, y[1], y[2])
    return strain, y[2], first, y[4], _force(m, ONE, n, more, drive, follow, y[3], y[4])


@inlined
def _force(
    m: FloatArray, i: Row, n: int, stiffer: float, drive: float, follow: float, place: float, rate: float
) -> float:
    """Evaluate the acceleration of one mode."""
    share, belt = _mode(m, i, SHARE, n), _mode(m, i, BELT_DAMPING, n)
    return (
        _mode(m, i, FREQUENCY2, n) * (1.0 + _mode(m, i, HIGHEST, n) * stiffer) * (share * drive - place)
        - _mode(m, i, DAMPING, n) * rate
        + belt * (share * follow - rate)
    )
