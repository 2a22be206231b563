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
or held), the springs between the masses are not linear, and simulations come one at a time: lanes of eight printers
with three motors would compute 24 axes for one, which takes 1.5 to 3 times as long. The two agree to 1e-13 mm.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.friction import bristle_rate, sliding_level, strain_rate
from models.printer.kernels.motors import belt_force, effective, ripple
from models.printer.kernels.vectors import compiled, inlined, plus

NO_RIPPLES = np.empty((0, 3))


class AxisParameters(NamedTuple):
    """The parameters of one axis by itself, SI: those of its model, those that printers have too, and its own."""

    mass: float
    stiffness: float = 0.0
    damping: float = 0.0
    offset: float = 0.0
    load: float = 0.0
    coupling: float = 0.0
    coupling_damping: float = 0.0
    by_force: float = 0.0  # 1: the input is a force
    drive_damping: float = 0.0  # N s/m, across the drive's spring
    drive_limit: float = math.inf  # N, of the drive
    back_emf: float = 0.0  # N s/m, the part of `damping` that does not load the gear
    dry: float = 0.0
    sticking: float = 0.0
    fading: float = 0.0
    fading_power: float = 1.0
    creep: float = 1.0
    creep_per_n: float = 0.0  # m/(N s), least creep speed by the friction that the integration step requires
    hold: float = 0.0
    half_backlash: float = 0.0
    landing: float = 0.0
    cubic: float = 0.0
    quintic: float = 0.0
    peak_stretch: float = math.inf
    ripple: float = 0.0
    wave: float = 0.0
    phase: float = 0.0
    second_sine: float = 0.0
    second_cosine: float = 0.0
    delay: float = 0.0
    ground: float = 0.0  # N/m, ground_spring
    drag: float = 0.0  # N s²/m², quadratic_drag
    weight_moment: float = 0.0  # N, pendulum_gravity
    weight_angle: float = 0.0
    load_share: float = 0.0  # friction_by_load
    held_share: float = 0.0
    by_direction: float = 0.0  # N s/m, friction_by_direction
    bristle_force: float = 0.0  # N, bristle_friction
    presliding: float = 1.0  # m
    bending: float = math.inf  # 1/s, see `record.py`
    play_at_drive: float = 0.0  # 1: of an axis with a load, the drive has play; 0: the coupling
    hardens_at_drive: float = 0.0  # likewise
    ripples: FloatArray = NO_RIPPLES  # (k, 3) forces that repeat along it: N of the sine and the cosine, rad/m


Q, V, Q_LOAD, V_LOAD, STRAIN, BENT = range(6)
State: TypeAlias = tuple[float, float, float, float, float, float]  # in this order


@inlined
def _spring(stretch: float, rate: float, k: float, c: float, play: bool, hardens: bool, p: AxisParameters) -> float:
    """Return the force of a spring and its damper; it may be the one that has play, or hardens."""
    half, landing = (p.half_backlash, p.landing) if play else (0.0, 0.0)
    if abs(stretch) < half:
        return 0.0
    cubic, quintic, peak = (p.cubic, p.quintic, p.peak_stretch) if hardens else (0.0, 0.0, math.inf)
    s = effective(stretch, half, peak)
    return belt_force(k, c, s, s, rate, landing, cubic, quintic)


