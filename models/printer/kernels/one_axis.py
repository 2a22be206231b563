"""Integrate one axis in time: one mass, or two with a coupling between them (`models/vibration/driven_axis.py`).

    m q̈ = F + F₀ − b q̇ − R(q, q̇) − D + (S_c(q_l − q) + c ẇ)          D = S(q − u) + c_d (q̇ − u̇),  ẇ = q̇_l − q̇
    M q̈_l = −S_c(q_l − q) − c ẇ                                      without a load neither S_c nor c

Force input: F is the delayed input, and u = 0. Position input: u is the delayed input with a ripple, and F is only the
known extra force. The drive's limit bounds F, or D. R is all resistance: the friction of the printers' guides
(`friction.py`), bristles in addition to dry friction, friction by direction or by the drive's force, drag, forces that
repeat along the axis, a spring, a pendulum. S is the drive and S_c the coupling, by the law of the printers' belts
(`motors.py`). One of them may have backlash, and one may harden:
by default S_c if there is a load. SI units; of an axis that turns, rad for m and N m for N.

It has its own integrator because the motion restarts at every shot, the input may be a force (linear between samples,
or held), and simulations come one at a time: lanes of eight printers with three motors would compute 24 axes for one.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.friction import bristle_rate, sliding_level, strain_rate
from models.printer.kernels.motors import belt_force, ripple
from models.printer.kernels.vectors import compiled, inlined, plus

# The parameters of one axis by itself: those of its model, those that printers have too, and its own.
AXIS_PARAMETERS = (
    *("mass", "stiffness", "damping", "offset", "load", "coupling", "coupling_damping", "by_force"),
    *("drive_damping", "drive_limit"),  # N s/m, across the drive's spring; N, of the drive
    *("dry", "sticking", "fading", "fading_power", "creep", "hold", "half_backlash", "landing", "cubic", "quintic"),
    *("ripple", "wave", "phase", "second_sine", "second_cosine", "delay"),
    "ground",  # N/m, ground_spring
    "drag",  # N s²/m², quadratic_drag
    *("weight_moment", "weight_angle"),  # N, m, pendulum_gravity
    *("load_share", "held_share"),  # friction_by_load
    "by_direction",  # N s/m, friction_by_direction
    *("bristle_force", "presliding"),  # N, m, bristle_friction
    *("play_at_drive", "hardens_at_drive"),  # 1: it is the drive of an axis with a load that has play, or hardens
)


def _places(*names: str) -> list[int]:
    return [AXIS_PARAMETERS.index(name) for name in names]


MASS, STIFFNESS, DAMPING, OFFSET, LOAD = _places("mass", "stiffness", "damping", "offset", "load")
COUPLING, COUPLING_DAMPING, BY_FORCE = _places("coupling", "coupling_damping", "by_force")
DRIVE_DAMPING, DRIVE_LIMIT = _places("drive_damping", "drive_limit")
DRY, STICKING, FADING, FADING_POWER = _places("dry", "sticking", "fading", "fading_power")
CREEP, HOLD, BRISTLE_FORCE, PRESLIDING = _places("creep", "hold", "bristle_force", "presliding")
HALF_BACKLASH, LANDING, PLAY_AT_DRIVE = _places("half_backlash", "landing", "play_at_drive")
CUBIC, QUINTIC, HARDENS_AT_DRIVE = _places("cubic", "quintic", "hardens_at_drive")
RIPPLE, WAVE, PHASE, DELAY = _places("ripple", "wave", "phase", "delay")
SECOND_SINE, SECOND_COSINE = _places("second_sine", "second_cosine")
GROUND, DRAG, WEIGHT_MOMENT, WEIGHT_ANGLE = _places("ground", "drag", "weight_moment", "weight_angle")
LOAD_SHARE, HELD_SHARE, BY_DIRECTION = _places("load_share", "held_share", "by_direction")
Q, V, Q_LOAD, V_LOAD, STRAIN, BENT = range(6)
State: TypeAlias = tuple[float, float, float, float, float, float]  # in this order


@inlined
def _spring(stretch: float, rate: float, k: float, c: float, play: bool, hardens: bool, p: FloatArray) -> float:
    """Return the force of a spring and its damper; it may be the one that has play, or hardens."""
    s, landing = stretch, 0.0
    if play:
        half = p[HALF_BACKLASH]
        if half > 0.0 and abs(stretch) < half:
            return 0.0
        s, landing = stretch - math.copysign(half, stretch), p[LANDING]
    cubic, quintic = (p[CUBIC], p[QUINTIC]) if hardens else (0.0, 0.0)
    return belt_force(k, c, s, s, rate, landing, cubic, quintic)


@inlined
def _resistance(
    q: float, v: float, strain: float, bent: float, drive: float, p: FloatArray, ripples: FloatArray
) -> tuple[float, float, float]:
    """Return what resists where the drive gives so much force, and the rates of strain and bristles."""
    held = p[GROUND] * q + p[WEIGHT_MOMENT] * math.sin(q - p[WEIGHT_ANGLE])
    force = p[DAMPING] * v + 0.5 * p[BY_DIRECTION] * abs(v) + p[DRAG] * v * abs(v) + held
    strained = bending = 0.0
    if p[DRY] + p[STICKING] + p[LOAD_SHARE] > 0.0:
        ratio = v / p[CREEP]
        level = p[DRY]
        if p[STICKING] > 0.0:
            level = sliding_level(p[DRY], p[STICKING], ((v * p[FADING]) ** 2) ** p[FADING_POWER])
        level += p[LOAD_SHARE] * (abs(drive) + p[HELD_SHARE] * abs(held))
        force += level * math.tanh(ratio + strain)
        strained = strain_rate(p[HOLD], ratio, abs(ratio), strain)
    if p[BRISTLE_FORCE] > 0.0:
        force += p[BRISTLE_FORCE] * bent
        bending = bristle_rate(1.0 / p[PRESLIDING], 0.0, v, bent)
    for i in range(len(ripples)):
        force += ripples[i, 0] * math.sin(ripples[i, 2] * q) + ripples[i, 1] * math.cos(ripples[i, 2] * q)
    return force, strained, bending


@inlined
def _drive(q: float, v: float, value: float, value_rate: float, p: FloatArray) -> tuple[float, float]:
    """Return the drive's force at an input and its rate, and that of a spring to the ground where a force drives."""
    by_force = p[BY_FORCE] != 0.0
    u, u_rate, spring = (0.0, 0.0, 0.0) if by_force else (value, value_rate, 0.0)
    if p[RIPPLE] != 0.0:
        wave = ripple(p[RIPPLE], p[WAVE], p[PHASE], p[SECOND_SINE], p[SECOND_COSINE], u, u_rate)
        u, u_rate = u + wave[0], u_rate + wave[1]
    if p[STIFFNESS] > 0.0:
        loaded = p[LOAD] > 0.0
        play, hardens = not loaded or p[PLAY_AT_DRIVE] > 0.5, not loaded or p[HARDENS_AT_DRIVE] > 0.5
        spring = _spring(u - q, u_rate - v, p[STIFFNESS], p[DRIVE_DAMPING], play, hardens, p)
    force = min(max(value if by_force else spring, -p[DRIVE_LIMIT]), p[DRIVE_LIMIT])
    return force, spring if by_force else 0.0


