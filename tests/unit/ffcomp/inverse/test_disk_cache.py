"""What is kept of a machine between runs: the same numbers, whole or not there, and never somebody else's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ffcomp.firmware.program import firmware_plan
from ffcomp.inverse import disk_cache as kept
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.sensitivity import Sensitivity
from ffcomp.inverse.settings import settings_for
from ffcomp.numerics.numba_cache import OUR_VARIABLE
from ffcomp.planner.trajectory import Section
from gcode.reader import read_program
from models.machine import Machine


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(OUR_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def offsets(inverter: InverseModel) -> np.ndarray:
    """Of a corner, from the path that is followed best."""
    program = read_program(b"G1 X0 Y0 F9000\nG1 X20 Y5\nG1 X0 Y20\n", start=(-20.0, 0.0, 0.3))
    plan = firmware_plan(program, inverter.full_machine)
    section = Section(0, len(program.moves), True, 0.0, plan.end_t)
    return inverter.robust_offsets([Reference(plan, section, inverter.settings)])[0]


def test_the_next_one_has_the_same_numbers_without_working_them_out(
    folder: Path, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = replace(settings_for(machine), robust=True)
    first = InverseModel(machine, settings)
    expected = offsets(first)
    assert np.abs(expected).max() > 0.0
    first.save_cache()
    assert len(list(folder.glob("*.npz"))) == 1
    monkeypatch.setattr(Sensitivity, "_of_draws", None)  # would fail
    np.testing.assert_array_equal(offsets(InverseModel(machine, settings)), expected)


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
