"""Input shapers, the baselines every firmware offers: a few pulses that let a vibration cancel itself.

The planned Cartesian path is convolved with the pulses, x_s(t) = Σ A_i x(t - (T_i - T̄)) with T̄ = Σ A_i T_i,
and only then turned into carriage paths, as Klipper does on a delta: taking T̄ off leaves no delay at
constant speed, so a `Shaper` holds the times with T̄ taken off already.

With K = exp(-ζπ/√(1-ζ²)), the decay over half a period, and T_d = 1/(f√(1-ζ²)), the damped period:

    zv        1, K                                        0, T_d/2
    mzv       1-1/√2, (√2-1)K', (1-1/√2)K'², K' = K^¾     0, ⅜T_d, ¾T_d
    ei        (1+v)/4, (1-v)K/2, (1+v)K²/4                0, T_d/2, T_d
    2hump_ei  a, (½-a)K, (½-a)K², aK³                     0, T_d/2, T_d, 3T_d/2

v is the vibration EI lets through at its own frequency to be wider around it (Singhose, Seering & Singer
1994); a = (3X² + 2X + 3v²)/(16X), X = ∛(v²(√(1-v²) + 1)) (Singhose, Porter, Tuttle & Singer 1997).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
Position = Callable[[FloatArray], FloatArray]  # t : (k,) s → (k, 3) mm, at any time, resting before and after

DAMPING_RATIO = 0.1  # what Klipper assumes unless it is told
TOLERATED_VIBRATION = 0.05


@dataclass(frozen=True, slots=True)
class Shaper:
    """Pulses in time order, centred: their amplitudes sum to one, their mean delay Σ A T is zero."""

    name: str
    amplitude: FloatArray  # (n,)
    time: FloatArray  # (n,) s

    @property
    def duration_s(self) -> float:
        return float(self.time[-1] - self.time[0])


def zv(frequency_hz: float, damping_ratio: float = DAMPING_RATIO) -> Shaper:
    decay, period = _decay_and_period(frequency_hz, damping_ratio)
    return _centred("zv", [1.0, decay], [0.0, period / 2])


def mzv(frequency_hz: float, damping_ratio: float = DAMPING_RATIO) -> Shaper:
    decay, period = _decay_and_period(frequency_hz, damping_ratio)
    outer, inner = 1 - 1 / np.sqrt(2), np.sqrt(2) - 1
    return _centred("mzv", [outer, inner * decay**0.75, outer * decay**1.5], [0.0, 0.375 * period, 0.75 * period])


def ei(frequency_hz: float, damping_ratio: float = DAMPING_RATIO, tolerated: float = TOLERATED_VIBRATION) -> Shaper:
    decay, period = _decay_and_period(frequency_hz, damping_ratio)
    outer, inner = (1 + tolerated) / 4, (1 - tolerated) / 2
    return _centred("ei", [outer, inner * decay, outer * decay**2], [0.0, period / 2, period])


def two_hump_ei(
    frequency_hz: float, damping_ratio: float = DAMPING_RATIO, tolerated: float = TOLERATED_VIBRATION
) -> Shaper:
    decay, period = _decay_and_period(frequency_hz, damping_ratio)
    x = np.cbrt(tolerated**2 * (np.sqrt(1 - tolerated**2) + 1))
    outer = (3 * x**2 + 2 * x + 3 * tolerated**2) / (16 * x)
    inner = 0.5 - outer
    pulses = np.array([outer, inner, inner, outer]) * decay ** np.arange(4)
    return _centred("2hump_ei", pulses, np.arange(4) * period / 2)


SHAPERS: dict[str, Callable[[float, float], Shaper]] = {
    "zv": zv,
    "mzv": mzv,
    "ei": ei,
    "2hump_ei": two_hump_ei,
}


def _decay_and_period(frequency_hz: float, damping_ratio: float) -> tuple[float, float]:
    """(K, T_d): decay over half a damped period, the damped period in s."""
    if not frequency_hz > 0:
        raise ValueError(f"A shaper's frequency must be above zero, not {frequency_hz} Hz.")
    if not 0 <= damping_ratio < 1:
        raise ValueError(f"A shaper's damping ratio must lie in [0, 1), not at {damping_ratio}.")
    damped = np.sqrt(1 - damping_ratio**2)
    return float(np.exp(-damping_ratio * np.pi / damped)), 1 / (frequency_hz * damped)


def _centred(name: str, pulses: ArrayLike, times: ArrayLike) -> Shaper:
    amplitude = np.asarray(pulses, dtype=float) / np.sum(pulses)
    return Shaper(name, amplitude, np.asarray(times, dtype=float) - amplitude @ np.asarray(times, dtype=float))


def shape(
    position: Position,
    t: FloatArray,
    x: Shaper | None = None,
    y: Shaper | None = None,
    z: Shaper | None = None,
) -> FloatArray:
    """The shaped position : (k, 3) mm at the times t : (k,) s; an axis without a shaper stays as planned.

    Exact: the planned motion is evaluated at the pulses' own times, never interpolated between samples.
    """
    by_axis = (x, y, z)
    out = np.array(position(t), dtype=float)
    for shaper in {id(s): s for s in by_axis if s is not None}.values():
        axes = [j for j in range(3) if by_axis[j] is shaper]
        out[:, axes] = sum(
            a * position(t - delay)[:, axes] for a, delay in zip(shaper.amplitude, shaper.time, strict=True)
        )
    return out


def residual_vibration(shaper: Shaper, frequency_hz: FloatArray, damping_ratio: float) -> FloatArray:
    """Vibration left after the last pulse : (n,), as a share of what one plain step would leave, per
    frequency.

    |Σ A_i exp(-(ζω - iω_d)(T_n - T_i))|, ω_d = ω√(1-ζ²) (Singer & Seering 1990).
    """
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)[..., None]
    pole = omega * (-damping_ratio + 1j * np.sqrt(1 - damping_ratio**2))
    return np.abs(np.exp(pole * (shaper.time[-1] - shaper.time)) @ shaper.amplitude)
