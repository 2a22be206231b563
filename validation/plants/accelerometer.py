"""Accelerometers as owners have them: counts, noise, gravity, a tilt, axes turned, and a clock of their own.

What a firmware makes of their samples: Klipper dates each with its print time, and keeps those between the ends of two
rests; RepRapFirmware counts them, and states a rate; others write their own time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from validation.plants import delta_plant

FloatArray = NDArray[np.float64]

GRAVITY_M_PER_S2 = 9.80665
STEP_S, KEPT = 1 / 12800, 2  # of the plant's integration; rows that are kept


@dataclass(frozen=True, eq=False)
class Chip:
    """An ADXL345, more or less."""

    rate_hz: float
    turn: FloatArray  # (3, 3) from the printer's axes to the chip's, its tilt included
    count_m_per_s2: float = 3.9e-3 * GRAVITY_M_PER_S2
    noise_m_per_s2: float = 0.15
    coloured: bool = False  # more of the noise at low frequencies

    def counts(self, felt: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Measure accelerations (n, 3) along the printer's axes: (n, 3) m/s² along the chip's."""
        own = (felt + np.array([0.0, 0.0, GRAVITY_M_PER_S2])) @ self.turn.T
        noise = rng.standard_normal(own.shape)
        if self.coloured:
            noise = 0.8 * noise + 0.5 * lfilter([0.8], [1.0, -0.6], rng.standard_normal(own.shape), axis=0)
        own = own + self.noise_m_per_s2 * noise
        return np.rint(own / self.count_m_per_s2) * self.count_m_per_s2

    def sampled(
        self, felt: CubicSpline, begin_s: float, end_s: float, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Measure what is felt between two times, from some part of a sample on: (n,) s, and `counts` (n, 3)."""
        t = np.arange(begin_s + rng.uniform() / self.rate_hz, end_s, 1 / self.rate_hz)
        return t, self.counts(felt(t), rng)


def draw_chip(rng: np.random.Generator, axes: FloatArray, tilt_deg: float = 2.0, rate_hz: float = 3200.0) -> Chip:
    """Draw a chip whose rate is within 1 %, tilted by so much about a horizontal axis, on a signed permutation."""
    about = rng.uniform(0, 2 * np.pi)
    tilt = Rotation.from_rotvec([tilt_deg * np.cos(about), tilt_deg * np.sin(about), 0.0], degrees=True)
    return Chip(rate_hz * rng.uniform(0.99, 1.01), axes @ tilt.as_matrix())


def nozzle_felt(machine: dict[str, Any], nozzle: Any, begin_s: float, end_s: float) -> CubicSpline:
    """Acceleration of the nozzle holder (m/s²) over time, of a command: nozzle(t (k,) s) → (k, 3) mm."""
    count = 2 * round((end_s - begin_s) / STEP_S) + 1
    t = begin_s + np.arange(count) * STEP_S / 2
    command = delta_plant.carriages_of(machine, nozzle(t))
    found = delta_plant.simulate(machine, command, STEP_S, gravity=True, keep_every=KEPT)
    return CubicSpline(begin_s + found["t"], found["nozzle_acc_m_per_s2"])


def klipper_capture(
    felt: CubicSpline, chip: Chip, begin_s: float, end_s: float, print_time_s: float, rng: np.random.Generator
) -> str:
    """Text of the capture between two toggles, `begin_s` and `end_s` on the clock of `felt`."""
    t, values = chip.sampled(felt, begin_s, end_s, rng)
    return klipper_text(t - begin_s + print_time_s, 1e3 * values)


def klipper_text(time_s: FloatArray, mm_per_s2: FloatArray, digits: int = 6) -> str:
    """Write times (n,) and accelerations (n, 3) as Klipper does."""
    rows = zip(time_s.tolist(), *mm_per_s2.T.tolist(), strict=True)
    lines = (f"{t:.6f},{x:.{digits}f},{y:.{digits}f},{z:.{digits}f}\n" for t, x, y, z in rows)
    return "#time,accel_x,accel_y,accel_z\n" + "".join(lines)


def reprapfirmware_capture(
    felt: CubicSpline, chip: Chip, begin_s: float, end_s: float, rng: np.random.Generator
) -> tuple[str, float]:
    """Text of a capture that begins somewhat late, and the time of its first row on the clock of `felt`.

    The rate that it states is off by up to 0.3 %.
    """
    first = begin_s + rng.uniform(0.0, 0.2)
    t = np.arange(first, end_s, 1 / chip.rate_hz)
    values = chip.counts(felt(t), rng) / GRAVITY_M_PER_S2
    rows = "".join(f"{k},{x:.4f},{y:.4f},{z:.4f}\n" for k, (x, y, z) in enumerate(values.tolist()))
    stated = chip.rate_hz * (1 + rng.uniform(-3e-3, 3e-3))
    return f"Sample,X,Y,Z\n{rows}Rate {stated:.0f}, overflows 0\n", first
