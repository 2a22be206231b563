"""Interpolate the rows of a command by a cubic spline."""

from __future__ import annotations

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.jit import compiled


@compiled
def slopes(rises: FloatArray) -> FloatArray:
    """Compute the knots' slopes : (n + 1,) of a not-a-knot cubic spline over n even intervals, from their mean slopes.

    s_{i−1} + 4 s_i + s_{i+1} = 3 (r_{i−1} + r_i) makes the curvature continuous (de Boor, 1978, IV). At the ends, one
    cubic over two intervals: s₀ + 2 s₁ = (5 r₀ + r₁)/2, which turns the first equation to 2 s₁ + s₂ = (r₀ + 5 r₁)/2.
    """
    n, r = len(rises), rises
    if n < 3:  # a straight line, or a parabola
        curvature = 0.5 * (r[n - 1] - r[0])
        return np.linspace(r[0] - curvature, r[n - 1] + curvature, n + 1)
    s, upper = np.empty(n + 1), np.empty(n)
    upper[1], s[1] = 0.5, 0.25 * (r[0] + 5.0 * r[1])
    for i in range(2, n - 1):
        upper[i] = 1.0 / (4.0 - upper[i - 1])
        s[i] = (3.0 * (r[i - 1] + r[i]) - s[i - 1]) * upper[i]
    s[n - 1] = (0.5 * (5.0 * r[n - 2] + r[n - 1]) - s[n - 2]) / (2.0 - upper[n - 2])
    for i in range(n - 2, 0, -1):
        s[i] -= upper[i] * s[i + 1]
    s[0], s[n] = 0.5 * (5.0 * r[0] + r[1]) - 2.0 * s[1], 0.5 * (r[n - 2] + 5.0 * r[n - 1]) - 2.0 * s[n - 1]
    return s


@compiled
def cubic_spline(rows: FloatArray, dt: float) -> FloatArray:
    """Return the cubics : (n, 3, 4) of splines through rows : (n, 3), highest power first; the last is a line."""
    cubics = np.zeros((len(rows), 3, 4))
    for i in range(3):
        rises = (rows[1:, i] - rows[:-1, i]) / dt
        s = slopes(rises)
        for n in range(len(rows)):
            cubics[n, i, 2], cubics[n, i, 3] = s[n], rows[n, i]
        for n in range(len(rises)):
            cubics[n, i, 0] = (s[n] + s[n + 1] - 2.0 * rises[n]) / (dt * dt)
            cubics[n, i, 1] = (3.0 * rises[n] - 2.0 * s[n] - s[n + 1]) / dt
    return cubics
