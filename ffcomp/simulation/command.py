"""A command over time, whatever its source, the reference path of the nozzle, and the clock that aligns both.

A comment before each section of a compensated file has its time on the original's clock.

mm, s. Actuators in the order A, B, C.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ffcomp.errors import NothingToDo
from ffcomp.firmware.program import PlannedProgram, known_to_the_firmware, plan_program
from ffcomp.metrics import EFFORT_SPAN_S, peaks, progress_in_order
from ffcomp.planner.reach import within_reach
from ffcomp.planner.trajectory import Trajectory
from ffcomp.shapers import DAMPING_RATIO, SHAPERS, Shaper, shape
from ffcomp.simulation.linear import continuous_intervals
from ffcomp.steps.archive import MOTORS, MotorSteps, StepsError
from gcode.embedded import STAMP_REACH, already_processed, find_offset, find_shaper, original, section_times
from gcode.errors import GcodeError
from gcode.program import Program
from gcode.reader import read_program
from models.arrays import BoolArray, FloatArray, IntArray
from models.errors import UnreachableError
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


# ---- files as commands ---------------------------------------------------------------------------
#
# G-code goes through the kinematics that the firmware believes in; a compensated file is evaluated against the original
# that its comments keep. Motors hold their microsteps: a step comes when the command crosses the middle between two of
# them, so the staircase is the command rounded to them, neither early nor late, no more than half a microstep off.

FILE_PLAN = "the planned path of the file itself"
ORIGINAL = "the planned path of the original print, which the compensated file keeps in its comments"
UNSHAPED = "the planned path of the print as sliced, without the input shaper that the file sets"


class Tuned(NamedTuple):
    """An input shaper with the frequencies for x and y that serve a print best."""

    kind: str
    hz: tuple[float, float]

    @property
    def name(self) -> str:
        """Kind and frequencies, for people."""
        return f"{self.kind.upper()}, x {self.hz[0]:.1f} Hz, y {self.hz[1]:.1f} Hz"

    def by_axis(self) -> list[Shaper]:
        """Return the shapers of x and y."""
        return [SHAPERS[self.kind](hz, DAMPING_RATIO) for hz in self.hz]


def read_gcode(
    data: bytes, path: str, machine: Machine, offset: tuple[float, float] = (0.0, 0.0), flavor: str = ""
) -> tuple[Command, Program]:
    """Read a sliced or a compensated file; return the command, and the program that was read.

    offset : (float, float), added to every position, mm; a compensated file states its own
    flavor : "" for what a compensated file says, the machine file, or else the file
    """
    if (both := read_compensated(data, path, machine, flavor)) is not None:
        return both.command(machine), both.written.program
    firmware = known_to_the_firmware(machine)
    program = read_program(data, path, offset_mm=offset, flavor=flavor or machine.flavor or None, **firmware)
    return gcode_command(plan_program(within_reach(program, machine.kinematics), machine), machine), program


@dataclass(frozen=True, slots=True)
class PlannedPrint:
    """A file and its original, both as the firmware plans them, and how they align."""

    written: PlannedProgram
    original: PlannedProgram
    clock: SectionClock
    reference: str = ORIGINAL  # a sentence: the path that it is evaluated against
    by_axis: Sequence[Shaper] = ()  # of the firmware, where the file is the print as sliced

    def command(self, machine: Machine) -> Command:
        """Return the file as a command, evaluated against the path of the original."""
        executed, plan = self.written.trajectory, self.original.trajectory
        path_t, path = path_corners(plan)

        def corners(from_s: float, to_s: float) -> tuple[FloatArray, FloatArray]:
            first, last = max(int(np.searchsorted(path_t, from_s)) - 1, 0), int(np.searchsorted(path_t, to_s, "right"))
            return path_t[first : last + 1], path[first : last + 1]

        def section(begin_s: float, end_s: float) -> CommandSection:
            last = float(np.nextafter(end_s, -np.inf))  # at the end itself the next section may have begun
            position = resting(lambda t: executed.position(t)[:, :3], begin_s, last, self.by_axis)
            actuators = Motion(position, begin_s, end_s, self.clock).actuators(machine)

            def plan_time(t: FloatArray) -> FloatArray:
                return self.clock.plan_time(np.clip(t, begin_s, last))

            def due(t: FloatArray) -> FloatArray:
                return np.ascontiguousarray(plan.position(plan_time(t))[:, :3])

            return CommandSection(begin_s, end_s, lambda t, step_s: actuators(t), actuators, due, plan_time, corners)

        return Command([section(*each) for each in continuous_intervals(executed)], "cubic", self.reference)


def read_compensated(data: bytes, path: str, machine: Machine, flavor: str = "") -> PlannedPrint | None:
    """Read a compensated file with the original that its comments keep; None: it has no stamp. flavor : "": its own."""
    if (stamp := already_processed(data)) is None:
        return None
    known, head = {"flavor": flavor or stamp.flavor, **known_to_the_firmware(machine)}, data[:STAMP_REACH]
    program = read_program(data, path, **known)
    sliced = read_program(original(data), path, offset_mm=find_offset(head), **known)
    written, planned = (plan_program(within_reach(each, machine.kinematics), machine) for each in (program, sliced))
    if (shaper := find_shaper(head)) is not None:
        clock = reference_clock(planned.trajectory)
        return PlannedPrint(written, planned, clock, UNSHAPED, Tuned(*shaper).by_axis())
    clock = section_starts(written.program, planned).clock(written.trajectory.start_t)
    return PlannedPrint(written, planned, clock)


def gcode_command(planned: PlannedProgram, machine: Machine) -> Command:
    """Return a planned program, evaluated against its own path."""
    return PlannedPrint(planned, planned, reference_clock(planned.trajectory), FILE_PLAN).command(machine)


REFERENCE = "the path of the steps themselves, with the microsteps smoothed out"
LEAD_S = 0.05  # of rest before the first step
AT_REST_S = 0.02  # a motor that holds a microstep for longer stands in its middle
PATH_SAMPLE_S = 1 / 3200  # of the reference path: 0.1 µm at 10 m/s²


def staircase(motor: MotorSteps, t: FloatArray, step_s: float) -> FloatArray:
    """Return the motor's mean position, (k,) mm, over one step of time about each of the even times t (k,) s.

    A mean keeps the time of every edge; executed with straight lines between rows, nothing comes early or late.
    """
    edges = np.append(t - step_s / 2, t[-1] + step_s / 2)
    first, last = np.searchsorted(motor.time_s, (edges[0], edges[-1]))
    # relative to the first edge, so that no digits are lost
    corners = np.concatenate([[0.0], motor.time_s[first:last] - edges[0], [edges[-1] - edges[0]]])
    level = motor.level_mm[first : last + 1]
    area = np.concatenate([[0.0], np.cumsum((level - level[0]) * np.diff(corners))])
    means: FloatArray = level[0] + np.diff(np.interp(edges - edges[0], corners, area)) / step_s
    return means


def smoothed(motor: MotorSteps, t: FloatArray) -> FloatArray:
    """Return the command, (k,) mm, that the motor's steps stand for, at rising times t (k,) s.

    Known at every step: half-way between two microsteps. In between it passes the middle of the microstep that is
    held, or stays there if that takes long.
    """
    first, last = np.searchsorted(motor.time_s, (t[0], t[-1]))
    part = slice(max(int(first) - 1, 0), int(last) + 1)  # one step more on either side
    crossed = motor.time_s[part]
    level = motor.level_mm[part.start : part.start + len(crossed) + 1]
    if not len(crossed):
        return np.full(len(t), level[0])
    stays = np.minimum(np.diff(crossed) / 2, AT_REST_S)
    before, after = np.append(AT_REST_S, stays), np.append(stays, AT_REST_S)
    times = np.stack([crossed - before, crossed, crossed + after], axis=1).ravel()
    heights = np.stack([level[:-1], (level[:-1] + level[1:]) / 2, level[1:]], axis=1).ravel()
    return np.interp(t, times, heights)


def steps_command(motors: Mapping[str, MotorSteps], machine: Machine, path: str = "") -> Command:
    """Return the steps of the motors a, b, c, from rest to rest, evaluated against the path they stand for.

    Raises StepsError if the carriages begin where the arms cannot join them, NothingToDo if no carriage steps.
    """
    carriages = [motors[motor] for motor in MOTORS]
    moving = [each.time_s for each in carriages if len(each.time_s)]
    if not moving:
        raise NothingToDo(f"{path or 'The archive'} holds no step of a carriage: nothing to simulate.")
    back = np.linalg.inv(machine.kinematics.motors).T
    try:
        machine.kinematics.forward(np.array([[each.start_mm for each in carriages]]) @ back)
    except UnreachableError as error:
        raise StepsError(f"a_start_mm, b_start_mm, c_start_mm: {error}", path=path) from error
    kinematics = machine.kinematics.compiled()
    begin_s = max(min(float(t[0]) for t in moving) - LEAD_S, 0.0)
    end_s = max(float(t[-1]) for t in moving) + AT_REST_S

    def rows(t: FloatArray, step_s: float) -> FloatArray:
        return np.column_stack([staircase(each, t, step_s) for each in carriages]) @ back

    def commanded(t: FloatArray) -> FloatArray:
        return np.column_stack([smoothed(each, t) for each in carriages]) @ back

    def nozzle(t: FloatArray) -> FloatArray:
        return kinematics.forward(commanded(t))

    def corners(from_s: float, to_s: float) -> tuple[FloatArray, FloatArray]:
        t = np.linspace(from_s, to_s, int(np.ceil((to_s - from_s) / PATH_SAMPLE_S)) + 1)
        return t, nozzle(t)

    section = CommandSection(begin_s, end_s, rows, commanded, nozzle, lambda t: t, corners)
    return Command([section], "linear", REFERENCE)
