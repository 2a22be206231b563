"""How large the hidden effects of a printer with straight axes are drawn: forces go with what they carry."""

from __future__ import annotations

import numpy as np

from validation.blind.printer.drawn import Drawn, Table, told
from validation.blind.printer.real import FloatArray, Real


def masses(real: Real) -> FloatArray:
    """Return all that each axis moves, (2,) kg."""
    return np.array(real.machine["plant"]["carriage"]) + np.array(real.machine["plant"]["tool"])


def springs(real: Real) -> FloatArray:
    """Return the stiffness of each belt, (2,) N/m."""
    return np.array(real.machine["plant"]["belt_k"])


def of_mass(real: Real, **values: FloatArray) -> Table:
    """Return forces of the axes, (2,) each, by a file's keys: per kilogram where it states no masses."""
    if real.machine["masses"]:
        return {key: told(value) for key, value in values.items()}
    return {f"{key}_per_kg": told(value / masses(real)) for key, value in values.items()}


AXES = Drawn(
    motors=2,
    loads=masses,
    forces=of_mass,
    uneven=(0.4, 1.6),
    friction=(1.2, 4.0),
    stiction=(1.2, 3.0),
    grease=(12.0, 40.0),
    slope_per_m=(1.0, 2.2),
    centre_mm=(70, 130),
    play_mm=(0.06, 0.16),
    stepper_mm=(0.5, 1.0),
    ripple_mm=(0.005, 0.015),
    frame_kg=(5.0, 15.0),
    frame_hz=(10.0, 30.0),
    pulley_m=(8e-5, 1.6e-4),
    pulley_share=(0.2, 0.35),
    warm_share=(0.2, 0.35),
    warm_s=(0.6, 1.5),
    cable_kg=(0.06, 0.15),
    fan=(0.5, 1.5),
    fan_felt=(0.0, 0.0, 0.0, 1.0, 1.0, 0.0),
    notch=(4.0, 10.0),
    bracket="soft_motor",
    springs=springs,
)
