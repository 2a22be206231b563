"""Smooth shapers: the plan is convolved with a polynomial kernel instead of a few pulses.

    x_s(t) = ∫ w(τ) x(t − τ) dτ over a support of T = S/f,     w(τ) = Σ c_k (τ/T)^k / T, zero at both ends

Kernels and supports are those published by their author for Klipper and Kalico (smooth_zv to smooth_si), made for a
damping ratio of 0.1; they do not change with it. The integral is a Gauss-Legendre sum, so that a smooth shaper is a
`Shaper` with many pulses, so shaping, calibration and search accept it unchanged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ffcomp.shapers.pulses import DAMPING_RATIO, Shaper, ei, mzv, three_hump_ei, two_hump_ei, zv, zvd, zvdd, zvddd

NODES = 24  # of the sum: the position along a 30 ms kernel is then exact to 0.1 µm at an acceleration's step of 10 m/s²


@dataclass(frozen=True)
class Kernel:
    """A polynomial over a support of one: its length in periods, and coefficients from the highest power down."""

    support_periods: float
    coefficients: tuple[float, ...]

    def shaper(self, name: str, frequency_hz: float) -> Shaper:
        """Return the kernel at a frequency, its mean delay taken off."""
        if not frequency_hz > 0:
            raise ValueError(f"A shaper's frequency must be above zero, not {frequency_hz} Hz.")
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        amplitude = weights * np.polyval(np.array(self.coefficients), nodes / 2)
        amplitude /= amplitude.sum()
        time = nodes / 2 * self.support_periods / frequency_hz
        return Shaper(name, amplitude, time - amplitude @ time)


KERNELS = {
    "smooth_zv": Kernel(
        0.8025, (-118.4265334338076, 5.861885495127615, 29.52796003014231, -1.465471373781904, 0.01966833207740377)
    ),
    "smooth_mzv": Kernel(
        0.95625,
        (
            -1906.717580206364,
            125.8892756660212,
            698.0200035767849,
            -37.75923018121473,
            -62.18762409216703,
            1.57172781617736,
            1.713117990217123,
        ),
    ),
    "smooth_ei": Kernel(
        1.06625,
        (
            -1797.048868963208,
            120.5310596109878,
            669.6653197989012,
            -35.71975707450795,
            -62.49388325512682,
            1.396748042940248,
            1.848276903900512,
        ),
    ),
    "smooth_2hump_ei": Kernel(
        1.14875,
        (
            -22525.88434486782,
            2524.826047114184,
            10554.22832043971,
            -1051.778387878068,
            -1475.914693073253,
            121.2177946817349,
            57.95603221424528,
            -4.018706414213658,
            0.8375784787864095,
        ),
    ),
    "smooth_zvd_ei": Kernel(
        1.475,
        (
            -18835.07746719777,
            1914.349309746547,
            8786.608981369287,
            -807.3061869131075,
            -1209.429748155012,
            96.48879052981883,
            43.1595785340444,
            -3.577268915175282,
            1.083220648523371,
        ),
    ),
    "smooth_si": Kernel(
        1.245,
        (
            -6186.76006449789,
            1206.747198930197,
            2579.985143622855,
            -476.8554763069169,
            -295.546608490564,
            52.69679971161049,
            4.234582468800491,
            -2.226157642004671,
            1.267781046297883,
        ),
    ),
}


def smooth(name: str, frequency_hz: float, damping_ratio: float = DAMPING_RATIO) -> Shaper:
    """Return a smooth shaper; the published kernels are for one damping ratio, whatever the mode's is."""
    del damping_ratio
    return KERNELS[name].shaper(name, frequency_hz)


@dataclass(frozen=True, slots=True)
class ShaperKind:
    """A kind of shaper: all that calibration, search and comparison need."""

    make: Callable[[float, float], Shaper]  # from frequency, Hz, and damping ratio
    lowest_hz: float  # that a calibration tries: there a print could still accelerate by about 1.5 m/s²
    usual: bool = False  # most printers have it: it is compared unless others are named
    recommended: bool = False  # calibrations choose among these

    def __call__(self, frequency_hz: float, damping_ratio: float) -> Shaper:
        """Return the shaper of a mode."""
        return self.make(frequency_hz, damping_ratio)


_SMOOTH_LOWEST_HZ = {"smooth_mzv": 20.0, "smooth_ei": 21.0, "smooth_2hump_ei": 21.5, "smooth_zvd_ei": 26.0}
_SMOOTH_LOWEST_HZ |= {"smooth_zv": 18.0, "smooth_si": 21.5}
SHAPERS: dict[str, ShaperKind] = {
    "zv": ShaperKind(zv, 21.0, usual=True, recommended=True),
    "mzv": ShaperKind(mzv, 23.0, usual=True, recommended=True),
    "zvd": ShaperKind(zvd, 29.0, usual=True),
    "zvdd": ShaperKind(zvdd, 35.0),
    "zvddd": ShaperKind(zvddd, 40.0),
    "ei": ShaperKind(ei, 29.0, usual=True, recommended=True),
    "2hump_ei": ShaperKind(two_hump_ei, 39.0, usual=True, recommended=True),
    "3hump_ei": ShaperKind(three_hump_ei, 48.0, usual=True, recommended=True),
    **{name: ShaperKind(partial(smooth, name), _SMOOTH_LOWEST_HZ[name]) for name in KERNELS},
}

USUAL = tuple(name for name, kind in SHAPERS.items() if kind.usual)
