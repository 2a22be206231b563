"""How long moves take that go out as they are."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ffcomp.firmware.base import FileLimits
from ffcomp.firmware.klipper import Klipper
from ffcomp.firmware.program import planner_of, raw_durations
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.segment_timing import SegmentLimits
from gcode.program import LimitCommand, MotionLimits
from gcode.reader import read_program
from gcode.slicing import passed_through
from models.file import load_machine

LIMITS = PlannerLimits(velocity_mm_per_s=300.0, acceleration_mm_per_s2=1000.0, square_corner_velocity_mm_per_s=5.0)
PLANNER = partial(plan_moves, limits=LIMITS)


def test_they_take_what_the_firmware_takes_for_the_same_moves() -> None:
    path = "G1 X50 F6000\nG1 X90 Z8\n; a comment\nG1 X0 F1200\nG4 P100\nG1 X7\n"
    known = read_program(path.encode(), start=(0, 0, 5))
    stops, waits = stops_and_waits(known)
    expected = plan_moves(known.moves, LIMITS, stop_before=stops, wait_before=waits).duration
    raw = read_program(f"G1 X0 Z5 F60\n{path}".encode())  # Y is never named
    assert not len(raw.moves)
    first, *durations = raw_durations(raw.events, PLANNER).values()
    assert first == 0.0, "from nowhere"
    assert durations == pytest.approx(expected.tolist())


def test_a_stop_separates_and_a_comment_does_not() -> None:
    together = _seconds("G1 X10 F60000\n;\nG1 X20\nG1 X30\n")
    apart = _seconds("G1 X10 F60000\nM400\nG1 X20\nM400\nG1 X30\n")
    assert 2 * np.sqrt(30 / 1000) < together < 0.65 * apart
    assert apart == pytest.approx(3 * _seconds("G1 X10 F60000\n"), rel=1e-6)


def test_marlin_has_no_plan_of_steps_for_what_no_joint_reaches() -> None:
    machine = load_machine("kossel")
    program = read_program(b"G90\nG1 X0 Y0 Z1 F6000\nG1 X500 F6000\n", flavor="marlin")
    beside = passed_through(program, np.ones(len(program.moves), dtype=np.bool_), "beside the volume")
    assert list(raw_durations(beside.events, planner_of(beside, machine)).values())[-1] == pytest.approx(5.0)


def _seconds(lines: str) -> float:
    """Y is never named, so that all are raw; X is known to begin at 0."""
    program = read_program(f"G1 X0 F60000\n{lines}".encode())
    return sum(raw_durations(program.events, PLANNER).values())


# ---- klipper ----


@pytest.mark.parametrize(("version", "known"), [((), True), ((0, 13, 0), True), ((2026, 6), True), ((2026, 7), False)])
def test_accel_to_decel_is_written_where_the_firmware_knows_it(version: tuple[int, ...], known: bool) -> None:
    machine = replace(load_machine("voron-300"), firmware_version=version)
    own = MotionLimits(accel_to_decel=700.0)
    file = FileLimits(MotionLimits(acceleration=1400.0), {"SET_VELOCITY_LIMIT": LimitCommand("", {}, own)})
    (opened,), (closed,) = (lines(machine, SegmentLimits(), file) for lines in (Klipper().opening, Klipper().closing))
    assert (b" ACCEL_TO_DECEL=100000" in opened) == (b" ACCEL_TO_DECEL=700" in closed) == known
    assert b"MINIMUM_CRUISE_RATIO=0" in opened and b" ACCEL=1400 " in closed
