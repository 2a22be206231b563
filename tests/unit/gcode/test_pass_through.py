"""Moves that become lines of their own; what is left is the rest of the program."""

from __future__ import annotations

import pytest

from gcode.program import EventKind
from gcode.reader import read_program
from gcode.slicing import passed_through

TEXT = b"""; a
G1 X10 F600 E1
M106 S9
G1 X20 E2
G2 X30 I5 J0 E3
; b
G1 X40 E4
"""


def test_a_move_becomes_a_line_that_goes_out_as_it_is() -> None:
    program = read_program(TEXT, start=(0.0, 0.0, 1.0))
    moves = program.moves
    left = passed_through(program, moves.line == 3, "why")
    (raw,) = (event for event in left.events if event.kind is EventKind.RAW_MOVE)
    assert (raw.line, raw.move) == (3, 1) and raw.moves_itself and raw.raw is not None
    assert (raw.raw.start[0], raw.raw.end[0], raw.raw.path_mm, raw.raw.filament_mm, raw.raw.speed) == (
        10.0,
        20.0,
        10.0,
        pytest.approx(1.0),
        10.0,
    )
    assert raw.raw.cause == (4, "why")
    assert [event.line for event in left.events] == sorted({0, 2, 3, 5})
    assert len(left.moves) == len(moves) - 1 and left.moves.start[1, 0] == 20.0
    assert [event.move for event in left.events] == [0, 1, 1, len(left.moves) - 1]