@inlined
def _rates(x: State, value: float, value_rate: float, extra: float, p: FloatArray, ripples: FloatArray) -> State:
    """Return the state's rate under an input, its rate, and a known extra force."""
    q, v, q_load, v_load, strain, bent = x
    drive, spring = _drive(q, v, value, value_rate, p)
    resistance, strained, bending = _resistance(q, v, strain, bent, drive, p, ripples)
    total = drive + spring + extra + p[OFFSET] - resistance
    loaded = p[LOAD] > 0.0
    if not loaded:
        return v, total / p[MASS], 0.0, 0.0, strained, bending
    play, hardens = p[PLAY_AT_DRIVE] <= 0.5, p[HARDENS_AT_DRIVE] <= 0.5
    pull = _spring(q_load - q, v_load - v, p[COUPLING], p[COUPLING_DAMPING], play, hardens, p)
    return v, (total + pull) / p[MASS], v_load, -pull / p[LOAD], strained, bending


@inlined
def _input(samples: FloatArray, slope: FloatArray, at: float) -> tuple[float, float]:
    """Return the input at so many samples after the first, and its rate by sample.

    It is straight between samples, or, where their slopes are known, a cubic.
    """
    i = min(max(math.floor(at), 0), len(samples) - 2)
    step, s, inside = samples[i + 1] - samples[i], min(max(at - i, 0.0), 1.0), 0.0 <= at <= len(samples) - 1
    if len(slope) == 0:
        return samples[i] + s * step, step if inside else 0.0
    bend, twist = 3.0 * step - 2.0 * slope[i] - slope[i + 1], slope[i] + slope[i + 1] - 2.0 * step
    value = samples[i] + s * (slope[i] + s * (bend + s * twist))
    return value, slope[i] + s * (2.0 * bend + 3.0 * s * twist) if inside else 0.0


