"""How belts and guides of a hidden printer differ from the catalogue's, for printers of every kind.

Friction is a bristle (Canudas de Wit, Olsson, Åström & Lischinsky, 1995) or a tanh, play has soft flanks and a damped
landing, a hardening belt has a fifth power, a stepper's sine acts in series with its belt. SI; `p` is a record of
`numbers` with the fields of its kind of printer.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

SLIDING_LIMIT_M_PER_S = 0.8  # speed at which grease begins to shear thinner


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
    if p.dry_kind == 1:
        force += level(v, i, p) * np.tanh(v / p.dry_v)
    elif p.dry_kind == 2:
        force += level(v, i, p) * z
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
