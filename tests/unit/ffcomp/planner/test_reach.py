"""Moves beside the print volume: those of the part are refused with their line, all others go out as they are."""

from __future__ import annotations

import pytest

from ffcomp.planner.reach import OutOfReach, Reach, within_reach
from gcode.program import EventKind
from gcode.reader import read_program
from models.file import load_machine
from models.machine import Machine

PRINT = b"""G1 X-2 Y20 Z0.3 F6000
G1 X-2 Y90 E9 F1200
G1 X40 Y90 F6000
;LAYER:0
G1 X60 Y90 E12
G1 X60 Y50 E15
G1 X0 Y240 F6000
"""


@pytest.fixture(scope="module")
def ender() -> Machine:
    return load_machine("ender-3")


def read(text: bytes, machine: Machine) -> Reach:
    reach = Reach(machine.kinematics)
    list(reach.whole([read_program(text, "a.gcode", start=(10.0, 10.0, 5.0))]))
    return reach


def test_a_purge_line_and_parking_go_out_as_they_are(ender: Machine) -> None:
    program = read_program(PRINT, start=(10.0, 10.0, 5.0))
    left = within_reach(program, ender.kinematics)
    assert [event.line for event in left.events if event.kind is EventKind.RAW_MOVE] == [0, 1, 2, 6]
    assert left.moves.line.tolist() == [4, 5]


def test_the_part_is_refused_with_its_own_line(ender: Machine) -> None:
    with pytest.raises(OutOfReach, match=r"^a\.gcode:5: The point X = 260\.000, Y = 90\.000"):
        read(PRINT.replace(b"X60 Y90", b"X260 Y90"), ender)


def test_a_part_that_begins_outside_names_the_line_that_went_there(ender: Machine) -> None:
    with pytest.raises(OutOfReach, match=r"^a\.gcode:3: The point X = 240\.000, Y = 90\.000"):
        read(PRINT.replace(b"X40 Y90", b"X240 Y90"), ender)
