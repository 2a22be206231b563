"""What printers with straight axes do that no entry of the catalogue is meant for: a diagnosis must say `unknown`.

Signature as in `hidden`: `OUTSIDE[name](rng, size, real)` → ({}, the printer).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ffcomp.bank.mishaps import behind, clipped_at, hummed, slipped, slowed
from ffcomp.bank.real import Hide, Real, Rng
from ffcomp.bank.straight.hidden import masses


def off_centre_pulley(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Once a turn (40 mm) the belt runs ahead, and is tighter."""
    fields = {
        "ripple": size * rng.uniform(8e-5, 1.6e-4, 2),
        "ripple_wave": np.full(2, 2 * np.pi / 0.04),
        "pulley_share": size * rng.uniform(0.2, 0.35),
        "pulley_wave": 2 * np.pi / 0.04,
    }
    return {}, real.having(**fields)


def warming_belt(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the belts soften while they work; before the next run they cool."""
    return {}, real.having(warm_share=size * rng.uniform(0.2, 0.35), warm_s=rng.uniform(0.6, 1.5))


def slow_driver(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a driver that cannot turn its motors faster than so, and catches up when it can."""
    return {}, real.ordered(behind(rng.uniform(25.0, 40.0) / size if size > 0 else np.inf))


def missed_steps(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a motor slips by four full steps, several times in every run, at times that nothing tells."""
    slip = 4.0 / real.machine["steps"]["full_steps_per_mm"] * (1.0 if size > 0 else 0.0)
    return {}, real.ordered(slipped(rng, slip, 2))


def swinging_cable(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a bundle of cables and filament that hangs on what moves, and swings by itself."""
    mass, hertz, ratio = size * rng.uniform(0.06, 0.15), rng.uniform(6.0, 16.0), rng.uniform(0.05, 0.15)
    omega = 2 * np.pi * hertz
    kept = mass if size > 0 else 1.0
    return {}, real.having(cable_mass=kept, cable_k=mass * omega**2, cable_b=2 * ratio * omega * mass)


def fans_tone(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a fan that starts with every run shakes the sensors at its own frequency."""
    return {}, real.read_by(hummed(rng, size * rng.uniform(0.5, 1.5, 6) * [0, 0, 0, 1, 1, 0]))


def notched_wheel(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Wheels out of round: a force by where the carriage stands, whichever way it goes."""
    notch = size * rng.uniform(4.0, 10.0, 2) * masses(real)
    return {}, real.having(notch=notch, notch_wave=2 * np.pi / rng.uniform(2e-3, 6e-3))


def soft_motor(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """One motor's bracket gives way and rings."""
    mass, hertz, ratio = rng.uniform(0.4, 0.8), rng.uniform(25.0, 70.0), rng.uniform(0.02, 0.06)
    omega = 2 * np.pi * hertz
    motor = int(rng.integers(2)) if size > 0 else -1
    return {}, real.having(soft_motor=motor, soft_mass=mass, soft_k=mass * omega**2, soft_b=2 * ratio * omega * mass)


def creeping_belt(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a belt that is stiffer the faster it is pulled (a spring and a dashpot in series beside the spring)."""
    added = size * rng.uniform(0.25, 0.5) * np.array(real.machine["plant"]["belt_k"])
    return {}, real.having(visco_k=added, visco_s=rng.uniform(4e-3, 1.2e-2))


def sluggish_sensor(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the accelerometers answer slowly: a low-pass of second order."""
    return {}, real.read_by(slowed(rng.uniform(70.0, 130.0), size))


def clipping_sensor(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the accelerometers end at some m/s², well below the loudest that they feel."""
    return {}, real.read_by(clipped_at(rng.uniform(5.0, 9.0), size))


def loose_load(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide a loose tray or spool on what moves: it slides where it is pushed harder than friction holds it."""
    share, grip = size * rng.uniform(0.15, 0.3), rng.uniform(1.0, 2.5)
    return {}, real.having(loose=share * masses(real), loose_grip=grip)


OUTSIDE: Mapping[str, Hide] = {
    hide.__name__: hide
    for hide in (
        off_centre_pulley,
        warming_belt,
        slow_driver,
        missed_steps,
        swinging_cable,
        fans_tone,
        notched_wheel,
        soft_motor,
        creeping_belt,
        sluggish_sensor,
        clipping_sensor,
        loose_load,
    )
}
