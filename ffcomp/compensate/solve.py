"""Solve the sections of a planned program one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ffcomp.errors import LimitsError
from ffcomp.inverse.extent import WHOLE, Extent
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.nonlinear.correction import LinearSolution, correct_sections
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.solve import Solution, solve
from ffcomp.inverse.time_scaling import FeasibleSection, SectionRequest, TimeScaling, solve_feasible
from ffcomp.planner.machine_limits import planner_limits
from ffcomp.planner.program import PlannedProgram, plan_section, smooth_section
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import PlannedMotion
from gcode.layers import LayerLookup
from gcode.program import EventKind
from models.arrays import FloatArray
from models.kinematics.base import Kinematics
from models.machine import Machine


@dataclass(frozen=True, slots=True)
class SolvedSection:
    """A run that travels, and the command whose response it is."""

    trajectory: PlannedMotion  # the plan, slower than it was before where limits asked for it
    run: Section
    wanted: Reference
    result: Solution
    slowed: tuple[TimeScaling, ...]
    knots: tuple[int, int]  # between which it is written


def solutions(
    planned: PlannedProgram,
    machine: Machine,
    inverter: InverseModel,
    state: FloatArray | None,
    keep: Callable[[Reference], bool],
    layers_before: int = 0,
    ends: Extent = WHOLE,
) -> Iterator[SolvedSection]:
    """Solve the sections that travel, one after the other: what rings when one ends is known to the next.

    Parameters
    ----------
    state : (18,) of the plant as the first run begins; None: at rest
    keep : asked once for each run whether its response is wanted
    layers_before : of the file, before this program
    ends : what is written of the program, if it begins or ends in motion

    Raises
    ------
    LimitsError
        Where a limit cannot be held, and the plan must not or cannot be slowed down.
    """
    ran = _by_the_model(planned, machine, inverter, state, keep, layers_before, ends)
    if inverter.printer is None:
        yield from (solved for solved, _ in ran)
        return
    known = list(ran)
    results = correct_sections(
        inverter, inverter.printer, [LinearSolution(s.wanted, s.result, rest) for s, rest in known]
    )
    yield from (replace(solved, result=result) for (solved, _), result in zip(known, results, strict=True))


def _by_the_model(
    planned: PlannedProgram,
    machine: Machine,
    inverter: InverseModel,
    state: FloatArray | None,
    keep: Callable[[Reference], bool],
    layers_before: int,
    ends: Extent,
) -> Iterator[tuple[SolvedSection, float | None]]:
    """Each run with its answer, and how long the nozzle has rested before it; None: others have moved it."""
    program, trajectory, settings = planned.program, planned.trajectory, inverter.settings
    moved, limits = _moved_before(planned), planner_limits(machine)
    replan = partial(smooth_section, machine, limits) if settings.s_curve else partial(plan_section, limits)
    layers = LayerLookup(program, layers_before)
    rested = later = 0.0
    for run in planned.sections:
        if not run.travels:
            continue
        start, rest_s = trajectory.origin[run.first, :3], run.begin_t - rested
        rested = run.end_t
        if state is None or moved[run.first]:
            state, rest = machine.equilibrium(start), None
        else:
            state, rest = inverter.state_after_rest(state, start, rest_s), rest_s
        if later:
            run = replace(run, begin_t=run.begin_t + later, end_t=run.end_t + later)
        own = ends if run is planned.sections[0] else WHOLE
        written = own.written(trajectory, run, settings)
        keep_response = keep(written.reference)
        if settings.time_scaling:
            request = SectionRequest(
                program, trajectory, run, written, state, limits, replan, own, keep_response, layers.of
            )
            found = solve_feasible(inverter, request)
            trajectory, later = found.trajectory, later + found.lost_s
        else:
            result = solve(inverter, written.reference, state, keep_response=keep_response)
            found = FeasibleSection(trajectory, run, written, result)
        reference, *knots = found.written
        yield (
            SolvedSection(trajectory, found.section, reference, found.solution, found.records, (knots[0], knots[1])),
            rest,
        )
        state = found.solution.state


def _moved_before(planned: PlannedProgram) -> dict[int, bool]:
    """Tell for the first move of each section that travels whether others have moved the nozzle since the last one."""
    others = {e.move for e in planned.program.events if e.kind in (EventKind.STOP, EventKind.RAW_MOVE)}
    found, pending, last = {}, False, -1
    for run in planned.sections:
        pending = pending or any(move in others for move in range(last + 1, run.first + 1))
        last = run.first
        if run.travels:
            found[run.first], pending, last = pending, False, run.last - 1
    return found


def keep_inside(kinematics: Kinematics, vertices: FloatArray, heights: FloatArray) -> FloatArray:
    """Move a command to where the firmware lets it go: it aborts a print over a µm outside the radius or below the bed.

    Parameters
    ----------
    kinematics : Kinematics
        Those of the machine.
    vertices : (n, 3) array
        The command at its knots, mm.
    heights : (m,) array
        Heights of the path itself, mm.

    Raises
    ------
    LimitsError
        If the command cannot be reached at all.
    """
    if not np.isfinite(vertices).all():
        raise LimitsError("The command leaves the arms' reach; the path runs too close to it.")
    return kinematics.drawn_in(vertices, heights)
