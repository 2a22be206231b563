"""Signals that excite one coordinate of a printer, as firmware executes them: polylines, a knot every S seconds.

Straight lines between knots pass a frequency f on by sinc²(f S), because linear interpolation is a convolution
with a triangle of that width. Twice differentiating in steps of S has the same gain: a sine of amplitude A at the
knots is executed, at its own frequency, as one of amplitude sinc²(f S) A, and

    A (2 sin(π f S) / S)²  =  sinc²(f S) A (2π f)²

is the amplitude both of its second difference and of the acceleration that is executed. So the signals are designed by
their second differences, and no frequency is weaker in the machine than it was designed. Images stand at |f ± n/S|.

mm, s, mm/s, mm/s²; one period of a signal is (knots,) mm.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import ceil, floor

import numpy as np

from ffcomp.errors import LimitsError
from models.arrays import FloatArray, IntArray

HIGHEST_SHARE = 0.45  # of the segments' rate: nearer to half of it, the image at 1/S − f is as strong as the signal
SEGMENTS_PER_SECOND, FASTEST_RATE = 250.0, 500.0  # the usual rate; what firmwares' hosts follow
RAMP_S = 0.5  # over which a signal that never rests is faded in and out
CREST_PASSES = 150
CLIP_FROM, CLIP_TO = 0.75, 0.97  # of the peak
CORNER_STEP = 1.1


@dataclass(frozen=True, slots=True)
class Band:
    """Frequencies that fit into a period a whole number of times, on `knots` knots."""

    lowest_hz: float
    highest_hz: float
    period_s: float
    knots: int  # per period

    @property
    def segment_s(self) -> float:
        """S, the time between two knots."""
        return self.period_s / self.knots

    @property
    def lines(self) -> IntArray:
        """(m,) periods of each frequency of the band in one period of the signal."""
        first, last = ceil(self.lowest_hz * self.period_s - 1e-9), floor(self.highest_hz * self.period_s + 1e-9)
        return np.arange(first, last + 1)

    @property
    def frequencies_hz(self) -> FloatArray:
        """(m,) Hz."""
        return self.lines / self.period_s


def band(lowest_hz: float, highest_hz: float, period_s: float) -> Band:
    """Make a band with the usual rate of knots, or a higher one if its highest frequency needs that.

    Raises LimitsError for a band that is empty, or that needs more segments than a firmware's host can follow.
    """
    rate = max(SEGMENTS_PER_SECOND, highest_hz / HIGHEST_SHARE)
    if rate > FASTEST_RATE:
        raise LimitsError(
            f"{highest_hz:g} Hz needs {rate:.0f} segments a second; firmwares follow {FASTEST_RATE:.0f}, "
            f"which is enough for {HIGHEST_SHARE * FASTEST_RATE:.0f} Hz."
        )
    result = Band(lowest_hz, highest_hz, period_s, ceil(rate * period_s - 1e-9))
    if not 0.0 < lowest_hz < highest_hz or not result.lines.size:
        raise LimitsError(
            f"The band from {lowest_hz:g} to {highest_hz:g} Hz must rise from above zero and hold a multiple of "
            f"{1.0 / period_s:g} Hz, as all frequencies of a period of {period_s:g} s are."
        )
    return result


def polyline_gain(frequency_hz: FloatArray, segment_s: float) -> FloatArray:
    """Return sinc²(f S), the share of a sine at the knots that straight lines between them pass on."""
    return np.asarray(np.sinc(frequency_hz * segment_s) ** 2)


def second_difference_gain(frequency_hz: FloatArray, segment_s: float) -> FloatArray:
    """Return (2 sin(π f S) / S)² = sinc²(f S) (2π f)², 1/s²: from a sine's amplitude at the knots to acceleration."""
    return polyline_gain(frequency_hz, segment_s) * (2.0 * np.pi * frequency_hz) ** 2


# One period


def multisine(band: Band, corner_hz: float, seed: int) -> FloatArray:
    """Sum all lines with random phases, their second difference flat above the corner: (knots,).

    The crest factor is reduced: the signal is clipped, its phases are kept and its amplitudes restored, repeatedly
    (Van der Ouderaa, Schoukens & Renneboog, IEEE Trans. Instrum. Meas. 37, 1988, 207-212).
    """
    weight = np.minimum(1.0, band.frequencies_hz / corner_hz)
    phase = np.random.default_rng(seed).uniform(-np.pi, np.pi, len(weight))
    spectrum = np.zeros(band.knots // 2 + 1, dtype=np.complex128)
    spectrum[band.lines] = weight * np.exp(1j * phase)
    for share in np.linspace(CLIP_FROM, CLIP_TO, CREST_PASSES):
        wave = np.fft.irfft(spectrum, band.knots)
        top = share * np.abs(wave).max()
        clipped = np.fft.rfft(np.clip(wave, -top, top))[band.lines]
        spectrum[band.lines] = weight * np.exp(1j * np.angle(clipped))
    spectrum[band.lines] /= -second_difference_gain(band.frequencies_hz, band.segment_s)
    return np.asarray(np.fft.irfft(spectrum, band.knots))


def smooth_step(x: FloatArray) -> FloatArray:
    """Step from 0 to 1 over 0 <= x <= 1, velocity and acceleration zero at both ends."""
    s = np.clip(x, 0.0, 1.0)
    return s**3 * (10.0 + s * (6.0 * s - 15.0))


def scaled(band: Band, acceleration: float, velocity: float, seed: int) -> FloatArray:
    """Scale one period of a multisine so that its second difference peaks at `acceleration` mm/s²: (knots,) mm.

    Where its speed would pass `velocity` mm/s, the low frequencies give way: the corner below which velocity and not
    acceleration is even rises until it does not.
    """
    corner = band.lowest_hz
    while corner <= band.highest_hz:
        wave = multisine(band, corner, seed)
        bend = np.abs(np.roll(wave, -1) - 2.0 * wave + np.roll(wave, 1)).max() / band.segment_s**2
        wave *= acceleration / bend
        fastest = float(np.abs(np.diff(wave, append=wave[0])).max()) / band.segment_s
        if fastest <= velocity:
            return wave
        corner *= CORNER_STEP
    fits = 0.99 * acceleration * velocity / fastest
    raise LimitsError(
        f"An acceleration of {acceleration:.0f} mm/s² from {band.lowest_hz:g} to {band.highest_hz:g} Hz needs "
        f"{fastest:.0f} mm/s and may have {velocity:.0f}; {fits:.0f} mm/s² would fit."
    )


# From rest to rest


def excitation(band: Band, periods: int, acceleration: float, velocity: float, seed: int) -> tuple[FloatArray, int]:
    """Repeat a multisine whose transient ends before the first of its `periods`: (n + 1,) mm, and the knot of that.

    It is faded in over the end of a period, and one whole period goes by before the first that counts.
    """
    wave, ramp, settling = scaled(band, acceleration, velocity, seed), round(RAMP_S / band.segment_s), band.knots
    at = np.arange(-ramp - settling, periods * band.knots + ramp + 1)
    faded = smooth_step((at - at[0]) / ramp) * smooth_step((at[-1] - at) / ramp)
    return faded * wave[at % band.knots], ramp + settling


def always_moving(counts: list[list[int]], axis: int) -> FloatArray:
    """Make every vertex (n + 1, 3), in counts, differ from the one before.

    A segment that goes nowhere would be left out, and its time lost: its end is moved by one count along an axis.
    """
    for before, here in pairwise(counts):
        if here == before:
            here[axis] += 1
    return np.array(counts, dtype=np.float64)
