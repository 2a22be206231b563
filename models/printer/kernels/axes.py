"""Straight axes: their modes (`models/vibration/modal.py`), and what acts on their belts and guides.

Each axis is driven by w, where its motors would have to be for linear belts without friction. With T from the axes to
the motors (a CoreXY's A = x + y, B = x − y), u the motors, q_d the axes' driven points, and g(s) the force of a belt
over its stiffness,

    w = T⁻¹ (u + g(s) − s) − F/k,   s = u − T q_d                  F the guides' friction, k of `drive_stiffness`
    p̈_i = ω_i² (σ_i w − p_i) − b_i ṗ_i + c_i (σ_i ẇ − ṗ_i)

so that an axis whose belts are linear and whose guides do not rub is the linear model itself. A rigid axis has damping
c between motor and driven point instead of b; it is off where a belt is slack.

Reactions: with f_i = p̈_i so far, N_i f_i summed is the force on the frame (d, along D) and on the yaw θ
of a gantry with the toolhead at x from its axis, whose inertia is λ² and whose share of the mass along y is μ:

    d̈ = −ω² d − 2 ζ ω ḋ − Dᵀ Σ N_i f_i/M_f,   (λ² + (1 − μ) x²) θ̈ = −λ² (ω² θ + 2 ζ ω θ̇) − x f_y + a f_x
    p̈_i = f_i − σ_i D d̈ − σ_i μ x θ̈ (along y),   y = Σ p_i + x θ

where a is the arm of the force along x. A mass that grows with the height z divides all f of its axis by 1 + g z; ω² of
an axis' highest mode may depend on x.

A whole step of a lane is one loop, with the state in registers. All that it needs is in rows of one array, after those
of `record.py`: only so does the compiler see that lanes do not disturb each other, and puts them side by side. The
modes of an axis are tuples, whose length is part of their type: each number of modes is compiled by itself.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels import record as r
from models.printer.kernels.friction import guide_force
from models.printer.kernels.motors import command_at, drive_of_axes, effective_stretch, rippled, torque
from models.printer.kernels.record import LANES, NO, ONE, ROWS, STATES, TWO, YES, ZERO, ActiveEffects, Row, Vector
from models.printer.kernels.vectors import at, compiled, dot, inlined, plus, unrolled, vector

LEAST_STIFFER = -0.9  # of ω², however far x is from the place where the file's holds

# A state, three entries a row: strain of dry friction, (θ, θ̇, nothing), d, ḋ, then p_i, ṗ_i of every mode.
STRAIN, YAW, SWAY, SWAY_RATE, FIRST = np.arange(5)
# The fields of a mode: `ModalAxes.printer_modes`.
FREQUENCY2, DAMPING, BELT_DAMPING, SHARE, PART, REACTION, HIGHEST = np.arange(7)
FIELDS = 7

# Rows after those of `record.py`: the state without its modes; u and u̇ at the beginning, the middle and the end of a
# step; place, velocity, acceleration of the nozzle at the step's beginning, then of the axes; 1/k of `drive_stiffness`;
# of each mode its fields, p and ṗ.
STATE = np.int64(ROWS)
MOTORS = STATE + 3 * FIRST
MOTION = MOTORS + 18
COMPLIANCE = MOTION + 18
MODES = COMPLIANCE + 3
PLACES, RATES = MODES + 3 * FIELDS, MODES + 3 * FIELDS + 3
EACH = np.int64(3 * FIELDS + 6)  # rows of a mode
WIDTH = 3 * LANES


def lanes_of_axes(states: FloatArray, modes: FloatArray, parameters: FloatArray) -> FloatArray:
    """Return m, as (rows, LANES), of k printers with states (k, rows, 3) and modes (k, n, 7, 3); see `record.lanes`."""
    m = r.lanes(np.zeros((len(states), STATES)), parameters, int(MODES + EACH * modes.shape[1]))
    m[COMPLIANCE:MODES] = 1.0 / m[r.belt_k : r.belt_k + 3]
    each = np.minimum(np.arange(LANES), len(states) - 1)
    m[STATE : STATE + 3 * FIRST] = states[each, :FIRST].reshape(LANES, -1).T
    for i in range(modes.shape[1]):
        begin, row = MODES + EACH * i, FIRST + 2 * i
        m[begin : begin + 3 * FIELDS] = modes[each, i].reshape(LANES, -1).T
        m[begin + 3 * FIELDS : begin + EACH] = states[each, row : row + 2].reshape(LANES, -1).T
    return m


@inlined
def _state_row(row: int) -> Row:
    return STATE + 3 * row if row < FIRST else PLACES + EACH * ((row - FIRST) // 2) + 3 * ((row - FIRST) % 2)


@compiled
def keep_state(m: FloatArray, l: int, states: FloatArray) -> None:
    """Copy the state of lane l to states : (k, rows, 3)."""
    for row in range(states.shape[1]):
        for a in range(3):
            states[l, row, a] = at(m, _state_row(row) + a, l)


@compiled
def keep_motors(m: FloatArray, half: Row) -> None:
    """Keep where the motors are and how fast, at one of a step's three times."""
    for n in range(WIDTH):
        m[(MOTORS + 6 * half) * LANES + n] = at(m, r.COMMAND, n) + at(m, r.RIPPLE, n)
        m[(MOTORS + 6 * half + 3) * LANES + n] = at(m, r.COMMAND_RATE, n) + at(m, r.RIPPLE_RATE, n)


