"""A file read in parts says what it says when it is read whole, wherever it is cut."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, reduce
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gcode.dialects import flavor_sign
from gcode.errors import GcodeError
from gcode.program import Moves, Program
from gcode.reader import read_parts, read_program
from gcode.slicing import excerpt, join, portions, preamble
from tests.support.data import PRINTS, real

ROOT = Path(__file__).parents[3]
SAMPLES = sorted(path.name for path in (ROOT / "sample_prints").glob("*.gcode"))
HOME = (0.0, 0.0, 0.0)
COLUMNS = [name for name in Moves.__dataclass_fields__ if name not in ("line", "frame")]


@cache
def named(name: str) -> bytes:
    return (ROOT / "sample_prints" / name).read_bytes() if name in SAMPLES else real(name)


def blocks(data: bytes, sizes: list[int]) -> Iterator[bytes]:
    """Blocks of these sizes, over and over."""
    at = turn = 0
    while at < len(data):
        yield data[at : at + sizes[turn % len(sizes)]]
        at += sizes[turn % len(sizes)]
        turn += 1


def said(programs: list[Program]) -> dict[str, object]:
    """All that the programs say, one after another, with the numbers of lines, moves and frames resolved."""
    first_move = np.cumsum([0, *(len(program.moves) for program in programs)]).tolist()
    lines = [program.moves.line + program.first_line for program in programs]
    frames, events = [], []
    for program, before in zip(programs, first_move, strict=False):
        texts = [repr(frame) for frame in program.frames]  # as text, where NaN equals NaN
        frames += [texts[number] for number in program.moves.frame.tolist()]
        for line, move, kind, frame, *rest in program.events:
            events.append((line + program.first_line, move + before, kind, texts[frame], repr(rest)))
    columns = {name: np.concatenate([getattr(p.moves, name) for p in programs]).tobytes() for name in COLUMNS}
    return {
        "lines": [line for program in programs for line in program.lines],
        "line of each move": np.concatenate(lines).tolist(),
        "frame of each move": frames,
        "events": events,
        # codes that are not known share a sentence in each part
        "warnings": [told for program in programs for told in program.warnings if "not known" not in told],
        **columns,
    }


def attempt(data: bytes, parts: Iterator[Program] | None = None, **options) -> dict[str, object] | str:
    try:
        return said(list(parts) if parts else [read_program(data, "p", **options)])
    except GcodeError as error:
        return str(error)


def assert_parts_say_the_same(data: bytes, sizes: list[int], part_bytes: int, **options) -> None:
    flavor = flavor_sign([data]).flavor
    parts = read_parts(blocks(data, sizes), "p", flavor=flavor, part_bytes=part_bytes, **options)
    assert attempt(data, parts, **options) == attempt(data, **options)


@pytest.mark.parametrize("name", [*SAMPLES, *PRINTS])
def test_real_prints(name: str) -> None:
    assert_parts_say_the_same(named(name), [4001], 1 << 15)


sizes = st.lists(st.integers(1, 60), min_size=1, max_size=8)


numbers = st.decimals(-200, 200, places=3).map(str)
moves = st.builds(
    lambda code, words: code + "".join(f" {letter}{number}" for letter, number in words.items()),
    st.sampled_from(["G0", "G1", "g1", "G01", ""]),
    st.dictionaries(st.sampled_from("XYZE"), numbers, min_size=1),
)
OTHERS = r"""
G90|G91|M82|M83|G20|G21|G92 E0|G92 X0 Y5|G92|G28|G1 F1200|G1 X1 F600|G3 I5 E1|G2 X9 R900|G1 X1 ; wall|G1 X1 (note)
M220 S90|M221 S95|SAVE_GCODE_STATE NAME=a|RESTORE_GCODE_STATE NAME=a|RESTORE_GCODE_STATE NAME=a MOVE=1|T0|T1|PAUSE
SET_GCODE_OFFSET X=1|M204 S500|SET_VELOCITY_LIMIT ACCEL=900|G4 P5|G17 G21|M117 G1 X1|FROBNICATE|M106 S255|%|  ;
G1 X00000001|G1 X0.1234567890123456|; caf\xe9 G1 X5|; form\x0bfeed|
"""
others = st.sampled_from([text for line in OTHERS.strip("\n").splitlines() for text in line.split("|")])
endings = st.sampled_from(["\n", "\r\n", "\r", "\n\n"])
texts = st.lists(st.tuples(moves | moves | others, endings), min_size=1, max_size=40)


@given(texts, sizes, st.integers(1, 200), st.booleans(), st.booleans())
def test_random_programs(
    lines: list[tuple[str, str]], sizes: list[int], part_bytes: int, known: bool, shifted: bool
) -> None:
    """The last line may lack its ending, and any block may end within a line's ending."""
    text = "SAVE_GCODE_STATE NAME=a\nG1\n" + "".join(text + ending for text, ending in lines).rstrip("\n")
    offset = (-10.0, 3.0) if shifted else (0.0, 0.0)
    data = text.encode("latin-1")
    assert_parts_say_the_same(data, sizes, part_bytes, start=HOME if known else None, offset_mm=offset)


