"""A delta's geometry, as all three firmwares mean it.

Radii are effective: from the middle of the towers' joints to that of the effector's. Towers A, B, C are X, Y, Z of
RepRapFirmware and Marlin; their angles are counter-clockwise from +x, and so are the trims.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from operator import add

from ffcomp.importers.values import Value, changed, converted, listed, together

TOWER_ANGLES_DEG = (210.0, 330.0, 90.0)
STEEPEST_ARM = 12.0  # carriage speed per nozzle speed beyond which Klipper allows no move


def arm_lengths(arms: Sequence[Value | None]) -> dict[str, Value | None]:
    """Return `arm_length_mm`, or `arm_lengths_mm` where the towers' arms differ."""
    value = together(arms)
    many = value is not None and isinstance(value.value, list)
    return {"kinematics.arm_lengths_mm" if many else "kinematics.arm_length_mm": value}


def tower_angles(trims: Sequence[Value | None]) -> Value:
    """Convert trims of the towers' angles to angles."""
    angles = [
        changed(trim, partial(add, angle), f"added to {angle:g} degrees")
        or Value(angle, "default", "M665 gives no angles: the firmware's towers")
        for trim, angle in zip(trims, TOWER_ANGLES_DEG, strict=True)
    ]
    return listed(angles)


def farthest_reach(arm_mm: float, radius_mm: float) -> float:
    """Return the reach of the steepest arm: 12 L / √(12² + 1) − radius, 0.3 % of its length short of lying flat."""
    return arm_mm * STEEPEST_ARM / math.hypot(STEEPEST_ARM, 1.0) - radius_mm


def print_radius(asked: Value | None, radius: Value | None, arm: Value | None) -> Value | None:
    """Limit the configured print radius to the reach of the shortest arm."""
    if asked is None or radius is None or arm is None:
        return asked
    reach = farthest_reach(arm.number, radius.number)
    if asked.number <= reach:
        return asked
    return converted(round(reach, 3), f"{asked.number:g} mm is more than such arms can do", asked)
