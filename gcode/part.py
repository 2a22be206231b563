"""A part of a program as a program of its own, and the lines that set what was in force where it begins."""

from __future__ import annotations

from dataclasses import fields, replace

from gcode.program import Moves, Program


def part(program: Program, first: int, last: int) -> Program:
    """The moves first..last-1 with their lines and the events between them; frames stay those of the whole.

    Arcs must stay whole: neither `first` nor `last` may be a later chord of the same line.
    """
    moves = program.moves
    begin = int(moves.line[first])
    end = int(moves.line[last]) if last < len(moves) else len(program.lines)
    columns = {each.name: getattr(moves, each.name)[first:last] for each in fields(Moves)}
    own = Moves(**{**columns, "line": columns["line"] - begin})
    events = [
        event._replace(line=event.line - begin, move=event.move - first)
        for event in program.events
        if begin <= event.line < end
    ]
    lines, first_line = program.lines[begin:end], program.first_line + begin
    return replace(program, lines=lines, moves=own, events=events, first_line=first_line)


def preamble(program: Program, move: int) -> bytes:
    """What a reader that knows where the nozzle is must be told to go on from this move: modes, names, feed."""
    moves = program.moves
    frame = program.frames[int(moves.frame[move])]
    x, y, z = ((moves.start[move, i] - frame.base[i]) / frame.unit_mm for i in range(3))
    e = (moves.start[move, 3] - frame.base[3]) / frame.flow / frame.unit_mm
    return (
        b"%b\nM220 S%.9g\nM221 S%.9g\n"
        % (b"G21" if frame.unit_mm == 1.0 else b"G20", 1e2 * frame.feed_factor, 1e2 * frame.flow)
        + b"G92 X%.9f Y%.9f Z%.9f E%.9f\n" % (x, y, z, e)
        + b"G1 F%.9f\n" % (60 * frame.feed_mm_per_s / frame.feed_factor / frame.unit_mm)
        + b"%b\n%b\n" % (b"G90" if frame.absolute else b"G91", b"M82" if frame.absolute_e else b"M83")
    )
