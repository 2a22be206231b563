"""Integrate one axis in time: one mass, or two with a coupling between them (`models/vibration/driven_axis.py`).

    m q̈ = F + F₀ − b q̇ − R(q, q̇) − S(q − u) + (S_c(q_l − q) + c ẇ)          ẇ = q̇_l − q̇
    M q̈_l = −S_c(q_l − q) − c ẇ                                             without a load neither S_c nor c

Force in: F is the input and u = 0. Position in: F = 0 and u is the input, its delay late, with a ripple. R holds all
that resists, by the laws of the printers' guides (`friction.py`), and what only an axis has: bristles beside dry
friction, what depends on the direction, drag, a force that repeats along the axis, a spring. S is the drive, S_c the
coupling, by the law of the printers' belts (`motors.py`); one of them may have play, and one may harden: S_c if there
is a load and nothing else is said. SI units.

It has an integrator of its own because its motion begins anew at every shot, its input may be a force that is straight
between samples, and one simulation at a time is asked for: lanes of eight printers with three motors each would compute
24 axes for one.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.friction import bristle_rate, sliding_level, strain_rate
from models.printer.kernels.motors import belt_force, ripple
from models.printer.kernels.record import AXIS_PARAMETERS
from models.printer.kernels.vectors import compiled, inlined

(MASS, STIFFNESS, DAMPING, OFFSET, LOAD, COUPLING, COUPLING_DAMPING, BY_FORCE) = range(8)
(DRY, STICKING, FADING, FADING_POWER, CREEP, HOLD, HALF_BACKLASH, LANDING, CUBIC, QUINTIC) = range(8, 18)
(RIPPLE, WAVE, PHASE, SECOND_SINE, SECOND_COSINE, DELAY, GROUND, DRAG) = range(18, 26)
(SINE, COSINE, FORCE_WAVE, BY_DIRECTION, BRISTLE_FORCE, PRESLIDING, PLAY_AT_DRIVE, HARDENS_AT_DRIVE) = range(26, 34)
assert len(AXIS_PARAMETERS) == 34
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
def _resistance(q: float, v: float, strain: float, bent: float, p: FloatArray) -> tuple[float, float, float]:
    """Return what resists, and the rates of strain and bristles."""
    force = p[DAMPING] * v + 0.5 * p[BY_DIRECTION] * abs(v) + p[DRAG] * v * abs(v) + p[GROUND] * q
    strained = bending = 0.0
    if p[DRY] + p[STICKING] > 0.0:
        ratio = v / p[CREEP]
        level = p[DRY]
        if p[STICKING] > 0.0:
            level = sliding_level(p[DRY], p[STICKING], ((v * p[FADING]) ** 2) ** p[FADING_POWER])
        force += level * math.tanh(ratio + strain)
        strained = strain_rate(p[HOLD], ratio, abs(ratio), strain)
    if p[BRISTLE_FORCE] > 0.0:
        force += p[BRISTLE_FORCE] * bent
        bending = bristle_rate(1.0 / p[PRESLIDING], 0.0, v, bent)
    if p[SINE] != 0.0 or p[COSINE] != 0.0:
        force += p[SINE] * math.sin(p[FORCE_WAVE] * q) + p[COSINE] * math.cos(p[FORCE_WAVE] * q)
    return force, strained, bending


@inlined
def _rates(x: State, drive: float, drive_rate: float, p: FloatArray) -> State:
    """Return the state's rate under an input and its rate."""
    q, v, q_load, v_load, strain, bent = x
    force, u, u_rate = (drive, 0.0, 0.0) if p[BY_FORCE] != 0.0 else (0.0, drive, drive_rate)
    if p[RIPPLE] != 0.0:
        wave = ripple(p[RIPPLE], p[WAVE], p[PHASE], p[SECOND_SINE], p[SECOND_COSINE], u, u_rate)
        u, u_rate = u + wave[0], u_rate + wave[1]
    loaded = p[LOAD] > 0.0
    resistance, strained, bending = _resistance(q, v, strain, bent, p)
    total = force + p[OFFSET] - resistance
    if p[STIFFNESS] > 0.0:
        play, hardens = not loaded or p[PLAY_AT_DRIVE] > 0.5, not loaded or p[HARDENS_AT_DRIVE] > 0.5
        total -= _spring(q - u, v - u_rate, p[STIFFNESS], 0.0, play, hardens, p)
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


@inlined
def _moved(x: State, h: float, k: State) -> State:
    """Return x + h k."""
    return (
        x[0] + h * k[0],
        x[1] + h * k[1],
        x[2] + h * k[2],
        x[3] + h * k[3],
        x[4] + h * k[4],
        x[5] + h * k[5],
    )


@inlined
def _step(
    x: State, first: State, samples: FloatArray, slope: FloatArray, at: float, dt: float, h: float, p: FloatArray
) -> State:
    """Step by the classical Runge-Kutta method from x, whose rate is `first`, so many samples after the first."""
    value, step = _input(samples, slope, at + 0.5 * h / dt)
    second = _rates(_moved(x, 0.5 * h, first), value, step / dt, p)
    third = _rates(_moved(x, 0.5 * h, second), value, step / dt, p)
    value, step = _input(samples, slope, at + h / dt)
    last = _rates(_moved(x, h, third), value, step / dt, p)
    mean = _moved(_moved(_moved(first, 2.0, second), 2.0, third), 1.0, last)
    return _moved(x, h / 6.0, mean)


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


@compiled
def integrate_axis(
    samples: FloatArray, slope: FloatArray, dt: float, substeps: int, shot: int, begin: FloatArray, p: FloatArray
) -> FloatArray:
    """Integrate an axis whose motion begins anew every so many samples.

    Parameters
    ----------
    samples : (n,) the input, N or m.
    slope : (n,) its rate by sample, where it is a cubic between samples; (0,) where it is straight.
    shot : samples from one beginning to the next; n or more: there is one.
    begin : (shots, 4) m and m/s of the last mass and of the first one at each beginning, NaN where nothing is known
        of one of them; what bends by friction goes on.
    p : in the order of `AXIS_PARAMETERS`.

    Returns
    -------
    (n, 3) position of the first mass and of the last one, m, and the last one's acceleration, m/s².
    """
    n, x = len(samples), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    out, h, late, loaded = np.empty((n, 3)), dt / substeps, p[DELAY] / dt, p[LOAD] > 0.0
    for i in range(n):
        if i % shot == 0 and i // shot < len(begin):
            x = _begin(x, begin[i // shot], _input(samples, slope, i - late)[0], p)
        value, step = _input(samples, slope, i - late)
        rate = _rates(x, value, step / dt, p)
        out[i, 0] = x[Q]
        out[i, 1] = x[Q_LOAD] if loaded else x[Q]
        out[i, 2] = rate[V_LOAD] if loaded else rate[V]
        for j in range(substeps if i < n - 1 else 0):
            at = i + j / substeps - late
            if j > 0:
                value, step = _input(samples, slope, at)
                rate = _rates(x, value, step / dt, p)
            x = _step(x, rate, samples, slope, at, dt, h, p)
    return out
