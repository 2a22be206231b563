"""Mass along the arms in the linear model, against the kinetic energy of rods summed over their points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.kinds import delta_vibration, with_parts
from models.machine import Machine

PLACES = np.array([[0.0, 0.0], [70.0, -40.0], [-20.0, 110.0]])


def with_share(machine: Machine, share: float, arm_pair_mass_kg: float = 0.2) -> Machine:
    carriage = replace(
        delta_vibration(machine).carriage, arm_pair_mass_kg=arm_pair_mass_kg, arm_mass_share_at_ends=share
    )
    return with_parts(machine, carriage=carriage)


def summed_energy(machine: Machine, xy: np.ndarray, rates: np.ndarray) -> float:
    """Return ½ ∫ v² dm over carriages, rods and effector, J, for the rates of (q, η) : (6,) m/s."""
    vibration = delta_vibration(machine)
    nozzle = machine.kinematics.jacobian(xy[None])[0] @ rates[:3]
    share, arm = vibration.carriage.arm_mass_share_at_ends, vibration.carriage.arm_pair_mass_kg
    where, weights = np.polynomial.legendre.leggauss(3)  # exact for what is square in the place along the rod
    energy = vibration.carriage.mass_kg * rates[:3] @ rates[:3] + vibration.effector.nozzle_mass_kg * nozzle @ nozzle
    energy += vibration.effector.extruder_mass_kg * np.sum((nozzle + rates[3:]) ** 2)
    for rate in rates[:3]:
        upper = np.array([0.0, 0.0, rate])
        along = upper + (where[:, None] + 1) / 2 * (nozzle - upper)
        energy += (1 - share) * arm / 2 * weights @ np.sum(along**2, axis=1)
        energy += share * arm / 2 * (upper @ upper + nozzle @ nozzle)
    return float(energy / 2)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_the_mass_matrix_holds_the_energy_of_rods(printer: Machine, share: float) -> None:
    machine = with_share(printer, share)
    rng = np.random.default_rng(3)
    for xy, mass in zip(PLACES, delta_vibration(machine).equations(PLACES).mass, strict=True):
        rates = rng.normal(size=6)
        assert rates @ mass @ rates / 2 == pytest.approx(summed_energy(machine, xy, rates), rel=1e-12)


def test_the_motion_of_the_path_pushes_as_the_rods_do(printer: Machine) -> None:
    """The nozzle's own acceleration f pushes on the carriages through Jᵀ of all masses at its end of the arms."""
    vibration = delta_vibration(with_share(printer, 0.0))
    space, j = vibration.state_space(PLACES), vibration.jacobian(PLACES)
    eq = vibration.equations(PLACES)
    nu = vibration.carriage.arm_inertia_kg
    both = (vibration.nozzle_side_mass_kg + vibration.effector.extruder_mass_kg - 3 * nu) * j.transpose(0, 2, 1)
    both = both + nu * np.broadcast_to([0.0, 0.0, 1.0], both.shape)
    pushed = np.concatenate(
        [both, np.broadcast_to(vibration.effector.extruder_mass_kg * np.eye(3), both.shape)], axis=1
    )
    expected = -np.linalg.solve(eq.mass, pushed)
    np.testing.assert_allclose(space.b_centripetal[:, 9:12], expected[:, :3], rtol=1e-9, atol=1e-12)
