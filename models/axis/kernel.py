"""Integrate one axis in time: one mass, or two with a coupling between them.

    m q̈ = F + F₀ − b q̇ − R(q, q̇) − S(q − u) + (S_c(q_l − q) + c ẇ)          ẇ = q̇_l − q̇
    M q̈_l = −S_c(q_l − q) − c ẇ                                             without a load neither S_c nor c

Force in: F is the input and u = 0. Position in: F = 0 and u is the input, its delay late, with a ripple. R holds all
that resists: dry friction as in `models/printer/kernels/friction.py`, bristles (P. Dahl, 1968), what depends on the
direction, drag, and a force that repeats along the axis. S is the spring, S_c the coupling; the one at the end, S_c if
there is a load, may have play and may harden. SI units.
"""

from __future__ import annotations

import math
from typing import Any

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
)
"""The entries of the parameters p, in order."""
MASS, STIFFNESS, DAMPING, OFFSET, LOAD, COUPLING, COUPLING_DAMPING, BY_FORCE = range(8)
DRY, STICKING, FADING, FADING_POWER, CREEP, HOLD, HALF_BACKLASH, LANDING, CUBIC, QUINTIC = range(8, 18)
RIPPLE, WAVE, PHASE, SECOND_SINE, SECOND_COSINE, DELAY, GROUND, DRAG = range(18, 26)
SINE, COSINE, FORCE_WAVE, BY_DIRECTION, BRISTLE, PRESLIDING = range(26, 32)
Q, V, Q_LOAD, V_LOAD, STRAIN, BENT = range(6)
STATES = 6
MOST_STRAIN = 3.0  # as of the printers' dry friction


def compiled(function: Any) -> Any:
    """Compile a kernel; the cache goes by this file, which holds all of them."""
    return njit(cache=True, error_model="numpy", nogil=True)(function)


@compiled
def _spring(stretch: float, rate: float, k: float, c: float, last: bool, p: FloatArray) -> float:
    """Return the force of a spring and its damper; the last spring of the axis may have play and may harden."""
    if not last:
        return k * stretch + c * rate
    half = p[HALF_BACKLASH]
    if half > 0.0 and abs(stretch) < half:
        return 0.0
    s = stretch - math.copysign(half, stretch)
    return k * (s + p[LANDING] * abs(s) * rate) + (p[CUBIC] + p[QUINTIC] * s * s) * s * s * s + c * rate


@compiled
def _resistance(x: FloatArray, p: FloatArray, rate: FloatArray) -> float:
    """Return what resists, and the rates of strain and bristles."""
    v = x[V]
    held = p[DAMPING] * v + 0.5 * p[BY_DIRECTION] * abs(v) + p[DRAG] * v * abs(v) + p[GROUND] * x[Q]
    rate[STRAIN] = rate[BENT] = 0.0
    if p[DRY] + p[STICKING] > 0.0:
        ratio = v / p[CREEP]
        speed = abs(ratio)
        level = p[DRY]
        if p[STICKING] > 0.0:
            level += p[STICKING] * math.exp(-((abs(v) * p[FADING]) ** p[FADING_POWER]))
        held += level * math.tanh(ratio + x[STRAIN])
        rate[STRAIN] = p[HOLD] * (ratio - (speed / MOST_STRAIN + speed * speed) * x[STRAIN]) / (1.0 + speed * speed)
    if p[BRISTLE] > 0.0:
        held += p[BRISTLE] * x[BENT]
        rate[BENT] = (v - abs(v) * x[BENT]) / p[PRESLIDING]
    if p[SINE] != 0.0 or p[COSINE] != 0.0:
        held += p[SINE] * math.sin(p[FORCE_WAVE] * x[Q]) + p[COSINE] * math.cos(p[FORCE_WAVE] * x[Q])
    return held


