"""The paper's numbers against each other: every way to a number, and what the file uses."""

from __future__ import annotations

from dataclasses import replace

import pytest

from models.checks import Quantity, redundancy_problems, redundant_quantities
from models.machine import Machine


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