@compiled
def motors_at(m: FloatArray, half: Row, t: float, ripple: bool) -> None:
    """Evaluate the motors t seconds after the row whose cubics are loaded, for one of a step's three times."""
    for n in range(WIDTH):
        place = (MOTORS + 6 * half) * LANES + n
        m[place], m[place + 3 * LANES] = command_at(m, n, t)
    if ripple:
        for n in range(WIDTH):
            place = (MOTORS + 6 * half) * LANES + n
            more = rippled(m, n, m[place], m[place + 3 * LANES])
            m[place], m[place + 3 * LANES] = m[place] + more[0], m[place + 3 * LANES] + more[1]


class Terms(NamedTuple):
    """The terms that are compiled in."""

    springs: bool
    rubbing: bool
    sticking: bool
    swaying: bool
    sines: bool
    powers: bool


PerMode: TypeAlias = tuple[float, ...]  # one number a mode
Axis: TypeAlias = tuple[float, PerMode, PerMode]  # strain of its friction, p, ṗ
Sway: TypeAlias = tuple[float, float, float, float, float, float]  # θ, θ̇; d and ḋ of the frame's two directions
Two: TypeAlias = tuple[float, float]
Axes: TypeAlias = tuple[Axis, Axis, Axis, Sway]


@unrolled(end=())
def _loaded(m: FloatArray, row: Row, n: int, like: PerMode) -> PerMode:
    """Return a row of each mode."""
    return (at(m, row, n), *_loaded(m, row + EACH, n, like[1:]))


@unrolled(end=0)
def _store(m: FloatArray, row: Row, n: int, values: PerMode) -> int:
    """Store a row of each mode."""
    m[row * LANES + n] = values[0]
    return _store(m, row + EACH, n, values[1:])


@unrolled(end=())
def _without(m: FloatArray, row: Row, n: int, by: float, y: PerMode) -> PerMode:
    """Return y less a row of each mode times `by`."""
    return (y[0] - at(m, row, n) * by, *_without(m, row + EACH, n, by, y[1:]))


@unrolled(end=-0.0)
def _sum(y: PerMode) -> float:
    return y[0] + _sum(y[1:])


@unrolled(end=-0.0)
def _dot(m: FloatArray, row: Row, n: int, y: PerMode) -> float:
    """Return the sum of y times a row of each mode."""
    return at(m, row, n) * y[0] + _dot(m, row + EACH, n, y[1:])


@unrolled(end=())
def _forces(
    m: FloatArray, row: Row, n: int, stiffer: float, drive: float, follow: float, rate: PerMode, place: PerMode
) -> PerMode:
    """Evaluate the acceleration of each mode by its axis' drive."""
    share, belt = at(m, row + 3 * SHARE, n), at(m, row + 3 * BELT_DAMPING, n)
    square = at(m, row + 3 * FREQUENCY2, n) * (1.0 + at(m, row + 3 * HIGHEST, n) * stiffer)
    force = square * (share * drive - place[0]) - at(m, row + 3 * DAMPING, n) * rate[0]
    first = force + belt * (share * follow - rate[0])
    return (first, *_forces(m, row + EACH, n, stiffer, drive, follow, rate[1:], place[1:]))


