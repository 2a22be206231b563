"""An axis that a force drives, by itself or inside its servo: one mass, or two with a coupling between them.

    m₁ q̈ = F − guide − g q̇ − what else resists − pull,   m₂ p̈ = pull + (what hangs on the end)

The coupling is a belt whose motor is the first mass (`shapes`); where there is none, all is on the first mass.
F is what the servo's drive makes of its order: a first-order lag of the current, then whatever is hidden there. The
servo works at its own pace on an encoder that counts: proportional, integral, a filtered derivative, and the path's
acceleration fed forward. Classical Runge-Kutta, bristles by an exponential step of their own. SI.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit

from validation.plants.shapes import DAHL, belt, bent, guide, record_of
from validation.plants.straight_plant import NEUTRAL, PRINTER, SLIDES_M_PER_S, Array

Q, V, END, ENDV, CABLE, CABLEV, LOOSE, STATES = 0, 1, 2, 3, 4, 5, 6, 7
TURNS_M_PER_S = 2e-3  # below which a direction is not quite one
ONE = (
    "offset drag direction hose hose_at tooth tooth_wave tooth_phase tooth_second delay delay_pace delay_phase fade "
    "fade_s limit commute commute_wave commute_phase bump bump_at bump_wide spin spin_wave weight weight_wave "
    "weight_at load"
)
LOOP = "stiff damp slow ahead filter_s lag_s pace_s count_m"
# its own numbers first: a record that began as a printer's would pass for one in what is compiled, with a warning
AXIS = np.dtype([*((name, "f8") for name in ONE.split()), *PRINTER.descr])
SERVO = np.dtype([(name, "f8") for name in LOOP.split()])
AT_REST: Mapping[str, Any] = {**NEUTRAL, "hose_at": 1.0, "fade_s": 1.0, "bump_wide": 1.0}


def axis_of(machine: Mapping[str, Any], hidden: Mapping[str, Any]) -> Any:
    """Return the numbers of an axis, with fields of AXIS set by what is hidden."""
    return record_of(AXIS, {**AT_REST, **machine["plant"], **hidden})


def servo_of(machine: Mapping[str, Any]) -> Any:
    """Return the numbers of its servo."""
    return record_of(SERVO, {name: machine["servo"][name] for name in LOOP.split()})


@njit(cache=True, error_model="numpy")
def _acts(force: float, q: float, t: float, p: Any) -> float:
    """Return what the drive makes of a force, N: it may end, fade while it works, or ripple along the magnets."""
    if p.limit > 0.0:
        force = p.limit * np.tanh(force / p.limit)
    if p.fade != 0.0:
        force *= 1.0 - p.fade * (1.0 - np.exp(-t / p.fade_s))
    if p.commute != 0.0:
        force *= 1.0 + p.commute * np.sin(p.commute_wave * q + p.commute_phase)
    if p.spin != 0.0:
        force += p.spin * np.sin(p.spin_wave * t)
    return force


@njit(cache=True, error_model="numpy")
def _resists(q: float, v: float, z: float, acts: float, p: Any) -> float:
    """Return all that resists the first mass but the coupling, N."""
    held = guide(v, q, z, 0, p) + p.ground[0] * v + p.drag * v * abs(v)
    if p.load != 0.0:
        held += p.load * abs(acts) * np.tanh(v / TURNS_M_PER_S)
    if p.weight != 0.0:
        held += p.weight * np.sin(p.weight_wave * q - p.weight_at)
    if p.direction != 0.0:
        held += 0.5 * p.direction * v * np.tanh(v / TURNS_M_PER_S)
    if p.hose != 0.0:
        held += p.hose * q * (1.0 + (q / p.hose_at) ** 2)
    if p.tooth != 0.0:
        at = p.tooth_wave * q + p.tooth_phase
        held += p.tooth * (np.sin(at) + p.tooth_second * np.sin(2.0 * at))
    if p.bump != 0.0:
        held += p.bump * np.exp(-(((q - p.bump_at) / p.bump_wide) ** 2)) * np.tanh(v / TURNS_M_PER_S)
    return held


@njit(cache=True, error_model="numpy")
def _rate(y: Array, z: float, t: float, force: float, p: Any, dy: Array) -> None:
    """Dy = d(state)/dt. z : the bristle of the guide."""
    acts = _acts(force, y[Q], t, p)
    first = acts + p.offset - _resists(y[Q], y[V], z, acts, p)
    two = p.tool[0] > 0.0
    last = ENDV if two else V
    grip = 0.0
    if p.loose[0] > 0.0:
        grip = p.loose_grip * np.tanh((y[last] - y[LOOSE]) / SLIDES_M_PER_S)
    dy[LOOSE] = grip
    hang = p.cable_k * y[CABLE] + p.cable_b * y[CABLEV] - p.loose[0] * grip
    dy[Q], dy[END] = y[V], y[ENDV]
    if two:
        pull = belt(y[Q] - y[END], y[V] - y[ENDV], y[END], y[Q], 0.0, t, 0, p)
        dy[V] = (first - pull) / p.carriage[0]
        dy[ENDV] = (pull + hang) / (p.tool[0] - p.loose[0])
    else:
        dy[V] = (first + hang) / (p.carriage[0] - p.loose[0])
        dy[END], dy[ENDV] = dy[Q], dy[V]
    dy[CABLE] = y[CABLEV]
    dy[CABLEV] = -dy[last] - (p.cable_k * y[CABLE] + p.cable_b * y[CABLEV]) / p.cable_mass


@njit(cache=True, error_model="numpy")
def _late(forces: Array, t: float, h: float, p: Any) -> float:
    """Return the force that acts at a time, of those ordered until then."""
    delay = p.delay * (1.0 + 0.01 * np.sin(p.delay_pace * t + p.delay_phase))
    at = max((t - delay) / h, 0.0)
    i = min(int(at), len(forces) - 2)
    return forces[i] + (at - i) * (forces[i + 1] - forces[i])


@njit(cache=True, error_model="numpy")
def _step(y: Array, z: float, n: int, h: float, forces: Array, p: Any, k: Array) -> float:
    """Step the state once; returns where the bristle is then. k : (4, STATES), its first row the rate at y."""
    t, half, full = n * h, z, z
    speed = y[V] + h / 2 * k[0, V]
    if p.dry_kind >= DAHL:
        half, full = bent(z, speed, h / 2, 0, p), bent(z, speed, h, 0, p)
    middle = _late(forces, t + h / 2, h, p)
    _rate(y + h / 2 * k[0], half, t + h / 2, middle, p, k[1])
    _rate(y + h / 2 * k[1], half, t + h / 2, middle, p, k[2])
    _rate(y + h * k[2], full, t + h, _late(forces, t + h, h, p), p, k[3])
    y += h / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
    return full


@njit(cache=True, error_model="numpy")
def follow(path: Array, push: Array, noise: Array, h: float, every: int, p: Any, s: Any) -> Array:
    """Let the servo follow a path, (n,) m with accelerations (n,) m/s², from rest; noise : (n,) m, of its encoder.

    Returns (m, 4): m of the first mass and of the end, m/s² of the end, and N as the servo's current says.
    """
    steps, pace = len(path) - 1, max(round(s.pace_s / h), 1)
    out, forces = np.empty((steps // every + 1, 4)), np.zeros(steps + 2)
    y, z, k = np.zeros(STATES), 0.0, np.zeros((4, STATES))
    y[Q] = y[END] = path[0]
    order = total = falling = before = 0.0
    decay = 1.0 - np.exp(-pace * h / s.filter_s)
    lag = np.exp(-h / s.lag_s)
    for n in range(steps + 1):
        if n % pace == 0:
            told = np.round((y[Q] + noise[n]) / s.count_m) * s.count_m
            off = path[n] - told
            if n > 0:
                falling += decay * ((off - before) / (pace * h) - falling)
            before = off
            total += off * pace * h
            order = s.stiff * off + s.damp * falling + s.slow * total + s.ahead * push[n]
        forces[n + 1] = order + (forces[n] - order) * lag
        _rate(y, z, n * h, _late(forces, n * h, h, p), p, k[0])
        if n % every == 0:
            row = n // every
            out[row, 0], out[row, 1] = y[Q], y[END]
            out[row, 2], out[row, 3] = k[0, ENDV], forces[n]
        if n < steps:
            z = _step(y, z, n, h, forces, p, k)
    return out


@njit(cache=True, error_model="numpy")
def pushed(forces: Array, begin: Array, shot: int, h: float, p: Any) -> Array:
    """Push with known forces, (n,) N; the motion restarts every so many rows at `begin`, (n, 4) m and m/s.

    Returns (n, 3): m of the first mass and of the end, m/s² of the end.
    """
    out, y, z, k = np.empty((len(forces), 3)), np.zeros(STATES), 0.0, np.zeros((4, STATES))
    for n in range(len(forces)):
        if n % shot == 0:
            y[:4] = begin[n]
        _rate(y, z, n * h, _late(forces, n * h, h, p), p, k[0])
        out[n, 0], out[n, 1], out[n, 2] = y[Q], y[END], k[0, ENDV]
        if n + 1 < len(forces):
            z = _step(y, z, n, h, forces, p, k)
    return out