def test_mistakes_name_the_line_of_the_file() -> None:
    parts = read_parts([b"; first\nG1 X1\nG1 X1 A3\n"], "part.gcode", flavor="klipper", start=HOME, part_bytes=1)
    assert [next(parts).warnings for _ in range(2)] == [[], [f"line 2: {NO_SPEED}."]]
    with pytest.raises(GcodeError, match=r"^part\.gcode:3: "):
        next(parts)


NO_SPEED = "the first move has no speed; 25 mm/s is assumed until the first F"


GROWTH = """
import resource
from pathlib import Path
from gcode.reader import read_parts

block = Path("sample_prints/lobed_vase.gcode").read_bytes().replace(b"G28", b"G92 E0")
def lines(count):
    parts = read_parts((block for _ in range(count)), flavor="marlin", start=(0.0, 0.0, 0.0))
    return sum(len(part.lines) for part in parts)
lines(1)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(lines(30_000_000 // len(block)))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.mark.skipif(os.name == "nt", reason="peak memory is asked of POSIX")
def test_memory_stays_flat_over_30_megabytes() -> None:
    answer = subprocess.run([sys.executable, "-c", GROWTH], capture_output=True, text=True, check=True, cwd=ROOT)
    lines, growth = map(int, answer.stdout.split())
    assert lines > 750_000
    assert growth * (1 if sys.platform == "darwin" else 1024) < 30e6  # Linux counts in KiB


# ---- slicing preamble ----


def whole_line(program: Program, move: int) -> int:
    while program.moves.line[move] == program.moves.line[move - 1]:
        move += 1
    return move


def read_alone(program: Program, first: int, last: int) -> Program:
    """The part's text, read by itself, as the printer's own coordinates."""
    x, y, z, _ = program.moves.start[first]
    text = preamble(program, first) + b"".join(excerpt(program, first, last).lines)
    return read_program(text, start=(x, y, z), flavor=flavor_sign(program.lines).flavor)


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


# ---- slicing ----


MANY_FRAMES = b"G90\nM82\nG1 X0 Y0 Z1 F1200\n" + b"".join(
    b"G1 X%d E%d F%d\n;between\nG92 E0\nG1 E-1 F600\n" % (k % 50, k % 7 + 1, 1000 + k) for k in range(100)
)
ARC = b"G90\nG1 X10 Y0 Z1 F1200\n;before\nG2 X-10 Y0 I-10 J0\n;after\nG1 X0\n"


def said_of_slicing(program: Program) -> list[object]:
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
    assert b"".join(line for each in parts for line in each.lines) == MANY_FRAMES
    together = parts[0]
    for each in parts[1:]:
        assert each.first_line == len(together.lines)
        together = join(together, each)
    assert said_of_slicing(together) == said_of_slicing(whole)
    assert max(len(each.frames) for each in parts) <= 4 * (every + 2)


@pytest.mark.parametrize("longest_s", [0.0, 2.5, 1e9])
def test_portions_of_little_motion_together_are_the_whole_and_end_with_lines(longest_s: float) -> None:
    whole = read_program(MANY_FRAMES + ARC)
    parts = list(portions(replace(whole, warnings=["once"]), longest_s))
    assert b"".join(line for each in parts for line in each.lines) == MANY_FRAMES + ARC
    assert [sentence for each in parts for sentence in each.warnings] == ["once"]
    assert said_of_slicing(reduce(join, parts)) == said_of_slicing(whole)
    for each in parts:
        moves = each.moves
        seconds = np.linalg.norm((moves.end - moves.start)[:, :3], axis=1) @ (1.0 / moves.speed)
        assert seconds <= longest_s or len(set(moves.line.tolist())) == 1
    assert len(parts) == {0.0: len(set(whole.moves.line.tolist())), 1e9: 1}.get(longest_s, len(parts)) and parts
    assert next(portions(read_program(b"; nothing\n"), 1.0)).lines == [b"; nothing\n"]
