"""How much of a print is compensated, and why some of it is not."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ffcomp.planner.limits import lines_of
from ffcomp.planner.reach import BESIDE
from gcode.program import Event, Moves

ENOUGH = 0.95  # of the path or the filament: below it there is a warning
_MACRO = re.compile(r"@?_?[A-Z][A-Z0-9]*_\w*|[A-Z]{4,}\w*")


@dataclass(frozen=True, slots=True)
class Part:
    """Some moves: what the nozzle travels, and what is pushed out on the way."""

    path_mm: float = 0.0
    filament_mm: float = 0.0
    seconds: float = 0.0  # only of what goes out as it was

    def __add__(self, other: Part) -> Part:
        """Add other moves."""
        return Part(self.path_mm + other.path_mm, self.filament_mm + other.filament_mm, self.seconds + other.seconds)


@dataclass(frozen=True, slots=True)
class Cause:
    """Why moves went out as they were: a command after which nobody knows the place."""

    line: int  # in the file, from 1; 0: its beginning
    command: str


@dataclass(frozen=True, slots=True)
class Shares:
    """What is compensated of the moves that a file makes by itself, and what is not."""

    compensated: Part = field(default_factory=Part)
    left: tuple[tuple[Cause, Part], ...] = ()  # by the command; the first line of each

    def __add__(self, later: Shares) -> Shares:
        """Add what comes after this."""
        if not later.left:
            return Shares(self.compensated + later.compensated, self.left)
        found = {cause.command: (cause, part) for cause, part in self.left}
        for cause, part in later.left:
            first, before = found.get(cause.command, (cause, Part()))
            found[cause.command] = first, before + part
        return Shares(self.compensated + later.compensated, tuple(found.values()))

    @property
    def uncompensated(self) -> Part:
        """All that went out as it was."""
        return sum((part for _, part in self.left), Part())

    @property
    def path(self) -> float:
        """The compensated share of the path, 0 to 1."""
        return _share(self.compensated.path_mm, self.uncompensated.path_mm)

    @property
    def filament(self) -> float:
        """The compensated share of the filament, 0 to 1."""
        return _share(self.compensated.filament_mm, self.uncompensated.filament_mm)

    def warnings(self) -> tuple[str, ...]:
        """Say where less than enough is compensated, why, and what helps."""
        if min(self.path, self.filament) >= ENOUGH:
            return ()
        said = (
            f"Only {100 * self.path:.0f} % of the path and {100 * self.filament:.0f} % of the filament are compensated"
        )
        cause, _ = max(self.left, key=lambda each: (each[1].path_mm, each[1].filament_mm))
        return (f"{said}, and errors are stated for these alone: {_because(cause)}",)

    def to_dict(self) -> dict[str, Any]:
        """Return the keys of `compensate`'s JSON object."""
        return {
            "compensated_share": {"path": self.path, "filament": self.filament},
            "uncompensated": [
                {
                    "line": cause.line,
                    "command": cause.command,
                    "path_mm": part.path_mm,
                    "filament_mm": part.filament_mm,
                    "seconds": part.seconds,
                }
                for cause, part in self.left
            ],
        }


def of_moves(moves: Moves) -> Part:
    """Count moves that are compensated."""
    lines = lines_of(moves)
    pushed = np.maximum(moves.end[:, 3] - moves.start[:, 3], 0.0)
    return Part(float(lines.length[lines.travels].sum()), float(pushed[lines.travels].sum()))


def of_raw_moves(events: Iterable[Event], seconds: Mapping[int, float]) -> Shares:
    """Count moves that go out as they were; `seconds` by the line's index."""
    shares = Shares()
    for event in events:
        if event.raw is not None:
            pushed = max(event.raw.filament_mm, 0.0) if event.raw.path_mm > 0.0 else 0.0
            part = Part(event.raw.path_mm, pushed, seconds.get(event.line, 0.0))
            shares += Shares(left=((Cause(*event.raw.cause), part),))
    return shares


def _share(part: float, rest: float) -> float:
    return 1.0 if rest <= 0.0 else part / (part + rest)


def _because(cause: Cause) -> str:
    if cause.command == BESIDE:
        return f"from line {cause.line} on, moves lie beside the print volume."
    if not cause.line:
        return "the file does not say where the nozzle begins; home, or name X, Y and Z, before it prints."
    where = f"after {cause.command} in line {cause.line} nobody knows where the nozzle is"
    if _MACRO.fullmatch(cause.command):
        return (
            f"{where}. If it comes back to where it was, say so in the machine file: "
            f'[macros] returns = ["{cause.command}"]; otherwise name X and Y after it in the slicer.'
        )
    return f"{where}; name X and Y after it."
