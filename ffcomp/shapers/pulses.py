"""Shapers of a few pulses as Klipper, Kalico and Marlin define them, and the vibration they leave.

With K = exp(-ζπ/√(1-ζ²)), the decay over half a period, and T_d = 1/(f√(1-ζ²)), the damped period:

    zv        1, K                                        0, T_d/2
    mzv       1-1/√2, (√2-1)K', (1-1/√2)K'², K' = K^¾     0, ⅜T_d, ¾T_d
    zvd       1, 2K, K²                                   0, T_d/2, T_d
    zvdd      1, 3K, 3K², K³                              0, T_d/2, T_d, 3T_d/2
    zvddd     1, 4K, 6K², 4K³, K⁴                         0, T_d/2, T_d, 3T_d/2, 2T_d
    ei        (1+v)/4, (1-v)K/2, (1+v)K²/4                0, T_d/2, T_d
    2hump_ei  a, (½-a)K, (½-a)K², aK³                     0, T_d/2, T_d, 3T_d/2
    3hump_ei  b, (1-v)K/4, ((1+v)/2-2b)K², (1-v)K³/4, bK⁴   0, T_d/2, T_d, 3T_d/2, 2T_d

zv leaves nothing at its own frequency, zvd nothing and no slope (Singer & Seering 1990), each further d one more
derivative. v is the vibration EI
lets through at its own frequency to be wider around it (Singhose, Seering & Singer 1994);
a = (3X² + 2X + 3v²)/(16X), X = ∛(v²(√(1-v²) + 1)), and b = (1 + 3v + 2√(2v(1+v)))/16
(Singhose, Porter, Tuttle & Singer 1997).

NOTE: for a damped vibration the EI pulses are the undamped ones times powers of K, as in Kalico; Klipper of 2026 has
polynomials in ζ and v instead, about 1 % different.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from models.arrays import FloatArray

DAMPING_RATIO = 0.1  # Klipper's default
TOLERATED_VIBRATION = 0.05


@dataclass(frozen=True, slots=True)
class Shaper:
    """Pulses in time order, centred: their amplitudes sum to one, their mean delay Σ A T is zero."""

    name: str
    amplitude: FloatArray  # (n,)
    time: FloatArray  # (n,) s

    @property
    def duration_s(self) -> float:
        """From the first pulse to the last."""
        return float(self.time[-1] - self.time[0])


def zv(frequency_hz: float, damping_ratio: float = DAMPING_RATIO) -> Shaper:
    """Return the zero vibration shaper."""
    return _half_periods("zv", [1.0, 1.0], frequency_hz, damping_ratio)


def mzv(frequency_hz: float, damping_ratio: float = DAMPING_RATIO) -> Shaper:
    """Return the modified zero vibration shaper."""
    outer, inner = 1 - 1 / np.sqrt(2), np.sqrt(2) - 1
    return _evenly("mzv", [outer, inner, outer], 0.75, frequency_hz, damping_ratio)


def zvd(frequency_hz: float, damping_ratio: float = DAMPING_RATIO) -> Shaper:
    """Return the zero vibration and derivative shaper."""
    return _half_periods("zvd", [1.0, 2.0, 1.0], frequency_hz, damping_ratio)


def zvdd(frequency_hz: float, damping_ratio: float = DAMPING_RATIO) -> Shaper:
    """Return the shaper with two zero derivatives of the vibration."""
    return _half_periods("zvdd", [1.0, 3.0, 3.0, 1.0], frequency_hz, damping_ratio)


def zvddd(frequency_hz: float, damping_ratio: float = DAMPING_RATIO) -> Shaper:
    """Return the shaper with three zero derivatives of the vibration."""
    return _half_periods("zvddd", [1.0, 4.0, 6.0, 4.0, 1.0], frequency_hz, damping_ratio)


def ei(frequency_hz: float, damping_ratio: float = DAMPING_RATIO, tolerated: float = TOLERATED_VIBRATION) -> Shaper:
    """Return the extra insensitive shaper."""
    outer, inner = (1 + tolerated) / 4, (1 - tolerated) / 2
    return _half_periods("ei", [outer, inner, outer], frequency_hz, damping_ratio)


def two_hump_ei(
    frequency_hz: float, damping_ratio: float = DAMPING_RATIO, tolerated: float = TOLERATED_VIBRATION
) -> Shaper:
    """Return the two-hump extra insensitive shaper."""
    x = np.cbrt(tolerated**2 * (np.sqrt(1 - tolerated**2) + 1))
    outer = (3 * x**2 + 2 * x + 3 * tolerated**2) / (16 * x)
    inner = 0.5 - outer
    return _half_periods("2hump_ei", [outer, inner, inner, outer], frequency_hz, damping_ratio)


def three_hump_ei(
    frequency_hz: float, damping_ratio: float = DAMPING_RATIO, tolerated: float = TOLERATED_VIBRATION
) -> Shaper:
    """Return the three-hump extra insensitive shaper."""
    outer = (1 + 3 * tolerated + 2 * np.sqrt(2 * tolerated * (1 + tolerated))) / 16
    inner, middle = (1 - tolerated) / 4, (1 + tolerated) / 2 - 2 * outer
    return _half_periods("3hump_ei", [outer, inner, middle, inner, outer], frequency_hz, damping_ratio)


def residual_vibration(shaper: Shaper, frequency_hz: FloatArray, damping_ratio: float) -> FloatArray:
    """Return the vibration left after the last pulse, as a share of what one plain step would leave, per frequency.

    |Σ A_i exp(-(ζω - iω_d)(T_n - T_i))|, ω_d = ω√(1-ζ²) (Singer & Seering 1990).
    """
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)[..., None]
    pole = omega * (-damping_ratio + 1j * np.sqrt(1 - damping_ratio**2))
    return np.abs(np.exp(pole * (shaper.time[-1] - shaper.time)) @ shaper.amplitude)


def _half_periods(name: str, undamped: ArrayLike, frequency_hz: float, damping_ratio: float) -> Shaper:
    return _evenly(name, undamped, 1.0, frequency_hz, damping_ratio)


def _evenly(name: str, undamped: ArrayLike, spacing: float, frequency_hz: float, damping_ratio: float) -> Shaper:
    """Put pulses `spacing` half periods apart, each smaller by what the vibration decays meanwhile."""
    decay, period = _decay_and_period(frequency_hz, damping_ratio)
    amplitude = np.asarray(undamped, dtype=float)
    at = spacing * np.arange(len(amplitude))  # half periods
    amplitude = amplitude * decay**at
    amplitude /= amplitude.sum()
    time = at * period / 2
    return Shaper(name, amplitude, time - amplitude @ time)


def _decay_and_period(frequency_hz: float, damping_ratio: float) -> tuple[float, float]:
    """Return (K, T_d): decay over half a damped period, the damped period in s."""
    if not frequency_hz > 0:
        raise ValueError(f"A shaper's frequency must be above zero, not {frequency_hz} Hz.")
    if not 0 <= damping_ratio < 1:
        raise ValueError(f"A shaper's damping ratio must lie in [0, 1), not at {damping_ratio}.")
    damped = np.sqrt(1 - damping_ratio**2)
    return float(np.exp(-damping_ratio * np.pi / damped)), 1 / (frequency_hz * damped)
