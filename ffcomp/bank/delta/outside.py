"""What printers do that no entry of the catalogue is meant for: a diagnosis must end in `unknown`.

Signature as in `hidden`: `OUTSIDE[name](rng, size, real)` → ({}, the printer).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ffcomp.bank.mishaps import behind, clipped_at, hummed, slipped, slowed
from ffcomp.bank.real import Hide, Real, Rng


def off_centre_pulley(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Once a turn (40 mm) the belt runs ahead, and is tighter."""
    fields = {
        "ripple": size * rng.uniform(4e-5, 9e-5, 3),
        "ripple_wave": np.full(3, 2 * np.pi / 0.04),
        "ripple_phase": 0.0,
        "pulley_share": size * rng.uniform(0.15, 0.3),
        "pulley_wave": 2 * np.pi / 0.04,
    }
    return {}, real.having(**fields)


def warming_belt(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the belts soften while they work; before the next run they cool."""
    return {}, real.having(warm_share=size * rng.uniform(0.15, 0.3), warm_s=rng.uniform(0.8, 2.0))


def slow_driver(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a driver that cannot turn its motor faster than so, and catches up when it can."""
    return {}, real.ordered(behind(rng.uniform(25.0, 40.0) / size if size > 0 else np.inf))


def missed_steps(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a motor slips by four full steps, several times in every run, at times that nothing tells."""
    slip = 4.0 / real.machine["steps"]["full_steps_per_mm"] * (1.0 if size > 0 else 0.0)
    return {}, real.ordered(slipped(rng, slip, 3))


def swinging_cable(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a bundle of cables and filament that hangs on the holder and swings by itself."""
    mass, hertz, ratio = size * rng.uniform(0.1, 0.25), rng.uniform(6.0, 16.0), rng.uniform(0.05, 0.15)
    omega = 2 * np.pi * hertz
    return {}, real.having(
        cable_mass=mass if size > 0 else 1.0, cable_k=mass * omega**2, cable_b=2 * ratio * omega * mass
    )


def fans_tone(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a fan that starts with every run shakes all sensors at its own frequency."""
    return {}, real.read_by(hummed(rng, size * rng.uniform(0.4, 1.2, 6)))


def notched_wheel(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Carriage wheels out of round: a force by where the carriage stands, whichever way it goes."""
    return {}, real.having(notch=size * rng.uniform(3.0, 8.0, 3), notch_wave=2 * np.pi / rng.uniform(2e-3, 6e-3))


def soft_tower(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """One motor's bracket gives way and rings."""
    mass, hertz, ratio = rng.uniform(0.4, 0.8), rng.uniform(25.0, 70.0), rng.uniform(0.02, 0.06)
    omega = 2 * np.pi * hertz
    return {}, real.having(
        soft_tower=int(rng.integers(3)) if size > 0 else -1,
        soft_mass=mass,
        soft_k=mass * omega**2,
        soft_b=2 * ratio * omega * mass,
    )


def loose_extruder(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the extruder swings against a stop: beyond a gap its mount is several times stiffer."""
    stiffness = min(real.machine["effector"]["extruder_stiffness_n_per_m"])
    return {}, real.having(stop_gap=rng.uniform(0.1e-3, 0.3e-3), stop_k=size * rng.uniform(4.0, 9.0) * stiffness)


def creeping_belt(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: a belt that is stiffer the faster it is pulled (a spring and a dashpot in series beside the spring)."""
    stiffness = real.machine["carriage"]["belt_stiffness_n_per_m"]
    added = size * rng.uniform(0.25, 0.5) * np.broadcast_to(stiffness, 3)
    return {}, real.having(visco_k=added, visco_s=rng.uniform(4e-3, 1.2e-2))


def sluggish_sensor(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the nozzle's accelerometer answers slowly: a low-pass of second order."""
    return {}, real.read_by(slowed(rng.uniform(70.0, 130.0), size))


def clipping_sensor(rng: Rng, size: float, real: Real) -> tuple[dict[str, Any], Real]:
    """Hide it: the nozzle's accelerometer ends at some m/s², well below the loudest that it feels."""
    return {}, real.read_by(clipped_at(rng.uniform(5.0, 9.0), size))


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
        soft_tower,
        loose_extruder,
        creeping_belt,
        sluggish_sensor,
        clipping_sensor,
    )
}
