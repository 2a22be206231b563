"""The shapes of belts and guides in all independent printers, on purpose not those of the machine files.

Dry friction is a tanh, or a bristle that bends before it slides, by one of three laws: Dahl's, LuGre's with a damping
of its own (Canudas de Wit, Olsson, Åström & Lischinsky, 1995), or a spring up to a break-away (Dupont, Hayward,
Armstrong & Altpeter, 2002), which over some µm is hard stiction. Backlash has soft flanks and a damped landing, a
hardening belt a fifth power, a stepper's sine acts in series with its belt, and a belt may be stiffer one way. SI; `p`
is a record with the fields `SHAPED`, and `BELTS` and `GUIDES` for each motor or axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit

SLIDING_LIMIT_M_PER_S = 0.8  # speed at which grease begins to shear thinner
TANH, DAHL, LUGRE, BREAKS = 1, 2, 3, 4  # kinds of dry friction
FINE = 0.1  # of a bristle's way: a step of one that breaks away
# Fields of each motor. Belts: N/m, N s/m; N/m³, N/m⁵; 1/m at m; share by which it is stiffer pulled, and softer pushed;
# m, whole width of the backlash; m, F_peak/k of the stepper (0: none); N/m of a spring with a dashpot in series.
# Motors: m and rad/m; kg, N/m, N s/m of a rotor between its magnets and its belt (0: it follows its command).
BELTS = """
    belt_k belt_c cubic quintic slope slope_at lean play stepper visco_k ripple ripple_wave rotor rotor_k rotor_b
"""
# N s/m; N; N more at rest; m, deflection that slides; N s/m while it bends; N s/m, shear-thinning; N
GUIDES = "guide_b dry stick bristle micro grease notch"
# m/s and power of the surplus at rest; m/s, of the tanh; share of the deflection up to which nothing slides; m, of the
# backlash's soft edges; s/m, damping while it closes; share of the compliance that is the stepper's; share of k lost in
# the end, and s; share of k, once a turn, rad/m; rad/m; s; share of the ripple's second harmonic, and its phase; kg,
# N/m, N s/m of the bracket of the motor `soft_motor` (-1: none)
SHAPED = """
    stick_v stick_power dry_v breaks flank landing stepper_share warm_share warm_s pulley_share pulley_wave notch_wave
    visco_s ripple_second ripple_phase soft_mass soft_k soft_b
"""
NEUTRAL: Mapping[str, Any] = {
    **dict.fromkeys(("stick_v", "stick_power", "stepper_share", "warm_s", "visco_s"), 1.0),
    **{"dry_v": 1e-3, "bristle": 1e-5, "flank": 1e-6, "soft_mass": 1.0, "soft_motor": -1},
}


def record_of(fields: np.dtype[Any], numbers: Mapping[str, Any]) -> Any:
    """Return numbers as one record, as compiled code wants them."""
    record = np.zeros(1, dtype=fields)
    for name, value in numbers.items():
        record[name][0] = value
    return record.view(np.recarray)[0]


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
    """Force of guide i against the motion, N. z : bristle's deflection, as a share of that at which it slides."""
    force = p.guide_b[i] * v
    if p.grease[i] != 0.0:
        force += p.grease[i] * v / np.sqrt(1.0 + (v / SLIDING_LIMIT_M_PER_S) ** 2)
    if p.dry_kind == TANH:
        force += level(v, i, p) * np.tanh(v / p.dry_v)
    elif p.dry_kind >= DAHL:
        force += level(v, i, p) * z
        if p.dry_kind == LUGRE:
            force += p.micro[i] * (v - abs(v) * z)
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
def bent(z: float, v: float, span: float, i: int, p: Any) -> float:
    """Return where the bristle of guide i is after `span`, its slider going on at the same speed."""
    if p.dry_kind != BREAKS:
        return slid(z, v, abs(v), span, p.bristle[i])
    way = v * span / p.bristle[i]
    for _ in range(min(int(abs(way) / FINE), 200) + 1):
        part = way / (min(int(abs(way) / FINE), 200) + 1)
        if z * part <= 0.0 or abs(z) < p.breaks:
            z += part
        else:
            yields = 0.5 - 0.5 * np.cos(np.pi * min((abs(z) - p.breaks) / (1.0 - p.breaks), 1.0))
            z += part * (1.0 - yields * abs(z))
        z = min(max(z, -1.0), 1.0)
    return z


@njit(cache=True, error_model="numpy")
def rippled(u: float, du: float, ud: float, dud: float, i: int, p: Any) -> tuple[float, float]:
    """Return where motor i is and how fast, with the ripple by its command's position."""
    if p.ripple[i] != 0.0:
        w = p.ripple_wave[i]
        first, second = w * ud, 2.0 * w * ud + p.ripple_phase
        u += p.ripple[i] * (np.sin(first) + p.ripple_second * np.sin(second))
        slope = np.cos(first) + 2.0 * p.ripple_second * np.cos(second)
        du += p.ripple[i] * w * dud * slope
    return u, du


@njit(cache=True, error_model="numpy")
def driven(
    y: Any, t: float, u: float, du: float, ud: float, q: float, dq: float, i: int, at: Any, p: Any, dy: Any
) -> float:
    """Force of belt i where a bracket may give way, a rotor swing and a belt creep.

    at : where the rotors, their speeds, the bracket and the creeping parts begin in the state y.
    """
    rotor, speed, mount, arm = at
    if i == p.soft_motor:
        u, du = u + y[mount], du + y[mount + 1]
    sent, turned = u, du
    if p.rotor[i] > 0.0:
        u, du = y[rotor + i], y[speed + i]
    pull = belt(u - q, du - dq, q, ud, y[arm + i], t, i, p)
    if p.rotor[i] > 0.0:
        dy[rotor + i] = du
        dy[speed + i] = (p.rotor_k[i] * (sent - u) + p.rotor_b[i] * (turned - du) - pull) / p.rotor[i]
    if i == p.soft_motor:
        dy[mount] = y[mount + 1]
        dy[mount + 1] = -(pull + p.soft_k * y[mount] + p.soft_b * y[mount + 1]) / p.soft_mass
    dy[arm + i] = (u - q - y[arm + i]) / p.visco_s if p.visco_k[i] > 0.0 else 0.0
    return pull
