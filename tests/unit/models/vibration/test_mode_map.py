"""Which mode is which: named by what it moves, followed over the bed through crossings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from models.arrays import constant
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.vibration.mode_map import ModeMap, kinds, mode_map


@pytest.fixture(scope="module")
def over(printer: Machine) -> ModeMap:
    return mode_map(delta_vibration(printer), 10.0)


def test_modes_at_the_centre_are_named(printer: Machine) -> None:
    centre = np.zeros(2)
    assert kinds(delta_vibration(printer), centre, printer.vibration.modes_at(centre)) == [
        "extruder, mostly x",
        "mostly y",
        "mostly x",
        "extruder, mostly y",
        "mostly z",
        "extruder, mostly z",
    ]


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


def test_a_mode_that_stops_swinging_leaves_a_hole(printer: Machine) -> None:
    """With so much damping along y that its mode is overdamped everywhere, five modes are left, and followed."""
    damped = constant([20.4, 100.0, 19.6])
    machine = with_parts(
        printer, effector=replace(delta_vibration(printer).effector, extruder_damping_n_s_per_m=damped)
    )
    over = mode_map(delta_vibration(machine), 20.0)
    assert over.frequency_hz.shape[2] == 5
    assert not any(kind == "extruder, mostly y" for kind in over.kinds)
    assert np.isfinite(over.frequency_hz[over.on_bed]).all()
