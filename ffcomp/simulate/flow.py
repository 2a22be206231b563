"""What flows out of the nozzle along a plan, by the machine file's model of the hot end's pressure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ffcomp.planner.trajectory import PlannedMotion
from models.arrays import FloatArray
from models.pressure import Pressure

STEP_S = 5e-4
SMOOTHED_S = 8e-3  # segments are steps of flow, which the plastic evens out


@dataclass(frozen=True, eq=False)
class Flow:
    """Filament that should flow and does, at m times, mm/s; retractions are left out."""

    t: FloatArray  # (m,) s
    pushed: FloatArray  # (m,) by the plan's filament
    flows: FloatArray  # (m,)

    def at(self, t: FloatArray) -> FloatArray:
        """Return what flows at times (k,) s, (k,) mm/s."""
        return np.interp(t, self.t, self.flows)


def flow_of(plan: PlannedMotion, pressure: Pressure) -> Flow:
    """Play a plan's filament through the firmware's own pressure advance and an extruder of one state."""
    t = np.arange(float(plan.start_t[0]), plan.end_t, STEP_S)
    travels = np.any(plan.direction[:, :3] != 0.0, axis=1)[plan.move_at(t)]
    along = travels[1:] & travels[:-1]
    pushed = np.append(np.where(along, np.diff(plan.position(t)[:, 3]), 0.0) / STEP_S, 0.0)
    by_motor = pushed + pressure.firmware_advance_s * np.gradient(pushed, STEP_S)
    tau, v, n = pressure.time_constant_s, pressure.reference_mm_per_s, pressure.flow_exponent
    out = _played(by_motor, STEP_S, tau * v, v, 1.0 / n)
    window = np.ones(max(1, round(SMOOTHED_S / STEP_S)))
    return Flow(t, pushed, np.convolve(out, window / window.sum(), mode="same"))


@njit(cache=True, nogil=True)
def _played(pushed: FloatArray, step_s: float, compressed_there: float, v: float, power: float) -> FloatArray:
    """Return what flows, (m,) mm/s; `compressed_there` is what is compressed where it flows at v."""
    out = np.zeros(len(pushed))
    compressed = 0.0
    for k in range(len(pushed)):
        compressed += pushed[k] * step_s
        if compressed > 0.0:
            out[k] = min(v * (compressed / compressed_there) ** power, compressed / step_s)
            compressed -= out[k] * step_s
    return out
