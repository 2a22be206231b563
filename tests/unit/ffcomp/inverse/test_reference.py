"""How much time a command gets beyond its path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.firmware.program import PlannedProgram, plan_program
from ffcomp.inverse.reference import LEAST_NEED, LEAST_S, WHOLE, Extent, Reference, Room, room_of, tighter_rooms
from ffcomp.inverse.settings import Settings
from ffcomp.planner.trajectory import PathPosition
from gcode.reader import read_program
from models.file import load_machine

START = (0.0, 0.0, 0.3)
SOFT, STIFF = (28e-6, 28e-6, 14e-6), (1e-6, 1e-6, 1e-6)  # s², the lag of a slow delta and of a quick machine


def planned(text: bytes) -> PlannedProgram:
    return plan_program(read_program(text, start=START, flavor="klipper"), load_machine("mp-delta-pro"))


def room(text: bytes, compliance_s2: tuple[float, float, float]) -> Room:
    plan = planned(text)
    return room_of(plan.trajectory, plan.sections[0], Settings(compliance_s2=compliance_s2))


S = Settings()


def total(text: bytes, compliance_s2: tuple[float, float, float]) -> float:
    return sum(room(text, compliance_s2))


@pytest.mark.parametrize(("way", "share"), [(b"X5", LEAST_NEED), (b"X5.3", LEAST_NEED), (b"X60", 1.0), (b"X61", 1.0)])
def test_a_soft_machine_gets_all_of_the_time_and_less_in_a_short_section(way: bytes, share: float) -> None:
    """And what whole segments leave beyond that is shared out: prints with four rests a second lost most by it."""
    given, needed_s = room(b"M204 S5000\nG1 %s E1 F6000\n" % way, SOFT), share * (S.lead_s + S.tail_s)
    assert needed_s - 1e-9 <= sum(given) < needed_s + S.segment_s
    assert given.lead_s == pytest.approx(2.0 * given.tail_s)


@pytest.mark.parametrize("text", [b"M204 S5000\nG1 X30 E1 F6000\n", b"M204 S5000\nG1 X30 F6000\n"])
def test_a_stiff_machine_needs_no_time_beyond_whole_segments(text: bytes) -> None:
    given = room(text, STIFF)
    assert sum(given) < S.segment_s and given.lead_s == pytest.approx(given.tail_s)


def test_less_time_is_spent_where_no_filament_flows() -> None:
    travel, line = (total(b"M204 S4000\nG1 X30 %sF6000\n" % e, SOFT) for e in (b"", b"E1 "))
    assert travel < line


def test_a_travel_before_a_print_gets_a_larger_share_behind() -> None:
    both = room(b"M204 S4000\nG1 X30 F6000\nG1 X50 E1\n", SOFT)
    alone = room(b"M204 S4000\nG1 X50 F6000\n", SOFT)
    assert both.tail_s / both.lead_s > alone.tail_s / alone.lead_s


def test_a_long_section_gets_all_of_the_time() -> None:
    assert room(b"G1 X90 F600\n", STIFF) == Room(S.lead_s, S.tail_s)


def test_only_axes_that_lag_count() -> None:
    assert total(b"G1 Z8 F600\n", (28e-6, 28e-6, 1e-8)) < S.segment_s


def test_around_a_cut_in_motion_the_time_does_not_depend_on_the_plan() -> None:
    plan = planned(b"M204 S500\nG1 X90 E4 F3000\n")
    settings = Settings(compliance_s2=STIFF)
    section = plan.sections[0]
    cut = Extent(end=PathPosition(0, 40.0)).written(plan.trajectory, section, settings)
    assert cut.reference.t0 == section.begin_t - settings.lead_s
    whole = WHOLE.written(plan.trajectory, section, settings)
    assert section.begin_t - S.segment_s < whole.reference.t0 <= section.begin_t
    assert whole.reference.knots == Reference(plan.trajectory, section, settings).knots


@pytest.mark.parametrize(("flows", "least_s"), [(True, LEAST_S), (False, 0.0)])
def test_less_time_than_a_short_section_needs_is_offered_from_the_least_on(flows: bool, least_s: float) -> None:
    plan = planned(b"M204 S5000\nG1 X11.1 F6000\n")
    section, settings = plan.sections[0], Settings(compliance_s2=SOFT)
    needed_s, duration_s = sum(room_of(plan.trajectory, section, settings)), section.end_t - section.begin_t
    offered = list(tighter_rooms(section, round((duration_s + needed_s) / S.segment_s), settings, flows))
    assert least_s <= sum(offered[0]) < least_s + S.segment_s and sum(offered[-1]) == pytest.approx(
        needed_s - S.segment_s
    )
    assert all(each.lead_s == pytest.approx(each.tail_s) for each in offered)


def test_a_long_section_is_offered_none() -> None:
    section = planned(b"G1 X90 F6000\n").sections[0]
    assert not list(tighter_rooms(section, round((section.end_t - section.begin_t + 0.012) / S.segment_s), S, True))


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
