"""Evaluate straight axes: their modes (`models/vibration/modal.py`), and what acts on their belts and guides.

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

`axes_step.py` does the same faster for most machines. The state, three rows for each entry, is the
strain of dry friction, (θ, θ̇, nothing), d, ḋ, then p_i, ṗ_i of every mode.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.friction import guide_friction, stribeck
from models.printer.kernels.motors import drive_of_axes, effective_stretch, torque_angle
from models.printer.kernels.record import (
    ACC,
    COMMAND,
    COMMAND_RATE,
    F0,
    GUIDE,
    GUIDES,
    LANES,
    MOTOR,
    MOTOR_RATE,
    NOW,
    ONE,
    PULL,
    QD,
    RATE,
    RHO,
    RIPPLE,
    RIPPLE_RATE,
    SPRING,
    STRETCH,
    THREE,
    XD,
    ActiveEffects,
    J,
    Q,
    Row,
    X,
    parameter_rows,
)
from models.printer.kernels.vectors import any_nonzero, at, compiled, dot, put, vector

TO_MOTORS, TO_AXES, BELT_K, GROWTH = parameter_rows("motor_matrix", "axis_matrix", "belt_k", "growth")
DIRECTIONS, FRAME_K, FRAME_B, FRAME = parameter_rows("frame_directions", "frame_k", "frame_b", "frame_inverse_mass")
YAW_K, YAW_B, YAW_INERTIA = parameter_rows("yaw_k", "yaw_b", "yaw_inertia")
YAW_SHARE, YAW_CENTRE, YAW_ARM = parameter_rows("yaw_share", "yaw_centre", "yaw_arm")
BY_X, BY_X_SQUARED, BY_X_CENTRE = parameter_rows("by_x", "by_x_squared", "by_x_centre")

# Rows of m that a delta uses for itself, here between the loops: w and ẇ − q̇_d of the axes, force over stiffness less
# stretch of the belts, ẇ's of the belts, the force Σ N f; acceleration of q_d; what x adds to ω², relative to it.
DRIVE, DRIVE_RATE, BEYOND, SLIP, STIFFER = XD, X, PULL, F0, RHO
LIGHTER, COMPLIANCE = J, J + 3  # the mass over that at this height; 1/k of `drive_stiffness`
LEAST_STIFFER = -0.9  # of ω², however far x is from the place where the file's holds
WIDTH = 3 * LANES  # of a row of a state
STRAIN, YAW, SWAY, SWAY_RATE, FIRST = np.arange(5)
FREQUENCY2, DAMPING, BELT_DAMPING, SHARE, PART, REACTION, HIGHEST = np.arange(7)


class AxesState(NamedTuple):
    """The state of all lanes, and the modes' table."""

    base: FloatArray  # (rows * WIDTH,) at the step's start
    now: FloatArray  # where the rate is evaluated
    rate: FloatArray
    sum: FloatArray  # of the step's rates
    modes: FloatArray  # (n, 7, WIDTH)
    mixed: bool  # whether a motor moves more than one axis, in any lane
    swaying: bool  # whether there is a frame that sways, or a gantry that yaws
    growing: bool  # whether the mass depends on the nozzle's height
    by_place: bool  # whether a mode depends on x


@compiled
def is_swaying(m: FloatArray) -> bool:
    """Whether there is a frame that sways, or a gantry that yaws, in any lane."""
    return any_nonzero(m, FRAME, ONE) or any_nonzero(m, YAW_INERTIA, ONE)


@compiled
def is_growing(m: FloatArray) -> bool:
    """Whether the mass depends on the nozzle's height, in any lane."""
    return any_nonzero(m, GROWTH, THREE)


@compiled
def depends_on_place(m: FloatArray) -> bool:
    """Whether a mode depends on x, in any lane."""
    return any_nonzero(m, BY_X, THREE) or any_nonzero(m, BY_X_SQUARED, THREE)


@compiled
def axes_rate(m: FloatArray, s: AxesState, has: ActiveEffects) -> None:
    """Evaluate the rate of s.now under the command in m, and with it the acceleration (ACC); see `axes_motion`."""
    _driven_points(m, s)
    if s.mixed:
        _mix(m, TO_MOTORS, NOW + Q, NOW + QD, BEYOND, SLIP)
    _belts(m)
    if has.torque_angle:
        torque_angle(m)
    if has.sticking:
        stribeck(m)
    if has.guides:
        guide_friction(m)
    _forces(m)
    if s.mixed:
        _mix(m, TO_AXES, BEYOND, SLIP, DRIVE, DRIVE_RATE)
    _modes(m, s)
    if s.swaying:
        _reactions(m, s)


@compiled
def axes_motion(m: FloatArray, s: AxesState) -> None:
    """Evaluate the motion (Q, QD; X, XD, ACC) at s.now, whose rate has been evaluated."""
    _motion(m, s)
    if s.swaying:
        _yawed(m, s)


