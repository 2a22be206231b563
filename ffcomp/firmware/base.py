"""What ffcomp must know about a firmware: how it plans, which limits it obeys, and how it executes segments.

Each firmware is one class that implements `Firmware`, listed in `ffcomp.firmware.table`. Defaults suit a firmware that
executes segments exactly as written.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import NamedTuple, Protocol

import numpy as np

from ffcomp.inverse.model import InverseModel
from ffcomp.planner.segment_merging import at_most, refit
from ffcomp.planner.segment_timing import SegmentLimits, SegmentSpeeds, segment_speeds
from ffcomp.planner.trajectory import Trajectory
from gcode.dialect import DIALECTS
from gcode.dialects import limit_lines
from gcode.program import LimitCommand, ModalState, MotionLimits, Moves, Program
from models.arrays import BoolArray, FloatArray, IntArray
from models.machine import Machine, MarlinSettings, RepRapFirmwareSettings
from models.machine import MotionLimits as NozzleLimits

Inside = Callable[[FloatArray], BoolArray]  # which points (n, 3) mm the firmware accepts


class Planner(Protocol):
    """A firmware's planner with its settings from the program and the machine file."""

    def __call__(
        self, moves: Moves, *, stop_before: BoolArray, wait_before: FloatArray, start_t: float = 0.0
    ) -> Trajectory:
        """Plan moves of the program from rest to rest; see `lookahead.plan_moves`."""


@dataclass(frozen=True, slots=True)
class FileLimits:
    """The limits that a file has set, at one of its lines."""

    at_move: MotionLimits = field(default_factory=MotionLimits)  # NaN: not set
    commands: Mapping[str, LimitCommand] = field(default_factory=dict)  # in effect (`gcode.program`)
    unit_mm: float = 1.0  # of the file's numbers


class AxisLimits(NamedTuple):
    """Limits of the axes X Y Z E."""

    acceleration: Sequence[float]  # (4,) mm/s²
    speed: Sequence[float]  # (4,) mm/s
    printing: float  # mm/s², of moves that extrude
    travel: float  # mm/s²
    jerk: Sequence[float]  # (4,) mm/s

    @classmethod
    def even(cls, limits: SegmentLimits | NozzleLimits) -> AxisLimits:
        """Return the same limits for every axis."""
        a, corner = limits.acceleration_mm_per_s2, limits.square_corner_velocity_mm_per_s
        return cls((a,) * 4, (limits.velocity_mm_per_s,) * 4, a, a, (corner,) * 4)

    @classmethod
    def of(cls, s: MarlinSettings | RepRapFirmwareSettings) -> AxisLimits:
        """Return those of a planner's settings."""
        accelerations = s.printing_acceleration_mm_per_s2, s.travel_acceleration_mm_per_s2
        return cls(s.acceleration_mm_per_s2, s.speed_mm_per_s, *accelerations, s.jerk_mm_per_s)

    def commands(self, jerk: str, axes: str, jerk_axes: str, filament: Container[str] = ()) -> list[LimitCommand]:
        """Return the commands that set them.

        jerk : the firmware's command for jerk, of `jerk_axes`
        filament : the commands that set the limit of E too
        """

        def command(code: str, axes: str, values: Sequence[float]) -> LimitCommand:
            axes += "E" if code in filament else ""
            return LimitCommand(code, {axis: values["XYZE".index(axis)] for axis in axes})

        return [
            command("M201", axes, self.acceleration),
            command("M203", axes, self.speed),
            LimitCommand("M204", {"P": self.printing, "T": self.travel}),
            command(jerk, jerk_axes, self.jerk),
        ]


class Firmware(Protocol):
    """One firmware."""

    flavor: str  # its name in options, machine files and stamps
    quicker_note: str = (
        "Quicker moves are planned by Klipper's corner rules, whatever the firmware: it executes ffcomp's segments."
    )

    slow_board_per_s: float = inf  # segments that its slowest boards cannot follow
    in_comparisons: Sequence[tuple[str, str]] = ()  # names and sentences of what a comparison must state
    # when it records with its own accelerometers
    usual_chips: Sequence[str] = ()  # empty: it has none
    captures_at: str = "from the printer"
    corrections_off: Sequence[str] = ()
    corrections_on: Sequence[str] = ()
    shaper_kept: Sequence[str] = ()  # lines that keep the settings of its shaper,
    shaper_back: Sequence[str] = ()  # and restore them; empty: it cannot
    restore_call: Sequence[str] = ()  # the macro at the end of a recording,
    restore_macro: Sequence[str] = ()  # and its text
    restores: str = ""  # how everything is restored, also after a cancelled run

    def capture(self, chips: Sequence[str], name: str, lasting_s: float) -> tuple[list[str], list[str]]:
        """Return the lines that begin and end a capture, which lasts so long, rests included."""
        return [], []

    def planner(self, program: Program, machine: Machine, within: bool = False) -> Planner:
        """Return the planner with the rules in force at each line of a program.

        within : the moves to plan are part of a motion, so that nothing is slowed because the queue fills
        """

    def opening(self, machine: Machine, raised: SegmentLimits, file: FileLimits) -> list[bytes]:
        """Return the lines that raise the limits for our segments."""
        return limit_lines(self.flavor, self._by_axes(AxisLimits.even(raised), raised), file.unit_mm)

    def closing(self, machine: Machine, raised: SegmentLimits, file: FileLimits) -> list[bytes]:
        """Return the lines that restore the machine's limits of the raised axes, then the file's own."""
        own = self._by_axes(self.own_limits(machine), raised)
        return limit_lines(self.flavor, [*own, *file.commands.values()], file.unit_mm)

    def own_limits(self, machine: Machine) -> AxisLimits:
        """Return the limits in force before a print."""
        return AxisLimits.even(machine.limits)

    def _by_axes(self, limits: AxisLimits, raised: SegmentLimits) -> list[LimitCommand]:
        code, axes = DIALECTS[self.flavor].jerk
        return limits.commands(code, raised.raised_axes, "".join(each for each in raised.raised_axes if each in axes))

    def cut(self, program: Program, machine: Machine) -> Program:
        """Cut moves where the firmware begins another block."""
        return program

    def arc_chords(self, length: float, turn: float) -> int:
        """Return how many chords it makes of an arc of a length, mm, and a turn, rad; 1: where they meet is unknown."""
        return 1

    def longest_part_s(self, machine: Machine) -> float:
        """Return how much motion may be read at a time, s: less where the firmware cuts moves into many."""
        return inf

    def shapers(self, machine: Machine) -> Collection[str]:
        """Return the input shapers that it has on a machine, by their names in `ffcomp.shapers`."""
        return DIALECTS[self.flavor].shapers

    def assumed(self, machine: Machine) -> str:
        """Say which settings of the planner are assumed; empty: none that matter."""
        return ""

    def segments(self, model: InverseModel) -> Segments:
        """Return how the firmware executes segments of a machine's inverse model."""
        return Segments(self, model.machine, model.settings.output, model.settings.segment_s)


