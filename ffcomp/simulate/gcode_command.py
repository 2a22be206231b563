"""G-code as a command: planned as the firmware plans it, and sent through the kinematics that it believes in.

A compensated file is evaluated against the original that its comments keep.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ffcomp.planner.machine_limits import known_to_the_firmware
from ffcomp.planner.program import PlannedProgram, plan_program
from ffcomp.planner.reach import within_reach
from ffcomp.planner.trajectory import PlannedMotion
from ffcomp.simulate.alignment import section_clock
from ffcomp.simulate.command import Command, CommandSection, ReferencePath
from ffcomp.simulate.linear import continuous_intervals
from ffcomp.simulate.motion import SectionClock, own_clock, path_corners_with_rests
from gcode.embedded import original
from gcode.program import Program
from gcode.reader import read_program
from gcode.stamp import STAMP_REACH, already_processed, find_offset
from models.arrays import FloatArray
from models.machine import Machine

OWN_PLAN = "the planned path of the file itself"
ORIGINAL = "the planned path of the original print, which the compensated file keeps in its comments"


def read_gcode(
    data: bytes, path: str, machine: Machine, offset: tuple[float, float] = (0.0, 0.0), flavor: str = ""
) -> tuple[Command, Program]:
    """Read a sliced or a compensated file.

    Parameters
    ----------
    data, path : bytes, str
        The file and its name.
    machine : Machine
    offset : (float, float)
        Added to every position, mm; a compensated file states its own.
    flavor : str
        "" for what the machine file says, or else the file.

    Returns
    -------
    Command, Program
        The command, and the program that was read.
    """
    own = known_to_the_firmware(machine)
    inside = partial(within_reach, kinematics=machine.kinematics)
    stamp = already_processed(data)
    if stamp is None:
        program = read_program(data, path, offset_mm=offset, flavor=flavor or machine.flavor or None, **own)
        return gcode_command(plan_program(inside(program), machine), machine), program
    program = read_program(data, path, flavor=stamp.flavor, **own)
    offset = find_offset(data[:STAMP_REACH])
    reference = read_program(original(data), path, offset_mm=offset, flavor=stamp.flavor, **own)
    executed = plan_program(inside(program), machine)
    return compensated_command(executed, plan_program(inside(reference), machine), machine), program


def gcode_command(planned: PlannedProgram, machine: Machine) -> Command:
    """Return a planned program, evaluated against its own path."""
    trajectory = planned.trajectory
    return _command(trajectory, trajectory, own_clock(trajectory), machine, OWN_PLAN)


def compensated_command(compensated: PlannedProgram, original: PlannedProgram, machine: Machine) -> Command:
    """Return a compensated program, evaluated against the original's path."""
    clock = section_clock(compensated, original)
    return _command(compensated.trajectory, original.trajectory, clock, machine, ORIGINAL)


def _command(
    executed: PlannedMotion, reference: PlannedMotion, clock: SectionClock, machine: Machine, description: str
) -> Command:
    intervals = continuous_intervals(executed)
    sections = [_section(executed, begin, end, reference, clock, machine) for begin, end in intervals]
    return Command(sections, "cubic", description)


def _section(
    executed: PlannedMotion,
    begin_s: float,
    end_s: float,
    reference: PlannedMotion,
    clock: SectionClock,
    machine: Machine,
) -> CommandSection:
    kinematics = machine.kinematics.compiled()
    last = np.nextafter(end_s, -np.inf)  # at the end itself the next section may have begun
    path_t, path = path_corners_with_rests(reference)

    def actuators(t: FloatArray) -> FloatArray:
        return kinematics.inverse(np.ascontiguousarray(executed.position(np.clip(t, begin_s, last))[:, :3]))

    def plan_time(t: FloatArray) -> FloatArray:
        return clock.plan_time(np.clip(t, begin_s, last))

    def nozzle(t: FloatArray) -> FloatArray:
        return np.ascontiguousarray(reference.position(plan_time(t))[:, :3])

    def between(from_s: float, to_s: float) -> tuple[FloatArray, FloatArray]:
        part = slice(max(int(np.searchsorted(path_t, from_s)) - 1, 0), int(np.searchsorted(path_t, to_s, "right")) + 1)
        return path_t[part], path[part]

    path_of_section = ReferencePath(nozzle, plan_time, between)
    return CommandSection(begin_s, end_s, lambda t, step_s: actuators(t), actuators, path_of_section)
