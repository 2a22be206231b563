"""Solve the sections of a planned program one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ffcomp.compensation.net import ENDS_MM, fault_of, path_fault
from ffcomp.errors import LimitsError
from ffcomp.firmware.program import PlannedProgram, section_planner
from ffcomp.inverse.feasible import SolvedSection, solve_feasible
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import WHOLE, Extent, Reference
from ffcomp.inverse.solve import held, solve
from ffcomp.inverse.time_scaling import PlannedSection, Replanner
from ffcomp.planner.limits import planner_limits
from ffcomp.planner.trajectory import Section
from gcode.layers import layers_of
from gcode.program import EventKind, Program
from gcode.slicing import some
from models.machine import Machine


def replanner_of(program: Program, machine: Machine, layers_before: int) -> Replanner:
    """Return the planner of a program's firmware, for some of its moves; so many layers have begun before."""
    layers = layers_of(program, layers_before).tolist()
    return Replanner(planner_limits(machine), section_planner(program, machine), layers.__getitem__)


def solutions(
    planned: PlannedProgram, model: InverseModel, layers_before: int = 0, extent: Extent = WHOLE
) -> Iterator[tuple[Section, SolvedSection | None]]:
    """Yield the sections in order, each with its solution, or None where only filament moves.

    Each solution begins with the vibration that the one before it leaves, the first one at rest.

    planned : a chunk's program
    model : the machine's inverse
    layers_before : layers of the file that have begun before this program
    extent : the part of the program that is written, if it begins or ends in motion

    Raises LimitsError where a limit cannot be held, and the plan must not or cannot be slowed down.
    """
    travelling = _linear(planned, model, layers_before, extent)
    if model.printer is not None:  # correct them by the whole printer, effects included
        from ffcomp.inverse.nonlinear import correct_sections

        corrected = correct_sections(model, model.printer, list(travelling))
        travelling = (_checked(each, planned, model) for each in corrected)
    for section in planned.sections:
        yield section, next(travelling) if section.travels else None


def _linear(
    planned: PlannedProgram, model: InverseModel, layers_before: int, extent: Extent
) -> Iterator[SolvedSection]:
    """Solve each section linearly."""
    program, trajectory, settings, machine = planned.program, planned.trajectory, model.settings, model.full_machine
    moved, replanner = _moved_before(planned), replanner_of(program, machine, layers_before)
    travels = [section for section in planned.sections if section.travels]
    parts = [extent if section is planned.sections[0] else WHOLE for section in travels]
    # robust offsets of many sections together cost half of what they do one by one
    laid = [Reference(trajectory, section, settings, part) for part, section in zip(parts, travels, strict=True)]
    offsets, later = model.robust_offsets(laid), 0.0
    before: SolvedSection | None = None  # None: its command was not written, or there is none
    for section, reference, offset in zip(travels, laid, offsets, strict=True):
        start, rest, fault = trajectory.origin[section.first, :3], None, ""
        if before is not None and not moved[section.first]:
            last = before.section.last - 1
            if float(np.abs(program.moves.end[last, :3] - start).max()) > ENDS_MM:
                fault = "it begins elsewhere than the last motion has ended"
            else:  # time that was lost by slowing down does not count
                plan = planned.trajectory
                rest = section.begin_t - float(plan.start_t[last] + plan.duration[last])
        if before is None or rest is None:
            state = machine.equilibrium(start)
        else:
            state = model.state_after_rest(before.solution.state, start, rest)
        if later:
            section = replace(section, begin_t=section.begin_t + later, end_t=section.end_t + later)
            reference = Reference(trajectory, section, settings, reference.extent)
        if reference.knots * settings.rows_per_segment == len(offset):
            reference.robust_offset = offset
        if settings.slowing.slow:
            request = PlannedSection(program, trajectory, section, reference, state, replanner)
            solved = solve_feasible(model, request)
        else:
            solution = held(model, reference, state, solve(model, reference, state))
            solved = SolvedSection(trajectory, section, reference, solution)
        solved = _checked(replace(solved, rest_s=rest, fault=fault), planned, model)
        if not solved.fault:
            trajectory, later = solved.trajectory, later + solved.lost_s
        yield solved
        before = None if solved.fault else solved


def _checked(solved: SolvedSection, planned: PlannedProgram, model: InverseModel) -> SolvedSection:
    """Check a section against its plan (`net`); one that is cut in motion cannot keep its original lines: refuse it."""
    if solved.fault:
        return solved
    reference, vertices = solved.reference, solved.solution.vertices
    if reference.extent == WHOLE:
        moves = some(planned.program.moves, slice(solved.section.first, solved.section.last))
        return replace(solved, fault=fault_of(model, moves, reference, vertices))
    if why := path_fault(model, reference, vertices, reference.written):
        line = planned.program.line_of(solved.section.first)
        raise LimitsError(
            f"line {line}: the command of the motion that begins here failed its check: {why}. This is a fault of "
            "ffcomp; print the original, and please report it with the file."
        )
    return solved


def _moved_before(planned: PlannedProgram) -> dict[int, bool]:
    others = {e.move for e in planned.program.events if e.kind in (EventKind.STOP, EventKind.RAW_MOVE)}
    moved, pending, last = {}, False, -1
    for section in planned.sections:
        pending = pending or any(move in others for move in range(last + 1, section.first + 1))
        last = section.first
        if section.travels:
            moved[section.first], pending, last = pending, False, section.last - 1
    return moved
