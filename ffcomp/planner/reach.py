"""Moves outside the print volume: an error in the part, passed through unchanged elsewhere.

Start and end code parks, wipes and purges outside the print volume of many machine files, where the printer still
reaches: a purge line at X-2, say. Such a move is neither compensated nor refused. It is passed through unchanged, and
the firmware decides whether it is reachable. Extrusion in layers must lie inside.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from gcode.errors import GcodeError
from gcode.layers import layer_starts
from gcode.program import EventKind, Program
from gcode.slicing import passed_through
from models.arrays import BoolArray
from models.errors import UnreachableError
from models.kinematics.base import Kinematics

BESIDE = "beside the print volume"  # why moves pass through unchanged
PURGE_MOVES = 20  # extruding moves at the beginning of a print without layer comments that may be a purge line …
PART_MOVES = 100  # … if so many are in sight


class PartMoves:
    """Tell which moves extrude the part, program after program of a file: not what comes before its first layer."""

    def __init__(self) -> None:
        self._begun = False  # whether a comment has begun a layer
        self._extruded = 0  # moves so far, as long as none has

    def of(self, program: Program) -> BoolArray:
        """Return which moves of the next program do, (n,)."""
        moves = program.moves
        way = moves.end - moves.start
        extrudes = (way[:, 3] > 0.0) & np.any(way[:, :2] != 0.0, axis=1)
        if self._begun:
            return np.asarray(extrudes)
        numbers = self._extruded + np.cumsum(extrudes)
        starts = layer_starts(program)
        self._begun = bool(starts)
        self._extruded = int(numbers[-1]) if numbers.size else self._extruded
        if starts:
            return np.asarray(extrudes & (np.arange(len(moves)) >= starts[0]))
        return np.asarray(extrudes & ((numbers > PURGE_MOVES) | (self._extruded < PART_MOVES)))


class Reach:
    """Passes the moves outside the print volume through, program by program."""

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics, self._part = kinematics, PartMoves()
        self._lines, self._left = 0, 0  # passed through unchanged; moves kept
        self._points = np.empty((0, 3))  # mm, points of those lines outside the volume
        self._first: GcodeError | None = None  # about the first of them

    def of(self, program: Program) -> Program:
        """Return the program with the moves outside the volume passed through unchanged.

        Raises OutOfReach if the part itself lies outside, with the line.
        """
        moves, part = program.moves, self._part.of(program)
        begin, end = (self._kinematics.reachable(points[:, :3]) for points in (moves.start, moves.end))
        outside = np.isin(moves.line, moves.line[~(begin & end)])  # a line that firmware cuts is one line
        self._left += int(np.count_nonzero(~outside))
        if not outside.any():
            return program
        if (error := _about(self._kinematics, program, part & ~end, part & ~begin)) is not None:
            raise error
        self._first = self._first or _about(self._kinematics, program, ~end, ~begin)
        self._lines += len(np.unique(moves.line[outside]))
        points = np.concatenate([self._points, moves.start[~begin, :3], moves.end[~end, :3]])
        self._points = np.unique(np.round(points, 3), axis=0)
        return passed_through(program, outside, BESIDE)

    def whole(self, parts: Iterable[Program]) -> Iterator[Program]:
        """Yield a file's programs in order, through `of`; raise if no move is left."""
        yield from map(self.of, parts)
        if self._first is not None and not self._left:
            raise self._first

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warn once per file of the moves passed through unchanged, with the remedy."""
        if self._first is None:
            return ()
        others = f", and so do {self._lines - 1} more lines" if self._lines > 1 else ""
        widening = self._kinematics.widening(self._points)
        remedy = f" If the printer reaches it, {widening}; the firmware decides in any case." if widening else ""
        rule = f"{self._first.rule.rstrip('.')}{others}: not part of the print, so it passes through uncompensated."
        return (f"line {self._first.line}: {rule}{remedy}",)


class OutOfReach(GcodeError):
    """A position that the machine cannot reach."""


def within_reach(program: Program, kinematics: Kinematics) -> Program:
    """Return a whole file's program without the moves outside the print volume; see `Reach`."""
    (inside,) = Reach(kinematics).whole([program])
    return inside


def check_moves(program: Program, kinematics: Kinematics) -> None:
    """Raise OutOfReach, with the line, unless every move lies in the print volume."""
    moves = program.moves
    begin, end = (kinematics.reachable(points[:, :3]) for points in (moves.start, moves.end))
    if (error := _about(kinematics, program, ~end, ~begin)) is not None:
        raise error


def _about(kinematics: Kinematics, program: Program, at_end: BoolArray, at_start: BoolArray) -> OutOfReach | None:
    """Return the error of the first move that ends or starts outside, if any."""
    moves, which = program.moves, at_end if at_end.any() else at_start
    if not which.any():
        return None
    move = int(np.flatnonzero(which)[0])
    points = moves.end if at_end.any() else moves.start
    if at_end.any():  # of a line that firmware cuts, the point that it names
        last = int(np.flatnonzero(moves.line == moves.line[move])[-1])
        move = last if at_end[last] else move
    try:
        kinematics.check_reach(points[move : move + 1, :3])
    except UnreachableError as error:
        line = int(moves.line[move]) if at_end.any() else _line_to_start(program, move)
        return OutOfReach(error.rule, program.first_line + line + 1, program.path)
    return None


def _line_to_start(program: Program, move: int) -> int:
    """Return the line that has brought the nozzle to where a move starts."""
    moves = program.moves
    lines = [event.line for event in program.events if event.move <= move and event.kind is EventKind.RAW_MOVE]
    if move and np.array_equal(moves.end[move - 1, :3], moves.start[move, :3]):
        lines.append(int(moves.line[move - 1]))
    return max((line for line in lines if line < moves.line[move]), default=int(moves.line[move]))