ROUNDING = 1e-9  # of a sample


class AxisInput(NamedTuple):
    """What drives an axis, n samples."""

    samples: FloatArray  # (n,) N or m
    slope: FloatArray  # (n,) its rate by sample, where it is a cubic between samples; (0,) where it is straight
    extra: FloatArray  # (n,) N, known extra force; (0,): none
    dt: float  # s
    held: bool  # from each sample to the next, instead of straight


@inlined
def _driven_by(inputs: AxisInput, at: float, begun: float, p: FloatArray) -> tuple[float, float]:
    """Return the input so many samples after the first, and its rate by sample, in a step that began there."""
    late = p[DELAY] / inputs.dt
    if inputs.held:
        return inputs.samples[min(max(math.floor(begun - late + ROUNDING), 0), len(inputs.samples) - 1)], 0.0
    return _input(inputs.samples, inputs.slope, at - late)


@inlined
def _until_jump(inputs: AxisInput, at: float, p: FloatArray) -> float:
    """Return for how many samples an input stays smooth; a held one jumps at each, after its delay."""
    since = at - p[DELAY] / inputs.dt + ROUNDING
    return 1.0 - (since - math.floor(since)) + ROUNDING if inputs.held else math.inf


@inlined
def _rate_at(x: State, at: float, begun: float, inputs: AxisInput, p: FloatArray, ripples: FloatArray) -> State:
    """Return the state's rate so many samples after the first, in a step that began there."""
    value, step = _driven_by(inputs, at, begun, p)
    extra = 0.0 if len(inputs.extra) == 0 else _input(inputs.extra, inputs.extra[:0], at)[0]
    return _rates(x, value, step / inputs.dt, extra, p, ripples)


@inlined
def _step(x: State, first: State, at: float, h: float, inputs: AxisInput, p: FloatArray, ripples: FloatArray) -> State:
    """Step by the classical Runge-Kutta method from x, whose rate is `first`, so many samples after the first."""
    middle = at + 0.5 * h / inputs.dt
    second = _rate_at(plus(0.5 * h, first, x), middle, at, inputs, p, ripples)
    third = _rate_at(plus(0.5 * h, second, x), middle, at, inputs, p, ripples)
    last = _rate_at(plus(h, third, x), at + h / inputs.dt, at, inputs, p, ripples)
    end: State = plus(h / 6.0, plus(1.0, last, plus(2.0, third, plus(2.0, second, first))), x)
    return end


