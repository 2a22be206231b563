"""How much time a command gets beyond its path."""

from __future__ import annotations

import pytest

from ffcomp.inverse.reference import WHOLE, Extent, Reference, Room, room_of
from ffcomp.inverse.settings import Settings
from ffcomp.planner.program import PlannedProgram, plan_program
from ffcomp.planner.trajectory import PathPosition
from gcode.reader import read_program
from models.file import load_machine

START = (0.0, 0.0, 0.3)
SOFT, STIFF = (28e-6, 28e-6, 14e-6), (1e-6, 1e-6, 1e-6)  # s², the lag of a slow delta and of a quick machine


def planned(text: bytes) -> PlannedProgram:
    return plan_program(read_program(text, start=START), load_machine("mp-delta-pro"))


def room(text: bytes, compliance_s2: tuple[float, float, float]) -> Room:
    plan = planned(text)
    return room_of(plan.trajectory, plan.sections[0], Settings(compliance_s2=compliance_s2))


def test_a_print_on_a_soft_machine_gets_all_of_the_time() -> None:
    s = Settings()
    assert room(b"M204 S5000\nG1 X30 E1 F6000\n", SOFT) == Room(s.lead_s, s.tail_s)


@pytest.mark.parametrize("text", [b"M204 S5000\nG1 X30 E1 F6000\n", b"M204 S5000\nG1 X30 F6000\n"])
def test_a_stiff_machine_needs_no_time_beyond_the_path(text: bytes) -> None:
    assert room(text, STIFF) == Room(0.0, 0.0)


def test_less_time_is_spent_where_no_filament_flows() -> None:
    travel, line = (room(b"M204 S4000\nG1 X30 %sF6000\n" % e, SOFT) for e in (b"", b"E1 "))
    assert 0.0 < travel.lead_s < line.lead_s and 0.0 < travel.tail_s < line.tail_s


def test_a_travel_before_a_print_gets_little_in_front_and_much_behind() -> None:
    both = room(b"M204 S4000\nG1 X30 F6000\nG1 X50 E1\n", SOFT)
    alone = room(b"M204 S4000\nG1 X50 F6000\n", SOFT)
    assert both.lead_s == pytest.approx(alone.lead_s) and both.tail_s > alone.tail_s


def test_only_axes_that_lag_count() -> None:
    assert room(b"G1 Z8 F600\n", (28e-6, 28e-6, 1e-8)) == Room(0.0, 0.0)


def test_around_a_cut_in_motion_the_time_does_not_depend_on_the_plan() -> None:
    plan = planned(b"M204 S500\nG1 X90 E4 F3000\n")
    settings = Settings(compliance_s2=STIFF)
    section = plan.sections[0]
    cut = Extent(end=PathPosition(0, 40.0)).written(plan.trajectory, section, settings)
    assert cut.reference.t0 == section.begin_t - settings.lead_s
    whole = WHOLE.written(plan.trajectory, section, settings)
    assert whole.reference.t0 == section.begin_t
    assert whole.reference.knots == Reference(plan.trajectory, section, settings).knots
