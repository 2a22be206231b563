"""Sub-models and their coupling: the paper's closed forms, statics, energy, and the paper's own errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.vibration.substructures import command_frf, impedance

FREQUENCIES = np.geomspace(0.5, 400, 60)
S = 2j * np.pi * FREQUENCIES
PLACES = [(0.0, 0.0), (80.0, 0.0), (-40.0, 69.0), (30.0, -100.0)]


@pytest.mark.parametrize("seed", range(6))
def test_six_rods_carry_the_virtual_work_load(rigid, seed: int, bed: np.ndarray) -> None:
    """Three forces and three moments give six axial rod forces; their pull is what the carriages feel.

    For the load of the flexible effector, W X at any frequency, in any direction, with any centre of mass.
    """
    generator = np.random.default_rng(seed)
    machine = rigid(offset=tuple(generator.uniform(-60, 60, 3)))
    w = delta_vibration(machine).effector_impedance(S[[30]])[0].real
    force = w * generator.normal(size=3)
    wanted = delta_vibration(machine).load_map(machine.kinematics.jacobian(bed)) @ force
    rods = [_rod_loads(machine, xy, force) for xy in bed]
    np.testing.assert_allclose(rods / np.abs(wanted).max(), wanted / np.abs(wanted).max(), rtol=0, atol=1e-12)


def _rod_loads(machine: Machine, xy: np.ndarray, force: np.ndarray) -> np.ndarray:
    """(3,) N, the vertical load of each carriage's two parallel rods, 50 mm apart."""
    geometry, angles = machine.kinematics, machine.kinematics.tower_angles_rad
    q = geometry.inverse(np.array([[*xy, 0.0]]))[0]
    from_carriage = np.column_stack([xy - geometry.towers_mm, geometry.effector_height_mm - q])
    rods = from_carriage / geometry.arm_lengths_mm[:, None]
    radial = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)])
    tangent = np.column_stack([-np.sin(angles), np.cos(angles), np.zeros(3)])
    joints = [39.91 * radial[i] + side * tangent[i] for i in range(3) for side in (-25.0, 25.0)]
    axes = np.repeat(rods, 2, axis=0)
    moments = np.cross(np.array(joints) - delta_vibration(machine).effector.center_of_mass_mm, axes)
    axial = np.linalg.solve(np.vstack([axes.T, moments.T]), np.concatenate([force, np.zeros(3)]))
    return axial.reshape(3, 2).sum(axis=1) * rods[:, 2]


# --- Coupled


@pytest.mark.parametrize("force_map", ["virtual_work", "paper"])
@pytest.mark.parametrize("xy", PLACES)
def test_slow_commands_are_followed_exactly(printer: Machine, force_map: str, xy: tuple[float, float]) -> None:
    effector = replace(delta_vibration(printer).effector, force_map=force_map)
    model, at = with_parts(printer, effector=effector).vibration, np.array([xy])
    np.testing.assert_allclose(model.frequency_response(at[0], np.zeros(1))[0], np.eye(3), atol=1e-14)
    np.testing.assert_allclose(model.low_frequency(at)[1], super(type(model), model).low_frequency(at)[1], atol=1e-16)


@pytest.mark.parametrize("xy", PLACES)
def test_frf_solves_equation_29(as_printed: Machine, xy: tuple[float, float]) -> None:
    """The paper's own form, sub-models by themselves: (I − G_Fq Γ W J) G = G_qd."""
    place = np.array(xy)
    j = as_printed.kinematics.jacobian(place[None])[0]
    gamma = delta_vibration(as_printed).load_map(j[None])[0]
    g = as_printed.vibration.frequency_response(place, FREQUENCIES)
    w = delta_vibration(as_printed).effector_impedance(S)[:, :, None] * np.eye(3)
    loop = (
        np.eye(3) + (gamma @ w @ j) / impedance(delta_vibration(as_printed).carriage, S)[:, None, None]
    )  # G_Fq, Eq. 44
    alone = command_frf(delta_vibration(as_printed).carriage, S)[:, None, None] * np.eye(3)
    np.testing.assert_allclose(loop @ g, alone, atol=1e-10)


@pytest.mark.parametrize("xy", PLACES)
def test_virtual_work_is_reciprocal(printer: Machine, xy: tuple[float, float]) -> None:
    g = printer.vibration.frequency_response(np.array(xy), FREQUENCIES)
    np.testing.assert_allclose(g, g.transpose(0, 2, 1), atol=1e-11)


@pytest.mark.parametrize("force_map", ["virtual_work", "paper"])
def test_shapes_are_free_vibrations(printer: Machine, force_map: str) -> None:
    """(λ² m_c + …) q = −load, with the carriages' part of each shape: Z(λ) q = 0."""
    machine = with_parts(printer, effector=replace(delta_vibration(printer).effector, force_map=force_map))
    place = np.array([50.0, -60.0])
    found = machine.vibration.modes_at(place)
    zeta = found.damping_ratios
    every = 2 * np.pi * found.frequencies_hz * (-zeta + 1j * np.sqrt(1 - zeta**2))
    j = machine.kinematics.jacobian(place[None])[0]
    gamma = delta_vibration(machine).load_map(j[None])[0]
    for pole, shape in zip(every, found.shapes, strict=True):
        w = delta_vibration(machine).effector_impedance(np.array([pole]))[0]
        z = impedance(delta_vibration(machine).carriage, np.array([pole]))[0] * np.eye(3) + gamma * w @ j
        assert np.linalg.norm(z @ shape[:3]) < 1e-9 * np.linalg.norm(z, 2)
        nozzle = j @ shape[:3]
        m2, effector = delta_vibration(machine).effector.extruder_mass_kg, delta_vibration(machine).effector
        mount = effector.extruder_damping_n_s_per_m * pole + effector.extruder_stiffness_n_per_m
        np.testing.assert_allclose(
            m2 * pole**2 * (nozzle + shape[3:]), -mount * shape[3:], atol=1e-6 * np.abs(mount).max()
        )
