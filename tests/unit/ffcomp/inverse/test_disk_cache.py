"""What is kept of a machine between runs: the same numbers, whole or not there, and never somebody else's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ffcomp.inverse import disk_cache as kept
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import settings_for
from ffcomp.numerics.numba_cache import OUR_VARIABLE
from models.machine import Machine

HERE, THERE = np.array([[0.0, 0.0], [12.0, -30.0]]), np.array([[-50.0, 20.0]])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(OUR_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def been_at(machine: Machine, *places: np.ndarray) -> InverseModel:
    inverter = InverseModel(machine, settings_for(machine))
    for place in places:
        inverter.gains.at(place)
    return inverter


def gains_at(inverter: InverseModel, place: np.ndarray) -> list[np.ndarray]:
    slots, gains = inverter.gains.at(place)
    return [gains.backward[slots], gains.forward[slots]]


def test_the_next_one_has_the_same_numbers_without_working_them_out(
    folder: Path, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = been_at(machine, HERE)
    first.save_cache()
    assert len(list(folder.glob("*.npz"))) == 1
    monkeypatch.setattr("ffcomp.inverse.model.plant_table", None)  # would fail
    second = InverseModel(machine, settings_for(machine))
    monkeypatch.setattr(second.gains, "_add", None)
    for one, other in zip(gains_at(first, HERE), gains_at(second, HERE), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(first.row_table.plant.a, second.row_table.plant.a)
    slot = int(second.gains.at(HERE)[0][1])
    np.testing.assert_array_equal(second.gains.end(slot).forward, first.gains.end(slot).forward)


def test_a_damaged_file_is_not_there(folder: Path) -> None:
    kept.save("a", {"n": np.arange(10_000)})
    (file,) = folder.glob("*.npz")
    whole = file.read_bytes()
    bits = bytearray(whole)
    bits[len(bits) // 2] ^= 0x40
    for damaged in (whole[: len(whole) // 2], bits, b""):
        file.write_bytes(damaged)
        assert kept.load("a") == {}
    kept.save("a", {"n": np.arange(10_000)})
    assert file.read_bytes() == whole