@inlined
def _driven(m: FloatArray, n: int, y: PerMode) -> float:
    """Return what the modes' places, rates or accelerations make of the driven point's."""
    return _dot(m, MODES + 3 * PART, n, y)


@inlined
def _yaw_x(m: FloatArray, l: int, x: float) -> float:
    return x - at(m, r.yaw_centre, l)


@inlined
def _sway_rates(m: FloatArray, l: int, sway: Sway, forces: Two, driven: Two, x: float) -> Sway:
    """Evaluate the rates of frame and gantry.

    Parameters
    ----------
    forces : Σ N f of x and y.
    driven : accelerations of the driven points of x and y.
    x : of the driven point, m.
    """
    theta, turning, d0, d1, dd0, dd1 = sway
    off, inertia = _yaw_x(m, l, x), at(m, r.yaw_inertia, l)
    torque = at(m, r.yaw_arm, l) * driven[0] - off * driven[1]
    torque -= inertia * (at(m, r.yaw_k, l) * theta + at(m, r.yaw_b, l) * turning)
    whole = inertia + (1.0 - at(m, r.yaw_share, l)) * off * off
    turn = torque / whole if inertia > 0.0 else 0.0
    return turning, turn, dd0, dd1, _swayed(m, ZERO, l, d0, dd0, forces), _swayed(m, ONE, l, d1, dd1, forces)


@inlined
def _swayed(m: FloatArray, j: Row, l: int, d: float, dd: float, forces: Two) -> float:
    force = at(m, r.frame_directions + 2 * j, l) * forces[0] + at(m, r.frame_directions + 2 * j + 1, l) * forces[1]
    return -at(m, r.frame_k, l) * d - at(m, r.frame_b, l) * dd - at(m, r.frame_inverse_mass, l) * force


@inlined
def _pull_of(m: FloatArray, l: int, rates: Sway, x: float) -> Two:
    """Return what the accelerations of frame and gantry take off the modes of x and y, m/s²."""
    along = at(m, r.frame_directions, l) * rates[4] + at(m, r.frame_directions + 2, l) * rates[5]
    across = at(m, r.frame_directions + 1, l) * rates[4] + at(m, r.frame_directions + 3, l) * rates[5]
    return along, across + at(m, r.yaw_share, l) * _yaw_x(m, l, x) * rates[1]


@inlined
def _stiffer(m: FloatArray, n: int, x: float) -> float:
    """Return what x adds to ω² of the highest mode, relative to it."""
    off = x - at(m, r.by_x_centre, n % LANES)
    return max((at(m, r.by_x, n) + at(m, r.by_x_squared, n) * off) * off, LEAST_STIFFER)


@compiled
def step_lanes(m: FloatArray, h: float, like: PerMode, used: int, has: ActiveEffects) -> None:
    """Step the used lanes by h, by the classical Runge-Kutta method of order 4, and go on from the motors at its end.

    The motion at the step's beginning is left in MOTION. `like` has the length of an axis' modes. Without a command an
    idle lane would decay to denormal numbers, which take a processor many times as long.
    """
    if has.torque_angle and not (has.swaying or has.guides):
        _steps(m, h, like, used, Terms(YES, NO, NO, NO, YES, NO))
    elif has.torque_angle:
        _steps(m, h, like, used, Terms(YES, YES, YES, YES, YES, YES))
    elif has.powers:
        _steps(m, h, like, used, Terms(YES, YES, YES, YES, NO, YES))
    elif has.swaying and (has.springs or has.guides):
        _steps(m, h, like, used, Terms(YES, YES, YES, YES, NO, NO))
    elif has.swaying:
        _steps(m, h, like, used, Terms(NO, NO, NO, YES, NO, NO))
    elif has.sticking:
        _steps(m, h, like, used, Terms(YES, YES, YES, NO, NO, NO))
    elif has.guides:
        _steps(m, h, like, used, Terms(YES, YES, NO, NO, NO, NO))
    elif has.springs:
        _steps(m, h, like, used, Terms(YES, NO, NO, NO, NO, NO))
    else:
        _steps(m, h, like, used, Terms(NO, NO, NO, NO, NO, NO))
    for n in range(2 * WIDTH):
        m[MOTORS * LANES + n] = m[(MOTORS + 12) * LANES + n]