@inlined
def _resistance(
    q: float, v: float, strain: float, bent: float, drive: float, p: AxisParameters
) -> tuple[float, float, float]:
    """Return what resists where the drive gives so much force, and the rates of strain and bristles."""
    held = p.ground * q + p.weight_moment * math.sin(q - p.weight_angle)
    force = p.damping * v + 0.5 * p.by_direction * abs(v) + p.drag * v * abs(v) + held
    strained = bending = 0.0
    if p.dry + p.sticking + p.load_share > 0.0:
        level, creep = p.dry, p.creep
        if p.sticking > 0.0:
            level = sliding_level(p.dry, p.sticking, ((v * p.fading) ** 2) ** p.fading_power)
        if p.load_share > 0.0:
            level += p.load_share * (abs(drive - p.back_emf * v) + p.held_share * abs(held))
            creep = max(creep, p.creep_per_n * level)
        ratio = v / creep
        force += level * math.tanh(ratio + strain)
        strained = strain_rate(p.hold, ratio, abs(ratio), strain)
    if p.bristle_force > 0.0:
        force += p.bristle_force * bent
        bending = bristle_rate(1.0 / p.presliding, p.bending, v, bent)
    for i in range(len(p.ripples)):
        force += p.ripples[i, 0] * math.sin(p.ripples[i, 2] * q) + p.ripples[i, 1] * math.cos(p.ripples[i, 2] * q)
    return force, strained, bending


@inlined
def _drive(q: float, v: float, value: float, value_rate: float, p: AxisParameters) -> tuple[float, float]:
    """Return the drive's force at an input and its rate, and that of a spring to the ground where a force drives."""
    by_force = p.by_force != 0.0
    u, u_rate, spring = (0.0, 0.0, 0.0) if by_force else (value, value_rate, 0.0)
    if p.ripple != 0.0:
        wave = ripple(p.ripple, p.wave, p.phase, p.second_sine, p.second_cosine, u, u_rate)
        u, u_rate = u + wave[0], u_rate + wave[1]
    if p.stiffness > 0.0:
        loaded = p.load > 0.0
        play, hardens = not loaded or p.play_at_drive > 0.5, not loaded or p.hardens_at_drive > 0.5
        spring = _spring(u - q, u_rate - v, p.stiffness, p.drive_damping, play, hardens, p)
    force = min(max(value if by_force else spring, -p.drive_limit), p.drive_limit)
    return force, spring if by_force else 0.0


@inlined
def _rates(x: State, value: float, value_rate: float, extra: float, p: AxisParameters) -> State:
    """Return the state's rate under an input, its rate, and a known extra force."""
    q, v, q_load, v_load, strain, bent = x
    drive, spring = _drive(q, v, value, value_rate, p)
    resistance, strained, bending = _resistance(q, v, strain, bent, drive, p)
    total = drive + spring + extra + p.offset - resistance
    loaded = p.load > 0.0
    if not loaded:
        return v, total / p.mass, 0.0, 0.0, strained, bending
    play, hardens = p.play_at_drive <= 0.5, p.hardens_at_drive <= 0.5
    pull = _spring(q_load - q, v_load - v, p.coupling, p.coupling_damping, play, hardens, p)
    return v, (total + pull) / p.mass, v_load, -pull / p.load, strained, bending


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
def _driven_by(inputs: AxisInput, at: float, begun: float, p: AxisParameters) -> tuple[float, float]:
    """Return the input so many samples after the first, and its rate by sample, in a step that began there."""
    late = p.delay / inputs.dt
    if inputs.held:
        return inputs.samples[min(max(math.floor(begun - late + ROUNDING), 0), len(inputs.samples) - 1)], 0.0
    return _input(inputs.samples, inputs.slope, at - late)


@inlined
def _until_jump(inputs: AxisInput, at: float, p: AxisParameters) -> float:
    """Return for how many samples an input stays smooth; a held one jumps at each, after its delay."""
    since = at - p.delay / inputs.dt + ROUNDING
    return 1.0 - (since - math.floor(since)) + ROUNDING if inputs.held else math.inf


@inlined
def _rate_at(x: State, at: float, begun: float, inputs: AxisInput, p: AxisParameters) -> State:
    """Return the state's rate so many samples after the first, in a step that began there."""
    value, step = _driven_by(inputs, at, begun, p)
    extra = 0.0 if len(inputs.extra) == 0 else _input(inputs.extra, inputs.extra[:0], at)[0]
    return _rates(x, value, step / inputs.dt, extra, p)


