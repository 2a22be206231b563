"""A delta's sub-models as transfer functions of python-control, to design with, simulate or plot.

The whole printer is `machine.vibration.to_control(xy)`. python-control takes seconds to import, so it is imported where
it is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from models.vibration.delta import DeltaVibration
from models.vibration.substructures import Effector, damping

if TYPE_CHECKING:
    from control import TransferFunction

Polynomial = NDArray[np.floating]  # (n,) coefficients, highest power first

AXES = "xyz"


def carriage_alone(model: DeltaVibration, added_mass_kg: float = 0.0) -> TransferFunction:
    """Return G_qd of Eq. 31, or G'_qd of Eq. 37 with a mass screwed on: command to position."""
    carriage, drive = model.carriage, model.carriage.drive
    num: Polynomial = np.array([carriage.belt_damping_n_s_per_m, carriage.belt_stiffness_n_per_m])
    den = _carriage_polynomial(model, added_mass_kg)
    if drive is not None:
        num = np.polymul(num, [drive.d1_per_s, drive.d0_per_s2])
        den = np.polymul(den, [1.0, drive.d2_per_s, drive.d0_per_s2])
    import control

    return control.TransferFunction(num, den, inputs=["cmd"], outputs=["pos"], name="carriage_alone")


def carriage_load(model: DeltaVibration) -> TransferFunction:
    """Return G_Fq of Eq. 44, m/N: the effector's load to position."""
    den = _carriage_polynomial(model, 0.0)
    import control

    return control.TransferFunction([-1.0], den, inputs=["force"], outputs=["pos"], name="carriage_load")


def effector_alone(model: DeltaVibration, with_arms: bool = False) -> TransferFunction:
    """Return Eq. 45, 1/kg, one axis beside the other: force on the nozzle holder to its acceleration.

    with_arms : the arms' lower halves ride along, as they do in W.
    """
    nozzle_side = model.nozzle_side_mass_kg if with_arms else model.effector.nozzle_mass_kg
    return _diagonal(
        [_struck(model.effector, nozzle_side, axis) for axis in range(3)], "force", "acc", "effector_alone"
    )


def effector_load(model: DeltaVibration) -> TransferFunction:
    """Return W of Eq. 61, N/m: nozzle position to the force it takes. Improper: twice more zeros than poles."""
    struck = [_struck(model.effector, model.nozzle_side_mass_kg, axis) for axis in range(3)]
    return _diagonal([(np.polymul(den, [1.0, 0.0, 0.0]), num) for num, den in struck], "pos", "force", "effector_load")


def _carriage_polynomial(model: DeltaVibration, added_mass_kg: float) -> Polynomial:
    """Return m s² + (c + b) s + k."""
    carriage = model.carriage
    return np.array([carriage.moving_mass_kg + added_mass_kg, damping(carriage), carriage.belt_stiffness_n_per_m])


def _struck(effector: Effector, nozzle_side_kg: float, axis: int) -> tuple[Polynomial, Polynomial]:
    """Return numerator and denominator of Eq. 45."""
    m2 = effector.extruder_mass_kg
    both, m12 = nozzle_side_kg + m2, nozzle_side_kg * m2
    b, k = effector.extruder_damping_n_s_per_m[axis], effector.extruder_stiffness_n_per_m[axis]
    return np.array([m2, b, k]), np.array([m12, both * b, both * k])


def _diagonal(fractions: Sequence[tuple[Polynomial, Polynomial]], of: str, to: str, name: str) -> TransferFunction:
    nothing = (np.zeros(1), np.ones(1))
    table = [[fractions[i] if i == k else nothing for k in range(3)] for i in range(3)]
    import control

    return control.TransferFunction(
        [[num for num, _ in row] for row in table],
        [[den for _, den in row] for row in table],
        inputs=[f"{of}_{axis}" for axis in AXES],
        outputs=[f"{to}_{axis}" for axis in AXES],
        name=name,
    )