class Filament(NamedTuple):
    """A move of the filament alone."""

    mm: float
    mm_per_s: float


class FilamentCount:
    """How E counts within our blocks: as in the file."""

    def begin(self, frame: ModalState, e_mm: float, late_mm: float = 0.0) -> None:
        """Continue from the file's own E: a block opens, or G92 renames the position.

        late_mm : how much more filament has passed than when the file renames it
        """

    def frame(self, frame: ModalState) -> ModalState:
        """Return how numbers are written within a block."""
        return frame

    def opening(self, frame: ModalState) -> list[bytes]:
        """Return the lines that change the count at a block's begin."""
        return []

    def naming(self, frame: ModalState, e_mm: float) -> list[bytes]:
        """Return the lines that give this position of the filament its name in the file."""
        return []

    def closing(self, frame: ModalState, e_mm: float) -> list[bytes]:
        """Return the lines that restore the file's count."""
        return []

    def set_by(self, line: bytes) -> str:
        """Return the command of a line that changes the count; empty: it does not."""
        return ""


@dataclass(frozen=True, slots=True)
class Segments:
    """How a firmware executes segments between the limits that `opening` raises: exactly as written."""

    firmware: Firmware
    machine: Machine
    raised: SegmentLimits
    knot_s: float

    @property
    def longest_s(self) -> float:
        """The longest segment that joined ones become."""
        return inf

    @property
    def most_in_a_second(self) -> int:
        """The most segments that begin within a second."""
        return round(1.0 / self.knot_s) - 1

    def count(self) -> FilamentCount:
        """Return how E counts within blocks."""
        return FilamentCount()

    def ends(
        self, at: FloatArray, points: FloatArray, e: FloatArray, kept: IntArray, pinned: BoolArray, inside: Inside
    ) -> tuple[IntArray, FloatArray, FloatArray, BoolArray]:
        """Return which points end segments, when they are due, (k,) knots, where, (k, 3) mm, and which are fixed.

        at : (n,) times of the points, in knots
        points : (n, 3) mm
        e : (n,) mm of filament
        kept : (m,) indices of the points that end segments so far
        pinned : (n,) points that must stay: a line stands there, or another writer continues
        """
        kept = at_most(at, points, kept, pinned, self.most_in_a_second)
        fixed = pinned[kept]
        fixed[[0, -1]] = True
        placed = refit(at, points, kept, fixed)
        return kept, at[kept], np.where(inside(placed)[:, None], placed, points[kept]), fixed

    def rounded(self, points: FloatArray) -> FloatArray:
        """Return where the firmware ends lines of the file that end at points, (n, 3) mm."""
        return points

    def executed(self, points: FloatArray, e: FloatArray, fixed: BoolArray, ends: BoolArray) -> IntArray:
        """Return the points (n, 3) mm, with e (n,) mm, that may end segments so that the firmware drops none, (m,).

        fixed : (n,) points that are left out only for another one of them: a line that stood there moves to it
        ends : (n,) points that must stay: another writer, or a rest, continues from there
        """
        return np.arange(len(points))

    def speeds(
        self, points: FloatArray, e: FloatArray, lasting: FloatArray, file: FileLimits, filament: Filament | None
    ) -> tuple[FloatArray, FloatArray, SegmentSpeeds]:
        """Return the speeds to request, (n,) mm/s, and how the firmware then executes the segments.

        Between them: the motors' limits that must be in force, (n,) mm/s; inf: those of the header.

        points : (n + 1, 3) mm
        e : (n + 1,) mm of filament
        lasting : (n,) s that each segment should take
        file : the file's own limits, which hold where the header raises none
        filament : the next move, without a rest before it: the last segment need not end at rest
        """
        speeds = segment_speeds(points, np.diff(e), lasting, self.raised)
        return speeds.cruise, np.full(len(lasting), inf), speeds

    def paced(self, motors_mm_per_s: float, unit_mm: float) -> list[bytes]:
        """Return the lines that set a limit of the motors; inf: that of the header."""
        return []

    def opening(self, file: FileLimits) -> list[bytes]:
        """Return the lines that raise the limits."""
        return self.firmware.opening(self.machine, self.raised, file)

    def closing(self, file: FileLimits) -> list[bytes]:
        """Return the lines that restore them."""
        return self.firmware.closing(self.machine, self.raised, file)
