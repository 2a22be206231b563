"""Which mode is which: named by what it moves, followed over the bed through crossings."""

from __future__ import annotations

import numpy as np
import pytest

from models.file import load_machine
from models.kinds import delta_vibration
from models.machine import Machine
from models.vibration.mode_map import ModeMap, mode_map


@pytest.fixture(scope="module")
def over(printer: Machine) -> ModeMap:
    return mode_map(delta_vibration(printer), 10.0)


@pytest.mark.parametrize("name", ["mp-delta-pro", "kossel", "flsun-qqs"])
def test_no_mode_jumps_from_place_to_place(name: str) -> None:
    over = mode_map(delta_vibration(load_machine(name)), 8.0)
    assert _largest_step(over.frequency_hz) < 0.07
    assert _largest_step(over.damping_ratio) < 0.35


def _largest_step(table: np.ndarray) -> float:
    """Between neighbours, of the mode's mean."""
    steps = [np.abs(np.diff(table, axis=axis)) / np.nanmean(table, axis=(0, 1)) for axis in (0, 1)]
    return float(max(np.nanmax(step) for step in steps))


def test_a_symmetric_printer_looks_the_same_from_every_tower() -> None:
    """Turned by 120°, the whole map of a centred machine with equal mounts; also the pair that is one at the centre."""
    machine = load_machine("kossel")
    over = mode_map(delta_vibration(machine), 5.0)
    for number in range(6):
        for place in ((40.0, 20.0), (-70.0, 35.0)):
            values = [_at(over, _turned(place, k * 2 * np.pi / 3), number) for k in range(3)]
            np.testing.assert_allclose(values, values[0], rtol=0.01)


def _turned(place: tuple[float, float], angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * place[0] - s * place[1], s * place[0] + c * place[1]])


def _at(over: ModeMap, xy: np.ndarray, mode: int) -> float:
    i, k = (int(np.abs(over.x_mm - at).argmin()) for at in xy)
    return float(over.frequency_hz[i, k, mode])
