"""Add up every move's time and filament by its layer, its feature, and its kind of motion, slice by slice."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import astuple, dataclass, field, replace
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
from gcode.layers import UNNAMED, begins_feature, begins_layer
from gcode.metadata import slicer_time_s, with_time
from gcode.program import Event, EventKind, Program
from gcode.slicing import join, split
from gcode.words import commands
from models.arrays import FloatArray, IntArray

PlanOf = Callable[[Program], Trajectory]


@dataclass(frozen=True, slots=True)
class PlannedSlice:
    """A planned program; its moves first … last - 1 and the lines between them count."""

    program: Program
    plan: Trajectory | None  # None: nothing in it moves
    first: int
    last: int

    @property
    def events(self) -> Iterator[Event]:
        """The events that are counted."""
        moves = self.program.moves
        begin = int(moves.line[self.first]) if self.first else 0
        end = int(moves.line[self.last]) if self.last < len(moves) else len(self.program.lines)
        return (event for event in self.program.events if begin <= event.line < end)


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


KINDS = ("extruding", "travelling", "retracting", "priming", "waiting")
EXTRUDING, TRAVELLING, RETRACTING, PRIMING, WAITING, FILAMENT = range(6)  # columns of rows
BEFORE = -1  # the number of the lines before the first layer
STILL_MM = 5e-5  # of filament in one move: less is rounding
RETRACTED_MM = 0.05  # of filament at least, to call it a retraction


@dataclass(frozen=True, slots=True)
class Spent:
    """Seconds by kind of motion, and filament."""

    json_keys: ClassVar = keys("time_s", *(f"{kind}_s" for kind in KINDS))

    extruding_s: float = 0.0
    travelling_s: float = 0.0
    retracting_s: float = 0.0
    priming_s: float = 0.0
    waiting_s: float = 0.0
    filament_mm: float = 0.0

    @property
    def time_s(self) -> float:
        """All of it."""
        return sum(self.by_kind.values())

    @property
    def by_kind(self) -> dict[str, float]:
        """Seconds of each of KINDS."""
        return dict(zip(KINDS, astuple(self), strict=False))

    def __add__(self, other: Spent) -> Spent:
        return Spent(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


@dataclass(frozen=True, slots=True)
class Layer:
    """Time and filament of a layer."""

    json_keys: ClassVar = keys("line", "z_mm", filament_mm="spent.filament_mm", layer="number") | {ALL_OF: "spent"}

    number: int | None  # from 0; None: the lines before the first
    line: int  # its first, from 1
    z_mm: float | None  # of its highest extruding move; None: none extrudes
    spent: Spent

    def with_more(self, other: Layer) -> Layer:
        """Add a later part of the same layer."""
        heights = [z for z in (self.z_mm, other.z_mm) if z is not None]
        return replace(self, z_mm=max(heights, default=None), spent=self.spent + other.spent)


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
_MACRO = "a macro or an unknown command"
_FROM_NOWHERE = "a move from an unknown position"


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


@dataclass(slots=True)
class Statistics:
    """Time and filament that have been counted so far."""

    json_keys: ClassVar = keys("filament_mm", "moves", "retractions", "warnings", "features") | {
        ALL_OF: "total",
        "slicer_time_s": "slicer_s",
        "layers": "layers_in_order",
        "unknown": "unknown_waits",
    }

    moves: int = 0
    retractions: int = 0
    filament_mm: float = 0.0
    slicer_s: float | None = None  # that the slicer's comment states
    features: dict[str, Spent] = field(default_factory=dict)
    layers: dict[int, Layer] = field(default_factory=dict)  # by number, in order
    unknown: dict[tuple[str, str], Unknown] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    _feature: str = UNNAMED
    _layer: int = BEFORE
    _fed_mm: float = 0.0
    _pulled_mm: float = 0.0  # how far back filament has been pulled just now, as a negative number
    _time_was: bytes | None = None  # of the line that comes next

    @property
    def total(self) -> Spent:
        """Times of everything."""
        return sum(self.features.values(), Spent())

    @property
    def layers_in_order(self) -> list[Layer]:
        """The lines before the first layer, if any, and the layers that the file's comments name."""
        return list(self.layers.values())

    @property
    def unknown_waits(self) -> list[Unknown]:
        """Commands of unknown duration."""
        return list(self.unknown.values())

    def add(self, part: PlannedSlice, raw_s: Mapping[int, float] = MappingProxyType({})) -> None:
        """Count a slice's own moves and lines.

        raw_s : mapping, durations of moves from an unknown position, s, by their line's index
        """
        layers, features, waits = self._read(part, raw_s)
        moves, counted = part.program.moves, slice(part.first, part.last)
        fed = moves.end[counted, 3] - moves.start[counted, 3]
        waiting = np.array(waits).reshape(-1, 3)
        line = np.concatenate([moves.line[counted], waiting[:, 0].astype(np.int64)])
        kind = np.concatenate([_kinds(lines_of(moves).travels[counted], fed), waiting[:, 1].astype(np.int64)])
        rows, tops, count = np.zeros((len(line), FILAMENT + 1)), np.full(len(line), -np.inf), len(fed)
        rows[np.arange(len(line)), kind] = np.append(
            [] if part.plan is None else part.plan.duration[counted], waiting[:, 2]
        )
        rows[:count, FILAMENT] = fed
        tops[:count] = np.where(kind[:count] == EXTRUDING, moves.end[counted, 2], -np.inf)
        self._feed(fed)
        self.moves += len(np.unique(moves.line[counted]))
        names = [self._feature, *(name for _, name in features)]
        for k, which in grouped(np.searchsorted([at for at, _ in features], line, side="right")):
            self.features[names[k]] = self.features.get(names[k], Spent()) + Spent(*rows[which].sum(axis=0).tolist())
        for k, which in grouped(self._layer + np.searchsorted(layers, line, side="right")):
            first = part.program.first_line + 1 + int(line[which].min())
            extruded = tops[which][np.isfinite(tops[which])]
            z_mm = float(extruded.max()) if extruded.size else None
            layer = Layer(None if k == BEFORE else k, first, z_mm, Spent(*rows[which].sum(axis=0).tolist()))
            self.layers[k] = self.layers[k].with_more(layer) if k in self.layers else layer
        self._layer += len(layers)
        self._feature = names[-1]
        self.warnings += part.program.warnings

    def _read(
        self, part: PlannedSlice, raw_s: Mapping[int, float]
    ) -> tuple[list[int], list[tuple[int, str]], list[tuple[int, int, float]]]:
        """Read its lines; return those that begin layers, and features with their names, and waits: line, kind, s."""
        layers, features, waits = list[int](), list[tuple[int, str]](), list[tuple[int, int, float]]()
        for event in part.events:
            line = part.program.lines[event.line]
            if line.startswith(TIME_WAS):
                self._time_was = line[len(TIME_WAS) :].rstrip()
                continue
            if begins_layer(line):
                layers.append(event.line)
            elif name := begins_feature(line):
                features.append((event.line, name))
            elif line.startswith(b";"):
                if self.slicer_s is None and not line.startswith(WAS):
                    self.slicer_s = slicer_time_s([line if self._time_was is None else with_time(line, self._time_was)])
            elif event.dwell_s:
                waits.append((event.line, WAITING, event.dwell_s))
            elif event.raw is not None and raw_s.get(event.line):
                kind = EXTRUDING if event.raw.filament_mm > STILL_MM else TRAVELLING
                waits.append((event.line, kind, raw_s[event.line]))
            elif command := unknown_in(part.program, event):
                self.unknown.setdefault(command, Unknown(*command)).add(part.program.first_line + 1 + event.line)
            self._time_was = None
        return layers, features, waits

    def _feed(self, fed: FloatArray) -> None:
        """Count retractions, and new filament: retracted filament that is fed again does not count."""
        if not len(fed):
            return
        steps = np.append(self._pulled_mm, fed)
        steps = steps[np.abs(steps) > STILL_MM]
        turns = np.flatnonzero(np.diff(np.sign(steps), prepend=0.0))
        runs = np.add.reduceat(steps, turns) if turns.size else np.zeros(1)  # of one direction
        self.retractions += int(np.count_nonzero(runs <= -RETRACTED_MM)) - (self._pulled_mm <= -RETRACTED_MM)
        self._pulled_mm = min(float(runs[-1]), 0.0)
        gone = self._fed_mm + np.cumsum(fed)
        self._fed_mm = float(gone[-1])
        self.filament_mm = max(self.filament_mm, float(gone.max()))


def grouped(keys: IntArray) -> Iterator[tuple[int, IntArray]]:
    """Yield each of the keys (n,) once, in ascending order, with its indices."""
    for key in np.unique(keys).tolist():
        yield key, np.flatnonzero(keys == key)


def _kinds(travels: NDArray[np.bool_], fed: FloatArray) -> IntArray:
    """Return the kind of each move, (n,); fed : (n,) mm."""
    moving = np.where(fed > STILL_MM, EXTRUDING, TRAVELLING)
    return np.where(travels, moving, np.where(fed < 0.0, RETRACTING, PRIMING))
