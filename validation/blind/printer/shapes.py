"""How belts and guides of a hidden printer differ from the catalogue's, for printers of every kind.

Friction is a tanh, or bends before it slides in one of three ways: as Dahl's bristle, with a damping of its own (LuGre:
Canudas de Wit, Olsson, Åström & Lischinsky, 1995), or as a spring up to a break-away (Dupont, Hayward, Armstrong &
Altpeter, 2002), which over some µm is hard stiction. Play has soft flanks and a damped landing, a hardening belt has a
fifth power, a stepper's sine acts in series with its belt, a belt may be stiffer one way. SI; `p` is a record of
`numbers` with the fields of its kind of printer.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

SLIDING_LIMIT_M_PER_S = 0.8  # speed at which grease begins to shear thinner
TANH, DAHL, LUGRE, BREAKS = 1, 2, 3, 4  # kinds of dry friction
FINE = 0.1  # of a bristle's way: a step of one that breaks away


@njit(cache=True, error_model="numpy")
def soft_play(s: float, width: float, flank: float) -> tuple[float, float]:
    """Stretch beyond the play, and its slope: two soft ramps in place of two corners."""
    high, low = (s - width / 2) / flank, (-s - width / 2) / flank
    right = high if high > 30.0 else np.log1p(np.exp(high))
    left = low if low > 30.0 else np.log1p(np.exp(low))
    slope = 1.0 / (1.0 + np.exp(-min(max(high, -60.0), 60.0))) + 1.0 / (1.0 + np.exp(-min(max(low, -60.0), 60.0)))
    return flank * (right - left), slope


@njit(cache=True, error_model="numpy")
def stepper_force(s: float, k: float, peak_m: float, share: float) -> float:
    """K peak sin(θ), where the rotor's share of the stretch, peak share θ, and the belt's, (1 - share) F/k, add up."""
    theta = s / peak_m
    for _ in range(4):
        over = peak_m * (share * theta + (1.0 - share) * np.sin(theta)) - s
        theta -= over / (peak_m * max(share + (1.0 - share) * np.cos(theta), 0.05))
    return k * peak_m * np.sin(theta)


@njit(cache=True, error_model="numpy")
def belt(s: float, ds: float, q: float, ud: float, arm: float, t: float, i: int, p: Any) -> float:
    """Force of belt i on its carriage, N."""
    slope = 1.0
    rate = ds
    if p.play[i] > 0.0:
        s, slope = soft_play(s, p.play[i], p.flank)
    k = p.belt_k[i]
    if p.slope[i] != 0.0:
        k /= 1.0 - p.slope[i] * (q - p.slope_at[i])
    if p.warm_share != 0.0:
        k *= 1.0 - p.warm_share * (1.0 - np.exp(-t / p.warm_s))
    if p.pulley_share != 0.0:
        k *= 1.0 + p.pulley_share * np.sin(p.pulley_wave * ud + i)
    if p.lean[i] != 0.0:
        k *= 1.0 + p.lean[i] if s > 0.0 else 1.0 - p.lean[i]
    force = k * s if p.stepper[i] == 0.0 else stepper_force(s, k, p.stepper[i], p.stepper_share)
    force += p.cubic[i] * s**3 + p.quintic[i] * s**5
    if p.play[i] > 0.0:
        force += k * abs(s) * p.landing * rate
    return force + p.belt_c[i] * rate * slope + p.visco_k[i] * (s - arm)


@njit(cache=True, error_model="numpy")
def level(v: float, i: int, p: Any) -> float:
    """Friction at rest and beyond, N."""
    return p.dry[i] + p.stick[i] * np.exp(-((abs(v) / p.stick_v) ** p.stick_power))


@njit(cache=True, error_model="numpy")
def guide(v: float, q: float, z: float, i: int, p: Any) -> float:
    """Evaluate what guide i does against the motion, N. z : of the bristle, share of its sliding deflection."""
    force = p.guide_b[i] * v + p.grease[i] * v / np.sqrt(1.0 + (v / SLIDING_LIMIT_M_PER_S) ** 2)
    if p.dry_kind == TANH:
        force += level(v, i, p) * np.tanh(v / p.dry_v)
    elif p.dry_kind >= DAHL:
        force += level(v, i, p) * z
        if p.dry_kind == LUGRE:
            force += p.micro * (v - abs(v) * z)
    if p.notch[i] != 0.0:
        force += p.notch[i] * np.sin(p.notch_wave * q + 2.0 * i)
    return force


@njit(cache=True, error_model="numpy")
def slid(z: float, v: float, speed: float, span: float, length: float) -> float:
    """Return where a bristle is after `span`, its slider going on at the same speed."""
    if speed < 1e-12:
        return z
    end = v / speed
    return end + (z - end) * np.exp(-speed * span / length)


@njit(cache=True, error_model="numpy")
def bent(z: float, v: float, span: float, p: Any) -> float:
    """Return where the bristle of a guide is after `span`, its slider going on at the same speed."""
    if p.dry_kind != BREAKS:
        return slid(z, v, abs(v), span, p.bristle)
    way = v * span / p.bristle
    for _ in range(min(int(abs(way) / FINE), 200) + 1):
        part = way / (min(int(abs(way) / FINE), 200) + 1)
        if z * part <= 0.0 or abs(z) < p.breaks:
            z += part
        else:
            yields = 0.5 - 0.5 * np.cos(np.pi * min((abs(z) - p.breaks) / (1.0 - p.breaks), 1.0))
            z += part * (1.0 - yields * abs(z))
        z = min(max(z, -1.0), 1.0)
    return z
