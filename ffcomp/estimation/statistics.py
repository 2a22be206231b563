"""Add up every move's time and filament by its layer, its feature, and its kind of motion, slice by slice.

Rows are added up, (6,) arrays: the seconds of each kind of motion and of waiting, and mm of filament.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ffcomp.compensation.chunks import MOST_MOVES, rests_of
from ffcomp.inverse.reference import LEAST_CONTEXT_S
from ffcomp.numerics.serialise import ALL_OF, keys
from ffcomp.planner.limits import lines_of
from ffcomp.planner.trajectory import Trajectory
from gcode.embedded import TIME_WAS, WAS
from gcode.layers import FEW_MOVES, SLOPE_MM, UNNAMED, begins_feature, begins_layer
from gcode.metadata import slicer_time_s, with_time
from gcode.program import Event, EventKind, Program
from gcode.slicing import join, split
from gcode.words import commands
from models.arrays import BoolArray, FloatArray, IntArray

PlanOf = Callable[[Program], Trajectory]


@dataclass(frozen=True, slots=True)
class PlannedSlice:
    """A planned program; its moves first … last - 1 and the lines between them count."""

    program: Program
    plan: Trajectory | None  # None: nothing in it moves
    first: int
    last: int

    @property
    def lines(self) -> range:
        """The lines that are counted."""
        moves = self.program.moves
        begin = int(moves.line[self.first]) if self.first else 0
        end = int(moves.line[self.last]) if self.last < len(moves) else len(self.program.lines)
        return range(begin, end)

    @property
    def events(self) -> Iterator[Event]:
        """The events that are counted."""
        counted = self.lines
        return (event for event in self.program.events if event.line in counted)


def planned_slices(parts: Iterable[Program], plan_of: PlanOf) -> Iterator[PlannedSlice]:
    """Join programs that follow each other, and cut them again where the nozzle rests.

    A print without rests, a vase in one spiral, is cut in motion: the moves of some seconds around the cut are planned
    twice, from rest on either side, which the moves at the cut no longer feel.
    """
    pending: Program | None = None
    counted = 0  # moves of `pending` that an earlier slice counts
    for part in parts:
        program = replace(part, frames=[])  # how numbers are written does not matter here, and each speed has its own
        pending = program if pending is None else join(pending, program)
        if not len(pending.moves):
            yield PlannedSlice(pending, None, 0, 0)
            pending = None
            continue
        rests = rests_of(pending)
        if rests.size:
            head, pending = split(pending, int(rests[-1]))
            yield PlannedSlice(head, plan_of(head), counted, len(head.moves))
            counted = 0
        elif len(pending.moves) > MOST_MOVES:
            plan = plan_of(pending)
            begun = _line_begun(pending, plan, plan.end_t - LEAST_CONTEXT_S)
            around = _line_begun(pending, plan, float(plan.start_t[begun]) - LEAST_CONTEXT_S)
            if begun > counted and around > 0:
                yield PlannedSlice(pending, plan, counted, begun)
                pending, counted = split(pending, around)[1], begun - around
    if pending is not None:
        yield PlannedSlice(pending, plan_of(pending), counted, len(pending.moves))


def _line_begun(program: Program, plan: Trajectory, t: float) -> int:
    line = program.moves.line
    return int(np.searchsorted(line, line[int(plan.move_at(t))]))


BEFORE = -1  # lines before the first layer
_STEP_MM = 1e-3  # unit of counted heights, so that a spiral vase has a limited number
_NOWHERE = -(1 << 40)  # the height before anything is extruded


@dataclass(frozen=True, slots=True)
class Layer:
    """Time and filament of a layer, or of a height."""

    json_keys: ClassVar = keys("line", "filament_mm", z_mm="highest_mm") | {ALL_OF: "spent"}

    row: FloatArray  # (6,), see `ffcomp.estimation.statistics`
    line: int  # its first, from 1
    z_mm: float = -np.inf  # of its highest extruding move; -inf: none extrudes
    extruding: int = 0  # moves

    @property
    def spent(self) -> Spent:
        """Its times."""
        return Spent.of(self.row)

    @property
    def highest_mm(self) -> float | None:
        """The height of its highest extruding move; None: none extrudes."""
        return self.z_mm if self.extruding else None

    @property
    def filament_mm(self) -> float:
        """Its filament."""
        return float(self.row[FILAMENT])

    def with_more(self, other: Layer) -> Layer:
        """Add another part of the same layer."""
        return Layer(
            self.row + other.row,
            min(self.line, other.line),
            max(self.z_mm, other.z_mm),
            self.extruding + other.extruding,
        )


@dataclass(frozen=True, slots=True)
class NumberedLayer:
    """A layer with its number."""

    json_keys: ClassVar = keys("layer") | {ALL_OF: "counted"}

    layer: int | None  # from 0; None: before the first
    counted: Layer


@dataclass(slots=True)
class Layers:
    """Layers that have been counted so far."""

    number: int = BEFORE  # of the current layer
    _numbered: dict[int, Layer] = field(default_factory=dict)
    _heights: dict[int, Layer] = field(default_factory=dict)  # as long as no comment has begun a layer
    _height: int = _NOWHERE  # of the last extruding move

    def leave(self, begun: int) -> None:
        """End a slice; `layers` is how many have begun."""
        self.number += begun

    def wait(self, begun: int, row: FloatArray, line: int) -> None:
        """Count a wait, when `begun` layers of the slice have begun."""
        number = self.number + begun
        if number > BEFORE:
            _put(self._numbered, number, Layer(row, line))
        else:
            _put(self._heights, self._height, Layer(row, line))

    def add(self, begun: IntArray, rows: FloatArray, z: FloatArray, extrudes: BoolArray, line: IntArray) -> None:
        """Count n moves.

        Parameters
        ----------
        begun : (n,), layers of the slice that have begun before each
        rows : (n, 6) array
        z : (n,), where each ends, mm
        extrudes : (n,) array
        line : (n,), in the file, from 1
        """
        number, height = self.number + begun, self._heights_of(z, extrudes)
        numbered = number > BEFORE
        tops = np.where(extrudes, z, -np.inf)
        for into, key, which in ((self._numbered, number, numbered), (self._heights, height, ~numbered)):
            for k, layer in _layers(key[which], rows[which], tops[which], line[which]):
                _put(into, k, layer)

    def _heights_of(self, z: FloatArray, extrudes: BoolArray) -> IntArray:
        """Return the height of the last extruding move, (n,)."""
        last = np.maximum.accumulate(np.where(extrudes, np.arange(len(z)), -1))
        height = np.where(last >= 0, np.rint(z[np.maximum(last, 0)] / _STEP_MM).astype(np.int64), self._height)
        self._height = int(height[-1])
        return height

    def in_order(self) -> list[tuple[int, Layer]]:
        """Return the layers with their numbers, from 0; BEFORE, if anything comes before the first."""
        if self._numbered:
            before = [(BEFORE, _together(self._heights.values()))] if self._heights else []
            return before + sorted(self._numbered.items())
        heights = dict(sorted(self._heights.items()))
        start = heights.pop(_NOWHERE, None)
        layers = list(heights.values())
        if sum(layer.extruding for layer in layers) < FEW_MOVES * len(layers):
            layers = _banded(heights)
        return ([] if start is None else [(BEFORE, start)]) + list(enumerate(layers))


def _put(layers: dict[int, Layer], key: int, layer: Layer) -> None:
    layers[key] = layers[key].with_more(layer) if key in layers else layer


def _together(layers: Iterable[Layer]) -> Layer:
    first, *others = layers
    for other in others:
        first = first.with_more(other)
    return first


def _banded(heights: dict[int, Layer]) -> list[Layer]:
    bands: dict[int, Layer] = {}
    for height, layer in heights.items():
        _put(bands, height // round(SLOPE_MM / _STEP_MM), layer)
    return list(bands.values())


def _layers(keys: IntArray, rows: FloatArray, tops: FloatArray, line: IntArray) -> Iterator[tuple[int, Layer]]:
    """Yield layers of moves by their key. tops : (n,) mm, -inf where nothing is extruded."""
    flows = np.isfinite(tops)
    for key, row, first in summed(keys, np.column_stack([rows, flows])):
        yield key, Layer(row[:-1], int(line[first]), float(tops[keys == key].max()), round(float(row[-1])))


def summed(keys: IntArray, rows: FloatArray) -> Iterator[tuple[int, FloatArray, int]]:
    """Yield each key once, with its rows' sum and the index of the first. keys : (n,), rows : (n, m)."""
    unique, first, which = np.unique(keys, return_index=True, return_inverse=True)
    sums = [np.bincount(which, column, minlength=len(unique)) for column in rows.T]
    yield from zip(unique.tolist(), np.stack(sums, axis=1), first.tolist(), strict=True)


