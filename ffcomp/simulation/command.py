"""A command over time, whatever its source, the reference path of the nozzle, and the clock that aligns both.

A comment before each section of a compensated file has its time on the original's clock.

mm, s. Actuators in the order A, B, C.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ffcomp.firmware.program import PlannedProgram
from ffcomp.metrics import EFFORT_SPAN_S, peaks, progress_in_order
from ffcomp.planner.trajectory import Trajectory
from ffcomp.shapers import Shaper, shape
from gcode.embedded import section_times
from gcode.errors import GcodeError
from gcode.program import Program
from models.arrays import BoolArray, FloatArray, IntArray
from models.machine import Machine

if TYPE_CHECKING:
    from models.printer.printer import Hold

OfTime = Callable[[FloatArray], FloatArray]  # t : (k,) s → (k, 3) mm

SAMPLE_S = 0.001


@dataclass(frozen=True, eq=False)
class CommandSection:
    """A command from rest to rest during which nothing else moves the nozzle, and its path on a plan's clock."""

    begin_s: float
    end_s: float
    rows: Callable[[FloatArray, float], FloatArray]  # even times (k,) s and their step → (k, 3) mm, as executed
    actuators: OfTime  # the commanded actuator positions without microsteps, at any time
    due: OfTime  # where the nozzle should be
    plan_time: Callable[[FloatArray], FloatArray]  # times on the plan's clock, (k,) s → (k,) s
    corners: Callable[[float, float], tuple[FloatArray, FloatArray]]  # from, to (plan's clock) → (n,) s, (n, 3) mm


@dataclass(frozen=True, eq=False)
class Command:
    """Sections of a command in the order of time."""

    sections: Sequence[CommandSection]
    hold: Hold  # how it runs from row to row
    reference: str  # a sentence: the path that the nozzle is evaluated against

    def between(self, from_s: float, to_s: float) -> list[tuple[CommandSection, float, float]]:
        """Return the sections of a part of the time, each with the part's begin and end in it."""
        parts = [(s, max(s.begin_s, from_s), min(s.end_s, to_s)) for s in self.sections]
        return [(section, begin, end) for section, begin, end in parts if begin < end]


def command_peaks(actuators: OfTime, begin_s: float, end_s: float) -> tuple[float, float]:
    """Return the largest speed, mm/s, and acceleration, mm/s², that a command demands of any actuator: `peaks`."""
    t = begin_s + SAMPLE_S * np.arange(max((end_s - begin_s) / SAMPLE_S, 2 * round(EFFORT_SPAN_S / SAMPLE_S)) + 1)
    return peaks(actuators(t), SAMPLE_S)


@dataclass(frozen=True, slots=True)
class SectionClock:
    """Alignment of an executed motion with the reference plan, section by section.

    Section i of m begins at executed_t[i], which is plan_t[i] on the plan's clock. The reference moves only from
    begin_t[i] to end_t[i] of that clock, and rests around it. Where a section takes another time than planned
    (`retimed`), the plan's time is that of the place on the path where the command is.
    """

    executed_t: FloatArray  # (m,) s
    plan_t: FloatArray  # (m,) s
    begin_t: FloatArray  # (m,) s
    end_t: FloatArray  # (m,) s
    retimed: BoolArray | None = None  # (m,); None: no section is
    passed_t: FloatArray | None = None  # (k,) s, when the command passes some places,
    due_t: FloatArray | None = None  # (k,) s, and when the plan does

    def plan_time(self, t: FloatArray) -> FloatArray:
        """Return the plan's time at each executed time, (k,) s → (k,) s."""
        i = np.maximum(np.searchsorted(self.executed_t, t, side="right") - 1, 0)
        planned = self.plan_t[i] + (t - self.executed_t[i])
        if self.retimed is not None and self.passed_t is not None and self.due_t is not None:
            planned = np.where(self.retimed[i], np.interp(t, self.passed_t, self.due_t), planned)
        # at the end itself the next section may have begun, somewhere else
        return np.clip(planned, self.begin_t[i], np.nextafter(self.end_t[i], -np.inf))


@dataclass(frozen=True, slots=True)
class Motion:
    """The nozzle's command at any time from begin_t to end_t, and its alignment with the reference plan."""

    position: OfTime
    begin_t: float  # s
    end_t: float  # s
    clock: SectionClock

    def actuators(self, machine: Machine) -> Callable[[FloatArray], FloatArray]:
        """Return the actuators' command at times (k,) s, by the inverse kinematics that the firmware believes in."""
        kinematics = machine.kinematics.compiled()
        return lambda t: kinematics.inverse(np.ascontiguousarray(self.position(t)))

    def peaks(self, machine: Machine) -> tuple[float, float]:
        """Return the largest speed, mm/s, and acceleration, mm/s², that it demands of any actuator."""
        return command_peaks(self.actuators(machine), self.begin_t, self.end_t)


def motion_of(trajectory: Trajectory, clock: SectionClock, by_axis: Sequence[Shaper] = ()) -> Motion:
    """Execute a plan as it stands, or through shapers of x and y."""
    begin, end = float(trajectory.start_t[0]), trajectory.end_t
    return Motion(resting(lambda t: trajectory.position(t)[:, :3], begin, end, by_axis), begin, end, clock)


