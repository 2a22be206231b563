"""Files as commands: G-code as the firmware plans it, and step timings, whose staircase itself is executed.

G-code goes through the kinematics that the firmware believes in; a compensated file is evaluated against the original
that its comments keep. Motors hold their microsteps: a step comes when the command crosses the middle between two of
them, so the staircase is the command rounded to them, neither early nor late, no more than half a microstep off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.errors import NothingToDo
from ffcomp.firmware.program import PlannedProgram, known_to_the_firmware, plan_program
from ffcomp.planner.reach import within_reach
from ffcomp.shapers import Shaper
from ffcomp.simulation.command import (
    Command,
    CommandSection,
    Motion,
    SectionClock,
    path_corners,
    reference_clock,
    resting,
    section_starts,
)
from ffcomp.simulation.expectation import Tuned
from ffcomp.simulation.linear import continuous_intervals
from ffcomp.steps.archive import MOTORS, MotorSteps, StepsError
from gcode.embedded import STAMP_REACH, already_processed, find_offset, find_shaper, original
from gcode.program import Program
from gcode.reader import read_program
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.machine import Machine

FILE_PLAN = "the planned path of the file itself"
ORIGINAL = "the planned path of the original print, which the compensated file keeps in its comments"
UNSHAPED = "the planned path of the print as sliced, without the input shaper that the file sets"


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
