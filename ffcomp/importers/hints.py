"""Hints for values that no firmware knows, and which values of an imported machine are still assumed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from models.provenance import is_assumed

IDENTIFY = "measure: ffcomp record plan --for identify, run its G-code with an accelerometer, then ffcomp identify fit"
HINTS = {  # the beginning of a key -> how to get its value
    "kinematics.effector_height_mm": "measure from the arms' lower joints down to the nozzle's tip",
    "kinematics.print_radius_mm": "how far from the centre the nozzle may go, from the printer's description",
    "kinematics.print_height_mm": "how high the nozzle may go, from the printer's description",
    "kinematics.arm_length": "from the printer's description, or measure from joint to joint",
    "kinematics.delta_radius": "the firmware's delta calibration finds it",
    "kinematics.": "the lowest and the highest position of the axis; Marlin answers it to M115 or M211",
    "carriage.": IDENTIFY,
    "effector.joint_radius_mm": "measure from the effector's centre to the arms' joints",
    "effector.": IDENTIFY,
    "axes.": "a start: --like voron-300 or ender-3; to measure: resonance tests, or any accelerometer, to identify fit",
    "limits.carriage_": "what the motors do without losing steps",
    "limits.": "from the printer's description, or what it prints with",
    "steps.full_steps_per_mm": "full steps of a motor's turn (200, or 400) over the mm of a turn",
    "steps.": "microsteps of a motor's turn over the mm of a turn",
}
IMPORTED = "imported"  # the entry in [provenance] that an import leaves


def hint(key: str) -> str:
    """Say how to get the value of a key."""
    return next(what for beginning, what in HINTS.items() if key.startswith(beginning))


def by_hint(keys: Iterable[str]) -> dict[str, list[str]]:
    """Group keys by hint."""
    grouped: dict[str, list[str]] = {}
    for key in keys:
        grouped.setdefault(hint(key), []).append(key)
    return grouped


def still_assumed(provenance: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence for each group of assumed values of an imported machine file."""
    if IMPORTED not in provenance:
        return
    for what, keys in by_hint(key for key, origin in provenance.items() if is_assumed(str(origin))).items():
        yield f"Not measured: {', '.join(keys)}. To know better: {what}."
