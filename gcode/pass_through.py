"""Let moves of a program go out as they are: the firmware plans them, and the motion rests before and after."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from gcode.arrays import IntArray
from gcode.program import Event, EventKind, Moves, Program, RawMove


def passed_through(program: Program, which: NDArray[np.bool_], reason: str) -> Program:
    """Turn moves into lines that are not compensated; of an arc all chords go, if one does.

    Parameters
    ----------
    program : Program
        The program.
    which : (n,) bool
        The moves.
    reason : str
        Why they go out as they are, in place of the command that others have as their cause.
    """
    moves = program.moves
    if not which.any():
        return program
    gone = np.isin(moves.line, moves.line[which])
    before = np.concatenate([[0], np.cumsum(~gone)])  # moves that stay before each one
    passing = [_event(program, own, int(before[own[0]]), reason) for own in _lines_of(moves, gone)]
    staying = [event._replace(move=int(before[event.move])) for event in program.events]
    left = Moves(**{each.name: getattr(moves, each.name)[~gone] for each in fields(Moves)})
    return replace(program, moves=left, events=sorted([*staying, *passing], key=lambda event: event.line))


def _lines_of(moves: Moves, gone: NDArray[np.bool_]) -> list[IntArray]:
    """Return the moves that go, line by line."""
    numbers = np.flatnonzero(gone)
    return np.split(numbers, np.flatnonzero(np.diff(moves.line[numbers])) + 1)


def _event(program: Program, own: IntArray, before: int, reason: str) -> Event:
    moves = program.moves
    first, last = int(own[0]), int(own[-1])
    start, end = moves.start[first], moves.end[last]
    raw = RawMove(
        tuple(start.tolist()),
        tuple(end.tolist()),
        path_mm=float(np.sqrt(((moves.end[own] - moves.start[own])[:, :3] ** 2).sum(axis=1)).sum()),
        filament_mm=float(end[3] - start[3]),
        speed=float(moves.speed[first]),
        velocity_limit=float(moves.velocity_limit[first]),
        acceleration=float(moves.acceleration[first]),
        square_corner_velocity=float(moves.square_corner_velocity[first]),
        cause=(program.first_line + int(moves.line[first]) + 1, reason),
    )
    frame = int(moves.frame[last])
    return Event(int(moves.line[first]), before, EventKind.RAW_MOVE, frame, moves_itself=True, raw=raw)
