"""A G-code file as data: lines byte for byte, moves as column arrays, other lines as events.

Units, once for the whole package: positions mm, E mm of filament, speeds mm/s, accelerations mm/s², times s.
Positions are *toolhead* coordinates (G92 offsets, flow and feed factors, units and relative modes resolved);
a move's `ModalState` is what turns them back into the numbers of the file.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from math import nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ByteArray = NDArray[np.uint8]


class EventKind(Enum):
    """The effect on the motion of a line that is not a compensated move."""

    PASS = "pass"  # no effect: it is written at its move's time (comments, fans, temperatures, G92 E, M82, ...)
    DWELL = "dwell"  # G4: rest for `dwell_s`; the line itself is kept
    STOP = "stop"  # the motion rests before and after it (homing, probing, waits, pauses, unknown macros)
    RAW_MOVE = "raw move"  # from or to an unknown position: passed through and planned by the firmware; also a stop


class RawMove(NamedTuple):
    """The known part of a move that passes through unchanged, used for the print time and the report."""

    start: tuple[float, ...]  # mm, X Y Z E; after a macro, the last known position; NaN: none
    end: tuple[float, ...]
    path_mm: float  # of the nozzle; 0 if unknown
    filament_mm: float  # pushed during the move
    speed: float  # mm/s, requested
    velocity_limit: float  # mm/s; NaN: the machine's own, as below
    acceleration: float  # mm/s²
    square_corner_velocity: float  # mm/s
    cause: tuple[int, str] = (0, "")  # line (from 1) and name of the command after which the position is unknown
    axes: tuple[int, ...] = (0, 1, 2)  # along which it moves, or may


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Limits of the firmware's planner."""

    velocity: float = nan  # mm/s
    acceleration: float = nan  # mm/s²; of extruding moves, if travel has its own
    square_corner_velocity: float = nan  # mm/s
    minimum_cruise_ratio: float = nan  # -
    travel_acceleration: float = nan  # mm/s², Marlin and RepRapFirmware: of moves that do not extrude; NaN: the same
    filament_velocity: float = nan  # mm/s of filament, likewise
    accel_to_decel: float = nan  # mm/s², older Klipper's form of the cruise ratio; NaN: from the ratio


MACHINE_LIMITS = MotionLimits()


class LimitCommand(NamedTuple):
    """A command that sets limits of the firmware's planner, in any syntax."""

    code: str  # M201, M203, M204, M205, M566, SET_VELOCITY_LIMIT, RESET_VELOCITY_LIMIT
    words: Mapping[str, float]  # mm, mm/s, mm/s²; M205 B in µs; M204 S as P and T; Klipper's are in `after`
    after: MotionLimits = MACHINE_LIMITS  # limits requested by the file from here on


class Event(NamedTuple):
    """A line that is not a compensated move."""

    line: int  # index into Program.lines
    move: int  # how many moves of Program.moves come before it
    kind: EventKind
    frame: int  # index into Program.frames: the state in force AFTER the line
    dwell_s: float = 0.0
    limits: LimitCommand | None = None  # that the line sets
    moves_itself: bool = False  # the firmware may move, uncompensated: homing, a macro, a pause, a raw move
    returns: bool = False  # and returns to the same position
    raw: RawMove | None = None  # of a RAW_MOVE
    lasts_s: float = 0.0  # the slicer's time for a filament change

    def to_return(self, before: bool) -> bool:
        """Return whether a macro that comes back has moved the nozzle last, if `before` says so of the line before."""
        return self.returns or (before and not self.moves_itself)


def shifted(events: Iterable[Event], line: int, move: int, frame: Mapping[int, int] | Sequence[int]) -> list[Event]:
    """Return the events with line and move numbers shifted and frames renumbered."""
    # positional, because `_replace` takes twice as long and this runs several times for every event
    return [
        Event(at + line, before + move, kind, frame[f], dwell, limits, moves, returns, raw, lasts)
        for at, before, kind, f, dwell, limits, moves, returns, raw, lasts in events
    ]


class ModalState(NamedTuple):
    """How toolhead coordinates are written in the file here (the modal state a writer needs).

    X_file = (x - base_x) / unit_mm ;  E_file = (e - base_e) / flow / unit_mm ;
    F_file = 60 v / feed_factor / unit_mm
    """

    base: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)  # x y z e, mm
    unit_mm: float = 1.0  # 25.4 after G20
    absolute: bool = True  # G90 / G91
    absolute_e: bool = True  # M82 / M83 (as in Klipper, G91 makes E relative too)
    flow: float = 1.0  # M221
    feed_factor: float = 1.0  # M220
    feed_mm_per_s: float = 25.0  # speed in force, feed factor included (Klipper's default until the first F)
    z_known: bool = True  # False: Z is assumed from before a macro, and may not be written


@dataclass(frozen=True, slots=True)
class Moves:
    """n moves, arcs as chords. A move does not always begin where the last one ended."""

    line: IntArray  # (n,) index into Program.lines (the chords of an arc share one)
    start: FloatArray  # (n, 4) mm, columns X Y Z E
    end: FloatArray  # (n, 4) mm, columns X Y Z E
    speed: FloatArray  # (n,) mm/s, requested
    frame: IntArray  # (n,) index into Program.frames
    velocity_limit: FloatArray  # (n,) mm/s; NaN: the machine's own
    acceleration: FloatArray  # (n,) mm/s²; NaN: the machine's own
    square_corner_velocity: FloatArray  # (n,) mm/s; NaN: the machine's own
    minimum_cruise_ratio: FloatArray  # (n,) -; NaN: the machine's own

    def __len__(self) -> int:
        return len(self.line)


@dataclass(frozen=True, slots=True)
class Program:
    """A G-code file, or a slice of one."""

    path: str
    lines: list[bytes]  # every line with its line ending; b"".join(lines) is the file
    moves: Moves
    events: list[Event]  # in file order; every line is the line of a move or of exactly one event
    frames: list[ModalState]
    warnings: list[str]  # sentences with line numbers
    first_line: int = 0  # number in the file, from 0, of lines[0]: not 0 in a later part of a file read in parts
    flavor: str = "klipper"  # the firmware it was read for
    limits: Mapping[str, LimitCommand] = field(default_factory=dict)  # in effect before lines[0] (`limits_in_effect`)

    def line_of(self, move: int) -> int:
        """Return the line of a move in the file, from 1."""
        return self.first_line + int(self.moves.line[move]) + 1

    @property
    def size(self) -> int:
        """Bytes of its lines."""
        return sum(map(len, self.lines))


class EventQueue:
    """Events in the file's order, consumed move by move."""

    def __init__(self, events: list[Event]) -> None:
        self._events, self._taken = events, 0

    def up_to(self, move: int) -> list[Event]:
        """Take the remaining events up to this move."""
        first = self._taken
        while self._taken < len(self._events) and self._events[self._taken].move <= move:
            self._taken += 1
        return self._events[first : self._taken]


def limits_in_effect(
    program: Program, before: Mapping[str, LimitCommand], events: int | None = None
) -> dict[str, LimitCommand]:
    """Return the limits in force at the end of a program, by code, the latest code last.

    before : at its beginning
    events : how many of its events to follow; None: all
    """
    commands = dict(before)
    for event in program.events[:events]:
        if event.limits is not None:
            note_limits(commands, event.limits)
    return commands


def note_limits(commands: dict[str, LimitCommand], command: LimitCommand) -> None:
    """Put a command last among those in effect; earlier values of its other letters still hold."""
    earlier = commands.pop(command.code, command)
    commands[command.code] = command._replace(words={**earlier.words, **command.words})
