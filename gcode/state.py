"""The modal state of a printer that reads G-code: where it is and what the next number means.

The arithmetic is Klipper's: `position` is the toolhead's, and `base` is added to the file's numbers. Where firmwares
differ, `tests/unit/gcode/test_modal_rules.py` has the table. An unknown coordinate is NaN and stays NaN through every
sum, so no other rule about unknown positions is needed.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from math import isnan, nan
from typing import Any

from gcode.dialect import DIALECTS, KLIPPER, Dialect
from gcode.errors import GcodeError
from gcode.program import MACHINE_LIMITS, ModalState, MotionLimits

DEFAULT_FEED_MM_PER_S = 25.0  # Klipper's, until the first F
INCH_MM = 25.4
AXES = "XYZE"
FIRST_AXES = {"XY": (0, 1, 2), "ZX": (2, 0, 1), "XZ": (0, 2, 1), "YZ": (1, 2, 0)}

Vector4 = list[float]
Whereabouts = tuple[tuple[float | None, ...], bool, bool]  # position and base, mm, None: unknown; absolute; z_known


Saved = Mapping[str, Any]  # what SAVE_GCODE_STATE saves, by attribute
_SAVED = ("base", "shift", "homing", "position", "z_known", "absolute", "absolute_e", "feed", "feed_factor", "flow")


@dataclass(slots=True)
class Modal:
    """Everything a line of G-code can change. Vectors hold X Y Z E in mm."""

    position: Vector4 = field(default_factory=lambda: [nan, nan, nan, 0.0])
    z_known: bool = True  # False: the position's Z is a guess
    guess: Vector4 = field(default_factory=lambda: [nan, nan, nan, 0.0])  # where the position is NaN
    base: Vector4 = field(default_factory=lambda: [0.0, 0.0, 0.0, 0.0])
    offset: tuple[float, float] = (0.0, 0.0)  # from the file's bed to the printer's, mm
    shift: Vector4 = field(default_factory=lambda: [0.0, 0.0, 0.0, 0.0])  # the offset, except where G92 set one
    homing: Vector4 = field(default_factory=lambda: [0.0, 0.0, 0.0, 0.0])  # SET_GCODE_OFFSET
    unit: float = 1.0
    absolute: bool = True
    absolute_e: bool = True
    relative_e_stated: bool = False  # by M83, even if G90 changed it since
    flow: float = 1.0
    feed_factor: float = 1.0
    kept_feed_factor: float = 1.0  # M220 B
    feed: float = DEFAULT_FEED_MM_PER_S  # mm/s, feed factor included
    feed_known: bool = False
    plane: tuple[int, int, int] = FIRST_AXES["XY"]  # the two axes of an arc's plane, then its normal
    motion: str = ""  # the last of G0 G1 G2 G3, which a line of bare words repeats
    tool: str = ""
    filament: str = ""  # the last tool that has one
    filament_change_s: float = 0.0  # from the slicer
    dialect: Dialect = DIALECTS[KLIPPER]
    limits: MotionLimits = MACHINE_LIMITS
    requested: MotionLimits = MACHINE_LIMITS  # requested by the file, before `caps`
    caps: MotionLimits = MACHINE_LIMITS  # M201 and M203 of Marlin and RepRapFirmware
    saved: dict[str, Saved] = field(default_factory=dict)
    pushed: list[tuple[bool, bool, float, float]] = field(default_factory=list)  # M120: modes, feed, unit
    returns: frozenset[str] = frozenset()  # macros that return, in addition to those of gcode.commands
    conditions: list[Whereabouts] = field(default_factory=list)  # position at each open M622

    def __post_init__(self) -> None:
        self.shift = [*self.offset, 0.0, 0.0]

    def frame(self) -> ModalState:
        """Return the part of the state that a writer needs."""
        x, y, z, e = self.base
        modes = self.unit, self.absolute, self.is_absolute(3), self.flow, self.feed_factor, self.feed, self.z_known
        return ModalState((x, y, z, e), *modes)

    def guessed(self) -> Vector4:
        """Return the position; where unknown, the guess from before the macro."""
        return [guess if isnan(known) else known for known, guess in zip(self.position, self.guess, strict=True)]

    def forget(self) -> None:
        """Make the position unknown (probing, a macro), but keep it as a guess."""
        self.guess = self.guessed()
        self.position = [nan, nan, nan, self.position[3]]
        self.z_known = True

    def forget_even_roughly(self) -> None:
        """Make the position unknown, without a guess (homing, motors off)."""
        self.forget()
        self.guess[:3] = [nan, nan, nan]

    def pass_through(self, words: dict[str, float]) -> tuple[Vector4, Vector4]:
        """Follow a move from or to an unknown position; returns its start and end as guessed.

        If X and Y are known after it and Z is not, the last Z is assumed: vibration does not depend on it.
        """
        start, end = self.guessed(), self.target(words)
        self.guess = self.target(words, start)
        self.position = end
        if "Z" in words and self.is_absolute(2):
            self.z_known = True
        elif isnan(end[2]) and not isnan(end[0] + end[1] + self.guess[2]):
            end[2], self.z_known = self.guess[2], False
        return start, self.guess[:]

    def take_names_back(self) -> None:
        """Undo G92: coordinates are the machine's again, apart from SET_GCODE_OFFSET."""
        self.base[:3] = self.homing[:3]
        self.shift = [*self.offset, 0.0, 0.0]

    def whereabouts(self) -> Whereabouts:
        """Return the state that a block of lines must not change if it may be skipped; relative E has no position."""
        axes = 4 if self.is_absolute(3) else 3
        places = tuple(None if isnan(mm) else mm for mm in (*self.position[:axes], *self.base[:axes]))
        return places, self.absolute, self.z_known

    def scale(self, axis: int) -> float:
        """Return mm of toolhead or filament per unit of the file."""
        return self.unit * self.flow if axis == 3 else self.unit

    def is_absolute(self, axis: int) -> bool:
        """Whether the axis is in absolute mode."""
        if axis < 3:
            return self.absolute
        return self.absolute_e and (self.absolute or not self.dialect.g91_makes_e_relative)

    def set_e_mode(self, absolute: bool) -> None:
        """M82, M83."""
        self.absolute_e, self.relative_e_stated = absolute, not absolute

    def target(self, words: dict[str, float], start: Vector4 | None = None) -> Vector4:
        """Return where a move with these words ends, from the position or another start."""
        start = self.position if start is None else start
        return [self._coordinate(axis, words.get(letter), start[axis]) for axis, letter in enumerate(AXES)]

    def _coordinate(self, axis: int, number: float | None, start: float) -> float:
        if number is None:
            return start
        origin = self.base[axis] + self.shift[axis] if self.is_absolute(axis) else start
        return number * self.scale(axis) + origin

    def set_feed(self, words: dict[str, float], line: int) -> None:
        """Apply the F word, if there is one."""
        if "F" not in words or (words["F"] <= 0 and self.dialect.zero_feed_keeps):
            return
        if words["F"] <= 0:
            raise GcodeError(f"F{words['F']:g} is not a speed; a feed must be above zero.", line)
        self.feed = words["F"] / 60 * self.unit * self.feed_factor
        self.feed_known = True

    def rename(self, words: dict[str, float]) -> None:
        """G92: give the present position these coordinates."""
        named = {axis: words[letter] for axis, letter in enumerate(AXES) if letter in words}
        if not named and self.dialect.bare_g92_is_zero:
            named = dict.fromkeys(range(4), 0.0)
        for axis, number in named.items():
            self.base[axis] = self.position[axis] - number * self.scale(axis)
            self.shift[axis] = 0.0  # the new name refers to the true position, shift included
            if axis == 2:
                self.z_known = True  # under its new name

    def set_feed_factor(self, factor: float) -> None:
        """M220: the speed in force changes too, as in Klipper."""
        self.feed *= factor / self.feed_factor
        self.feed_factor = factor

    def offset_axis(self, axis: int, offset: float) -> None:
        """SET_GCODE_OFFSET: later coordinates of this axis lie `offset` further."""
        self.base[axis] += offset - self.homing[axis]
        self.homing[axis] = offset

    def save(self, name: str) -> None:
        """Keep the state under a name (SAVE_GCODE_STATE)."""
        self.saved[name] = {key: copy(getattr(self, key)) for key in _SAVED}

    def restore(self, saved: Saved) -> None:
        """RESTORE_GCODE_STATE without its move; E continues from its present value."""
        for key in set(_SAVED) - {"position", "z_known"}:
            setattr(self, key, copy(saved[key]))
        self.base[3] += self.position[3] - saved["position"][3]
        if any(map(isnan, self.base)):  # saved after G92 had named an unknown position
            self.position = [nan if isnan(b) else p for p, b in zip(self.position, self.base, strict=True)]

    def set_limits(self, **changes: float) -> None:
        """Set the limits that the file requests; `caps` still bound them."""
        self.requested = replace(self.requested, **changes)
        self._bound()

    def set_caps(self, **changes: float) -> None:
        """Set the caps on the file's limits."""
        self.caps = replace(self.caps, **changes)
        self._bound()

    def _bound(self) -> None:
        requested, caps = self.requested, self.caps
        self.limits = replace(
            requested,
            velocity=_smaller(requested.velocity, caps.velocity),
            acceleration=_smaller(requested.acceleration, caps.acceleration),
            travel_acceleration=_smaller(requested.travel_acceleration, caps.acceleration),
            filament_velocity=caps.filament_velocity,
        )


def _smaller(a: float, b: float) -> float:
    """Return the smaller of two limits; NaN means no limit."""
    return b if isnan(a) else a if isnan(b) else min(a, b)
