"""Follow the plain bulk of a print straight from its bytes, into tables of moves and events.

That is plain `G0` and `G1`, comments, empty lines. (Arcs, `G92 E0` and M codes are too rare to gain by it: 1 % of the
time of `compensate` at most.)

A plain line is `G0` or `G1` with each of the words X Y Z E F at most once, in capitals, as plain decimals of at most 15
digits, 6 of them before the point. The result equals that of `gcode.words` and `gcode.state` bit for bit: an integer
below 10^15 and a power of ten up to 10^22 are exact in binary, so their quotient is the double nearest to the decimal
(Clinger 1990, "How to read floating point numbers accurately", section 4), and sums have the same order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import repeat
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gcode.commands import PASS, Effect
from gcode.program import ByteArray, Event, EventKind, FloatArray, IntArray, ModalState, MotionLimits, Moves
from gcode.state import Vector4
from models.compiled import kernel

STILL_MM2 = 1e-18  # squared displacement below which nothing moves: 1e-9 mm, as in Klipper

_TAB, _NEWLINE, _RETURN, _SPACE, _PLUS, _MINUS, _POINT, _SEMICOLON, _G = b"\t\n\r +-.;G"
_LETTERS = b"XYZEF"
_RECENT = 16
_DIGITS_BEFORE_POINT, _DIGITS = 6, 15
_POWERS = np.array([10.0**k for k in range(_DIGITS + 1)])
_COLUMN = np.full(256, -1, dtype=np.int64)  # of each letter among the words
_COLUMN[list(_LETTERS)] = range(len(_LETTERS))


class Modes(NamedTuple):
    """The part of the modal state that no plain line changes."""

    origin_x: float  # mm, added to an absolute coordinate
    origin_y: float
    origin_z: float
    origin_e: float
    relative: bool
    relative_e: bool
    unit: float  # mm of toolhead per unit of the file
    unit_e: float  # mm of filament per unit of the file
    feed_factor: float


class Cursor(NamedTuple):
    """The reading position; counts are of rows in the tables."""

    byte: int
    line: int
    moves: int
    events: int
    feeds: int  # feeds that were in force so far
    state: int  # the number of the one in force
    x: float  # mm, of the toolhead; NaN: not known
    y: float
    z: float
    e: float
    feed: float  # mm/s; NaN: no line has set one yet
    motion: int  # of the last plain move followed: 0 or 1; -1: there was none
    stuck: bool  # the line needs the general reader


# NOTE: A call that passes an array counts its references, which costs as much as reading a number. Functions here are
# few and long for that reason. Rows are written number by number because storing a tuple takes 2 s to compile.


@kernel
def follow(
    text: ByteArray, here: Cursor, modes: Modes, limit: int,
    ends: FloatArray, moves: IntArray, events: IntArray, feeds: FloatArray,
) -> tuple[float, ...]:  # fmt: skip
    """Follow lines until one needs the general reader, `feeds` is full, or the text ends; return a Cursor's values.

    Parameters
    ----------
    text : the bytes of whole lines, and an extra newline
    limit : the number of the limits in force
    ends : (n, 4) mm, columns X Y Z E: where each move ends; rows are written from `here.moves` on
    moves : (n, 3), columns line, state, limit
    events : (m, 3), columns line, moves before it, state, of m lines; rows are written from `here.events` on
    feeds : (k,) mm/s, of each new state; written from its beginning on
    """
    at, line, move, event, known, state, x, y, z, e, feed, motion, _ = here
    words = np.empty(len(_LETTERS))
    new_count, stuck = 0, False
    while at < len(text) - 1 and new_count < len(feeds):
        code, moved, number = at, False, text[at + 1] - 48
        if text[at] == _G and number in (0, 1):
            code = _read_words(text, at + 2, words)
            new_x = _coordinate(words[0], modes.unit, x, modes.origin_x, modes.relative)
            new_y = _coordinate(words[1], modes.unit, y, modes.origin_y, modes.relative)
            new_z = _coordinate(words[2], modes.unit, z, modes.origin_z, modes.relative)
            new_e = _coordinate(words[3], modes.unit_e, e, modes.origin_e, modes.relative_e)
            dx, dy, dz, de = new_x - x, new_y - y, new_z - z, new_e - e
            travelled = dx * dx + dy * dy + dz * dz + de * de
            stuck = code < 0 or words[4] <= 0 or np.isnan(travelled)  # NaN: from or to an unknown place
            if stuck:
                break
            moved = travelled > STILL_MM2
            wanted = words[4] / 60 * modes.unit * modes.feed_factor
            if not np.isnan(wanted) and wanted != feed:
                feed = wanted
                new = _state(feeds, new_count, feed)
                new_count, state = max(new_count, new + 1), known + new
            x, y, z, e, motion = new_x, new_y, new_z, new_e, number
        else:
            while text[code] in (_SPACE, _TAB):
                code += 1
            stuck = not _ends_code(text[code])
            if stuck:
                break
        if moved:
            ends[move, 0], ends[move, 1], ends[move, 2], ends[move, 3] = x, y, z, e
            moves[move, 0], moves[move, 1], moves[move, 2] = line, state, limit
            move += 1
        else:
            events[event, 0], events[event, 1], events[event, 2] = line, move, state
            event += 1
        at = code
        while text[at] not in (_NEWLINE, _RETURN):
            at += 1
        at += 2 if text[at] == _RETURN and text[at + 1] == _NEWLINE else 1
        line += 1
    return at, line, move, event, known + new_count, state, x, y, z, e, feed, motion, stuck


@kernel
def _state(feeds: FloatArray, new_count: int, feed: float) -> int:
    """Return the row of this feed: one of the last few, because prints alternate between feeds, or a new one."""
    for row in range(new_count - 1, max(new_count - _RECENT, 0) - 1, -1):
        if feeds[row] == feed:
            return row
    feeds[new_count] = feed
    return new_count


@kernel
def _read_words(text: ByteArray, at: int, words: FloatArray) -> int:
    """Read X Y Z E F, NaN where absent; returns where the code ends, or -1 if it is not plain."""
    for column in range(len(words)):
        words[column] = np.nan
    while True:
        while text[at] in (_SPACE, _TAB):
            at += 1
        if _ends_code(text[at]):
            return at
        column = _COLUMN[text[at]]
        if column < 0 or not np.isnan(words[column]):
            return -1
        at += 1
        sign = text[at]
        if sign in (_MINUS, _PLUS):
            at += 1
        begin, point, mantissa = at, -1, 0
        while True:
            digit = text[at] - 48
            if 0 <= digit <= 9:
                mantissa = 10 * mantissa + digit
            elif text[at] == _POINT and point < 0:
                point = at
            else:
                break
            at += 1
        whole, decimals = (at - begin, 0) if point < 0 else (point - begin, at - point - 1)
        if whole > _DIGITS_BEFORE_POINT or not 0 < whole + decimals <= _DIGITS:
            return -1
        size = mantissa / _POWERS[decimals]
        words[column] = -size if sign == _MINUS else size


@kernel
def _ends_code(byte: int) -> bool:
    """Whether a line, or the part of it before its comment, ends with this byte."""
    return byte in (_SEMICOLON, _NEWLINE, _RETURN)


@kernel
def _coordinate(word: float, unit: float, place: float, origin: float, relative: bool) -> float:
    if np.isnan(word):
        return place
    return word * unit + (place if relative else origin)


_LIMITS = attrgetter(
    *("velocity", "acceleration", "travel_acceleration"),
    *("square_corner_velocity", "minimum_cruise_ratio", "filament_velocity"),
)


def _speed_for_filament(steps: FloatArray, most: FloatArray) -> FloatArray:
    """Return the speed (n,) that keeps filament within its limit; NaN: no filament moves, or no limit.

    steps : (n, 4) mm, columns X Y Z E;  most : (n,) mm/s of filament
    """
    length, filament = np.linalg.norm(steps[:, :3], axis=1), np.abs(steps[:, 3])
    way = np.where(length > 0.0, length, filament)
    return most * np.divide(way, filament, out=np.full(len(way), np.nan), where=filament > 0.0)


class MoveTable:
    """Moves in the order of the file. A move starts where the last one ended, except at `jumps`."""

    def __init__(self, capacity: int, start: Vector4) -> None:
        self.count = 0
        self.ends = np.empty((capacity, 4))  # mm, columns X Y Z E
        self.rows = np.empty((capacity, 3), dtype=np.int64)  # columns line, state, limit
        self.jumps = {0: list(start)}  # move number → its start

    def make_room(self, more: int) -> None:
        """Make room for so many more moves."""
        missing = self.count + more - len(self.ends)
        if missing > 0:
            added = max(missing, len(self.ends))
            self.ends = np.concatenate((self.ends, np.empty((added, 4))))
            self.rows = np.concatenate((self.rows, np.empty((added, 3), dtype=np.int64)))

    def add(self, line: int, state: int, limit: int, ends: ArrayLike) -> None:
        """Add the moves of one line: one, or an arc's chords, (k, 4) mm."""
        ends = np.atleast_2d(ends)
        self.make_room(len(ends))
        new = slice(self.count, self.count + len(ends))
        self.ends[new], self.rows[new] = ends, (line, state, limit)
        self.count += len(ends)

    def moves(self, frame_of_state: IntArray, frames: list[ModalState], limits: list[MotionLimits]) -> Moves:
        """Return the table as arrays; speeds and limits come from the frames and limits in force."""
        line, state, limit = self.rows[: self.count].T.copy()
        frame = frame_of_state[state]
        columns = np.array([_LIMITS(each) for each in limits])
        velocity, acceleration, travel, corner, cruise_ratio, filament = np.take(columns.T, limit, axis=1)
        start, end = np.empty((self.count, 4)), self.ends[: self.count]
        start[1:] = end[:-1]
        for number, place in self.jumps.items():
            if number < self.count:
                start[number] = place
        speed = np.array([a.feed_mm_per_s for a in frames])[frame]
        if not np.isnan(filament).all():
            speed = np.fmin(speed, _speed_for_filament(end - start, filament))
        travels = (end[:, 3] == start[:, 3]) & ~np.isnan(travel)
        limited = velocity, np.where(travels, travel, acceleration), corner, cruise_ratio
        return Moves(line, start, end, speed, frame, *limited)


@dataclass(slots=True)
class EventTable:
    """Events in the order of the file. Nearly all only pass through; `effects` has the others."""

    rows: IntArray  # (m, 3), columns line, moves before it, state; one row for every line there may be
    count: int = 0
    effects: dict[int, Effect] = field(default_factory=dict)  # event number → what it does

    def add(self, line: int, moves: int, state: int, effect: Effect) -> None:
        """Add the event of a line."""
        self.rows[self.count] = line, moves, state
        if effect is not PASS:
            self.effects[self.count] = effect
        self.count += 1

    def events(self, frame_of_state: IntArray) -> list[Event]:
        """Return the table as events."""
        line, moves, state = self.rows[: self.count].T
        passing = zip(line.tolist(), moves.tolist(), repeat(EventKind.PASS), frame_of_state[state].tolist())
        events = [Event(*row) for row in passing]
        for number, effect in self.effects.items():
            line, move, _, frame, *_ = events[number]
            flags = effect.moves_itself, effect.returns, effect.raw, effect.lasts_s
            events[number] = Event(line, move, effect.kind, frame, effect.dwell_s, effect.limits, *flags)
        return events
