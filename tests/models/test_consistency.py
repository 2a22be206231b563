"""The paper's numbers against each other, and whether models hold still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.consistency import inconsistencies, unstable_places
from models.machine import Machine, constant
from models.machine_file import LIBRARY, load_machine
from models.receptance import poles

NAMES = sorted(path.stem for path in LIBRARY.glob("*.toml"))


@pytest.mark.parametrize(
    ("equation", "number"),
    [("41", "0.164"), ("36", "1.039e+05"), ("35", "26.19"), ("39", "29.81"), ("47", "2.515e+05")],
)
def test_table_1_contradicts_itself(as_printed: Machine, equation: str, number: str) -> None:
    assert any(f"{equation})" in note and f" {number} " in note for note in inconsistencies(as_printed))


def test_table_1_agrees_with_equation_49(as_printed: Machine) -> None:
    assert len(inconsistencies(as_printed)) == 5
    lighter = replace(as_printed.effector, nozzle_mass_kg=0.3)
    assert any("Eq. 49" in note for note in inconsistencies(replace(as_printed, effector=lighter)))


@pytest.mark.parametrize("name", [name for name in NAMES if name != "mp-delta-pro-as-printed"])
def test_the_other_machines_agree_with_themselves(name: str) -> None:
    assert inconsistencies(load_machine(name)) == []


@pytest.mark.parametrize("name", NAMES)
def test_vibrations_of_the_library_decay_all_over_the_bed(name: str) -> None:
    machine = load_machine(name)
    assert unstable_places(machine).shape == (0, 2)
    assert poles(machine, np.zeros((1, 2))).real.max() < -3.0  # 1/s: not merely by rounding


def test_a_map_that_conserves_no_energy_can_make_energy(as_printed: Machine) -> None:
    far = replace(as_printed.effector, center_of_mass_mm=constant([35.0, -60.0, 120.0]))
    assert len(unstable_places(replace(as_printed, effector=far))) > 0
    sound = replace(far, force_map="virtual_work")
    assert len(unstable_places(replace(as_printed, effector=sound))) == 0
