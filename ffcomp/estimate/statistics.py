"""Add up every move's time and filament by its layer, its feature, and its kind of motion.

Rows are added up, (6,) arrays: the seconds of each kind of motion and of waiting, and mm of filament.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ffcomp.estimate.layers import Layers, summed
from ffcomp.estimate.slices import PlannedSlice
from ffcomp.estimate.unknown import Unknown, unknown_in
from ffcomp.planner.limits import lines_of
from gcode.embedded import TIME_WAS, WAS
from gcode.layers import UNNAMED, begins_feature, begins_layer
from gcode.metadata import slicer_time_s, with_time
from gcode.program import Event
from models.arrays import FloatArray, IntArray

KINDS = ("extruding", "travelling", "retracting", "priming", "waiting")
EXTRUDING, TRAVELLING, RETRACTING, PRIMING, WAITING, FILAMENT = range(6)
COLUMNS = 6
STILL_MM = 5e-5  # of filament in one move: less is rounding
RETRACTED_MM = 0.05  # of filament at least, to call it a retraction


@dataclass(slots=True)
class _Marks:
    """Lines of a slice whose comments begin layers and features: indices into the program's lines."""

    layers: list[int] = field(default_factory=list)
    features: list[int] = field(default_factory=list)
    names: list[str] = field(default_factory=list)  # of the features; the first is the one before them all


@dataclass(slots=True)
class Statistics:
    """Time and filament that have been counted so far."""

    moves: int = 0
    retractions: int = 0
    filament_mm: float = 0.0
    slicer_s: float | None = None  # that the slicer's comment states
    features: dict[str, FloatArray] = field(default_factory=dict)
    layers: Layers = field(default_factory=Layers)
    unknown: dict[tuple[str, str], Unknown] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    _feature: str = UNNAMED
    _fed_mm: float = 0.0
    _pulled_mm: float = 0.0  # how far back filament has been pulled just now, as a negative number
    _time_was: bytes | None = None  # of the line that comes next

    @property
    def total(self) -> FloatArray:
        """(6,) of everything."""
        return np.sum([np.zeros(COLUMNS), *self.features.values()], axis=0)

    def add(self, part: PlannedSlice, raw_s: Mapping[int, float] = MappingProxyType({})) -> None:
        """Count a slice's own moves and lines.

        Parameters
        ----------
        part : PlannedSlice
        raw_s : mapping
            What moves from a place not known take, s, by their line's index.
        """
        marks = self._read(part, raw_s)
        if part.plan is not None and part.last > part.first:
            self._add_moves(part, part.plan.duration[part.first : part.last], marks)
        self.layers.leave(len(marks.layers))
        self._feature = marks.names[-1]
        self.warnings += part.program.warnings

    def _read(self, part: PlannedSlice, raw_s: Mapping[int, float]) -> _Marks:
        """Read its lines."""
        marks = _Marks(names=[self._feature])
        number = part.program.first_line + 1  # in the file, of the program's first line
        for event in part.events:
            line = part.program.lines[event.line]
            if line.startswith(TIME_WAS):
                self._time_was = line[len(TIME_WAS) :].rstrip()
                continue
            if line.startswith(b";"):
                self._comment(line, event, marks)
            elif event.dwell_s:
                self._wait(event, event.dwell_s, WAITING, number, marks)
            elif event.raw is not None and raw_s.get(event.line):
                kind = EXTRUDING if event.raw.filament_mm > STILL_MM else TRAVELLING
                self._wait(event, raw_s[event.line], kind, number, marks)
            elif found := unknown_in(part.program, event):
                self.unknown.setdefault(found, Unknown(*found)).add(number + event.line)
            self._time_was = None
        return marks

    def _comment(self, line: bytes, event: Event, marks: _Marks) -> None:
        if line.startswith(WAS):
            return
        if begins_layer(line):
            marks.layers.append(event.line)
        elif name := begins_feature(line):
            marks.features.append(event.line)
            marks.names.append(name)
        elif self.slicer_s is None:
            self.slicer_s = slicer_time_s([line if self._time_was is None else with_time(line, self._time_was)])

    def _wait(self, event: Event, seconds: float, kind: int, number: int, marks: _Marks) -> None:
        row = np.zeros(COLUMNS)
        row[kind] = seconds
        _put(self.features, marks.names[-1], row)
        self.layers.wait(len(marks.layers), row, number + event.line)

    def _add_moves(self, part: PlannedSlice, seconds: FloatArray, marks: _Marks) -> None:
        moves, own = part.program.moves, slice(part.first, part.last)
        fed = moves.end[own, 3] - moves.start[own, 3]
        kind = _kinds(lines_of(moves).travels[own], fed)
        rows = np.zeros((len(seconds), COLUMNS))
        rows[np.arange(len(seconds)), kind] = seconds
        rows[:, FILAMENT] = fed
        self.moves += len(seconds)
        self._feed(fed)
        line = moves.line[own]
        for k, row, _ in summed(np.searchsorted(marks.features, line, side="right"), rows):
            _put(self.features, marks.names[k], row)
        begun = np.searchsorted(marks.layers, line, side="right")
        self.layers.add(begun, rows, moves.end[own, 2], kind == EXTRUDING, part.program.first_line + 1 + line)

    def _feed(self, fed: FloatArray) -> None:
        """Count retractions, and new filament: retracted filament that is fed again does not count."""
        steps = np.append(self._pulled_mm, fed)
        steps = steps[np.abs(steps) > STILL_MM]
        turns = np.flatnonzero(np.diff(np.sign(steps), prepend=0.0))
        runs = np.add.reduceat(steps, turns) if turns.size else np.zeros(1)  # of one direction
        self.retractions += int(np.count_nonzero(runs <= -RETRACTED_MM)) - (self._pulled_mm <= -RETRACTED_MM)
        self._pulled_mm = min(float(runs[-1]), 0.0)
        gone = self._fed_mm + np.cumsum(fed)
        self._fed_mm = float(gone[-1])
        self.filament_mm = max(self.filament_mm, float(gone.max()))


def _kinds(travels: NDArray[np.bool_], fed: FloatArray) -> IntArray:
    """Return the kind of each move, (n,); fed : (n,) mm."""
    moving = np.where(fed > STILL_MM, EXTRUDING, TRAVELLING)
    return np.where(travels, moving, np.where(fed < 0.0, RETRACTING, PRIMING))


def _put(rows: dict[str, FloatArray], key: str, row: FloatArray) -> None:
    rows[key] = rows[key] + row if key in rows else row
