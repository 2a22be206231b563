"""What a file of Marlin or RepRapFirmware itself sets of its planner (M201, M203, M204, M205, M566), line by line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ffcomp.firmware import marlin_queue as q
from ffcomp.planner.limits import PlannerLimits, bounds_of, lines_of, planner_limits
from gcode.program import MACHINE_LIMITS, LimitCommand, Moves, Program
from models.arrays import FloatArray, IntArray
from models.machine import Machine, MarlinSettings, RepRapFirmwareSettings


@dataclass(frozen=True, slots=True)
class SettingsInForce:
    """The rows of settings of a program, and the line where each begins."""

    lines: IntArray  # (k,) rising
    rows: FloatArray  # (k, COLUMNS)
    as_read: FloatArray  # (k, 3) mm/s², mm/s², mm/s: P, T and corner of the file as `Moves` has them; NaN: not set
    limits: PlannerLimits  # the machine's own where the file has set nothing

    @classmethod
    def of(cls, program: Program, machine: Machine, row: FloatArray) -> SettingsInForce:
        """Follow a program's own lines on limits.

        row : (COLUMNS,) the machine's settings
        """
        after = MACHINE_LIMITS
        for command in program.limits.values():
            row, after = row_after(row, command), command.after
        lines, rows, read = [-1], [row], [after]
        for event in program.events:
            if event.limits is not None:
                rows.append(row_after(rows[-1], event.limits))
                lines.append(event.line)
                read.append(event.limits.after)
        as_read = [(each.acceleration, each.travel_acceleration, each.square_corner_velocity) for each in read]
        return cls(np.array(lines, dtype=np.int64), np.array(rows), np.array(as_read), planner_limits(machine))

    def at(self, moves: Moves) -> NDArray[np.float32]:
        """Return the settings in force at each move, (n, COLUMNS): lower where a move requests less than the file.

        Only time scaling does (`ffcomp.inverse.time_scaling`), for limits of the machine itself.
        """
        which = np.searchsorted(self.lines, moves.line, side="right") - 1
        rows = self.rows.astype(np.float32)[which]
        printing, travel, corner = self.as_read[which].T
        asked = np.where((moves.end[:, 3] == moves.start[:, 3]) & ~np.isnan(travel), travel, printing)
        asked = np.where(np.isnan(asked), self.limits.acceleration_mm_per_s2, asked)
        # time scaling begins with what a move's axes allow, which its block keeps to as well
        allowed = bounds_of(replace(moves, acceleration=asked), lines_of(moves), self.limits).acceleration
        allowed = np.minimum(allowed, asked)
        gentler = np.fmin(moves.acceleration / allowed, 1.0)
        rows[:, q.SCALE] = gentler
        corner = np.where(np.isnan(corner), self.limits.square_corner_velocity_mm_per_s, corner)
        corner = np.where(gentler < 1.0, corner * np.sqrt(allowed / asked), corner)  # as time scaling wrote it
        slower = np.fmin(moves.square_corner_velocity / corner, 1.0)
        if (slower < 1.0).any():
            rows[:, q.JERK] *= slower[:, None]
            rows[:, q.DEVIATION] *= np.where(rows[:, q.DEVIATION] > 0.0, np.minimum(slower**2 / gentler, 1.0), 1.0)
        return rows


def row_after(row: FloatArray, command: LimitCommand) -> FloatArray:
    """Return the settings (COLUMNS,) after a command that sets some (Marlin's M200-M205.cpp; RepRapFirmware's list)."""
    row, code, words = row.copy(), command.code, command.words
    if code == "M201":
        row[q.ACCELERATION] = _named(row[q.ACCELERATION], words)
    elif code == "M203":
        row[q.SPEED] = _named(row[q.SPEED], words)
        row[q.LEAST] = words.get("I", row[q.LEAST])  # of RepRapFirmware: the slowest of any move
    elif code == "M204":
        row[q.RETRACT], row[q.PRINT] = words.get("R", row[q.RETRACT]), words.get("P", row[q.PRINT])
        row[q.TRAVEL] = words.get("T", row[q.TRAVEL])
    elif code == "M566":
        row[q.POLICY], row[q.JERK] = words.get("P", row[q.POLICY]), _named(row[q.JERK], words)
    elif code == "M205":
        row[q.LEAST], row[q.LEAST_TRAVEL] = words.get("S", row[q.LEAST]), words.get("T", row[q.LEAST_TRAVEL])
        row[q.SHORTEST_US] = words.get("B", row[q.SHORTEST_US])
        if row[q.DEVIATION] < 0.0:
            row[q.JERK] = _named(row[q.JERK], words)
        elif 0.01 <= words.get("J", 0.0) <= 0.3:
            row[q.DEVIATION] = words["J"]
    return row


def own_row(s: MarlinSettings | RepRapFirmwareSettings) -> FloatArray:
    """Return the settings (COLUMNS,) that both firmwares have; the others are zero."""
    row = np.zeros(q.COLUMNS)
    row[q.SPEED], row[q.ACCELERATION], row[q.JERK] = s.speed_mm_per_s, s.acceleration_mm_per_s2, s.jerk_mm_per_s
    row[q.PRINT], row[q.TRAVEL] = s.printing_acceleration_mm_per_s2, s.travel_acceleration_mm_per_s2
    row[q.SCALE] = 1.0
    return row


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


def _named(values: FloatArray, new: Mapping[str, float]) -> list[float]:
    return [new.get(axis, old) for axis, old in zip("XYZE", values.tolist(), strict=True)]