@compiled
def _rates(x: FloatArray, given: float, given_rate: float, p: FloatArray, rate: FloatArray) -> None:
    """Evaluate the state's rate under an input and its rate."""
    force, u, u_rate = (given, 0.0, 0.0) if p[BY_FORCE] != 0.0 else (0.0, given, given_rate)
    if p[RIPPLE] != 0.0:
        at = p[WAVE] * u + p[PHASE]
        ripple = math.sin(at) + p[SECOND_SINE] * math.sin(2 * at) + p[SECOND_COSINE] * math.cos(2 * at)
        u += p[RIPPLE] * ripple
    loaded = p[LOAD] > 0.0
    total = force + p[OFFSET] - _resistance(x, p, rate)
    if p[STIFFNESS] > 0.0:
        total -= _spring(x[Q] - u, x[V] - u_rate, p[STIFFNESS], 0.0, not loaded, p)
    rate[Q], rate[Q_LOAD], rate[V_LOAD] = x[V], 0.0, 0.0
    if loaded:
        pull = _spring(x[Q_LOAD] - x[Q], x[V_LOAD] - x[V], p[COUPLING], p[COUPLING_DAMPING], True, p)
        total += pull
        rate[Q_LOAD], rate[V_LOAD] = x[V_LOAD], -pull / p[LOAD]
    rate[V] = total / p[MASS]


@compiled
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


@compiled
def _step(
    x: FloatArray, given: FloatArray, slope: FloatArray, at: float, dt: float, h: float, p: FloatArray, k: FloatArray
) -> None:
    """Step by the classical Runge-Kutta method; k : (6, STATES) of working space."""
    late = p[DELAY] / dt
    for stage in range(4):
        share = (0.0, 0.5, 0.5, 1.0)[stage]
        value, step = _input(given, slope, at - late + share * h / dt)
        for n in range(STATES):
            k[5, n] = x[n] + (share * h * k[stage - 1, n] if stage > 0 else 0.0)
        _rates(k[5], value, step / dt, p, k[stage])
    for n in range(STATES):
        x[n] += h / 6.0 * (k[0, n] + 2.0 * k[1, n] + 2.0 * k[2, n] + k[3, n])


@compiled
def _begin(x: FloatArray, at: FloatArray, given: float, p: FloatArray) -> None:
    """Set places and speeds; of a mass whose place is not known, as far from the other as the coupling is stretched."""
    last, first = at[0] == at[0], at[2] == at[2]  # not NaN
    if p[LOAD] <= 0.0:
        x[Q], x[V] = (at[0], at[1]) if last else (at[2], at[3])
        x[Q_LOAD], x[V_LOAD] = x[Q], x[V]
        return
    x[Q_LOAD], x[V_LOAD] = (at[0], at[1]) if last else (at[2], at[3])
    x[Q], x[V] = (at[2], at[3]) if first else (at[0], at[1])
    if last and first:
        return
    force = (given if p[BY_FORCE] != 0.0 else p[STIFFNESS] * (given - x[Q])) - p[DAMPING] * x[V]
    stretch = p[LOAD] / (p[LOAD] + p[MASS]) * force / p[COUPLING]
    x[Q] += stretch if last else 0.0
    x[Q_LOAD] -= 0.0 if last else stretch


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
    p : (32,) in the order of `NAMES`.

    Returns
    -------
    (n, 3) position of the first mass and of the last one, m, and the last one's acceleration, m/s².
    """
    n, x, k = len(given), np.zeros(STATES), np.zeros((6, STATES))
    out, h = np.empty((n, 3)), dt / substeps
    for i in range(n):
        if i % shot == 0 and i // shot < len(begin):
            _begin(x, begin[i // shot], _input(given, slope, i - p[DELAY] / dt)[0], p)
        value, step = _input(given, slope, i - p[DELAY] / dt)
        _rates(x, value, step / dt, p, k[0])
        out[i, 0] = x[Q]
        out[i, 1] = x[Q_LOAD] if p[LOAD] > 0.0 else x[Q]
        out[i, 2] = k[0, V_LOAD] if p[LOAD] > 0.0 else k[0, V]
        for j in range(substeps if i < n - 1 else 0):
            _step(x, given, slope, i + j / substeps, dt, h, p, k)
    return out