REMEMBERED = 50  # lines of each command that are remembered

_NO_TIME = re.compile(
    r"M2|M3|M4|M5|M17|M18|M30|M8[01]|M84|M206|M400|M420|M428|M575|M593|M66[56]|G92|SET_INPUT_SHAPER|BED_MESH_CLEAR"
    r"|BED_MESH_OFFSET|BED_MESH_PROFILE|SYNC_EXTRUDER_MOTION|SET_KINEMATIC_POSITION|(?:SAVE|RESTORE)_GCODE_STATE"
    r"|SET_GCODE_OFFSET"
)
_KINDS = {
    "heating": re.compile(r"M109|M116|M19[01]|M303|TEMPERATURE_WAIT"),
    "homing": re.compile(r"G28"),
    "probing": re.compile(
        r"G29|G3[0-4]|G38\.\d|M48|M40[12]|BED_MESH_CALIBRATE|DELTA_CALIBRATE|PROBE|QUAD_GANTRY_LEVEL|Z_TILT_ADJUST"
    ),
    "a pause": re.compile(r"M0|M1|M25|M125|M226|M28[0]|M60[0-2]|PAUSE|RESUME"),
    "a change of tool or filament": re.compile(r"T(-?\d+|\?)|M70[12]|ACTIVATE_EXTRUDER"),
    "retraction by the firmware": re.compile(r"G1[01]"),
}
_MACRO = "a macro or a command not known"
_FROM_NOWHERE = "a move from a place not known"


