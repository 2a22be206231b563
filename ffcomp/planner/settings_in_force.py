"""What a file of Marlin or RepRapFirmware itself sets of its planner (M201, M203, M204, M205, M566), line by line."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffcomp.planner.marlin_queue import (
    ACCELERATION,
    DEVIATION,
    JERK,
    LEAST,
    LEAST_TRAVEL,
    POLICY,
    PRINT,
    RETRACT,
    SCALE,
    SHORTEST_US,
    SPEED,
    TRAVEL,
)
from gcode.program import Moves, Program
from models.arrays import FloatArray, IntArray
from models.machine import Machine

_NUMBER = re.compile(rb"[-+]?\d*\.?\d+")
_XYZE = "XYZE"


@dataclass(frozen=True, slots=True)
class SettingsInForce:
    """The rows of settings of a program, and from which of its lines on each holds."""

    lines: IntArray  # (k,) rising
    rows: FloatArray  # (k, COLUMNS)
    as_read: FloatArray  # (k, 3) mm/s², mm/s², mm/s: P, T and corner of the file as `Moves` has them; NaN: not set

    limits: tuple[float, float]  # mm/s² and mm/s, the machine's own where the file has set nothing

    @classmethod
    def of(cls, program: Program, machine: Machine, row: FloatArray, minutes: bool = False) -> SettingsInForce:
        """Follow a program's own lines on limits.

        row : (COLUMNS,) the machine's settings
        minutes : M203 is in mm/min, as RepRapFirmware's
        """
        state = _State(row, 60.0 if minutes else 1.0)
        for line in program.limits.values():
            state = state.after(line, 1.0)
        lines, states = [-1], [state]
        for event in program.events:
            if event.touches_limits:
                unit_mm = program.frames[event.frame].unit_mm if program.frames else 1.0
                state = state.after(program.lines[event.line], unit_mm)
                lines.append(event.line)
                states.append(state)
        rows, read = np.array([each.row for each in states]), np.array([each.as_read for each in states])
        own = (machine.limits.acceleration_mm_per_s2, machine.limits.square_corner_velocity_mm_per_s)
        return cls(np.array(lines, dtype=np.int64), rows, read, own)

    def at(self, moves: Moves) -> NDArray[np.float32]:
        """Return the settings in force at each move, (n, COLUMNS): gentler where a move asks for less than the file.

        Only time scaling does (`ffcomp.inverse.time_scaling`), for limits of the machine itself.
        """
        which = np.searchsorted(self.lines, moves.line, side="right") - 1
        rows = self.rows.astype(np.float32)[which]
        printing, travel, corner = self.as_read[which].T
        asked = np.where((moves.end[:, 3] == moves.start[:, 3]) & ~np.isnan(travel), travel, printing)
        gentler = _share(moves.acceleration, asked, self.limits[0])
        rows[:, SCALE] = gentler
        slower = _share(moves.square_corner_velocity, corner, self.limits[1])
        if (slower < 1.0).any():
            rows[:, JERK] *= slower[:, None]
            rows[:, DEVIATION] *= np.where(rows[:, DEVIATION] > 0.0, np.minimum(slower**2 / gentler, 1.0), 1.0)
        return rows


def _share(value: FloatArray, in_file: FloatArray, in_machine: float) -> FloatArray:
    share = value / np.where(np.isnan(in_file), in_machine, in_file)
    return np.where(share < 1.0, share, 1.0)


class _State(NamedTuple):
    """Settings while the lines of a file are followed."""

    row: FloatArray  # (COLUMNS,)
    speed_unit_s: float = 1.0  # of M203
    requested: tuple[float, float] = (np.nan, np.nan)  # mm/s², of moves that extrude and of others, as the file asks
    cap: float = np.nan  # mm/s², of M201
    corner: float = np.nan  # mm/s, of M205 or M566, X Y

    @property
    def as_read(self) -> tuple[float, float, float]:
        """What the reader of G-code makes of them."""
        printing, travel = (float(np.fmin(each, self.cap)) for each in self.requested)
        return printing, travel, self.corner

    def after(self, line: bytes, unit_mm: float) -> _State:
        """Return the settings after a line that sets some (Marlin's M200-M205.cpp; RepRapFirmware's dictionary).

        unit_mm : after G20, they are in inches
        """
        code, values = words_of(line)
        new = {letter: value * unit_mm for letter, value in values.items()}
        row = self.row.copy()
        if code == b"M203" or code == b"M566":
            new = {letter: value / (60.0 if code == b"M566" else self.speed_unit_s) for letter, value in new.items()}
        if code in (b"M201", b"M203"):
            which = ACCELERATION if code == b"M201" else SPEED
            row[which] = _named(row[which], new)
            if code == b"M203" and self.speed_unit_s > 1.0:  # the slowest of any move is RepRapFirmware's
                row[LEAST] = new.get("I", row[LEAST])
            cap = min((new[axis] for axis in "XY" if axis in new), default=self.cap)
            return self._replace(row=row, cap=cap if code == b"M201" else self.cap)
        if code == b"M204":
            both = new.get("S")
            printing, travel = new.get("P", both), new.get("T", both)
            row[RETRACT] = new.get("R", row[RETRACT])
            row[PRINT] = row[PRINT] if printing is None else printing
            row[TRAVEL] = row[TRAVEL] if travel is None else travel
            before, travel_before = self.requested
            requested = (before if printing is None else printing, travel_before if travel is None else travel)
            return self._replace(row=row, requested=requested)
        if code not in (b"M205", b"M566"):
            return self
        if code == b"M566":
            row[POLICY] = values.get("P", row[POLICY])
        else:
            row[LEAST], row[LEAST_TRAVEL] = new.get("S", row[LEAST]), new.get("T", row[LEAST_TRAVEL])
            row[SHORTEST_US] = values.get("B", row[SHORTEST_US])
        if row[DEVIATION] < 0.0:
            row[JERK] = _named(row[JERK], new)
        elif 0.01 <= new.get("J", 0.0) <= 0.3:
            row[DEVIATION] = new["J"]
        return self._replace(row=row, corner=min((new[axis] for axis in "XY" if axis in new), default=self.corner))


def row_after(row: FloatArray, lines: Iterable[bytes], unit_mm: float = 1.0) -> FloatArray:
    """Return Marlin's settings (COLUMNS,) after lines that set some, in a unit of so many mm."""
    state = _State(row)
    for line in lines:
        state = state.after(line, unit_mm)
    return state.row


def assumed_sentence(firmware: str, stated: Sequence[str], matter: Sequence[str], source: str) -> str:
    """Say which of the settings that matter a machine file does not state; empty: none."""
    missing = [name for name in matter if name not in stated]
    if not missing:
        return ""
    table = f"[firmware.{firmware.lower()}]"
    which = f"has no {table}" if not stated else f"has no {', '.join(missing)} in {table}"
    return (
        f"The machine file {which}, so its limits and {firmware}'s defaults are taken for {firmware}'s planner; "
        f"`ffcomp machines import` reads them from {source}."
    )


@lru_cache(maxsize=1024)
def words_of(line: bytes) -> tuple[bytes, dict[str, float]]:
    """Return a command and the numbers behind its letters."""
    code, _, words = line.partition(b";")[0].strip().upper().partition(b" ")
    first = ((word[:1].decode(), word[1:].partition(b":")[0]) for word in words.split())  # of several extruders
    return code, {letter: float(number) for letter, number in first if _NUMBER.fullmatch(number)}


def _named(values: FloatArray, new: dict[str, float]) -> list[float]:
    return [new.get(axis, old) for axis, old in zip(_XYZE, values.tolist(), strict=True)]
