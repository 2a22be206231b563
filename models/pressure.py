"""What the hot end keeps back: filament that is compressed before it flows, as a model of one state.

The state is the compressed filament s, mm: it grows with what the motor pushes, and what flows out depends on it alone,
ds/dt = v_in - v_out, v_out = f(s). Linear, s = τ v_out, it is what firmwares call pressure advance. Molten plastic is
thinner the faster it flows, so that s grows less than the flow: s = τ v_ref (v_out / v_ref)^n with n below 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.arrays import FloatArray

REFERENCE_MM_PER_S = 2.0  # of filament 1.75 mm thick: 4.8 mm³/s, an ordinary print
CORNER_MM_PER_S = 1.0  # as Klipper's `instantaneous_corner_velocity` where its configuration says nothing
LEAST_MM_PER_S = 1e-3  # below, the law is a straight line: it would be infinitely steep at rest


@dataclass(frozen=True, slots=True)
class Pressure:
    """The model, and what the firmware does against it by itself."""

    time_constant_s: float
    flow_exponent: float = 1.0  # n
    reference_mm_per_s: float = REFERENCE_MM_PER_S  # of filament, the flow at which the time constant holds
    firmware_advance_s: float = 0.0  # the firmware's own pressure advance, which stays on
    corner_velocity_mm_per_s: float = CORNER_MM_PER_S  # by which the extruder's speed may jump between two segments

    def compressed(self, v: FloatArray) -> FloatArray:
        """Return the filament (n,) mm that is compressed where it flows at v (n,) mm/s, 0 or more."""
        share = np.maximum(v, LEAST_MM_PER_S) / self.reference_mm_per_s
        law = self.time_constant_s * self.reference_mm_per_s * share**self.flow_exponent
        return np.asarray(law * np.minimum(v / LEAST_MM_PER_S, 1.0))

    def flow(self, compressed: FloatArray) -> FloatArray:
        """Return how fast filament flows, (n,) mm/s, where so much of it is compressed, (n,) mm; none below zero."""
        least = float(self.compressed(np.array([LEAST_MM_PER_S]))[0])
        share = np.maximum(compressed, least) / (self.time_constant_s * self.reference_mm_per_s)
        law = self.reference_mm_per_s * share ** (1.0 / self.flow_exponent)
        return np.asarray(law * np.clip(compressed / least, 0.0, 1.0))
