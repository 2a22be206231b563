"""How much time a command gets beyond its path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.firmware.program import PlannedProgram, plan_program
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import Settings
from gcode.reader import read_program
from models.file import load_machine

START = (0.0, 0.0, 0.3)


def planned(text: bytes) -> PlannedProgram:
    return plan_program(read_program(text, start=START, flavor="klipper"), load_machine("mp-delta-pro"))


@pytest.mark.parametrize("early_s", [0.0, 1e-12, 1e-6])
def test_no_reference_holds_the_place_of_the_next_section(early_s: float) -> None:
    """Where a plan was slowed down, rounding lets the next section begin before this one ends, and elsewhere."""
    text = b"G28\nG90\nM83\nG1 X10 Y10 Z5 F6000\nG1 X20 Y10 E1\nT1\nG1 X60 Y60\nG1 X70 Y60 E1\n"
    machine = load_machine("voron-300")
    planned = plan_program(read_program(text), machine)
    plan, section = planned.trajectory, planned.sections[0]
    start_t = plan.start_t.copy()
    start_t[section.last] = section.end_t - early_s
    reference = Reference(replace(plan, start_t=start_t), section, Settings(substeps=4))
    knots = np.arange(-5, reference.knots + 6)
    for nozzle in (reference.at_knots(knots), reference.substeps(0, reference.knots + 4)[0]):
        np.testing.assert_allclose(nozzle[-1], [20.0, 10.0, 5.0], atol=1e-9)
        assert np.abs(np.diff(nozzle, axis=0)).max() < 1.0
    assert reference.extrusion()[-1] == pytest.approx(planned.program.moves.end[section.last - 1, 3])
