"""What printers of every kind do that no entry of the catalogue is meant for: a diagnosis must end in `unknown`.

Signature as in `hidden`: `SHARED[name](kind, rng, size, real)` → ({}, the printer).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from validation.blind.printer.drawn import Drawn, Table
from validation.blind.printer.hidden import Drawing
from validation.blind.printer.mishaps import behind, clipped_at, hummed, slipped, slowed
from validation.blind.printer.real import Real, Rng, sign


def off_centre_pulley(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Once a turn (40 mm) the belt runs ahead, and is tighter."""
    fields = {
        "ripple": size * rng.uniform(*kind.pulley_m, kind.motors),
        "ripple_wave": np.full(kind.motors, 2 * np.pi / 0.04),
        "pulley_share": size * rng.uniform(*kind.pulley_share),
        "pulley_wave": 2 * np.pi / 0.04,
    }
    return {}, real.having(**fields)


def warming_belt(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Hide it: the belts soften while they work; before the next run they cool."""
    return {}, real.having(warm_share=size * rng.uniform(*kind.warm_share), warm_s=rng.uniform(*kind.warm_s))


def slow_driver(_: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Hide it: a driver that cannot turn its motors faster than so, and catches up when it can."""
    return {}, real.ordered(behind(rng.uniform(25.0, 40.0) / size if size > 0 else np.inf))


def missed_steps(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Hide it: a motor slips by four full steps, several times in every run, at times that nothing tells."""
    slip = 4.0 / real.machine["steps"]["full_steps_per_mm"] * (1.0 if size > 0 else 0.0)
    return {}, real.ordered(slipped(rng, slip, kind.motors))


def swinging_cable(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Hide it: a bundle of cables and filament that hangs on what moves, and swings by itself."""
    mass, hertz, ratio = size * rng.uniform(*kind.cable_kg), rng.uniform(6.0, 16.0), rng.uniform(0.05, 0.15)
    omega = 2 * np.pi * hertz
    kept = mass if size > 0 else 1.0
    return {}, real.having(cable_mass=kept, cable_k=mass * omega**2, cable_b=2 * ratio * omega * mass)


def fans_tone(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Hide it: a fan that starts with every run shakes all sensors at its own frequency."""
    return {}, real.read_by(hummed(rng, size * rng.uniform(*kind.fan, 6) * kind.fan_felt))


def notched_wheel(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Carriage wheels out of round: a force by where the carriage stands, whichever way it goes."""
    notch = size * rng.uniform(*kind.notch, kind.motors) * kind.loads(real)
    return {}, real.having(notch=notch, notch_wave=2 * np.pi / rng.uniform(2e-3, 6e-3))


def soft_bracket(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """One motor's bracket gives way and rings."""
    mass, hertz, ratio = rng.uniform(0.4, 0.8), rng.uniform(25.0, 70.0), rng.uniform(0.02, 0.06)
    omega = 2 * np.pi * hertz
    which = {kind.bracket: int(rng.integers(kind.motors)) if size > 0 else -1}
    return {}, real.having(**which, soft_mass=mass, soft_k=mass * omega**2, soft_b=2 * ratio * omega * mass)


def creeping_belt(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Hide it: a belt that is stiffer the faster it is pulled (a spring and a dashpot in series beside the spring)."""
    added = size * rng.uniform(0.25, 0.5) * kind.springs(real)
    return {}, real.having(visco_k=added, visco_s=rng.uniform(4e-3, 1.2e-2))


def heavy_rotor(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Hide it: rotors with inertia between magnets and belts, which at rest give way together as the file says."""
    share, hertz = rng.uniform(3.0, 6.0), rng.uniform(70.0, 130.0)
    magnets = share * kind.springs(real)
    mass = size * magnets / (2 * np.pi * hertz) ** 2
    fields = {"rotor_k": magnets, "rotor_b": rng.uniform(0.02, 0.06) * 2 * np.sqrt(magnets * mass)}
    if size > 0:
        fields["belt_k"] = magnets / (share - 1.0)  # of the belt alone
    return {}, real.having(rotor=mass, **fields)


def one_sided_belt(kind: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Hide it: belts that are stiffer pulled than pushed, for one side is slack."""
    return {}, real.having(lean=size * sign(rng) * kind.some(rng) * rng.uniform(0.25, 0.45))


def sluggish_sensor(_: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Hide it: the nozzle's accelerometer answers slowly: a low-pass of second order."""
    return {}, real.read_by(slowed(rng.uniform(70.0, 130.0), size))


def clipping_sensor(_: Drawn, rng: Rng, size: float, real: Real) -> tuple[Table, Real]:
    """Hide it: the nozzle's accelerometer ends at some m/s², well below the loudest that it feels."""
    return {}, real.read_by(clipped_at(rng.uniform(5.0, 9.0), size))


SHARED: Mapping[str, Drawing] = {
    hide.__name__: hide
    for hide in (
        off_centre_pulley,
        warming_belt,
        slow_driver,
        missed_steps,
        swinging_cable,
        fans_tone,
        notched_wheel,
        soft_bracket,
        creeping_belt,
        heavy_rotor,
        one_sided_belt,
        sluggish_sensor,
        clipping_sensor,
    )
}
