"""What suits those who stay with an input shaper: kind, frequency and acceleration, as a firmware's calibration has it.

The fitted machine is put through the firmware's own resonance test in the middle of the bed. The acceleration is the
highest at which the shaper rounds a corner by no more than Klipper tolerates (`TARGET_SMOOTHING` of its calibration).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.shapers.calibration import Fit, calibrated, resonance_test_psd, smoothing
from models.effects.catalogue import effective_machine
from models.machine import Machine

ROUNDED_MM = 0.12  # at a corner, at most
HIGHEST, STEP = 100_000.0, 100.0  # mm/s², looked at and rounded down to
AXES = ("x", "y")


@dataclass(frozen=True, slots=True)
class ShaperAdvice:
    """The shaper of one axis."""

    axis: str
    shaper: str  # a name of the firmware: zv, mzv, ei, …
    frequency_hz: float
    remaining_vibration: float  # share of the measured power that it leaves
    max_accel_mm_per_s2: float


def shaper_advice(machine: Machine, square_corner_velocity: float | None = None) -> tuple[ShaperAdvice, ...]:
    """Return what suits x and y; nothing for an axis that does not answer.

    Parameters
    ----------
    machine : Machine
    square_corner_velocity : float, optional
        In mm/s; None: the machine file's.
    """
    corner = (
        machine.limits.square_corner_velocity_mm_per_s if square_corner_velocity is None else square_corner_velocity
    )
    tested = effective_machine(machine)
    spectra = [resonance_test_psd(tested, np.zeros(2), axis) for axis in ("x", "y")]
    found = zip(AXES, calibrated(spectra[0], spectra[1], corner), strict=True)
    return tuple(_advice(axis, each.recommended, corner) for axis, each in found)


def _advice(axis: str, fit: Fit, corner: float) -> ShaperAdvice:
    return ShaperAdvice(axis, fit.kind, fit.frequency_hz, fit.vibration, _highest(fit, corner))


def _highest(fit: Fit, corner: float) -> float:
    """Return the highest acceleration, mm/s², at which corners are rounded by no more than ROUNDED_MM."""
    low, high = 0.0, HIGHEST
    while high - low > STEP / 10:
        middle = (low + high) / 2
        low, high = (middle, high) if smoothing(fit.shaper, corner, middle) <= ROUNDED_MM else (low, middle)
    return STEP * int(low / STEP)


def in_words(advice: tuple[ShaperAdvice, ...]) -> str:
    """Say it in a sentence, empty without advice."""
    if not advice:
        return ""
    each = ", ".join(f"{one.axis} {one.shaper.upper()} at {one.frequency_hz:.1f} Hz" for one in advice)
    most = min(one.max_accel_mm_per_s2 for one in advice)
    return f"With an input shaper instead (middle of the bed): {each}, max_accel up to {most:.0f} mm/s²."
