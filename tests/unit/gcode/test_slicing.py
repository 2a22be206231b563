"""Parts of a program as programs."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from itertools import pairwise

import numpy as np
import pytest

from gcode.program import Program
from gcode.reader import read_program
from gcode.slicing import excerpt, join, portions

MANY_FRAMES = b"G90\nM82\nG1 X0 Y0 Z1 F1200\n" + b"".join(
    b"G1 X%d E%d F%d\n;between\nG92 E0\nG1 E-1 F600\n" % (k % 50, k % 7 + 1, 1000 + k) for k in range(100)
)
ARC = b"G90\nG1 X10 Y0 Z1 F1200\n;before\nG2 X-10 Y0 I-10 J0\n;after\nG1 X0\n"


def said(program: Program) -> list[object]:
    """All that a program says of its moves and events, whatever the numbers of its frames."""
    moves = [(program.lines[a], *b, program.frames[c]) for a, b, c in _rows(program)]
    return [*moves, *((program.lines[e.line], e.kind, program.frames[e.frame]) for e in program.events)]


def _rows(program: Program) -> list[tuple[int, tuple[float, ...], int]]:
    moves = program.moves
    places = np.hstack([moves.start, moves.end]).tolist()
    return list(zip(moves.line.tolist(), map(tuple, places), moves.frame.tolist(), strict=True))


@pytest.mark.parametrize("every", [1, 7, 50])
def test_a_part_says_what_the_whole_says_and_keeps_only_its_own_frames(every: int) -> None:
    whole = read_program(MANY_FRAMES)
    edges = [0, *range(3, len(whole.moves), every), len(whole.moves)]
    parts = [excerpt(whole, a, b) for a, b in pairwise(edges)]
    assert b"".join(line for part in parts for line in part.lines) == MANY_FRAMES
    together = parts[0]
    for part in parts[1:]:
        assert part.first_line == len(together.lines)
        together = join(together, part)
    assert said(together) == said(whole)
    assert max(len(part.frames) for part in parts) <= 4 * (every + 2)


@pytest.mark.parametrize("longest_s", [0.0, 2.5, 1e9])
def test_portions_of_little_motion_together_are_the_whole_and_end_with_lines(longest_s: float) -> None:
    whole = read_program(MANY_FRAMES + ARC)
    parts = list(portions(replace(whole, warnings=["once"]), longest_s))
    assert b"".join(line for part in parts for line in part.lines) == MANY_FRAMES + ARC
    assert [sentence for part in parts for sentence in part.warnings] == ["once"]
    assert said(reduce(join, parts)) == said(whole)
    for part in parts:
        moves = part.moves
        seconds = np.linalg.norm((moves.end - moves.start)[:, :3], axis=1) @ (1.0 / moves.speed)
        assert seconds <= longest_s or len(set(moves.line.tolist())) == 1
    assert len(parts) == {0.0: len(set(whole.moves.line.tolist())), 1e9: 1}.get(longest_s, len(parts)) and parts
    assert next(portions(read_program(b"; nothing\n"), 1.0)).lines == [b"; nothing\n"]
