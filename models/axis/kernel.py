"""Integrate one axis in time: one mass, or two with a coupling between them.

    m q̈ = F + F₀ − b q̇ − R(q, q̇) − S(q − u) + (S_c(q_l − q) + c ẇ)          ẇ = q̇_l − q̇
    M q̈_l = −S_c(q_l − q) − c ẇ                                             without a load neither S_c nor c

Force in: F is the input and u = 0. Position in: F = 0 and u is the input, its delay late, with a ripple. R holds all
that resists: dry friction as in `models/printer/kernels/friction.py`, bristles (P. Dahl, 1968), what depends on the
direction, drag, and a force that repeats along the axis. S is the spring, S_c the coupling; one of them may have play,
and one may harden: S_c if there is a load and nothing else is said. SI units.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numba import njit

from models.arrays import FloatArray

NAMES = (
    "mass",
    "stiffness",
    "damping",
    "offset",
    "load",
    "coupling",
    "coupling_damping",
    "by_force",
    "dry",
    "sticking",
    "fading",
    "fading_power",
    "creep",
    "hold",
    "half_backlash",
    "landing",
    "cubic",
    "quintic",
    "ripple",
    "wave",
    "phase",
    "second_sine",
    "second_cosine",
    "delay",
    "ground",
    "drag",
    "sine",
    "cosine",
    "force_wave",
    "by_direction",
    "bristle",
    "presliding",
    "play_at_drive",
    "bends_at_drive",
)
"""The entries of the parameters p, in order."""
MASS, STIFFNESS, DAMPING, OFFSET, LOAD, COUPLING, COUPLING_DAMPING, BY_FORCE = range(8)
DRY, STICKING, FADING, FADING_POWER, CREEP, HOLD, HALF_BACKLASH, LANDING, CUBIC, QUINTIC = range(8, 18)
RIPPLE, WAVE, PHASE, SECOND_SINE, SECOND_COSINE, DELAY, GROUND, DRAG = range(18, 26)
SINE, COSINE, FORCE_WAVE, BY_DIRECTION, BRISTLE, PRESLIDING, PLAY_AT_DRIVE, BENDS_AT_DRIVE = range(26, 34)
Q, V, Q_LOAD, V_LOAD, STRAIN, BENT = range(6)
State: TypeAlias = tuple[float, float, float, float, float, float]  # in this order
MOST_STRAIN = 3.0  # as of the printers' dry friction


def compiled(function: Any) -> Any:
    """Compile a kernel; the cache goes by this file, which holds all of them."""
    return njit(cache=True, error_model="numpy", nogil=True)(function)


# a call would pass the state through memory
inlined = njit(error_model="numpy", nogil=True, forceinline=True)


@inlined
def _spring(stretch: float, rate: float, k: float, c: float, play: bool, bends: bool, p: FloatArray) -> float:
    """Return the force of a spring and its damper; it may be the one that has play, or hardens."""
    force = c * rate
    s = stretch
    if play:
        half = p[HALF_BACKLASH]
        if half > 0.0 and abs(stretch) < half:
            return 0.0
        s = stretch - math.copysign(half, stretch)
        force += k * p[LANDING] * abs(s) * rate
    if bends:
        force += (p[CUBIC] + p[QUINTIC] * s * s) * s * s * s
    return force + k * s


@inlined
def _resistance(q: float, v: float, strain: float, bent: float, p: FloatArray) -> tuple[float, float, float]:
    """Return what resists, and the rates of strain and bristles."""
    held = p[DAMPING] * v + 0.5 * p[BY_DIRECTION] * abs(v) + p[DRAG] * v * abs(v) + p[GROUND] * q
    strain_rate = bent_rate = 0.0
    if p[DRY] + p[STICKING] > 0.0:
        ratio = v / p[CREEP]
        speed = abs(ratio)
        level = p[DRY]
        if p[STICKING] > 0.0:
            level += p[STICKING] * math.exp(-((abs(v) * p[FADING]) ** p[FADING_POWER]))
        held += level * math.tanh(ratio + strain)
        strain_rate = p[HOLD] * (ratio - (speed / MOST_STRAIN + speed * speed) * strain) / (1.0 + speed * speed)
    if p[BRISTLE] > 0.0:
        held += p[BRISTLE] * bent
        bent_rate = (v - abs(v) * bent) / p[PRESLIDING]
    if p[SINE] != 0.0 or p[COSINE] != 0.0:
        held += p[SINE] * math.sin(p[FORCE_WAVE] * q) + p[COSINE] * math.cos(p[FORCE_WAVE] * q)
    return held, strain_rate, bent_rate


@inlined
def _rates(x: State, given: float, given_rate: float, p: FloatArray) -> State:
    """Return the state's rate under an input and its rate."""
    q, v, q_load, v_load, strain, bent = x
    force, u, u_rate = (given, 0.0, 0.0) if p[BY_FORCE] != 0.0 else (0.0, given, given_rate)
    if p[RIPPLE] != 0.0:
        at = p[WAVE] * u + p[PHASE]
        ripple = math.sin(at) + p[SECOND_SINE] * math.sin(2 * at) + p[SECOND_COSINE] * math.cos(2 * at)
        u += p[RIPPLE] * ripple
    loaded = p[LOAD] > 0.0
    held, strain_rate, bent_rate = _resistance(q, v, strain, bent, p)
    total = force + p[OFFSET] - held
    if p[STIFFNESS] > 0.0:
        play, bends = not loaded or p[PLAY_AT_DRIVE] > 0.5, not loaded or p[BENDS_AT_DRIVE] > 0.5
        total -= _spring(q - u, v - u_rate, p[STIFFNESS], 0.0, play, bends, p)
    if not loaded:
        return v, total / p[MASS], 0.0, 0.0, strain_rate, bent_rate
    play, bends = p[PLAY_AT_DRIVE] <= 0.5, p[BENDS_AT_DRIVE] <= 0.5
    pull = _spring(q_load - q, v_load - v, p[COUPLING], p[COUPLING_DAMPING], play, bends, p)
    return v, (total + pull) / p[MASS], v_load, -pull / p[LOAD], strain_rate, bent_rate


