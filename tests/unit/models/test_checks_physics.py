"""Stability, reciprocity, passivity: by construction with virtual work, by luck with the paper's map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.checks import Quantity, check_physics, redundancy_problems, redundant_quantities
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine


def with_map(machine: Machine, force_map: str) -> Machine:
    return with_parts(machine, effector=replace(delta_vibration(machine).effector, force_map=force_map))


@pytest.mark.parametrize("name", ["mp-delta-pro", "kossel", "flsun-super-racer"])
def test_virtual_work_keeps_the_books(name: str) -> None:
    sound = check_physics(with_map(load_machine(name), "virtual_work"))
    assert sound.growth_per_s.value < 0 and sound.is_passive and sound.is_reciprocal
    assert sound.dissipation.value > 1e-4  # not merely by rounding
    assert max(sound.asymmetry.value, sound.load_asymmetry.value) < 1e-13
    assert sound.least_load.value == pytest.approx(1) and sound.most_load.value == pytest.approx(1)


def test_the_papers_map_with_table_1_is_stable_but_makes_energy(as_printed: Machine) -> None:
    sound = check_physics(as_printed)
    assert sound.growth_per_s.value < -3.0
    assert not sound.is_passive and sound.dissipation.value == pytest.approx(-0.228, abs=0.005)
    assert not sound.is_reciprocal and sound.asymmetry.value == pytest.approx(0.45, abs=0.01)
    assert sound.load_asymmetry.value == pytest.approx(0.31, abs=0.01)
    assert sound.least_load.value < 0 < 0.4 < sound.most_load.value


def test_where_energy_comes_from_it_really_does(as_printed: Machine) -> None:
    """The force that PhysicsChecks says gets work out of the machine: its mean power, ½ Re(F* v), is below zero."""
    worst = check_physics(as_printed).dissipation
    assert worst.frequency_hz is not None
    y = delta_vibration(as_printed).receptance(
        np.array([worst.x_mm, worst.y_mm]), 2j * np.pi * np.array([worst.frequency_hz])
    )[0]
    mobility = 2j * np.pi * worst.frequency_hz * y
    values, vectors = np.linalg.eigh((mobility + mobility.conj().T) / 2)
    force = vectors[:, 0]
    power = 0.5 * np.real(force.conj() @ (mobility @ force))
    assert power == pytest.approx(values[0] / 2) and power < 0
    assert values[0] / np.linalg.norm(mobility, 2) == pytest.approx(worst.value, rel=1e-3)


# ---- checks redundancy ----


def with_measured(machine: Machine, **numbers: object) -> Machine:
    measured = {**machine.provenance.get("measured", {}), **numbers}
    return replace(machine, provenance={**machine.provenance, "measured": measured})


def quantity(machine: Machine, key: str) -> Quantity:
    return next(each for each in redundant_quantities(machine) if key in each.key)


@pytest.mark.parametrize(
    ("key", "equation", "value"),
    [
        ("carriage.mass_kg", "Eq. 41", 0.1640),
        ("carriage.mass_kg", "Eq. 36", 0.2271),
        ("carriage.mass_kg", "Eq. 40", 1.21e5 / 490**2 - 0.2),
        ("belt_stiffness", "Eq. 36", 1.0392e5),
        ("belt_stiffness", "Eq. 40", 0.395 * 490**2),
        ("belt_stiffness", "Eqs. 36, 41", 0.16400 * 730**2),
        ("belt_damping", "Eq. 35", 26.19),
        ("belt_damping", "Eq. 39", 29.81),
        ("effector.nozzle_mass_kg", "Eq. 49", 0.5360),
        ("effector.extruder_mass_kg", "Eq. 49", 0.1150),
        ("extruder_stiffness_n_per_m[z]", "Eq. 47", 2.5150e5),
        ("extruder_stiffness_n_per_m[z]", "Eq. 48", 2.5431e5),
    ],
)
def test_every_way_to_a_number_of_table_1(as_printed: Machine, key: str, equation: str, value: float) -> None:
    found = quantity(as_printed, key)
    way = next(each for each in found.others if each.equation.startswith(f"{equation}:"))
    assert way.value == pytest.approx(value, rel=5e-4)
    assert way.difference == pytest.approx(value / found.of_file - 1, abs=1e-3)


def test_the_scale_is_one_more_way(printer: Machine) -> None:
    assert redundancy_problems(with_measured(printer, total_effector_mass_kg=0.651)) == []
    heavier = with_measured(printer, total_effector_mass_kg=0.75)
    assert len(redundancy_problems(heavier)) == 3  # the sum, m_1 and m_2
    by_hammer = next(each for each in redundant_quantities(heavier) if each.key == "effector.nozzle_mass_kg").others
    assert by_hammer[1].value == pytest.approx((1519 / 1674) ** 2 * 0.75)
