"""The firmware's own motion limits, as a file may set them; NaN stands for "the machine's own"."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan


@dataclass(frozen=True, slots=True)
class MotionLimits:
    velocity: float = nan  # mm/s
    acceleration: float = nan  # mm/s²; where travel has its own, of moves that extrude
    square_corner_velocity: float = nan  # mm/s
    minimum_cruise_ratio: float = nan  # -
    travel_acceleration: float = nan  # mm/s², Marlin and RepRapFirmware: of moves that do not extrude; NaN: no other


MACHINE_LIMITS = MotionLimits()