@inlined
def _begin(x: State, at: FloatArray, drive: float, p: FloatArray) -> State:
    """Set places and speeds; of a mass whose place is not known, as far from the other as the coupling is stretched."""
    last, first = at[0] == at[0], at[2] == at[2]  # not NaN
    strain, bent = x[STRAIN], x[BENT]
    if p[LOAD] <= 0.0:
        q, v = (at[0], at[1]) if last else (at[2], at[3])
        return q, v, q, v, strain, bent
    q_load, v_load = (at[0], at[1]) if last else (at[2], at[3])
    q, v = (at[2], at[3]) if first else (at[0], at[1])
    if last and first:
        return q, v, q_load, v_load, strain, bent
    force = (drive if p[BY_FORCE] != 0.0 else p[STIFFNESS] * (drive - q)) - p[DAMPING] * v
    stretch = p[LOAD] / (p[LOAD] + p[MASS]) * force / p[COUPLING]
    if last:
        return q + stretch, v, q_load, v_load, strain, bent
    return q, v, q_load - stretch, v_load, strain, bent


@inlined
def _settled(state: float, at_rest: float, at_one: float, h: float) -> float:
    """Return a state after h whose rate is linear in it: `at_rest` where it is zero, `at_one` where it is one."""
    decay = at_rest - at_one
    return state + h * at_rest if decay <= 0.0 else at_rest / decay + (state - at_rest / decay) * math.exp(-decay * h)


@inlined
def _remembered(x: State, v: float, h: float, p: FloatArray) -> State:
    """Return the state h later, of an axis that moves as measured, at v: its friction alone remembers."""
    strain, bent, ratio, bristles = x[STRAIN], x[BENT], v / p[CREEP], 1.0 / p[PRESLIDING]
    hold, speed = p[HOLD], abs(ratio)
    strain = _settled(strain, strain_rate(hold, ratio, speed, 0.0), strain_rate(hold, ratio, speed, 1.0), h)
    bent = _settled(bent, bristle_rate(bristles, 0.0, v, 0.0), bristle_rate(bristles, 0.0, v, 1.0), h)
    return x[Q], x[V], x[Q_LOAD], x[V_LOAD], strain, bent


@compiled
def integrate_axis(
    inputs: AxisInput, substeps: int, shot: int, begin: FloatArray, p: FloatArray, ripples: FloatArray
) -> FloatArray:
    """Integrate an axis whose motion restarts every `shot` samples.

    Parameters
    ----------
    shot : samples from one beginning to the next; n or more: there is one; 1: it moves as measured at every sample.
    begin : (shots, 4) m and m/s of the last mass and of the first one at each beginning, NaN where one
        is unknown; the friction's strain and bristles continue.
    p : in the order of `AXIS_PARAMETERS`.
    ripples : (k, 3) forces that repeat along the axis: of the sine and of the cosine, N, and rad/m.

    Returns
    -------
    (n, 6) position of the first mass and of the last one, m; the last one's acceleration, m/s², and speed, m/s; the
    drive's force, N; the first mass' acceleration, m/s².
    """
    n, x = len(inputs.samples), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    out, loaded = np.empty((n, 6)), p[LOAD] > 0.0
    for i in range(n):
        value, step = _driven_by(inputs, i, i, p)
        if i % shot == 0 and i // shot < len(begin):
            x = _begin(x, begin[i // shot], value, p)
        rate = _rate_at(x, i, i, inputs, p, ripples)
        out[i, 0] = x[Q]
        out[i, 1] = x[Q_LOAD] if loaded else x[Q]
        out[i, 2] = rate[V_LOAD] if loaded else rate[V]
        out[i, 3] = x[V_LOAD] if loaded else x[V]
        out[i, 4] = _drive(x[Q], x[V], value, step / inputs.dt, p)[0]
        out[i, 5] = rate[V]
        if shot == 1 and i < n - 1:
            x = _remembered(x, 0.5 * (begin[i, 3] + begin[i + 1, 3]), inputs.dt, p)
        for j in range(substeps if i < n - 1 and shot > 1 else 0):
            at, end = i + j / substeps, i + (j + 1) / substeps
            while end - at > ROUNDING:
                part = min(end - at, _until_jump(inputs, at, p))
                if at > i:
                    rate = _rate_at(x, at, at, inputs, p, ripples)
                x = _step(x, rate, at, part * inputs.dt, inputs, p, ripples)
                at += part
    return out
