"""A part of a print as a file of its own holds the same moves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gcode.dialects import detect_flavor
from gcode.program import Program
from gcode.reader import read_program
from gcode.slicing import excerpt, preamble
from tests.support.data import PRINTS, real

ROOT = Path(__file__).parents[3]
SAMPLES = sorted(path.name for path in (ROOT / "sample_prints").glob("*.gcode"))


def whole_line(program: Program, move: int) -> int:
    while program.moves.line[move] == program.moves.line[move - 1]:
        move += 1
    return move


def read_alone(program: Program, first: int, last: int) -> Program:
    """The part's text, read by itself, as the printer's own coordinates."""
    x, y, z, _ = program.moves.start[first]
    text = preamble(program, first) + b"".join(excerpt(program, first, last).lines)
    return read_program(text, start=(x, y, z), flavor=detect_flavor(program.lines))


def assert_same_way(alone: Program, program: Program, first: int, last: int) -> None:
    assert len(alone.moves) == last - first
    for column in ("start", "end"):
        mine, theirs = getattr(alone.moves, column), getattr(program.moves, column)[first:last]
        np.testing.assert_allclose(mine[:, :3], theirs[:, :3], atol=1e-6)
    filament = alone.moves.end[:, 3] - alone.moves.start[:, 3]
    np.testing.assert_allclose(filament, (program.moves.end - program.moves.start)[first:last, 3], atol=1e-6)
    np.testing.assert_allclose(alone.moves.speed, program.moves.speed[first:last], rtol=1e-6)


@pytest.mark.parametrize("name", [*SAMPLES, *PRINTS])
@pytest.mark.parametrize("share", [0.3, 0.8])
def test_the_middle_of_real_prints_read_alone_goes_the_same_way(name: str, share: float) -> None:
    data = (ROOT / "sample_prints" / name).read_bytes() if name in SAMPLES else real(name)
    program = read_program(data, name)
    count = len(program.moves)
    first, last = (whole_line(program, int(at * count)) for at in (share, share + 0.05))
    assert_same_way(read_alone(program, first, last), program, first, last)
