"""Shapers of a few pulses as Klipper, Kalico and Marlin define them, and the vibration they leave.

With K = exp(-ζπ/√(1-ζ²)), the decay over half a period, and T_d = 1/(f√(1-ζ²)), the damped period, pulse i of U_i
without damping is A_i = U_i K^(s i) / Σ U_j K^(s j) at s i T_d/2; s is 1, for mzv ¾.

zv leaves nothing at its own frequency, zvd nothing and no slope (Singer & Seering 1990), each further d one more
derivative. v is the vibration that EI lets through at its own frequency to be wider around it (Singhose, Seering &
Singer 1994); a and b are of EI with two and three humps (Singhose, Porter, Tuttle & Singer 1997).

NOTE: for a damped vibration the EI pulses are the undamped ones times powers of K, as in Kalico; Klipper of 2026 has
polynomials in ζ and v instead, about 1 % different.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.arrays import FloatArray

DAMPING_RATIO = 0.1  # Klipper's default


@dataclass(frozen=True, slots=True)
class Shaper:
    """Pulses in time order, centred: their amplitudes sum to one, their mean delay Σ A T is zero."""

    amplitude: FloatArray  # (n,)
    time: FloatArray  # (n,) s

    @classmethod
    def of(cls, weight: FloatArray, time: FloatArray) -> Shaper:
        """Return pulses of these relative weights at these times, centred."""
        amplitude = weight / weight.sum()
        return cls(amplitude, time - amplitude @ time)


@dataclass(frozen=True)
class Pulses:
    """A kind of shaper of a few pulses."""

    undamped: tuple[float, ...]  # U_i
    lowest_hz: float  # that a calibration tries: there a print could still accelerate by about 1.5 m/s²
    spacing: float = 1.0  # s, half periods from pulse to pulse

    def __call__(self, frequency_hz: float, damping_ratio: float = DAMPING_RATIO) -> Shaper:
        """Return the shaper of a mode."""
        check_frequency(frequency_hz)
        if not 0 <= damping_ratio < 1:
            raise ValueError(f"A shaper's damping ratio must lie in [0, 1), not at {damping_ratio}.")
        damped = np.sqrt(1 - damping_ratio**2)
        at = self.spacing * np.arange(len(self.undamped))  # half periods
        decay = float(np.exp(-damping_ratio * np.pi / damped))
        return Shaper.of(np.array(self.undamped) * decay**at, at * (1 / (frequency_hz * damped)) / 2)


_v = 0.05
_x = np.cbrt(_v**2 * (np.sqrt(1 - _v**2) + 1))
_a = (3 * _x**2 + 2 * _x + 3 * _v**2) / (16 * _x)
_b = (1 + 3 * _v + 2 * np.sqrt(2 * _v * (1 + _v))) / 16
PULSES = {
    "zv": Pulses((1.0, 1.0), 21.0),
    "mzv": Pulses((1 - 1 / np.sqrt(2), np.sqrt(2) - 1, 1 - 1 / np.sqrt(2)), 23.0, spacing=0.75),
    "zvd": Pulses((1.0, 2.0, 1.0), 29.0),
    "zvdd": Pulses((1.0, 3.0, 3.0, 1.0), 35.0),
    "zvddd": Pulses((1.0, 4.0, 6.0, 4.0, 1.0), 40.0),
    "ei": Pulses(((1 + _v) / 4, (1 - _v) / 2, (1 + _v) / 4), 29.0),
    "2hump_ei": Pulses((_a, 0.5 - _a, 0.5 - _a, _a), 39.0),
    "3hump_ei": Pulses((_b, (1 - _v) / 4, (1 + _v) / 2 - 2 * _b, (1 - _v) / 4, _b), 48.0),
}
USUAL = ("zv", "mzv", "zvd", "ei", "2hump_ei", "3hump_ei")  # most printers have them


def check_frequency(frequency_hz: float) -> None:
    """Raise ValueError for one that no mode has."""
    if not frequency_hz > 0:
        raise ValueError(f"A shaper's frequency must be above zero, not {frequency_hz} Hz.")


def residual_vibration(shaper: Shaper, frequency_hz: FloatArray, damping_ratio: float) -> FloatArray:
    """Return the vibration left after the last pulse, as a share of what one plain step would leave, per frequency.

    |Σ A_i exp(-(ζω - iω_d)(T_n - T_i))|, ω_d = ω√(1-ζ²) (Singer & Seering 1990).
    """
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)[..., None]
    pole = omega * (-damping_ratio + 1j * np.sqrt(1 - damping_ratio**2))
    return np.abs(np.exp(pole * (shaper.time[-1] - shaper.time)) @ shaper.amplitude)


# ---- smooth shapers ------------------------------------------------------------------------------
#
#     x_s(t) = ∫ w(τ) x(t − τ) dτ over a support of T = S/f,     w(τ) = Σ c_k (τ/T)^k / T, zero at both ends
#
# Kernels and supports are those published by their author for Klipper and Kalico, made for a damping ratio of 0.1; they
# do not change with it. The integral is a Gauss-Legendre sum, so a smooth shaper is a `Shaper` with many pulses, which
# shaping, calibration and search accept unchanged.

NODES = 24  # of the sum: the position along a 30 ms kernel is then exact to 0.1 µm at an acceleration's step of 10 m/s²


@dataclass(frozen=True)
class Kernel:
    """A polynomial over a support of one: its length in periods, and coefficients from the highest power down."""

    support_periods: float
    lowest_hz: float  # that a calibration tries
    even: tuple[float, ...]  # of even powers
    odd: tuple[float, ...]  # of odd powers

    @property
    def coefficients(self) -> FloatArray:
        """Return those of all powers, from the highest down."""
        every = np.empty(len(self.even) + len(self.odd))
        every[::2], every[1::2] = self.even, self.odd
        return every

    def __call__(self, frequency_hz: float, damping_ratio: float = DAMPING_RATIO) -> Shaper:
        """Return the kernel at a frequency; it is for a damping ratio of 0.1."""
        del damping_ratio
        check_frequency(frequency_hz)
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        return Shaper.of(
            weights * np.polyval(self.coefficients, nodes / 2), nodes / 2 * self.support_periods / frequency_hz
        )


KERNELS = {
    "smooth_zv": Kernel(
        0.8025,
        18.0,
        even=(-118.4265334338076, 29.52796003014231, 0.01966833207740377),
        odd=(5.861885495127615, -1.465471373781904),
    ),
    "smooth_mzv": Kernel(
        0.95625,
        20.0,
        even=(-1906.717580206364, 698.0200035767849, -62.18762409216703, 1.713117990217123),
        odd=(125.8892756660212, -37.75923018121473, 1.57172781617736),
    ),
    "smooth_ei": Kernel(
        1.06625,
        21.0,
        even=(-1797.048868963208, 669.6653197989012, -62.49388325512682, 1.848276903900512),
        odd=(120.5310596109878, -35.71975707450795, 1.396748042940248),
    ),
    "smooth_2hump_ei": Kernel(
        1.14875,
        21.5,
        even=(-22525.88434486782, 10554.22832043971, -1475.914693073253, 57.95603221424528, 0.8375784787864095),
        odd=(2524.826047114184, -1051.778387878068, 121.2177946817349, -4.018706414213658),
    ),
    "smooth_zvd_ei": Kernel(
        1.475,
        26.0,
        even=(-18835.07746719777, 8786.608981369287, -1209.429748155012, 43.1595785340444, 1.083220648523371),
        odd=(1914.349309746547, -807.3061869131075, 96.48879052981883, -3.577268915175282),
    ),
    "smooth_si": Kernel(
        1.245,
        21.5,
        even=(-6186.76006449789, 2579.985143622855, -295.546608490564, 4.234582468800491, 1.267781046297883),
        odd=(1206.747198930197, -476.8554763069169, 52.69679971161049, -2.226157642004671),
    ),
}


SHAPERS: dict[str, Pulses | Kernel] = {**PULSES, **KERNELS}
