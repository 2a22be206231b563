"""How much time a command gets beyond its path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.firmware.program import PlannedProgram, plan_program
from ffcomp.inverse.reference import LEAST_S, Extent, Reference, Room, rooms_of
from ffcomp.inverse.settings import Settings
from ffcomp.planner.trajectory import PathPosition
from gcode.reader import read_program
from models.file import load_machine

START = (0.0, 0.0, 0.3)


def planned(text: bytes) -> PlannedProgram:
    return plan_program(read_program(text, start=START, flavor="klipper"), load_machine("mp-delta-pro"))


S = Settings()


@pytest.mark.parametrize(("flow", "least_s"), [(b" E1", LEAST_S), (b"", 0.0)])
@pytest.mark.parametrize("way", [b"X5", b"X5.3", b"X60"])
def test_more_and_more_time_is_offered_up_to_all_of_it(way: bytes, flow: bytes, least_s: float) -> None:
    """From what whole segments need, and a little where filament flows."""
    section = planned(b"M204 S5000\nG1 %s%s F6000\n" % (way, flow)).sections[0]
    *less, last = rooms_of(section, S, flows=bool(flow))
    duration_s = section.end_t - section.begin_t
    assert last == Room(S.lead_s, S.tail_s) and all(each.lead_s == pytest.approx(each.tail_s) for each in less)
    assert least_s - 1e-9 <= sum(less[0]) < least_s + S.segment_s and sum(less[-1]) < sum(last)
    segments = [(duration_s + sum(each)) / S.segment_s for each in less]
    assert segments == pytest.approx(np.rint(segments)) and np.diff(segments) == pytest.approx(np.ones(len(less) - 1))


def test_around_a_cut_in_motion_the_time_does_not_depend_on_the_plan() -> None:
    plan = planned(b"M204 S500\nG1 X90 E4 F3000\n")
    section = plan.sections[0]
    cut = Extent(end=PathPosition(0, 40.0)).written(plan.trajectory, section, S)
    assert cut.reference.t0 == section.begin_t - S.lead_s


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
