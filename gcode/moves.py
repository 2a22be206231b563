"""Columns that grow while a file is read, and become arrays once."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from gcode.limits import MotionLimits
from gcode.program import Frame, Moves
from gcode.state import Vector4

FloatArray = NDArray[np.float64]


@dataclass(slots=True)
class MoveTable:
    """Moves as they are read. A move starts where the last one ended, except where `jumps` says otherwise."""

    ends: list[float] = field(default_factory=list)  # x y z e x y z e …, mm
    lines: list[int] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    limits: list[int] = field(default_factory=list)
    jumps: dict[int, Vector4] = field(default_factory=dict)  # move number → its start

    def moves(self, frames: list[Frame], limits: list[MotionLimits]) -> Moves:
        """The table as arrays; speeds and limits are looked up from the frames and limits in force."""
        end = np.array(self.ends, dtype=np.float64).reshape(-1, 4)
        frame = np.array(self.frames, dtype=np.int64)
        limit = np.array(self.limits, dtype=np.int64)
        columns = np.array(
            [
                (a.velocity, a.acceleration, a.travel_acceleration, a.square_corner_velocity, a.minimum_cruise_ratio)
                for a in limits
            ]
        )
        velocity, acceleration, travel, corner, cruise_ratio = columns[limit].T
        start = self._starts(end)
        travels = (end[:, 3] == start[:, 3]) & ~np.isnan(travel)
        return Moves(
            line=np.array(self.lines, dtype=np.int64),
            start=start,
            end=end,
            speed=np.array([a.feed_mm_per_s for a in frames])[frame],
            frame=frame,
            velocity_limit=velocity,
            acceleration=np.where(travels, travel, acceleration),
            square_corner_velocity=corner,
            minimum_cruise_ratio=cruise_ratio,
        )

    def _starts(self, end: FloatArray) -> FloatArray:
        start = np.roll(end, 1, axis=0)
        numbers = [number for number in self.jumps if number < len(end)]
        places = chain.from_iterable(self.jumps[number] for number in numbers)
        start[numbers] = np.fromiter(places, dtype=np.float64).reshape(-1, 4)
        return start
