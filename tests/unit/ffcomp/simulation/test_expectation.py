"""What to expect of printers that are off: equal to the exact error where nothing is, and honest about a shaper."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ffcomp.comparison.sampling import Print, Sampling
from ffcomp.simulation.command import planned_motion
from ffcomp.simulation.expectation import Expectation, expectation, pieces_of
from models.file import load_machine
from models.machine import Machine
from tests.support.prints import squares


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("ender-3")


def uncompensated(machine: Machine) -> Expectation:
    """What the firmware's plan itself would be, were it a compensation."""
    (stretch,), _ = Print(squares(1), "squares.gcode", machine, machine.kinematics.centre_mm).slices(Sampling())
    found = expectation(machine, pieces_of(stretch.motion, planned_motion(stretch.trajectory), stretch.corners))
    assert found is not None
    return found


def test_where_the_file_is_certain_the_printer_is_as_it_says(machine: Machine) -> None:
    found = uncompensated(replace(machine, uncertainty={"default": 0.0}))
    assert found.printers == 0 and found.uncertainty == 0.0
    assert found.compensated_um == pytest.approx(found.uncompensated_um, rel=1e-3)
    assert found.shaper_um < 0.5 * found.uncompensated_um


def test_where_the_shaper_is_better_it_comes_first_and_a_measurement_is_next(machine: Machine) -> None:
    found = uncompensated(machine)
    assert found.shaper_is_better and found.assumed and found.uncertainty == pytest.approx(0.2, rel=0.1)
    assert found.headline.startswith("The firmware's input shaper is better here") and "assumed" in found.headline
    assert "ffcomp record plan --for identify -m ender-3" in found.next_step
    assert found.shaper_um > uncompensated(replace(machine, uncertainty={"default": 0.0})).shaper_um > 0.0
    assert not replace(found, compensated_um=1.0).shaper_is_better
