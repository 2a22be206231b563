"""Friction of guides and joints. To add a force on a guide, change only `guide_force` here."""

from __future__ import annotations

import math

from models.arrays import FloatArray
from models.printer.kernels.record import (
    GUIDE,
    GUIDES,
    JOINT,
    JOINTS,
    LANES,
    LEVEL,
    NOW,
    QD,
    RATE,
    THREE,
    XD,
    parameter_rows,
)
from models.printer.kernels.vectors import add, any_nonzero, at, compiled, dot, inlined, power, put, scale, tanh, vector

DRY, STICKING, FADING, FADING_POWER = parameter_rows("dry", "sticking", "fading", "fading_power")
CREEP, HOLD, BRISTLES, BRISTLE_LAG = parameter_rows("creep", "hold", "bristles", "bristle_lag")
JOINT_DRY, JOINT_CREEP, JOINT_HOLD = parameter_rows("joint_dry", "joint_creep", "joint_hold")

MOST_STRAIN = 3.0  # φ_m


@inlined
def strain_rate(hold: float, ratio: float, speed: float, strain: float) -> float:
    """Return φ̇ along one direction, with `hold` = κ, `ratio` = r along it and `speed` = |r|."""
    return hold * (ratio - (speed / MOST_STRAIN + speed * speed) * strain) / (1.0 + speed * speed)


@inlined
def bristle_rate(bristles: float, lag: float, rate: float, state: float) -> float:
    """Return ż of bristles that bend over 1/`bristles`, and follow at speed by `lag` later."""
    way = abs(rate) * bristles
    return (rate * bristles - way * state) / (1.0 + way * lag)


@inlined
def sliding_level(dry: float, sticking: float, power: float) -> float:
    """Return ℓ with its Stribeck part, `power` = |q̇/v_s|^δ; e to the −2x is (1 − tanh x)/(1 + tanh x)."""
    faded = tanh(0.5 * power)
    return dry + sticking * (1.0 - faded) / (1.0 + faded)


@compiled
def guides_rub(m: FloatArray) -> bool:
    """Whether there is a force on a guide, in any lane."""
    return any_nonzero(m, DRY, THREE) or any_nonzero(m, STICKING, THREE)


@inlined
def guide_force(m: FloatArray, n: int, level: float, rate: float, state: float) -> tuple[float, float]:
    """Return the force of a guide and the rate of its state: how far bristles are bent, or the strain."""
    ratio, bristles = rate / at(m, CREEP, n), at(m, BRISTLES, n)
    bending = bristle_rate(bristles, at(m, BRISTLE_LAG, n), rate, state)
    straining = strain_rate(at(m, HOLD, n), ratio, abs(ratio), state)
    bent = bristles > 0.0
    return level * (state if bent else tanh(ratio + state)), bending if bent else straining


@compiled
def stribeck(m: FloatArray) -> None:
    """Evaluate ℓ with its Stribeck part near rest, exp −|q̇/v_s|^δ."""
    uneven = has_powers(m)
    for n in range(3 * LANES):
        m[LEVEL * LANES + n] = (at(m, NOW + QD, n) * at(m, FADING, n)) ** 2
    if uneven:
        for n in range(3 * LANES):
            m[LEVEL * LANES + n] = power(at(m, LEVEL, n), at(m, FADING_POWER, n))
    for n in range(3 * LANES):
        m[LEVEL * LANES + n] = sliding_level(at(m, DRY, n), at(m, STICKING, n), at(m, LEVEL, n))


@compiled
def has_powers(m: FloatArray) -> bool:
    """Whether friction near rest fades otherwise than by the square of the speed, in any lane."""
    uneven = False
    for n in range(3 * LANES):
        uneven |= at(m, STICKING, n) != 0.0 and at(m, FADING_POWER, n) != 1.0
    return uneven


@compiled
def guide_friction(m: FloatArray) -> None:
    """Evaluate the friction on the carriages, positive when they move up, and the rate of its state."""
    for n in range(3 * LANES):
        force, rate = guide_force(m, n, at(m, LEVEL, n), at(m, NOW + QD, n), at(m, NOW + GUIDE, n))
        m[GUIDES * LANES + n] = force
        m[(RATE + GUIDE) * LANES + n] = rate


@compiled
def joint_friction(m: FloatArray) -> None:
    """Evaluate the friction on the nozzle holder, along its motion, and the rate of its strain."""
    for l in range(LANES):
        strain, hold = vector(m, NOW + JOINT, l), at(m, JOINT_HOLD, l)
        ratio = scale(1.0 / at(m, JOINT_CREEP, l), vector(m, XD, l))
        along, speed = add(ratio, strain), math.sqrt(dot(ratio, ratio))
        size = math.sqrt(dot(along, along))
        put(m, JOINTS, l, scale(at(m, JOINT_DRY, l) * tanh(size) / max(size, 1e-300), along))
        for a in range(3):
            m[(RATE + JOINT + a) * LANES + l] = strain_rate(hold, ratio[a], speed, strain[a])
