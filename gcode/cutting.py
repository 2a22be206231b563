"""A program cut in two before the line of a move, and two that follow each other joined."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import fields, replace
from operator import attrgetter

import numpy as np

from gcode.program import Moves, Program


def split(program: Program, move: int) -> tuple[Program, Program]:
    """What stands before the line of a move, and the rest. The move must not be a later chord of an arc."""
    moves = program.moves
    line = int(moves.line[move])
    at = bisect_left(program.events, line, key=attrgetter("line"))
    later = [event._replace(line=event.line - line, move=event.move - move) for event in program.events[at:]]
    head = replace(program, lines=program.lines[:line], moves=_some(moves, slice(move)), events=program.events[:at])
    own = _some(moves, slice(move, None))
    own = replace(own, line=own.line - line)
    first_line = program.first_line + line
    tail = replace(program, lines=program.lines[line:], moves=own, events=later, warnings=[], first_line=first_line)
    return head, tail


def join(first: Program, second: Program) -> Program:
    """One program of two, the second of which begins where the first ends."""
    lines, moves, frames = len(first.lines), len(first.moves), len(first.frames)
    own = second.moves
    own = replace(own, line=own.line + lines, frame=own.frame + frames)
    columns = (each.name for each in fields(Moves))
    both = Moves(**{name: np.concatenate([getattr(first.moves, name), getattr(own, name)]) for name in columns})
    later = [
        event._replace(line=event.line + lines, move=event.move + moves, frame=event.frame + frames)
        for event in second.events
    ]
    return replace(
        first,
        lines=first.lines + second.lines,
        moves=both,
        events=first.events + later,
        frames=first.frames + second.frames,
        warnings=first.warnings + second.warnings,
    )


def _some(moves: Moves, which: slice) -> Moves:
    return Moves(**{each.name: getattr(moves, each.name)[which] for each in fields(Moves)})
