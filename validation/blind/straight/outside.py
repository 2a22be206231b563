"""What printers with straight axes do that no entry of the catalogue is meant for: a diagnosis must say `unknown`.

Signature as in `hidden`: `OUTSIDE[name](rng, size, real)` → ({}, the printer).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from validation.blind.printer.hidden import of_kind
from validation.blind.printer.outside import SHARED
from validation.blind.printer.real import Hide, Real, Rng
from validation.blind.straight.drawn import AXES, masses


def loose_load(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a loose tray or spool on what moves: it slides where it is pushed harder than friction holds it."""
    share, grip = size * rng.uniform(0.15, 0.3), rng.uniform(1.0, 2.5)
    return {}, real.having(loose=share * masses(real), loose_grip=grip)


_SHARED = of_kind(SHARED, AXES)
_KNOWN: Mapping[str, Hide] = {**_SHARED, "soft_motor": _SHARED["soft_bracket"], "loose_load": loose_load}
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
        "soft_motor",
        "creeping_belt",
        "heavy_rotor",
        "one_sided_belt",
        "sluggish_sensor",
        "clipping_sensor",
        "loose_load",
    )
}
