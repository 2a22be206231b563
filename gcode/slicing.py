"""Split and join programs, and pass moves through uncompensated."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import fields, replace
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from gcode import program as data
from gcode.program import Event, EventKind, FloatArray, IntArray, Moves, Program, RawMove


def split(program: Program, move: int) -> tuple[Program, Program]:
    """Split a program before the line of a move, which must not be a later chord of an arc."""
    return excerpt(program, 0, move), replace(excerpt(program, move), warnings=[])


def excerpt(program: Program, first: int, last: int | None = None) -> Program:
    """Return the moves first … last - 1 (one at least), with the lines from that of the first up to that of `last`.

    If it begins or ends within an arc, it has the arc's line and the chords in the range.
    """
    moves, by_line = program.moves, attrgetter("line")
    last = len(moves) if last is None else last
    begin = int(moves.line[first]) if first else 0
    end = max(int(moves.line[last]), int(moves.line[last - 1]) + 1) if last < len(moves) else len(program.lines)
    a, b = (bisect_left(program.events, line, key=by_line) for line in (begin, end))
    moves_within, events = some(moves, slice(first, last)), program.events[a:b]
    used = list(
        dict.fromkeys([_frame_before(program, first, a), *moves_within.frame.tolist(), *(e.frame for e in events)])
    )
    number = {frame: k for k, frame in enumerate(used)}
    frame = np.array([number[each] for each in moves_within.frame.tolist()], dtype=np.int64)
    return replace(
        program,
        lines=program.lines[begin:end],
        moves=replace(moves_within, line=moves_within.line - begin, frame=frame),
        events=data.shifted(events, -begin, -first, number),
        frames=[program.frames[each] for each in used] if program.frames else [],  # none where they do not matter
        first_line=program.first_line + begin,
        limits=data.limits_in_effect(program, program.limits, a),
    )


def portions(program: Program, longest_s: float) -> Iterator[Program]:
    """Split a program between lines into consecutive ones of at most `longest_s` of motion, or of one line."""
    moves = program.moves
    until_s = np.cumsum(np.linalg.norm((moves.end - moves.start)[:, :3], axis=1) / moves.speed)
    if not len(moves) or until_s[-1] <= longest_s:
        yield program
        return
    lines = np.flatnonzero(np.diff(moves.line, append=-1))  # the last move of each
    first, warnings = 0, program.warnings
    while first < len(moves):
        begun_s = float(until_s[first - 1]) if first else 0.0
        at = max(int(np.searchsorted(until_s[lines], begun_s + longest_s)), int(np.searchsorted(lines, first)) + 1)
        last = int(lines[at - 1]) + 1
        yield replace(excerpt(program, first, last), warnings=warnings)
        first, warnings = last, []


def _frame_before(program: Program, move: int, event: int) -> int:
    """Return the frame in force before a move's line; `event` is the first one after it."""
    moves, last = program.moves, program.events[event - 1] if event else None
    if not move:
        return 0
    return last.frame if last is not None and last.line > moves.line[move - 1] else int(moves.frame[move - 1])


def shortened(program: Program, start: FloatArray | None, end: FloatArray | None) -> Program:
    """Begin the first move later and end the last one earlier, at (4,) mm; None: unchanged."""
    moves = program.moves
    starts, ends = moves.start.copy(), moves.end.copy()
    if start is not None:
        starts[0] = start
    if end is not None:
        ends[-1] = end
    return replace(program, moves=replace(moves, start=starts, end=ends))


def join(first: Program, second: Program) -> Program:
    """Join two programs; the second begins where the first ends."""
    lines, moves, frames = len(first.lines), len(first.moves), len(first.frames)
    later_moves = second.moves
    later_moves = replace(later_moves, line=later_moves.line + lines, frame=later_moves.frame + frames)
    columns = (each.name for each in fields(Moves))
    both = Moves(**{name: np.concatenate([getattr(first.moves, name), getattr(later_moves, name)]) for name in columns})
    numbers = range(frames, 1 << 30)  # also those of a program that keeps no frames
    later = data.shifted(second.events, lines, moves, numbers)
    return replace(
        first,
        lines=first.lines + second.lines,
        moves=both,
        events=first.events + later,
        frames=first.frames + second.frames,
        warnings=first.warnings + second.warnings,
    )


def some(moves: Moves, which: slice | NDArray[np.bool_]) -> Moves:
    """Return a slice of moves, or those that are marked."""
    return Moves(**{each.name: getattr(moves, each.name)[which] for each in fields(Moves)})


def preamble(program: Program, move: int) -> bytes:
    """Return the lines that set the modes, offsets and feed in force before this move."""
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


def passed_through(program: Program, which: NDArray[np.bool_], reason: str) -> Program:
    """Turn moves into lines that are not compensated; one chord takes its arc with it.

    which : (n,) the moves
    reason : why they are not compensated; it stands where others have the command that caused it
    """
    moves = program.moves
    if not which.any():
        return program
    gone = np.isin(moves.line, moves.line[which])
    before = np.concatenate([[0], np.cumsum(~gone)])  # moves kept before each one
    numbers = np.flatnonzero(gone)
    lines = np.split(numbers, np.flatnonzero(np.diff(moves.line[numbers])) + 1)  # the moves of each
    passing = [_event(program, each, int(before[each[0]]), reason) for each in lines]
    staying = [event._replace(move=int(before[event.move])) for event in program.events]
    return replace(program, moves=some(moves, ~gone), events=sorted([*staying, *passing], key=lambda event: event.line))


def _event(program: Program, numbers: IntArray, before: int, reason: str) -> Event:
    moves = program.moves
    first, last = int(numbers[0]), int(numbers[-1])
    start, end = moves.start[first], moves.end[last]
    path_mm = float(np.sqrt(((moves.end[numbers] - moves.start[numbers])[:, :3] ** 2).sum(axis=1)).sum())
    columns = moves.speed, moves.velocity_limit, moves.acceleration, moves.square_corner_velocity
    speed, velocity, acceleration, corner = (float(column[first]) for column in columns)
    way, cause = (path_mm, float(end[3] - start[3]), speed), (program.line_of(first), reason)
    raw = RawMove(tuple(start.tolist()), tuple(end.tolist()), *way, velocity, acceleration, corner, cause)
    frame = int(moves.frame[last])
    return Event(int(moves.line[first]), before, EventKind.RAW_MOVE, frame, moves_itself=True, raw=raw)
