"""Friction of guides and joints. To add a force on a guide, change only `guide_force` here."""

from __future__ import annotations

import math

from models.arrays import FloatArray
from models.printer.kernels import record as r
from models.printer.kernels.record import LANES, NO, YES, ActiveEffects
from models.printer.kernels.vectors import add, at, compiled, dot, inlined, power, put, scale, tanh, vector

MOST_STRAIN = 3.0  # φ_m
RELAXED = 1.6  # largest |q̇|/s₀ x step: there a Runge-Kutta step damps most


@inlined
def strain_rate(hold: float, ratio: float, speed: float, strain: float) -> float:
    """Return φ̇ along one direction, with `hold` = κ, `ratio` = r along it and `speed` = |r|."""
    return hold * (ratio - (speed / MOST_STRAIN + speed * speed) * strain) / (1.0 + speed * speed)


@inlined
def bristle_rate(bristles: float, most: float, rate: float, state: float) -> float:
    """Return ż of bristles that bend over 1/`bristles`, at `most` so often a second."""
    bending = min(max(rate * bristles, -most), most)
    return bending - abs(bending) * state


@inlined
def sliding_level(dry: float, sticking: float, power: float) -> float:
    """Return ℓ with its Stribeck part, `power` = |q̇/v_s|^δ; e to the −2x is (1 − tanh x)/(1 + tanh x)."""
    faded = tanh(0.5 * power)
    return dry + sticking * (1.0 - faded) / (1.0 + faded)


@inlined
def guide_force(m: FloatArray, n: int, rate: float, state: float, sticking: bool, powers: bool) -> tuple[float, float]:
    """Return the force of a guide and the rate of its state: how far bristles are bent, or the strain."""
    level = at(m, r.dry, n)
    if sticking:
        squared = (rate * at(m, r.fading, n)) ** 2
        faded = power(squared, at(m, r.fading_power, n)) if powers else squared
        level = sliding_level(level, at(m, r.sticking, n), faded)
    ratio, bristles = rate / at(m, r.creep, n), at(m, r.bristles, n)
    bending = bristle_rate(bristles, at(m, r.bending, n), rate, state)
    straining = strain_rate(at(m, r.hold, n), ratio, abs(ratio), state)
    bent = bristles > 0.0
    return level * (state if bent else tanh(ratio + state)), bending if bent else straining


@compiled
def guide_friction(m: FloatArray, has: ActiveEffects) -> None:
    """Evaluate the friction on the carriages, positive when they move up, and the rate of its state."""
    if has.powers:
        _guides(m, YES, YES)
    elif has.sticking:
        _guides(m, YES, NO)
    else:
        _guides(m, NO, NO)


@inlined
def _guides(m: FloatArray, sticking: bool, powers: bool) -> None:
    for n in range(3 * LANES):
        rate, state = at(m, r.NOW + r.QD, n), at(m, r.NOW + r.GUIDE, n)
        force = guide_force(m, n, rate, state, sticking, powers)
        m[r.GUIDES * LANES + n], m[(r.RATE + r.GUIDE) * LANES + n] = force


@compiled
def joint_friction(m: FloatArray) -> None:
    """Evaluate the friction on the nozzle holder, along its motion, and the rate of its strain."""
    for l in range(LANES):
        strain, hold = vector(m, r.NOW + r.JOINT, l), at(m, r.joint_hold, l)
        ratio = scale(1.0 / at(m, r.joint_creep, l), vector(m, r.XD, l))
        along, speed = add(ratio, strain), math.sqrt(dot(ratio, ratio))
        size = math.sqrt(dot(along, along))
        put(m, r.JOINTS, l, scale(at(m, r.joint_dry, l) * tanh(size) / max(size, 1e-300), along))
        for a in range(3):
            m[(r.RATE + r.JOINT + a) * LANES + l] = strain_rate(hold, ratio[a], speed, strain[a])
