"""What can happen to any printer's orders and readings, whatever its kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from scipy.signal import butter, sosfilt

from validation.blind.printer.real import FloatArray, Order, Reader, Reading, Rng

SLIP_S = 0.006


def behind(fastest_mm_per_s: float) -> Order:
    """Return orders of which a driver follows at most so much a second."""

    def limited(t: FloatArray, command: FloatArray) -> FloatArray:
        return _behind(np.ascontiguousarray(command), fastest_mm_per_s * (t[1] - t[0]))

    return limited


@njit(cache=True)
def _behind(command: FloatArray, most: float) -> FloatArray:
    """Follow (n, motors) by at most so much a row."""
    out = command.copy()
    for n in range(1, len(command)):
        for i in range(command.shape[1]):
            out[n, i] = out[n - 1, i] + min(max(command[n, i] - out[n - 1, i], -most), most)
    return out


def slipped(rng: Rng, slip_mm: float, motors: int) -> Order:
    """Return orders with six slips of one motor, anywhere in a run."""
    motor, shares = int(rng.integers(motors)), np.sort(rng.uniform(0.1, 0.9, 6))
    steps = slip_mm * rng.choice([-1.0, 1.0], 6)

    def slipping(t: FloatArray, command: FloatArray) -> FloatArray:
        out = command.copy()
        for share, step in zip(shares, steps, strict=True):
            x = np.clip((t - share * t[-1]) / SLIP_S, 0.0, 1.0)
            out[:, motor] += step * x**2 * (3 - 2 * x)
        return out

    return slipping


def hummed(rng: Rng, level: FloatArray) -> Reader:
    """Return readings with a tone of 44 to 110 Hz, (6,) m/s² on carriages and nozzle."""
    hertz, phase = rng.uniform(44.0, 110.0), rng.uniform(0, 2 * np.pi, 6)

    def read(r: Reading) -> Reading:
        tone = level * np.sin(2 * np.pi * hertz * r.t[:, None] + phase)
        return replace(r, carriage=r.carriage + tone[:, :3], nozzle=r.nozzle + tone[:, 3:])

    return read


def slowed(cutoff_hz: float, size: float) -> Reader:
    """Return readings of which the nozzle's went through a low-pass of second order."""

    def read(r: Reading) -> Reading:
        sections = butter(2, cutoff_hz, fs=1 / (r.t[1] - r.t[0]), output="sos")
        return replace(r, nozzle=sosfilt(sections, r.nozzle, axis=0)) if size > 0 else r

    return read


def clipped_at(most_m_per_s2: float, size: float) -> Reader:
    """Return readings of which the nozzle's end at so much."""

    def read(r: Reading) -> Reading:
        return replace(r, nozzle=np.clip(r.nozzle, -most_m_per_s2, most_m_per_s2)) if size > 0 else r

    return read
