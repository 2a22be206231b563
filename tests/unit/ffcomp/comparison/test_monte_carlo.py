"""Drawn printers, and plants that are another printer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.simulation.expectation import PRINTERS, TRUNCATION_SD, draw_plants
from ffcomp.simulation.playback import check_same_kinematics
from models.arrays import constant
from models.errors import MachineFileError
from models.file import load_machine
from models.machine import value_of
from tests.support.mismatch import SEEDS, study, tuned

MACHINE = load_machine("mp-delta-pro")


def test_every_dynamic_number_is_off_by_the_standard_deviation() -> None:
    plants = draw_plants(MACHINE, 0.1, 400)
    for name in MACHINE.vibration.parameters().names:
        off = np.array([value_of(m, name) for m in plants]) / value_of(MACHINE, name) - 1
        assert np.std(off) == pytest.approx(0.1, rel=0.15)
        assert abs(np.mean(off)) < 0.02 and np.abs(off).max() <= 0.1 * TRUNCATION_SD + 1e-12
    assert all(m.kinematics is MACHINE.kinematics for m in plants)


def test_few_printers_have_the_mean_of_many() -> None:
    """The mean of |off| over 20, for every number: independent draws miss that of a normal distribution by 17 %."""
    for first in (0, PRINTERS, 2 * PRINTERS):
        plants = draw_plants(MACHINE, 0.1, first + PRINTERS)[first:]
        for name in MACHINE.vibration.parameters().names:
            off = np.array([value_of(m, name) for m in plants]) / value_of(MACHINE, name) - 1
            assert np.mean(np.abs(off)) == pytest.approx(0.1 * np.sqrt(2 / np.pi), rel=0.1)
            assert abs(np.mean(off)) < 0.01


def test_another_printer_is_refused_by_key_and_rule() -> None:
    other = replace(MACHINE.kinematics, arm_lengths_mm=constant([250.0] * 3), effector_height_mm=20.0)
    with pytest.raises(MachineFileError) as error:
        check_same_kinematics(MACHINE, replace(MACHINE, kinematics=other, path="other.toml"))
    assert len(error.value.problems) == 2
    assert "other.toml: kinematics.arm_lengths_mm is 250, 250, 250, but 300, 300, 300" in str(error.value)


def test_the_numbers_do_not_depend_on_the_processes() -> None:
    (alone, _), (together, told) = study(), study(2)
    assert alone == together
    for method in tuned():
        spread, _ = alone[method.name]
        assert spread is not None and len(set(spread.contour_rms_um)) == SEEDS  # every plant is its own
    assert alone["mzv"][1] is not None
    assert told == sorted(told) and told[-1] == pytest.approx(1.0)