@compiled
def _driven_points(m: FloatArray, s: AxesState) -> None:
    """Evaluate q_d and its rate, unmixed also as what the belts hold, and give the friction its strain."""
    for i in range(len(s.modes)):
        p, pd = (FIRST + 2 * i) * WIDTH, (FIRST + 2 * i + 1) * WIDTH
        for n in range(WIDTH):
            part, q, qd = s.modes[i, PART, n], at(m, NOW + Q, n), at(m, NOW + QD, n)
            q, qd = (0.0 if i == 0 else q) + part * s.now[p + n], (0.0 if i == 0 else qd) + part * s.now[pd + n]
            m[(NOW + Q) * LANES + n], m[(NOW + QD) * LANES + n] = q, qd
            m[BEYOND * LANES + n], m[SLIP * LANES + n] = q, qd
            m[(NOW + GUIDE) * LANES + n] = s.now[STRAIN * WIDTH + n]


@compiled
def _mix(m: FloatArray, matrix: Row, x: Row, x_rate: Row, to: Row, to_rate: Row) -> None:
    """Evaluate a matrix times three rows, and times the three of their rates."""
    for l in range(LANES):
        q, qd = vector(m, x, l), vector(m, x_rate, l)
        rows = vector(m, matrix, l), vector(m, matrix + 3, l), vector(m, matrix + 6, l)
        put(m, to, l, (dot(rows[0], q), dot(rows[1], q), dot(rows[2], q)))
        put(m, to_rate, l, (dot(rows[0], qd), dot(rows[1], qd), dot(rows[2], qd)))


@compiled
def _belts(m: FloatArray) -> None:
    """Evaluate the ideal motors and the stretch of the belts and its rate.

    The stretch is less the backlash, and up to that of the peak force.
    """
    for n in range(WIDTH):
        motor, motor_rate = at(m, COMMAND, n) + at(m, RIPPLE, n), at(m, COMMAND_RATE, n) + at(m, RIPPLE_RATE, n)
        m[MOTOR * LANES + n], m[MOTOR_RATE * LANES + n] = motor, motor_rate
        stretch = effective_stretch(m, n, motor - at(m, BEYOND, n))
        m[STRETCH * LANES + n] = m[SPRING * LANES + n] = stretch
        m[SLIP * LANES + n] = motor_rate - m[SLIP * LANES + n]


@compiled
def _forces(m: FloatArray) -> None:
    """Evaluate u + g(s) − s of the belts, with s = u − T q_d, and ẇ; unmixed they are the axes' own."""
    for n in range(WIDTH):
        stretch, spring = at(m, STRETCH, n), at(m, SPRING, n)
        force, slip = drive_of_axes(m, n, at(m, MOTOR, n), at(m, BEYOND, n), stretch, spring, at(m, SLIP, n))
        m[BEYOND * LANES + n], m[SLIP * LANES + n] = force, slip
        m[DRIVE * LANES + n], m[DRIVE_RATE * LANES + n] = force, slip


@compiled
def _modes(m: FloatArray, s: AxesState) -> None:
    """Evaluate f of every mode, Σ N f and Σ f of each axis, and the rate of the friction's strain."""
    if s.growing:
        _lighter(m)
    if s.by_place:
        _by_place(m)
    for i in range(len(s.modes)):
        p, pd = (FIRST + 2 * i) * WIDTH, (FIRST + 2 * i + 1) * WIDTH
        for n in range(WIDTH):
            share, place, rate = s.modes[i, SHARE, n], s.now[p + n], s.now[pd + n]
            drive = share * (m[DRIVE * LANES + n] - at(m, GUIDES, n) * m[COMPLIANCE * LANES + n])
            follow = share * (m[DRIVE_RATE * LANES + n] + at(m, NOW + QD, n)) - rate
            square = s.modes[i, FREQUENCY2, n] * (1.0 + s.modes[i, HIGHEST, n] * m[STIFFER * LANES + n])
            f = square * (drive - place) - s.modes[i, DAMPING, n] * rate + s.modes[i, BELT_DAMPING, n] * follow
            light = f * m[LIGHTER * LANES + n]
            force, sum_f, driven = at(m, F0, n), at(m, ACC, n), at(m, RATE + QD, n)
            m[F0 * LANES + n] = (0.0 if i == 0 else force) + s.modes[i, REACTION, n] * f
            m[ACC * LANES + n] = (0.0 if i == 0 else sum_f) + light
            m[(RATE + QD) * LANES + n] = (0.0 if i == 0 else driven) + s.modes[i, PART, n] * light
            s.rate[p + n], s.rate[pd + n] = rate, light
            s.rate[STRAIN * WIDTH + n] = m[(RATE + GUIDE) * LANES + n]