@inlined
def _steps(m: FloatArray, h: float, like: PerMode, used: int, has: Terms) -> None:
    for l in range(min(used, LANES)):  # by LANES the compiler sees that rows do not overlap
        _step(m, l, h, like, has)


@inlined
def _step(m: FloatArray, l: int, h: float, like: PerMode, has: Terms) -> None:
    """Step one lane."""
    y = _axis(m, l, like), _axis(m, LANES + l, like), _axis(m, 2 * LANES + l, like), _sway(m, l)
    k1 = _rates(m, y, ZERO, l, has)
    _sample(m, l, ZERO, y[0], k1[0])
    _sample(m, l, ONE, y[1], k1[1])
    _sample(m, l, TWO, y[2], k1[2])
    if has.swaying:
        _sample_sway(m, l, y, k1, like)
    k2 = _rates(m, _moved(y, k1, 0.5 * h), ONE, l, has)
    k3 = _rates(m, _moved(y, k2, 0.5 * h), ONE, l, has)
    k4 = _rates(m, _moved(y, k3, h), TWO, l, has)
    end = _moved(_moved(_moved(_moved(y, k1, h / 6.0), k2, h / 3.0), k3, h / 3.0), k4, h / 6.0)
    _put(m, l, end[0])
    _put(m, LANES + l, end[1])
    _put(m, 2 * LANES + l, end[2])
    if has.swaying:
        _put_sway(m, l, end[3])


@inlined
def _sample(m: FloatArray, l: int, a: Row, y: Axis, rates: Axis) -> None:
    m[(MOTION + a) * LANES + l], m[(MOTION + 3 + a) * LANES + l] = _sum(y[1]), _sum(y[2])
    m[(MOTION + 6 + a) * LANES + l] = _sum(rates[2])


@inlined
def _sample_sway(m: FloatArray, l: int, y: Axes, rates: Axes, like: PerMode) -> None:
    """Keep the axes' motion, which is seen from the frame, and add to the nozzle's what frame and gantry do."""
    for n in range(9):
        m[(MOTION + 9 + n) * LANES + l] = at(m, MOTION + n, l)
    pull, share = _pull_of(m, l, rates[3], _driven(m, l, y[0][1])), MODES + 3 * SHARE
    theta, turning, turn = y[3][0], y[3][1], rates[3][1]
    x, xd, xdd = _yaw_x(m, l, at(m, MOTION, l)), at(m, MOTION + 3, l), at(m, MOTION + 6, l)
    m[(MOTION + 1) * LANES + l] += x * theta
    m[(MOTION + 4) * LANES + l] += x * turning + xd * theta
    m[(MOTION + 6) * LANES + l] += _sum(_loaded(m, share, l, like)) * pull[0]
    # the share of its own reaction is in the axis' acceleration seen from the frame
    swung = x * turn + 2.0 * xd * turning + xdd * theta - at(m, r.yaw_share, l) * x * turn
    swung = swung if at(m, r.yaw_inertia, l) > 0.0 else 0.0
    m[(MOTION + 7) * LANES + l] += _sum(_loaded(m, share, LANES + l, like)) * pull[1] + swung


@inlined
def _axis(m: FloatArray, n: int, like: PerMode) -> Axis:
    return at(m, STATE, n), _loaded(m, PLACES, n, like), _loaded(m, RATES, n, like)


@inlined
def _put(m: FloatArray, n: int, axis: Axis) -> None:
    m[STATE * LANES + n] = axis[0]
    _store(m, PLACES, n, axis[1])
    _store(m, RATES, n, axis[2])


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
    return _moved_axis(y[0], k[0], by), _moved_axis(y[1], k[1], by), _moved_axis(y[2], k[2], by), plus(by, k[3], y[3])


@inlined
def _moved_axis(y: Axis, k: Axis, by: float) -> Axis:
    return y[0] + by * k[0], plus(by, k[1], y[1]), plus(by, k[2], y[2])


