"""Smooth shapers: the plan is convolved with a polynomial kernel instead of a few pulses.

    x_s(t) = ∫ w(τ) x(t − τ) dτ over a support of T = S/f,     w(τ) = Σ c_k (τ/T)^k / T, zero at both ends

Kernels and supports are those published by their author for Klipper and Kalico (smooth_zv to smooth_si), made for a
damping ratio of 0.1; they do not change with it. The integral is a Gauss-Legendre sum, so that a smooth shaper is a
`Shaper` with many pulses, so shaping, calibration and search accept it unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.shapers.pulses import DAMPING_RATIO, PULSES, Pulses, Shaper, check_frequency
from models.arrays import FloatArray

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
