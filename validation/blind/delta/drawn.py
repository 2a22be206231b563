"""How large the hidden effects of a delta are drawn."""

from __future__ import annotations

import numpy as np

from validation.blind.printer.drawn import Drawn, Table, told
from validation.blind.printer.real import FloatArray, Real


def _springs(real: Real) -> FloatArray:
    return np.ones(3) * real.machine["carriage"]["belt_stiffness_n_per_m"]


def _forces(_: Real, **values: FloatArray) -> Table:
    return {key: told(value) for key, value in values.items()}


TOWERS = Drawn(
    motors=3,
    loads=lambda real: np.ones(3),
    forces=_forces,
    uneven=(0.3, 1.7),
    friction=(1.0, 4.0),
    stiction=(0.8, 2.2),
    grease=(8.0, 25.0),
    slope_per_m=(0.7, 1.8),
    centre_mm=(330, 430),
    play_mm=(0.04, 0.12),
    stepper_mm=(0.35, 0.8),
    ripple_mm=(0.004, 0.014),
    frame_kg=(4.0, 14.0),
    frame_hz=(10.0, 45.0),
    pulley_m=(4e-5, 9e-5),
    pulley_share=(0.15, 0.3),
    warm_share=(0.15, 0.3),
    warm_s=(0.8, 2.0),
    cable_kg=(0.1, 0.25),
    fan=(0.4, 1.2),
    fan_felt=(1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
    notch=(3.0, 8.0),
    bracket="soft_tower",
    springs=_springs,
)
