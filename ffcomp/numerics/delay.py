"""Signals moved in time by less than a sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import next_fast_len

from models.arrays import FloatArray


def delayed(x: FloatArray, late_s: float, rate_hz: float, drift: float = 0.0) -> FloatArray:
    """Move signals (n, m), at rest at both ends, to a later time; missing samples (NaN) stay missing.

    drift : relative lag of their clock about the middle, to first order because it is small.
    """
    if late_s == 0.0 and drift == 0.0:
        return x
    n = len(x)
    spare = int(abs(late_s) * rate_hz) + 32
    known = np.isfinite(x)
    more = next_fast_len(n + 2 * spare, real=True) - n - spare
    ends = np.pad(np.where(known, x, 0.0), ((spare, more), (0, 0)), mode="edge")
    w = 2 * np.pi * np.fft.rfftfreq(len(ends), 1 / rate_hz)
    turned = np.fft.rfft(ends, axis=0) * np.exp(-1j * w * late_s)[:, None]
    moved = np.fft.irfft(turned, len(ends), axis=0)[spare : spare + n]
    if drift:
        slope = np.fft.irfft(turned * (1j * w)[:, None], len(ends), axis=0)[spare : spare + n]
        middle = (np.arange(n) - (n - 1) / 2) / rate_hz
        moved = moved - drift * middle[:, None] * slope
    return np.where(known, moved, np.nan)


def moved_columns(
    x: FloatArray, columns: Sequence[int], late_s: float, rate_hz: float, drift: float = 0.0
) -> FloatArray:
    """Move some of the signals (n, m), as `delayed` does; the others stay."""
    if len(columns) == x.shape[1]:
        return delayed(x, late_s, rate_hz, drift)
    moved = x.copy()
    moved[:, columns] = delayed(x[:, columns], late_s, rate_hz, drift)
    return moved
