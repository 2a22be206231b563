"""What to expect of printers that are off: equal to the exact error where nothing is, and honest about a shaper."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.comparison.sampling import Print, Sampling
from ffcomp.firmware.table import FIRMWARES
from ffcomp.simulation.command import planned_motion
from ffcomp.simulation.expectation import (
    KINDS,
    PRINTERS,
    STEP_S,
    TRUNCATION_SD,
    Expectation,
    Piece,
    draw_plants,
    expectation,
    expectation_of,
    pieces_of,
    tuned_shapers,
)
from models.file import load_machine
from models.machine import Machine, value_of
from tests.support.prints import squares

MACHINE = load_machine("mp-delta-pro")


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("ender-3")


def pieces(machine: Machine) -> list[Piece]:
    (stretch,), _ = Print(squares(1), "squares.gcode", machine, machine.kinematics.centre_mm).slices(Sampling())
    return pieces_of(stretch.motion, planned_motion(stretch.trajectory), stretch.corners)


def uncompensated(machine: Machine) -> Expectation:
    """What the firmware's plan itself would be, were it a compensation."""
    found = expectation(machine, pieces(machine), "marlin")
    assert found is not None
    return found


def test_where_the_file_is_certain_the_printer_is_as_it_says(machine: Machine) -> None:
    found = uncompensated(replace(machine, uncertainty={"default": 0.0}))
    assert found.printers == 0 and found.uncertainty == 0.0
    assert found.compensated_um == pytest.approx(found.uncompensated_um, rel=1e-3)
    assert found.shaper_um < 0.5 * found.uncompensated_um


def test_the_first_piece_holds_what_a_command_does_before_its_path_begins(machine: Machine) -> None:
    """A command leads its path from rest: a printer that began in the middle of the lead would ring from a jump."""
    (stretch,), _ = Print(squares(1), "squares.gcode", machine, machine.kinematics.centre_mm).slices(Sampling())
    command = planned_motion(stretch.trajectory)
    leading = replace(command, begin_t=command.begin_t - 0.01)
    (late,), (early,) = (pieces_of(stretch.motion, each, stretch.corners) for each in (command, leading))
    assert len(early.command) - len(late.command) >= round(0.01 / STEP_S)


def test_where_the_shaper_is_better_it_comes_first_and_a_measurement_is_next(machine: Machine) -> None:
    found = uncompensated(machine)
    assert found.assumed and found.uncertainty == pytest.approx(0.2, rel=0.1)
    assert found.headline.startswith("An input shaper, if the firmware has one, would be better here")
    assert "assumed" in found.headline and "(ZV, x " in found.headline
    assert "ffcomp record plan --for identify -m ender-3" in found.next_step
    assert found.shaper_um > uncompensated(replace(machine, uncertainty={"default": 0.0})).shaper_um > 0.0
    numbers = found.numbers() | {"compensated_um": 1.0}
    assert expectation_of(machine, **numbers).headline.startswith("Expected contour error")
    for own, begin in {(): "An input shaper, which the firmware lacks,", ("M593 X F40",): "The firmware's"}.items():
        worse = expectation_of(replace(machine, input_shaper=own), **(numbers | {"compensated_um": 1e3}))
        assert worse.headline.startswith(begin)


def test_pieces_where_nothing_rings_do_not_tune_a_shaper(machine: Machine) -> None:
    (loud,) = pieces(machine)
    plan, path = (np.broadcast_to(loud.plan[0], each.shape) for each in (loud.plan, loud.path))
    still = replace(loud, plan=plan, path=path)
    assert tuned_shapers(machine, [still, loud, still], "klipper") == tuned_shapers(machine, [loud], "klipper")


def test_a_shaper_is_one_that_the_firmware_has(machine: Machine) -> None:
    """Marlin has ZV, and none on deltas; RepRapFirmware has one frequency for both axes."""
    kinds = {flavor: [each.kind for each in tuned_shapers(machine, pieces(machine), flavor)] for flavor in FIRMWARES}
    assert kinds == {"klipper": list(KINDS), "marlin": ["zv"], "reprapfirmware": ["mzv", "2hump_ei"]}
    assert all(each.hz[0] == each.hz[1] for each in tuned_shapers(machine, pieces(machine), "reprapfirmware"))
    assert not FIRMWARES["marlin"].shapers(MACHINE)


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
