"""How to get the numbers that no firmware knows, and which of an imported machine's numbers are still assumed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

IDENTIFY = "measure: ffcomp identify plan, run its G-code with an accelerometer, then ffcomp identify fit"
REMEDIES = {  # the beginning of a key -> what to do
    "kinematics.effector_height_mm": "measure from the arms' lower joints down to the nozzle's tip",
    "kinematics.print_radius_mm": "how far from the centre the nozzle may go, from the printer's description",
    "kinematics.print_height_mm": "how high the nozzle may go, from the printer's description",
    "kinematics.arm_length": "from the printer's description, or measure from joint to joint",
    "kinematics.delta_radius": "the firmware's delta calibration finds it",
    "kinematics.": "the lowest and the highest place of the axis; Marlin answers it to M115 or M211",
    "carriage.": IDENTIFY,
    "effector.joint_radius_mm": "measure from the effector's centre to the arms' joints",
    "effector.": IDENTIFY,
    "axes.": "import with --like voron-300 or ender-3, then give the firmware's resonance tests to ffcomp identify fit",
    "limits.carriage_": "what the motors do without losing steps",
    "limits.": "from the printer's description, or what it prints with",
    "steps.full_steps_per_mm": "full steps of a motor's turn (200, or 400) over the mm of a turn",
    "steps.": "microsteps of a motor's turn over the mm of a turn",
}
ASSUMED = "assumed"  # how the provenance of an assumed number begins
START = "as a start"  # stands in the provenance of a number that is only near the one meant
IMPORTED = "imported"  # the entry in [provenance] that an import leaves


def remedy(key: str) -> str:
    return next(what for beginning, what in REMEDIES.items() if key.startswith(beginning))


def is_assumed(origin: str) -> bool:
    return origin.startswith(ASSUMED) or START in origin


def by_remedy(keys: Iterable[str]) -> dict[str, list[str]]:
    """What to do -> the keys that it would give."""
    grouped: dict[str, list[str]] = {}
    for key in keys:
        grouped.setdefault(remedy(key), []).append(key)
    return grouped


def still_assumed(provenance: Mapping[str, Any]) -> Iterator[str]:
    """A sentence for each thing to do about an imported machine file; nothing about one that began otherwise."""
    if IMPORTED not in provenance:
        return
    for what, keys in by_remedy(key for key, origin in provenance.items() if is_assumed(str(origin))).items():
        yield f"Not measured: {', '.join(keys)}. To know better: {what}."
