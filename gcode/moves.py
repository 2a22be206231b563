"""Columns that grow while a file is read, and become moves and events once."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import repeat

import numpy as np
from numpy.typing import ArrayLike

from gcode.arrays import FloatArray, IntArray
from gcode.commands import PASS, Effect
from gcode.limits import MotionLimits
from gcode.program import Event, EventKind, ModalState, Moves
from gcode.state import Vector4


class MoveTable:
    """Moves as they are read. A move starts where the last one ended, except where `jumps` says otherwise."""

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
        """Return the table as arrays; speeds and limits are looked up from the frames and limits in force."""
        line, state, limit = self.rows[: self.count].T.copy()
        frame = frame_of_state[state]
        columns = np.array(
            [
                (a.velocity, a.acceleration, a.travel_acceleration, a.square_corner_velocity, a.minimum_cruise_ratio)
                for a in limits
            ]
        )
        velocity, acceleration, travel, corner, cruise_ratio = np.take(columns.T, limit, axis=1)
        start, end = self._starts(), self.ends[: self.count]
        travels = (end[:, 3] == start[:, 3]) & ~np.isnan(travel)
        return Moves(
            line=line,
            start=start,
            end=end,
            speed=np.array([a.feed_mm_per_s for a in frames])[frame],
            frame=frame,
            velocity_limit=velocity,
            acceleration=np.where(travels, travel, acceleration),
            square_corner_velocity=corner,
            minimum_cruise_ratio=cruise_ratio,
        )

    def _starts(self) -> FloatArray:
        start = np.empty((self.count, 4))
        start[1:] = self.ends[: max(self.count - 1, 0)]
        for number, place in self.jumps.items():
            if number < self.count:
                start[number] = place
        return start


@dataclass(slots=True)
class EventTable:
    """Events as they are read. Nearly all only pass through; what the others do stands in `effects`."""

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
            own = effect.moves_itself, effect.returns, effect.raw
            events[number] = Event(line, move, effect.kind, frame, effect.dwell_s, effect.touches_limits, *own)
        return events
