"""Plan a program as the firmware will, and cut the plan into sections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.errors import NothingToDo
from ffcomp.planner.junctions import junction_limits
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.machine_limits import planner_limits
from ffcomp.planner.reach import check_moves
from ffcomp.planner.s_curve import SCurve, s_curve
from ffcomp.planner.sections import Section, split_sections
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from gcode.errors import GcodeError
from gcode.program import Moves, Program
from models.machine import Machine


@dataclass(frozen=True, slots=True)
class PlannedProgram:
    """A program with the firmware's plan for it."""

    program: Program
    trajectory: PlannedMotion
    sections: list[Section]
    firmware_s: float  # what the firmware's own plan takes


def plan_program(program: Program, machine: Machine, smooth: bool = False) -> PlannedProgram:
    """Check that every move can be reached, and plan them all.

    smooth : with S-curves, within a percent of the firmware's time
    """
    trajectory: PlannedMotion
    trajectory = plan = firmware_plan(program, machine)
    stop_before, wait_before = stops_and_waits(program)
    if smooth:
        rests = stop_before | (wait_before > 0.0)
        trajectory = _smoothed(plan, program.moves, machine, planner_limits(machine), rests)
    return PlannedProgram(program, trajectory, split_sections(trajectory, stop_before), plan.end_t)


def firmware_plan(program: Program, machine: Machine) -> Trajectory:
    """Plan every move, once it is known that the nozzle can get there; what need not is out of it (`Reach`)."""
    moves = program.moves
    if not len(moves):
        raise NothingToDo(f"{program.path or 'The file'} holds no move whose start is known: nothing to compensate.")
    check_moves(program, machine.kinematics)
    stop_before, wait_before = stops_and_waits(program)
    try:
        return plan_moves(moves, planner_limits(machine), stop_before=stop_before, wait_before=wait_before)
    except GcodeError as error:
        raise error.located(program.path, program.first_line) from None


def plan_section(limits: PlannerLimits, moves: Moves, begin_t: float) -> Trajectory:
    """Plan the moves of one section, from rest to rest."""
    n = len(moves)
    return plan_moves(moves, limits, stop_before=np.zeros(n, dtype=np.bool_), wait_before=np.zeros(n), start_t=begin_t)


def smooth_section(machine: Machine, limits: PlannerLimits, moves: Moves, begin_t: float) -> PlannedMotion:
    """Plan the moves of one section with S-curves."""
    plan = plan_section(limits, moves, begin_t)
    return _smoothed(plan, moves, machine, limits, np.zeros(len(moves), dtype=np.bool_))


def _smoothed(
    plan: Trajectory, moves: Moves, machine: Machine, limits: PlannerLimits, rests: NDArray[np.bool_]
) -> PlannedMotion:
    most = SCurve(limit_mm_per_s2=machine.limits.acceleration_mm_per_s2)
    allowed = junction_limits(moves, limits, rests)
    return s_curve(plan, machine.kinematics.compiled().inverse, most, allowed_v=allowed)