@dataclass(slots=True)
class Unknown:
    """Lines with one command that may take time."""

    what: str  # a process of unknown duration: homing, heating, …
    command: str
    count: int = 0
    lines: list[int] = field(default_factory=list)  # of the file, from 1

    def add(self, line: int) -> None:
        """Count one more line."""
        self.count += 1
        if len(self.lines) < REMEMBERED:
            self.lines.append(line)


def unknown_in(program: Program, event: Event) -> tuple[str, str] | None:
    """Return the kind of wait and the command of a line; None for lines that take no time, or a known one."""
    if event.kind not in (EventKind.STOP, EventKind.RAW_MOVE):
        return None
    line = program.lines[event.line]
    words = commands(line, program.first_line + event.line + 1)
    name = words[0].name if words else ""
    if event.kind is EventKind.RAW_MOVE:
        return _FROM_NOWHERE, name or "G1"
    if not name or (_NO_TIME.fullmatch(name) and b"MOVE=1" not in line.upper()):
        return None
    return next((what for what, names in _KINDS.items() if names.fullmatch(name)), _MACRO), name


KINDS = ("extruding", "travelling", "retracting", "priming", "waiting")
EXTRUDING, TRAVELLING, RETRACTING, PRIMING, WAITING, FILAMENT = range(6)
COLUMNS = 6
STILL_MM = 5e-5  # of filament in one move: less is rounding
RETRACTED_MM = 0.05  # of filament at least, to call it a retraction


@dataclass(frozen=True, slots=True)
class Spent:
    """Seconds by kind of motion."""

    time_s: float  # all of it
    extruding_s: float
    travelling_s: float
    retracting_s: float
    priming_s: float
    waiting_s: float

    @classmethod
    def of(cls, row: FloatArray) -> Spent:
        """Return the times of a row (6,)."""
        return cls(seconds(row), *row[:FILAMENT].tolist())


def seconds(row: FloatArray) -> float:
    """Return all the time in a row (6,)."""
    return float(row[:FILAMENT].sum())


@dataclass(slots=True)
class _Marks:
    """Lines of a slice whose comments begin layers and features: indices into the program's lines."""

    layers: list[int] = field(default_factory=list)
    features: list[int] = field(default_factory=list)
    names: list[str] = field(default_factory=list)  # of the features; the first is the one before them all


@dataclass(slots=True)
class Statistics:
    """Time and filament that have been counted so far."""

    json_keys: ClassVar = keys("filament_mm", "moves", "retractions", "warnings") | {
        ALL_OF: "spent",
        "slicer_time_s": "slicer_s",
        "features": "spent_by_feature",
        "layers": "numbered_layers",
        "unknown": "unknown_waits",
    }

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

    @property
    def spent(self) -> Spent:
        """Times of everything."""
        return Spent.of(self.total)

    @property
    def spent_by_feature(self) -> dict[str, Spent]:
        """Times by the slicer's feature names."""
        return {name: Spent.of(row) for name, row in self.features.items()}

    @property
    def numbered_layers(self) -> list[NumberedLayer]:
        """The layers in their order."""
        return [NumberedLayer(None if k == BEFORE else k, each) for k, each in self.layers.in_order()]

    @property
    def unknown_waits(self) -> list[Unknown]:
        """Commands of unknown duration."""
        return list(self.unknown.values())

    def add(self, part: PlannedSlice, raw_s: Mapping[int, float] = MappingProxyType({})) -> None:
        """Count a slice's own moves and lines.

        Parameters
        ----------
        raw_s : mapping, durations of moves from an unknown position, s, by their line's index
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
            elif command := unknown_in(part.program, event):
                self.unknown.setdefault(command, Unknown(*command)).add(number + event.line)
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
        _add_row(self.features, marks.names[-1], row)
        self.layers.wait(len(marks.layers), row, number + event.line)

    def _add_moves(self, part: PlannedSlice, seconds: FloatArray, marks: _Marks) -> None:
        moves, counted = part.program.moves, slice(part.first, part.last)
        fed = moves.end[counted, 3] - moves.start[counted, 3]
        kind = _kinds(lines_of(moves).travels[counted], fed)
        rows = np.zeros((len(seconds), COLUMNS))
        rows[np.arange(len(seconds)), kind] = seconds
        rows[:, FILAMENT] = fed
        self._feed(fed)
        line = moves.line[counted]
        self.moves += len(np.unique(line))
        for k, row, _ in summed(np.searchsorted(marks.features, line, side="right"), rows):
            _add_row(self.features, marks.names[k], row)
        begun = np.searchsorted(marks.layers, line, side="right")
        self.layers.add(begun, rows, moves.end[counted, 2], kind == EXTRUDING, part.program.first_line + 1 + line)

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


def _add_row(rows: dict[str, FloatArray], key: str, row: FloatArray) -> None:
    rows[key] = rows[key] + row if key in rows else row
