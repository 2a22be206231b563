"""The firmware's own motion limits, as a file may set them; NaN stands for "the machine's own"."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import nan

from gcode.program import Program


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of the firmware's planner."""

    velocity: float = nan  # mm/s
    acceleration: float = nan  # mm/s²; where travel has its own, of moves that extrude
    square_corner_velocity: float = nan  # mm/s
    minimum_cruise_ratio: float = nan  # -
    travel_acceleration: float = nan  # mm/s², Marlin and RepRapFirmware: of moves that do not extrude; NaN: no other


MACHINE_LIMITS = MotionLimits()


def limits_in_effect(program: Program, before: Mapping[bytes, bytes]) -> dict[bytes, bytes]:
    """Return the file's last command for each limit at the end of a program; `before`: at its beginning."""
    said = dict(before)
    for event in program.events:
        if event.touches_limits:
            said |= limit_set_by(program.lines[event.line])
    return said


def limit_set_by(line: bytes) -> dict[bytes, bytes]:
    """Return the command of a line by its name and letters: one with other letters sets other limits."""
    code = line.partition(b";")[0].strip()
    letters = b"".join(sorted(set(re.findall(rb"[A-Z]", code.upper()))))
    return {code.split()[0].upper() + letters: code}
