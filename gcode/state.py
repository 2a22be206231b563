"""The modal state of a printer that reads G-code: where it is and what the next number means.

The arithmetic is Klipper's: `position` is where the toolhead is, `base` what is added to the file's numbers.
Marlin and RepRapFirmware agree wherever a print can tell. A coordinate that nobody knows is NaN and stays
NaN through every sum, so no rule about unknown places is needed anywhere else.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import isnan, nan

from gcode.errors import GcodeError
from gcode.limits import MACHINE_LIMITS, MotionLimits
from gcode.program import ModalState

DEFAULT_FEED_MM_PER_S = 25.0  # Klipper's, until the first F
INCH_MM = 25.4
AXES = "XYZE"
FIRST_AXES = {"XY": (0, 1, 2), "ZX": (2, 0, 1), "XZ": (0, 2, 1), "YZ": (1, 2, 0)}

Vector4 = list[float]
Whereabouts = tuple[Vector4, Vector4, bool]  # position and base, mm; absolute
FrameValues = tuple[tuple[float, float, float, float], float, bool, bool, float, float, float]


@dataclass(frozen=True, slots=True)
class Saved:
    """What SAVE_GCODE_STATE keeps."""

    base: tuple[float, ...]
    shift: tuple[float, ...]
    homing: tuple[float, ...]
    position: tuple[float, ...]
    absolute: bool
    absolute_e: bool
    feed: float
    feed_factor: float
    flow: float


@dataclass(slots=True)
class Modal:
    """Everything a line of G-code can change. Vectors hold X Y Z E in mm."""

    position: Vector4 = field(default_factory=lambda: [nan, nan, nan, 0.0])
    base: Vector4 = field(default_factory=lambda: [0.0, 0.0, 0.0, 0.0])
    offset: tuple[float, float] = (0.0, 0.0)  # from the file's bed to the printer's, mm
    shift: Vector4 = field(default_factory=lambda: [0.0, 0.0, 0.0, 0.0])  # it, except where G92 named a place
    homing: Vector4 = field(default_factory=lambda: [0.0, 0.0, 0.0, 0.0])  # SET_GCODE_OFFSET
    unit: float = 1.0
    absolute: bool = True
    absolute_e: bool = True
    flow: float = 1.0
    feed_factor: float = 1.0
    kept_feed_factor: float = 1.0  # M220 B
    feed: float = DEFAULT_FEED_MM_PER_S  # mm/s, feed factor included
    feed_known: bool = False
    plane: str = "XY"
    motion: str = ""  # the last of G0 G1 G2 G3: what a line of bare words means
    tool: str = ""
    flavor: str = "klipper"
    limits: MotionLimits = MACHINE_LIMITS
    own: MotionLimits = MACHINE_LIMITS  # asked for by the file, before `caps`
    caps: MotionLimits = MACHINE_LIMITS  # M201 and M203 of Marlin and RepRapFirmware
    saved: dict[str, Saved] = field(default_factory=dict)
    conditions: list[Whereabouts] = field(default_factory=list)  # where each M622 that is open has begun

    def __post_init__(self) -> None:
        self.shift = [*self.offset, 0.0, 0.0]

    def frame(self) -> ModalState:
        """Return the part of the state that a writer needs."""
        return ModalState(*self.frame_values())

    def frame_values(self) -> FrameValues:
        """Return the values of `frame`, in its order: many times quicker to look up than the frame itself."""
        x, y, z, e = self.base
        absolute_e = self.absolute_e and self.absolute
        return (x, y, z, e), self.unit, self.absolute, absolute_e, self.flow, self.feed_factor, self.feed

    def forget(self) -> None:
        """Nobody knows where the toolhead is: homing, probing, a macro."""
        self.position[:3] = [nan, nan, nan]

    def home(self) -> None:
        """Homing also takes back what G92 did. On a delta it moves all axes, whichever were named."""
        self.take_names_back()
        self.forget()

    def take_names_back(self) -> None:
        """Coordinates are those of the machine again, but for SET_GCODE_OFFSET: what G92 did is undone."""
        self.base[:3] = self.homing[:3]
        self.shift = [*self.offset, 0.0, 0.0]

    def whereabouts(self) -> Whereabouts:
        """Return what a block of lines that may not be run must leave as it is."""
        return self.position[:], self.base[:], self.absolute

    def scale(self, axis: int) -> float:
        """Return mm of toolhead or filament per unit of the file."""
        return self.unit * self.flow if axis == 3 else self.unit

    def is_absolute(self, axis: int) -> bool:
        """Tell whether the axis is in absolute mode."""
        return self.absolute and (axis < 3 or self.absolute_e)

    def target(self, words: dict[str, float]) -> Vector4:
        """Where a move with these words ends."""
        return [self._coordinate(axis, words.get(letter)) for axis, letter in enumerate(AXES)]

    def _coordinate(self, axis: int, number: float | None) -> float:
        if number is None:
            return self.position[axis]
        origin = self.base[axis] + self.shift[axis] if self.is_absolute(axis) else self.position[axis]
        return number * self.scale(axis) + origin

    def set_feed(self, words: dict[str, float], line: int) -> None:
        """Take the F word, if there is one."""
        if "F" not in words or (words["F"] <= 0 and self.flavor != "klipper"):  # others go on with the last feed
            return
        if words["F"] <= 0:
            raise GcodeError(f"F{words['F']:g} asks for no speed; a feed must be above zero.", line)
        self.feed = words["F"] / 60 * self.unit * self.feed_factor
        self.feed_known = True

    def rename(self, words: dict[str, float]) -> None:
        """G92: the place we are at gets these coordinates (all axes zero when none is named)."""
        named = {axis: words[letter] for axis, letter in enumerate(AXES) if letter in words}
        for axis, number in (named or dict.fromkeys(range(4), 0.0)).items():
            self.base[axis] = self.position[axis] - number * self.scale(axis)
            self.shift[axis] = 0.0  # the new name is tied to the true place, shift included

    def set_feed_factor(self, factor: float) -> None:
        """M220: also the speed in force changes, as in Klipper."""
        self.feed *= factor / self.feed_factor
        self.feed_factor = factor

    def set_flow(self, flow: float) -> None:
        """M221: E of the file goes on without a jump."""
        in_file = (self.position[3] - self.base[3]) / self.flow
        self.base[3] = self.position[3] - in_file * flow
        self.flow = flow

    def offset_axis(self, axis: int, offset: float) -> None:
        """SET_GCODE_OFFSET: later coordinates of this axis lie `offset` further."""
        self.base[axis] += offset - self.homing[axis]
        self.homing[axis] = offset

    def save(self, name: str) -> None:
        """Keep the state under a name (SAVE_GCODE_STATE)."""
        self.saved[name] = Saved(
            tuple(self.base),
            tuple(self.shift),
            tuple(self.homing),
            tuple(self.position),
            self.absolute,
            self.absolute_e,
            self.feed,
            self.feed_factor,
            self.flow,
        )

    def restore(self, saved: Saved) -> None:
        """RESTORE_GCODE_STATE without its move; E goes on from where it is."""
        self.base, self.shift, self.homing = list(saved.base), list(saved.shift), list(saved.homing)
        self.base[3] += self.position[3] - saved.position[3]
        self.absolute, self.absolute_e = saved.absolute, saved.absolute_e
        self.feed, self.feed_factor, self.flow = saved.feed, saved.feed_factor, saved.flow
        for axis in range(3):
            if isnan(self.base[axis]):  # saved while G92 had named an unknown place
                self.position[axis] = nan

    def arc_axes(self) -> tuple[int, int, int]:
        """Return the two axes of the arc's plane, then its normal."""
        return FIRST_AXES[self.plane]

    def set_limits(self, **changes: float) -> None:
        """Limits the file asks for; `caps` still bound them."""
        self.own = replace(self.own, **changes)
        self._bound()

    def reset_limits(self) -> None:
        """Take back the limits that the file has asked for."""
        self.own = MACHINE_LIMITS
        self._bound()

    def set_caps(self, **changes: float) -> None:
        """Set the caps on what the file may ask for."""
        self.caps = replace(self.caps, **changes)
        self._bound()

    def _bound(self) -> None:
        velocity = _smaller(self.own.velocity, self.caps.velocity)
        acceleration = _smaller(self.own.acceleration, self.caps.acceleration)
        travel = _smaller(self.own.travel_acceleration, self.caps.acceleration)
        self.limits = replace(self.own, velocity=velocity, acceleration=acceleration, travel_acceleration=travel)


def _smaller(a: float, b: float) -> float:
    """Return the smaller of two limits; NaN binds nothing."""
    return b if isnan(a) else a if isnan(b) else min(a, b)
