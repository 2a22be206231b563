"""Noise of a curve from the curve itself: its residual to a smooth curve through the neighbours."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_coeffs

from models.arrays import ComplexArray, FloatArray

_WINDOW = 9  # lines
_DEGREE = 2


def roughness_variance(value: ComplexArray, window: int = _WINDOW) -> FloatArray:
    """Estimate E|δ|² of each line from the residual to a quadratic through the lines around it, (k,) → (k,).

    A quadratic through the w = `window` lines around a line leaves of white noise at that line 1 − h, h the middle
    coefficient of the fit (Savitzky & Golay, 1964); the squares are averaged over w lines.
    """
    coefficients = savgol_coeffs(window, _DEGREE)
    inner = np.convolve(value, coefficients, mode="valid")
    half = window // 2
    residual = np.pad(value[half:-half] - inner, half, mode="edge")
    square = np.abs(residual) ** 2 / (1 - coefficients[half])
    return np.asarray(uniform_filter1d(square, window, mode="nearest"), dtype=np.float64)
