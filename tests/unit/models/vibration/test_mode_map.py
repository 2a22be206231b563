"""Which mode is which: named by what it moves, followed over the bed through crossings."""

from __future__ import annotations

import numpy as np
import pytest

from models.file import load_machine
from models.kinds import delta_vibration
from models.machine import Machine
from models.vibration.mode_map import numbers


def frequencies(machine: Machine, xy: np.ndarray) -> np.ndarray:
    """By the modes' numbers."""
    model = delta_vibration(machine)
    return model.modes_at(xy).frequencies_hz[np.argsort(numbers(model, xy))]


@pytest.mark.parametrize("name", ["mp-delta-pro", "kossel", "flsun-qqs"])
def test_no_mode_jumps_from_place_to_place(name: str) -> None:
    machine = load_machine(name)
    rim = machine.kinematics.bed_radius_mm * np.array([np.cos(0.4), np.sin(0.4)])
    way = np.array([frequencies(machine, share * rim) for share in np.linspace(0.1, 1.0, 30)])
    assert sorted(numbers(delta_vibration(machine), rim)) == [1, 2, 3, 4, 5, 6]
    assert np.max(np.abs(np.diff(way, axis=0)) / way[1:]) < 0.07


def test_at_the_centre_modes_are_numbered_by_frequency(printer: Machine) -> None:
    assert numbers(delta_vibration(printer), np.zeros(2)) == [1, 2, 3, 4, 5, 6]


def test_a_symmetric_printer_looks_the_same_from_every_tower() -> None:
    """Turned by 120°, of a centred machine with equal mounts; also the pair that is one at the centre."""
    machine = load_machine("kossel")
    for place in ((40.0, 20.0), (-70.0, 35.0)):
        values = [frequencies(machine, _turned(place, k * 2 * np.pi / 3)) for k in range(3)]
        np.testing.assert_allclose(values, [values[0]] * 3, rtol=0.01)


def _turned(place: tuple[float, float], angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * place[0] - s * place[1], s * place[0] + c * place[1]])
