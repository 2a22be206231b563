"""RepRapFirmware's documented rules, each in closed form."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

import pytest

from ffcomp.firmware.base import FileLimits
from ffcomp.firmware.program import firmware_plan, known_to_the_firmware
from ffcomp.firmware.reprapfirmware import RepRapFirmware
from ffcomp.planner.segment_timing import SegmentLimits
from ffcomp.planner.trajectory import Trajectory
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine, RepRapFirmwareSettings

SETTINGS = RepRapFirmwareSettings((200, 150, 10, 50), (2000, 1000, 100, 3000), (10, 8, 0.2, 5), 1500, 2500, 1)


def machine_of(name: str = "prusa-mk3s", settings: RepRapFirmwareSettings | None = SETTINGS) -> Machine:
    return replace(load_machine(name), reprapfirmware=settings)


def plan(text: str, machine: Machine | None = None) -> Trajectory:
    machine = machine or machine_of()
    known = known_to_the_firmware(machine)
    program = read_program(f"M83\n{text}".encode(), flavor="reprapfirmware", start=(0.0, 0.0, 10.0), **known)
    return firmware_plan(program, machine)


@pytest.mark.parametrize(("unit", "unit_mm"), [("G21", 1.0), ("G20", 25.4)])
def test_limits_are_raised_to_the_same_mm_in_a_file_in_inches(unit: str, unit_mm: float) -> None:
    """60 mm at 500 mm/s and 100 m/s²: the line's own speed holds, not a limit that is 25 times too high or too low."""
    raised = SegmentLimits(velocity_mm_per_s=500.0, acceleration_mm_per_s2=1e5)
    lines = RepRapFirmware().opening(machine_of(), raised, FileLimits(unit_mm=unit_mm))
    text = "\n".join([unit, *(line.decode() for line in lines), "G21", "G1 X60 F600000"])
    assert plan(text).duration == pytest.approx([ramped_s(60, 500, 1e5)], rel=1e-5)


def ramped_s(mm: float, top: float, a: float, begin: float = 0.0, end: float = 0.0) -> float:
    """From one speed to another over a top that is reached."""
    ramps = (2 * top**2 - begin**2 - end**2) / (2 * a)
    assert ramps < mm
    return (2 * top - begin - end) / a + (mm - ramps) / top


@pytest.mark.parametrize(
    ("line", "mm", "top", "a"),
    [
        ("G1 X60 F6000", 60, 100, 2000),  # M201 X is less than M204 T
        ("G1 X60 E2 F6000", 60, 100, 1500),  # M204 P
        ("G1 X60 E60 F6000", 60, 50, 1500),  # M203 E
        ("M201 X500\nN5 M201X1000\nG1 X60 F6000", 60, 100, 1000),  # spelling makes no difference
        ("(slow) M203X3000\nG1 X60 F6000", 60, 50, 2000),
        ("M204P500\nG1 X60 E2 F6000", 60, 100, 500),
        ("G20\nM203 X60\nG21\nG1 X60 F6000", 60, 25.4, 2000),  # in/min
        ("G1 X60 E150 F600", 60, 10, 1200),  # M201 E by its share
        ("G1 Y60 F12000", 60, 150, 1000),  # M203 Y, M201 Y
        ("G1 X80 Y60 F6000", 100, 100, 1000 / 0.6),  # each axis by its share
        ("G1 Z20 F6000", 10, 10, 100),  # no M204: neither X nor Y moves
        ("G1 X30 F6", 30, 0.5, 2000),  # nothing is slower than 0.5 mm/s
    ],
)
def test_one_line_from_rest_to_rest(line: str, mm: float, top: float, a: float) -> None:
    assert plan(line).duration == pytest.approx([ramped_s(mm, top, a)], rel=1e-6)


