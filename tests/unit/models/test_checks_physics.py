"""Stability and passivity: by construction with virtual work, by luck with the paper's map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.checks import check_physics
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine


def with_map(machine: Machine, force_map: str) -> Machine:
    return with_parts(machine, effector=replace(delta_vibration(machine).effector, force_map=force_map))


@pytest.mark.parametrize("name", ["mp-delta-pro", "kossel", "flsun-super-racer"])
def test_virtual_work_keeps_the_books(name: str) -> None:
    sound = check_physics(with_map(load_machine(name), "virtual_work"))
    assert sound.growth_per_s.value < 0 and sound.is_passive
    assert sound.dissipation.value > 1e-4  # not merely by rounding


def test_the_papers_map_with_table_1_is_stable_but_makes_energy(as_printed: Machine) -> None:
    sound = check_physics(as_printed)
    assert sound.growth_per_s.value < -3.0
    assert not sound.is_passive and sound.dissipation.value == pytest.approx(-0.228, abs=0.005)


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
