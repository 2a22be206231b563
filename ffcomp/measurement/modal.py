"""Sums of modes, and how a spectrum shows them: the model that every fit of a spectrum shares.

    H(f) = Σ_j A_j h_j(f),   h_j = 1/(1 − (f/f_j)² + 2i ζ_j f/f_j)

    S(f) = e(f) |H(f)|²  seen through the window's |W|²

A firmware's resonance test sweeps at 1 Hz/s with an acceleration proportional to f, so the power density of its command
grows with f²: e = f². Nothing known about the excitation: e = 1. A window of 0.6 s is as wide as a mode of ζ = 0.03 at
40 Hz; without the convolution with |W|² (its shape in lines is known) dampings come out too high.

`ffcomp.identification.modal_fit` fits shares of one axis that sum to one, `ffcomp.identification.belts` those that
follow from the stiffness of belts.
"""

from __future__ import annotations

import numpy as np

from models.arrays import ComplexArray, FloatArray

KAISER_BETA = 6.0  # of the firmwares' window, and ours
LINES_TO_EACH_SIDE, POINTS_A_LINE = 4, 4  # of the model: beyond four lines, the window is at −44 dB


def single_modes(frequency_hz: FloatArray, damping_ratio: FloatArray, at_hz: FloatArray) -> ComplexArray:
    """Evaluate h_j of m modes at any frequencies (…): (m, …)."""
    expand = (slice(None), *[None] * at_hz.ndim)
    ratio = at_hz / frequency_hz[expand]
    return np.asarray(1 / (1 - ratio**2 + 2j * damping_ratio[expand] * ratio))


class WindowedPower:
    """What the lines of a spectrum (k,) show of a response, through a Kaiser window (β = 6) of one line's width."""

    def __init__(self, frequency_hz: FloatArray, line_hz: float) -> None:
        offset, self._window = window_kernel()  # (w,)
        self.fine_hz = np.maximum(frequency_hz[:, None] + offset * line_hz, 1e-3)  # (k, w)
        self.excitation = (self.fine_hz / frequency_hz.mean()) ** 2

    def power(self, response: ComplexArray) -> FloatArray:
        """Return S, (k,), of a response (k, w) at `fine_hz`."""
        return np.asarray((self.excitation * np.abs(response) ** 2) @ self._window)


def window_kernel() -> tuple[FloatArray, FloatArray]:
    """Return |W|² of a Kaiser window between the lines: offsets (w,) in lines, weights (w,) of sum one."""
    power = np.abs(np.fft.fft(np.kaiser(64, KAISER_BETA), 64 * POINTS_A_LINE)) ** 2
    reach = np.arange(-LINES_TO_EACH_SIDE * POINTS_A_LINE, LINES_TO_EACH_SIDE * POINTS_A_LINE + 1)
    return reach / POINTS_A_LINE, power[reach] / power[reach].sum()