@compiled
def fill_rows(m: FloatArray) -> None:
    """Fill the rows that do not change, unless the mass grows."""
    for n in range(WIDTH):
        m[LIGHTER * LANES + n] = 1.0
        m[COMPLIANCE * LANES + n] = 1.0 / at(m, BELT_K, n)


@compiled
def _lighter(m: FloatArray) -> None:
    """Evaluate how much lighter than at this height the axes are at the bed."""
    for n in range(WIDTH):
        m[LIGHTER * LANES + n] = 1.0 / (1.0 + at(m, GROWTH, n) * at(m, NOW + Q + 2, n % LANES))


@compiled
def _by_place(m: FloatArray) -> None:
    """Evaluate what x adds to ω² of each axis' highest mode."""
    for n in range(WIDTH):
        x = at(m, NOW + Q, n % LANES) - at(m, BY_X_CENTRE, n % LANES)
        m[STIFFER * LANES + n] = max((at(m, BY_X, n) + at(m, BY_X_SQUARED, n) * x) * x, LEAST_STIFFER)


@compiled
def _reactions(m: FloatArray, s: AxesState) -> None:
    """Move frame and gantry, and subtract their effect on the modes: PULL, one acceleration per axis."""
    for n in range(WIDTH):
        m[PULL * LANES + n] = 0.0
    for l in range(LANES):
        for j in range(2):
            d, dd = s.now[SWAY * WIDTH + j * LANES + l], s.now[SWAY_RATE * WIDTH + j * LANES + l]
            along, across = at(m, DIRECTIONS + 2 * j, l), at(m, DIRECTIONS + 2 * j + 1, l)
            force = along * at(m, F0, l) + across * at(m, F0 + 1, l)
            sway = -at(m, FRAME_K, l) * d - at(m, FRAME_B, l) * dd - at(m, FRAME, l) * force
            s.rate[SWAY * WIDTH + j * LANES + l], s.rate[SWAY_RATE * WIDTH + j * LANES + l] = dd, sway
            m[PULL * LANES + l] += along * sway
            m[(PULL + 1) * LANES + l] += across * sway
        inertia = at(m, YAW_INERTIA, l)
        if inertia > 0.0:
            x, share = at(m, NOW + Q, l) - at(m, YAW_CENTRE, l), at(m, YAW_SHARE, l)
            yaw, rate = s.now[YAW * WIDTH + l], s.now[YAW * WIDTH + LANES + l]
            torque = -inertia * (at(m, YAW_K, l) * yaw + at(m, YAW_B, l) * rate) - x * at(m, RATE + QD + 1, l)
            torque += at(m, YAW_ARM, l) * at(m, RATE + QD, l)
            turn = torque / (inertia + (1.0 - share) * x * x)
            s.rate[YAW * WIDTH + l], s.rate[YAW * WIDTH + LANES + l] = rate, turn
            m[(PULL + 1) * LANES + l] += share * x * turn
    for i in range(len(s.modes)):
        for n in range(WIDTH):
            s.rate[(FIRST + 2 * i + 1) * WIDTH + n] -= s.modes[i, SHARE, n] * m[PULL * LANES + n]


@compiled
def _motion(m: FloatArray, s: AxesState) -> None:
    """Evaluate every axis and the nozzle: Q and X seen from the frame, ACC from the ground."""
    for n in range(WIDTH):
        m[X * LANES + n] = m[XD * LANES + n] = 0.0
        m[(RATE + QD) * LANES + n] = m[ACC * LANES + n] - (m[PULL * LANES + n] if s.swaying else 0.0)
    for i in range(len(s.modes)):
        for n in range(WIDTH):
            m[X * LANES + n] += s.now[(FIRST + 2 * i) * WIDTH + n]
            m[XD * LANES + n] += s.now[(FIRST + 2 * i + 1) * WIDTH + n]
    for n in range(WIDTH):
        m[(NOW + Q) * LANES + n], m[(NOW + QD) * LANES + n] = m[X * LANES + n], m[XD * LANES + n]


@compiled
def _yawed(m: FloatArray, s: AxesState) -> None:
    """Add the nozzle's motion along y from the gantry's yaw."""
    for l in range(LANES):
        if at(m, YAW_INERTIA, l) > 0.0:
            x, xd = at(m, X, l) - at(m, YAW_CENTRE, l), at(m, XD, l)
            yaw, rate = s.now[YAW * WIDTH + l], s.now[YAW * WIDTH + LANES + l]
            m[(X + 1) * LANES + l] += x * yaw
            m[(XD + 1) * LANES + l] += x * rate + xd * yaw
            turn = s.rate[YAW * WIDTH + LANES + l]
            swung = x * turn + 2.0 * xd * rate + at(m, RATE + QD, l) * yaw
            # the share of its own reaction is in the axis' acceleration seen from the frame
            m[(ACC + 1) * LANES + l] += swung - at(m, YAW_SHARE, l) * (at(m, NOW + Q, l) - at(m, YAW_CENTRE, l)) * turn
