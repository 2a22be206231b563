"""A place on a path and when it is passed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ffcomp.firmware.program import firmware_plan
from ffcomp.inverse.reference import CRUISE_RATIO, LEAST_CONTEXT_S, SLOWEST_RAMPS, context_s
from ffcomp.planner.trajectory import PathPosition, Trajectory
from gcode.reader import read_program
from models.file import load_machine

SQUARE = b"G1 X30 Y0 F6000\nG1 X30 Y30 F1200\nG1 X29.9 Y30\nG1 X0 Y0 F9000\n"


@pytest.fixture(scope="module")
def plan() -> Trajectory:
    return firmware_plan(read_program(SQUARE, start=(0.0, 0.0, 1.0), flavor="klipper"), load_machine("mp-delta-pro"))


@given(share=st.floats(0.0, 1.0))
@settings(deadline=None)
def test_a_place_is_passed_when_the_plan_is_there(plan: Trajectory, share: float) -> None:
    t = share * plan.end_t * (1 - 1e-9)
    move = int(plan.move_at(t))
    along = float(np.linalg.norm((plan.position([t])[0] - plan.origin[move])[:3]))
    assert PathPosition(move, along).time_in(plan) == pytest.approx(t, abs=1e-6)  # near a rest a place is passed slowly


def test_what_is_needed_around_a_cut_grows_with_the_ramps() -> None:
    machine = load_machine("mp-delta-pro")
    found = []
    for limit in (b"", b"M204 S50\n"):
        program = read_program(limit + b"G1 X100 F6000\nG1 X-100\n", start=(0.0, 0.0, 1.0), flavor="klipper")
        found.append(context_s(program.moves, firmware_plan(program, machine)))
    assert found[0] == LEAST_CONTEXT_S
    peak = np.sqrt(50.0 * 100.0)  # mm/s, in the middle of 100 mm at 50 mm/s²
    assert found[1] == pytest.approx(SLOWEST_RAMPS * peak / (50.0 * CRUISE_RATIO))
