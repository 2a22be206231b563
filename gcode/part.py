"""A part of a print as a file of its own: what was set before it is set first, then its lines follow as they are."""

from __future__ import annotations

import re
from collections.abc import Iterator

from gcode.program import Event, EventKind, Program

_MOVES_OR_SAYS = re.compile(rb"\s*(?:;|$|(?:N\d+\s*)?G0?[0-3]\b)", re.IGNORECASE)


def part(program: Program, first: int, last: int) -> bytes:
    """The text of the moves first..last-1, which must begin and end with a line (arcs stay whole).

    The nozzle goes to where the first of them begins; modes, speed, filament and limits are those in force there.
    """
    moves = program.moves
    begin = int(moves.line[first])
    end = int(moves.line[last]) if last < len(moves) else len(program.lines)
    lines = [*_settings(program, begin), *_place(program, first), *program.lines[begin:end]]
    return b"".join(line if line.endswith(b"\n") else line + b"\n" for line in lines)


def _settings(program: Program, end: int) -> Iterator[bytes]:
    """The lines before `end` that set something and move nothing."""
    for event in program.events:
        if event.line < end and _sets(event, program.lines[event.line]):
            yield program.lines[event.line]


def _sets(event: Event, line: bytes) -> bool:
    """Not a comment, nor a move that went nowhere: from elsewhere it would go somewhere."""
    return event.kind is EventKind.PASS and not _MOVES_OR_SAYS.match(line)


def _place(program: Program, first: int) -> Iterator[bytes]:
    moves = program.moves
    frame = program.frames[int(moves.frame[first])]
    at = moves.start[first]
    x, y, z = ((at[i] - frame.base[i]) / frame.unit_mm for i in range(3))
    e = (at[3] - frame.base[3]) / frame.flow / frame.unit_mm
    yield b"G90\n"
    yield b"G1 X%.9f Y%.9f Z%.9f F%.9f\n" % (x, y, z, 60 * frame.feed_mm_per_s / frame.feed_factor / frame.unit_mm)
    if not frame.absolute:
        yield b"G91\n"
    yield b"%b\nG92 E%.9f\n" % (b"M82" if frame.absolute_e else b"M83", e)
