"""The check of each command before it is written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.compensation.net import fault_of, path_fault
from ffcomp.firmware.program import plan_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import settings_for
from ffcomp.inverse.solve import solve
from gcode.reader import read_program
from models.file import load_machine

START = (0.0, 0.0, 0.3)
BUMP = np.exp(-(((np.arange(400) - 60.0) / 12.0) ** 2))[:, None] * np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("off_mm", "why"), [(0.0, ""), (0.3, ""), (3.0, "it leaves its path by 3"), (np.nan, "it is not finite")]
)
def test_a_command_far_from_its_path_is_refused(off_mm: float, why: str) -> None:
    machine = load_machine("mp-delta-pro")
    planned = plan_program(read_program(b"G1 X30 F3000\nG1 X30 Y4\n", start=START, flavor="klipper"), machine)
    model, section = InverseModel(machine, settings_for(machine)), planned.sections[0]
    reference, moves = Reference(planned.trajectory, section, model.settings), planned.program.moves
    vertices = solve(model, reference, machine.equilibrium(np.array(START))).vertices
    found = fault_of(model, moves, reference, vertices - off_mm * BUMP[: len(vertices)])
    assert found.startswith(why) and bool(found) == bool(why)
    assert path_fault(model, reference, vertices - off_mm * BUMP[: len(vertices)], (110, reference.knots)) == (
        why if np.isnan(off_mm) else ""
    )
    assert "off its path" in fault_of(model, moves, reference, vertices + 0.02)
    apart = np.array([[0.0] * 4, [0.1, 0.0, 0.0, 0.0]])
    gap = replace(moves, start=moves.start + apart)
    assert "jumps by 0.1 mm" in fault_of(model, gap, reference, vertices)