@inlined
def _step(x: State, first: State, at: float, h: float, inputs: AxisInput, p: AxisParameters) -> State:
    """Step by the classical Runge-Kutta method from x, whose rate is `first`, so many samples after the first."""
    middle = at + 0.5 * h / inputs.dt
    second = _rate_at(plus(0.5 * h, first, x), middle, at, inputs, p)
    third = _rate_at(plus(0.5 * h, second, x), middle, at, inputs, p)
    last = _rate_at(plus(h, third, x), at + h / inputs.dt, at, inputs, p)
    end: State = plus(h / 6.0, plus(1.0, last, plus(2.0, third, plus(2.0, second, first))), x)
    return end


@inlined
def _begin(x: State, at: FloatArray, drive: float, p: AxisParameters) -> State:
    """Set places and speeds; of a mass whose place is not known, as far from the other as the coupling is stretched."""
    last, first = at[0] == at[0], at[2] == at[2]  # not NaN
    strain, bent = x[STRAIN], x[BENT]
    if p.load <= 0.0:
        q, v = (at[0], at[1]) if last else (at[2], at[3])
        return q, v, q, v, strain, bent
    q_load, v_load = (at[0], at[1]) if last else (at[2], at[3])
    q, v = (at[2], at[3]) if first else (at[0], at[1])
    if last and first:
        return q, v, q_load, v_load, strain, bent
    force = (drive if p.by_force != 0.0 else p.stiffness * (drive - q)) - p.damping * v
    stretch = p.load / (p.load + p.mass) * force / p.coupling
    if last:
        return q + stretch, v, q_load, v_load, strain, bent
    return q, v, q_load - stretch, v_load, strain, bent


@inlined
def _settled(state: float, at_rest: float, at_one: float, h: float) -> float:
    """Return a state after h whose rate is linear in it: `at_rest` where it is zero, `at_one` where it is one."""
    decay = at_rest - at_one
    return state + h * at_rest if decay <= 0.0 else at_rest / decay + (state - at_rest / decay) * math.exp(-decay * h)


@inlined
def _remembered(x: State, v: float, h: float, p: AxisParameters) -> State:
    """Return the state h later, of an axis that moves as measured, at v: its friction alone remembers."""
    strain, bent, ratio, bristles = x[STRAIN], x[BENT], v / p.creep, 1.0 / p.presliding
    hold, speed = p.hold, abs(ratio)
    strain = _settled(strain, strain_rate(hold, ratio, speed, 0.0), strain_rate(hold, ratio, speed, 1.0), h)
    bent = _settled(bent, bristle_rate(bristles, math.inf, v, 0.0), bristle_rate(bristles, math.inf, v, 1.0), h)
    return x[Q], x[V], x[Q_LOAD], x[V_LOAD], strain, bent


@compiled
def integrate_axis(inputs: AxisInput, substeps: int, shot: int, begin: FloatArray, p: AxisParameters) -> FloatArray:
    """Integrate an axis whose motion restarts every `shot` samples.

    Parameters
    ----------
    shot : samples from one beginning to the next; n or more: there is one; 1: it moves as measured at every sample.
    begin : (shots, 4) m and m/s of the last mass and of the first one at each beginning, NaN where one
        is unknown; the friction's strain and bristles continue.

    Returns
    -------
    (n, 6) position of the first mass and of the last one, m; the last one's acceleration, m/s², and speed, m/s; the
    drive's force, N; the first mass' acceleration, m/s².
    """
    n, x = len(inputs.samples), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    out, loaded = np.empty((n, 6)), p.load > 0.0
    for i in range(n):
        value, step = _driven_by(inputs, i, i, p)
        if i % shot == 0 and i // shot < len(begin):
            x = _begin(x, begin[i // shot], value, p)
        rate = _rate_at(x, i, i, inputs, p)
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
                    rate = _rate_at(x, at, at, inputs, p)
                x = _step(x, rate, at, part * inputs.dt, inputs, p)
                at += part
    return out
