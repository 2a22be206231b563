"""What printers do that no entry of the catalogue is meant for: a diagnosis must end in `unknown`.

Signature as in `hidden`: `OUTSIDE[name](rng, size, real)` → ({}, the printer).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from validation.blind.delta.drawn import TOWERS
from validation.blind.printer.hidden import of_kind
from validation.blind.printer.outside import SHARED
from validation.blind.printer.real import Hide, Real, Rng


def loose_extruder(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the extruder swings against a stop: beyond a gap its mount is several times stiffer."""
    stiffness = min(real.machine["effector"]["extruder_stiffness_n_per_m"])
    return {}, real.having(stop_gap=rng.uniform(0.1e-3, 0.3e-3), stop_k=size * rng.uniform(4.0, 9.0) * stiffness)


_SHARED = of_kind(SHARED, TOWERS)
_KNOWN: Mapping[str, Hide] = {**_SHARED, "soft_tower": _SHARED["soft_bracket"], "loose_extruder": loose_extruder}
OUTSIDE: Mapping[str, Hide] = {  # in the order in which the bank draws them
    name: _KNOWN[name]
    for name in (
        "off_centre_pulley",
        "warming_belt",
        "slow_driver",
        "missed_steps",
        "swinging_cable",
        "fans_tone",
        "notched_wheel",
        "soft_tower",
        "loose_extruder",
        "creeping_belt",
        "heavy_rotor",
        "sluggish_sensor",
        "clipping_sensor",
    )
}