@inlined
def _rates(m: FloatArray, y: Axes, half: Row, l: int, has: Terms) -> Axes:
    """Evaluate the rates of one lane's axes with the motors at one half step."""
    a, b, c = l, LANES + l, 2 * LANES + l
    q = _driven(m, a, y[0][1]), _driven(m, b, y[1][1]), _driven(m, c, y[2][1])
    qd = _driven(m, a, y[0][2]), _driven(m, b, y[1][2]), _driven(m, c, y[2][2])
    u, ud = _mixed(m, r.motor_matrix, l, q), _mixed(m, r.motor_matrix, l, qd)
    pull_a, pull_b = _pull(m, a, half, u[0], ud[0], has), _pull(m, b, half, u[1], ud[1], has)
    pull_c = _pull(m, c, half, u[2], ud[2], has)
    drive = _mixed(m, r.axis_matrix, l, (pull_a[0], pull_b[0], pull_c[0]))
    rate = _mixed(m, r.axis_matrix, l, (pull_a[1], pull_b[1], pull_c[1]))
    x = _axis_rate(m, a, q[0], y[0], drive[0], rate[0], qd[0], has)
    y_rate = _axis_rate(m, b, q[0], y[1], drive[1], rate[1], qd[1], has)
    z = _axis_rate(m, c, q[0], y[2], drive[2], rate[2], qd[2], has)
    if not has.swaying:
        return x, y_rate, z, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    forces = _dot(m, MODES + 3 * REACTION, a, x[2]), _dot(m, MODES + 3 * REACTION, b, y_rate[2])
    x, y_rate, z = _heavier(m, a, q[2], x), _heavier(m, b, q[2], y_rate), _heavier(m, c, q[2], z)
    sway = _sway_rates(m, l, y[3], forces, (_driven(m, a, x[2]), _driven(m, b, y_rate[2])), q[0])
    pull = _pull_of(m, l, sway, q[0])
    return _pulled(m, a, x, pull[0]), _pulled(m, b, y_rate, pull[1]), z, sway


@inlined
def _heavier(m: FloatArray, n: int, height: float, rates: Axis) -> Axis:
    """Return the rates of an axis whose mass is larger than at the bed."""
    more = at(m, r.growth, n) * height
    return rates[0], rates[1], plus(1.0 / (1.0 + more) - 1.0, rates[2], rates[2])


@inlined
def _pulled(m: FloatArray, n: int, rates: Axis, pull: float) -> Axis:
    """Return the rates of an axis less what frame and gantry take off its modes."""
    return rates[0], rates[1], _without(m, MODES + 3 * SHARE, n, pull, rates[2])


@inlined
def _mixed(m: FloatArray, matrix: Row, l: int, x: Vector) -> Vector:
    return dot(vector(m, matrix, l), x), dot(vector(m, matrix + 3, l), x), dot(vector(m, matrix + 6, l), x)


@inlined
def _pull(m: FloatArray, n: int, half: Row, q: float, qd: float, has: Terms) -> tuple[float, float]:
    """Return what one belt adds to w, and to ẇ less that of its driven point."""
    motor, motor_rate = at(m, MOTORS + 6 * half, n), at(m, MOTORS + 6 * half + 3, n)
    if not has.springs:
        return motor + at(m, r.uneven, n) * (motor - q), motor_rate - qd
    stretch = effective_stretch(m, n, motor - q)
    return drive_of_axes(m, n, motor, q, stretch, torque(m, n, stretch) if has.sines else stretch, motor_rate - qd)


@inlined
def _axis_rate(
    m: FloatArray, n: int, x: float, y: Axis, drive: float, drive_rate: float, qd: float, has: Terms
) -> Axis:
    """Evaluate the rate of one axis: its modes, driven by w and ẇ − q̇_d, and its friction."""
    strain = 0.0
    if has.rubbing:
        force, strain = guide_force(m, n, qd, y[0], has.sticking, has.powers)
        drive -= force * at(m, COMPLIANCE, n)
    more = _stiffer(m, n, x) if has.swaying else 0.0
    return strain, y[2], _forces(m, MODES, n, more, drive, drive_rate + qd, y[2], y[1])
