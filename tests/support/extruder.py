"""An extruder of one state: what flows out of it."""

from __future__ import annotations

import numpy as np

from models.arrays import FloatArray
from models.machine import Pressure


def flowing(pushed: FloatArray, pressure: Pressure, step_s: float) -> FloatArray:
    """Return what flows out, mm/s, at each of the even steps of what is pushed, mm."""
    out, compressed = np.zeros(len(pushed)), 0.0
    tau, v, n = pressure.time_constant_s, pressure.reference_mm_per_s, pressure.flow_exponent
    for k in range(1, len(pushed)):
        compressed += pushed[k] - pushed[k - 1]
        out[k] = v * (max(compressed, 0.0) / (tau * v)) ** (1 / n)
        compressed -= out[k] * step_s
    return out