@inlined
def _input(given: FloatArray, slope: FloatArray, at: float) -> tuple[float, float]:
    """Return the input at so many samples after the first, and its rate by sample.

    It is straight between samples, or, where their slopes are known, a cubic.
    """
    i = min(max(math.floor(at), 0), len(given) - 2)
    step, s, inside = given[i + 1] - given[i], min(max(at - i, 0.0), 1.0), 0.0 <= at <= len(given) - 1
    if len(slope) == 0:
        return given[i] + s * step, step if inside else 0.0
    bend, twist = 3.0 * step - 2.0 * slope[i] - slope[i + 1], slope[i] + slope[i + 1] - 2.0 * step
    value = given[i] + s * (slope[i] + s * (bend + s * twist))
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
    x: State, first: State, given: FloatArray, slope: FloatArray, at: float, dt: float, h: float, p: FloatArray
) -> State:
    """Step by the classical Runge-Kutta method from x, whose rate is `first`, so many samples after the first."""
    value, step = _input(given, slope, at + 0.5 * h / dt)
    second = _rates(_moved(x, 0.5 * h, first), value, step / dt, p)
    third = _rates(_moved(x, 0.5 * h, second), value, step / dt, p)
    value, step = _input(given, slope, at + h / dt)
    last = _rates(_moved(x, h, third), value, step / dt, p)
    mean = _moved(_moved(_moved(first, 2.0, second), 2.0, third), 1.0, last)
    return _moved(x, h / 6.0, mean)


@inlined
def _begin(x: State, at: FloatArray, given: float, p: FloatArray) -> State:
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
    force = (given if p[BY_FORCE] != 0.0 else p[STIFFNESS] * (given - q)) - p[DAMPING] * v
    stretch = p[LOAD] / (p[LOAD] + p[MASS]) * force / p[COUPLING]
    if last:
        return q + stretch, v, q_load, v_load, strain, bent
    return q, v, q_load - stretch, v_load, strain, bent


@compiled
def integrate_axis(
    given: FloatArray, slope: FloatArray, dt: float, substeps: int, shot: int, begin: FloatArray, p: FloatArray
) -> FloatArray:
    """Integrate an axis whose motion begins anew every so many samples.

    Parameters
    ----------
    given : (n,) N or m.
    slope : (n,) its rate by sample, where it is a cubic between samples; (0,) where it is straight.
    shot : samples from one beginning to the next; n or more: there is one.
    begin : (shots, 4) m and m/s of the last mass and of the first one at each beginning, NaN where nothing is known
        of one of them; what bends by friction goes on.
    p : (34,) in the order of `NAMES`.

    Returns
    -------
    (n, 3) position of the first mass and of the last one, m, and the last one's acceleration, m/s².
    """
    n, x = len(given), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    out, h, late, loaded = np.empty((n, 3)), dt / substeps, p[DELAY] / dt, p[LOAD] > 0.0
    for i in range(n):
        if i % shot == 0 and i // shot < len(begin):
            x = _begin(x, begin[i // shot], _input(given, slope, i - late)[0], p)
        value, step = _input(given, slope, i - late)
        rate = _rates(x, value, step / dt, p)
        out[i, 0] = x[Q]
        out[i, 1] = x[Q_LOAD] if loaded else x[Q]
        out[i, 2] = rate[V_LOAD] if loaded else rate[V]
        for j in range(substeps if i < n - 1 else 0):
            at = i + j / substeps - late
            if j > 0:
                value, step = _input(given, slope, at)
                rate = _rates(x, value, step / dt, p)
            x = _step(x, rate, given, slope, at, dt, h, p)
    return out