def resting(position: OfTime, begin_s: float, end_s: float, by_axis: Sequence[Shaper]) -> OfTime:
    """Return a position that rests before and after two times, through shapers of x and y."""

    def rests(t: FloatArray) -> FloatArray:
        return position(np.clip(t, begin_s, end_s))

    return (lambda t: shape(rests, t, *by_axis)) if by_axis else rests


def reference_clock(trajectory: Trajectory) -> SectionClock:
    """Return the clock of the reference plan itself."""
    begin, end = trajectory.start_t[:1], np.array([trajectory.end_t])
    return SectionClock(begin, begin, begin, end)


def planned_motion(trajectory: Trajectory) -> Motion:
    """Execute the reference plan itself, on its own clock."""
    return motion_of(trajectory, reference_clock(trajectory))


def path_corners(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Return when each straight move begins and ends (2 n,) s, and where (2 n, 3) mm: a rest is a corner twice.

    By rounding a move may end just after the next one begins; its corner is then both.
    """
    end_t = trajectory.start_t + trajectory.duration
    ends = trajectory.position(np.nextafter(end_t, -np.inf))[:, :3]
    t = np.maximum.accumulate(np.stack([trajectory.start_t, end_t], axis=1).ravel())
    return t, np.stack([trajectory.origin[:, :3], ends], axis=1).reshape(-1, 3)


RETIMED_S = 0.02  # a section that ends so much earlier or later by its path than by its clock is on another one,
ADRIFT_S = 0.04  # and one that is so much early or late anywhere, nearly as far as the contour error's window reaches
HALVINGS = 18  # of a move's time, until it is known when the plan passes a place on it


@dataclass(frozen=True, slots=True)
class SectionStarts:
    """The m sections of the original that begin in a compensated file, from its comments."""

    move: IntArray  # (m,) first travelling move of each in the compensated file
    plan_t: FloatArray  # (m,) s on the original's clock when that move begins
    begin_t: FloatArray  # (m,) s on that clock when the section's path begins
    end_t: FloatArray  # (m,) s and ends
    passing: IntArray  # (k,) the travelling moves from the first section on
    due_t: FloatArray  # (k,) s on the original's clock, when the plan is where each of them begins

    def clock(self, start_t: FloatArray) -> SectionClock:
        """Return the clock if move k of the compensated file begins at start_t[k], whoever planned it."""
        first = np.searchsorted(self.passing, self.move)
        last = np.append(first[1:], len(self.passing)) - 1
        passed_t = start_t[self.passing]
        section = np.searchsorted(self.move, self.passing, side="right") - 1
        kept_t = (self.plan_t - start_t[self.move])[section] + passed_t
        off_s = np.abs(np.clip(kept_t, self.begin_t[section], self.end_t[section]) - self.due_t)
        retimed = (off_s[last] > RETIMED_S) | (np.maximum.reduceat(off_s, first) > ADRIFT_S)
        return SectionClock(start_t[self.move], self.plan_t, self.begin_t, self.end_t, retimed, passed_t, self.due_t)


def section_starts(compensated: Program, original: PlannedProgram) -> SectionStarts:
    """Read from a compensated file when each section of its original begins; GcodeError without these comments."""
    program, moves = original.program, compensated.moves
    line_of = program.first_line + program.moves.line
    by_line = {int(line_of[section.first]): section for section in original.sections if section.travels}
    times = [time for time in section_times(compensated.lines) if time.line in by_line]
    if not times:
        rule = "No comment `;section line=… t=…` of ffcomp states when a section of the original begins"
        raise GcodeError(
            f"{rule}: the file was changed after it was compensated. Compensate the original again.",
            path=compensated.path,
        )
    travels = np.flatnonzero(np.any(moves.end[:, :3] != moves.start[:, :3], axis=1))
    after = np.searchsorted(moves.line[travels], [time.at for time in times], side="right")
    begin_t = np.array([by_line[time.line].begin_t for time in times])
    end_t = np.array([by_line[time.line].end_t for time in times])
    passing = travels[after[0] :]
    section = np.searchsorted(travels[after], passing, side="right") - 1
    due_t = _due(moves.start[passing, :3], begin_t[section], end_t[section], original.trajectory)
    plan_t = begin_t + np.array([time.t for time in times])
    return SectionStarts(travels[after], plan_t, begin_t, end_t, passing, due_t)


def _due(places: FloatArray, begin_t: FloatArray, end_t: FloatArray, plan: Trajectory) -> FloatArray:
    """Return when the plan is at each of the places (k, 3) mm, which lie on sections between these times (k,), s."""
    path_t, path = path_corners(plan)
    low = np.searchsorted(path_t[1:], begin_t, side="right")
    high = np.maximum(np.searchsorted(path_t[:-1], end_t, side="left"), low + 1)
    segment, share = progress_in_order(path, places, low, high)
    begin_t, end_t = path_t[segment], path_t[segment + 1]
    begin, length = path[segment], np.maximum(np.linalg.norm(path[segment + 1] - path[segment], axis=1), 1e-12)
    for _ in range(HALVINGS):  # a move speeds up and brakes: half of it is not half of its time
        middle_t = 0.5 * (begin_t + end_t)
        before = np.linalg.norm(plan.position(middle_t)[:, :3] - begin, axis=1) < share * length
        begin_t, end_t = np.where(before, middle_t, begin_t), np.where(before, end_t, middle_t)
    return np.asarray(0.5 * (begin_t + end_t))