@pytest.mark.parametrize(
    ("lines", "speed"),
    [
        ("G1 X60 F6000\nG1 Y60", 8.0),  # X may jump by 10, Y by 8
        ("G1 X60 F6000\nG1 X30", 5.0),  # there and back: twice the speed
        ("G1 X60 F6000\nG1 X100 Y40", 8.0 * sqrt(2)),  # Y jumps by v sin 45°, X by less
        ("G1 X60 F6000\nG1 X120", 100.0),  # no corner
        ("G1 X60 F6000\nG1 X120 F2400", 40.0),  # the slower of both
        ("G1 X60 E3 F6000\nG1 X120 E12", 5 / 0.15),  # the filament jumps
        ("M566 Y6\nG1 X60 F6000\nG1 Y60", 0.1),  # mm/min
        ("M205 Y6\nG1 X60 F6000\nG1 Y60", 6.0),  # mm/s
        ("m566y300\nG1 X60 F6000\nG1 Y60", 5.0),
    ],
)
def test_the_speed_in_a_corner_is_that_at_which_no_axis_jumps_too_far(lines: str, speed: float) -> None:
    made = plan(lines)
    assert made.end_v[0] == made.start_v[1] == pytest.approx(speed, rel=1e-6)


def test_limits_that_the_file_sets_hold_from_their_line_on() -> None:
    made = plan(
        "M204 P800 T2500\nM203 X3000 E600:600 ; 50 and 10 mm/s\nG1 X60 F6000\nG1 Y60\n"
        "M566 X300 Y240 E60:60\nM201 Y500\nM203 X6000\nG1 X0\nG1 Y0"
    )
    assert made.end_v == pytest.approx([8.0, 4.0, 4.0, 0.0], rel=1e-6)
    assert made.cruise_v == pytest.approx([50, 100, 100, 100], rel=1e-6)
    assert made.acceleration == pytest.approx([2000, 1000, 2000, 500], rel=1e-6)
    ends = [ramped_s(60, 50, 2000, 0, 8), ramped_s(60, 100, 1000, 8, 4)]
    ends += [ramped_s(60, 100, 2000, 4, 4), ramped_s(60, 100, 500, 4, 0)]
    assert made.duration == pytest.approx(ends, rel=1e-6)


@pytest.mark.parametrize(
    "lines",
    [
        "G1 X60 E2 F6000\nG1 X120",  # extrudes, travels
        "G1 X60 F6000\nG1 Z10.4",  # X, then Z alone
        "G1 X60 E2 F6000\nG1 X120 E-2",  # a wipe is no printing move
    ],
)
def test_by_default_no_speed_is_carried_between_unlike_moves(lines: str) -> None:
    policies = [machine_of(settings=replace(SETTINGS, jerk_policy=policy)) for policy in (0, 1)]
    speeds = [plan(lines, machine).end_v[0] for machine in policies]
    assert speeds[0] == 0.0 < speeds[1]
    assert plan(f"M566 P1\n{lines}", policies[0]).end_v[0] == pytest.approx(speeds[1])
    assert plan(f"M566 P0\n{lines}", policies[1]).end_v[0] == 0.0


def test_x_and_y_share_limits_on_corexy_and_on_a_delta() -> None:
    """A CoreXY's motor on the diagonal runs sqrt 2 times as fast; a delta's limits are the same in all directions."""
    diagonal = "G1 X30 Y30 F12000"
    cartesian, belts, delta = (plan(diagonal, machine_of(name)) for name in ("prusa-mk3s", "voron-300", "kossel"))
    assert cartesian.acceleration == pytest.approx([1000 * sqrt(2)])
    assert belts.acceleration == pytest.approx([sqrt(2) / (1 / 2000 + 1 / 1000)])
    assert delta.acceleration == pytest.approx([1000.0])


def test_the_queue_is_as_far_as_it_sees() -> None:
    """40 lines of 0.1 mm leave 4 mm to brake in: sqrt(2 · 1000 · 4) mm/s."""
    lines = "G1 Y0.1 F12000\n" + "".join(f"G1 Y{0.1 * k:.1f}\n" for k in range(2, 500))
    for queue in (40, 100):
        speeds = plan(lines, machine_of(settings=replace(SETTINGS, queue_moves=queue))).start_v
        assert speeds.max() == pytest.approx(sqrt(2 * 1000 * 0.1 * queue), rel=1e-6)


def test_moves_that_are_to_be_gentler_are() -> None:
    """Time scaling lowers a move's acceleration and corner below the file's."""
    machine = machine_of()
    text = b"M204 P1500 T1000\nG1 X60 F6000\nG1 Y60\n"
    known = known_to_the_firmware(machine)
    program = read_program(text, flavor="reprapfirmware", start=(0.0, 0.0, 10.0), **known)
    moves = replace(program.moves, acceleration=0.5 * program.moves.acceleration)
    assert firmware_plan(replace(program, moves=moves), machine).acceleration == pytest.approx([500.0, 500.0])
