"""A section's command within all limits of machine and firmware: less robust, or else more time."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, fields, replace

import numpy as np

from ffcomp.inverse.command_limits import ACCELERATION, utilisation_from_rest
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import WHOLE, Extent, Reference, context_s, rooms_of
from ffcomp.inverse.solve import Solution, solve
from ffcomp.inverse.time_scaling import (
    Command,
    PlannedSection,
    Replanner,
    ScaledSection,
    TimeScaling,
    after_events,
    late_segments,
)
from ffcomp.planner.lifts import FLOWS_MM
from ffcomp.planner.limits import lines_of
from ffcomp.planner.trajectory import PathPosition, Section, Trajectory
from gcode.program import Moves, Program
from models.arrays import BoolArray, FloatArray

ENDS = 6  # knots of a command at either end, where its motion begins and ends
STEEP = 1.4  # times the accelerations of its path and its middle: limit for the ends
CALMED = 3  # rounds; each inverts more of the section plainly
SCALED = 0.75  # share of the context of a cut that may become slower before the cut
NO_TOLERANCE_MM = 0.0  # around a cut: where no limit is active, both sides find the same command


@dataclass(frozen=True, slots=True)
class SolvedSection:
    """A section that travels, and its command."""

    trajectory: Trajectory  # the whole plan; `lost_s` later after the section
    section: Section
    reference: Reference
    solution: Solution
    slowed: tuple[TimeScaling, ...] = ()
    lost_s: float = 0.0
    fault: str = ""  # why its original lines must be written instead; empty: its command is safe
    rest_s: float | None = None  # since the section before it ended; None: others have moved the nozzle


def solve_feasible(model: InverseModel, request: PlannedSection) -> SolvedSection:
    """Solve a section; where its limits cannot be kept within the tolerance, on a plan that is slower there.

    The model's settings say how far the nozzle may leave the path where a limit is active, and whether to refuse
    (`strict`) instead of slowing down.

    Raises LimitsError where the path itself lies beyond a carriage's travel, where no slower plan is found, or when
    `strict`.
    """
    trajectory, section = request.trajectory, request.section
    for reference, gentle in _layouts(model, request):
        free = solve(model, reference, request.state)
        if (found := _within_limits(model, request, (reference, free), gentle)) is not None:
            return SolvedSection(trajectory, section, *found)
    scaled = ScaledSection(model, request)
    reference, solution = scaled.solve(model.settings.slowing.tolerance_um * 1e-3, (reference, free))
    if not scaled.reasons:
        return SolvedSection(trajectory, section, reference, solution)
    spliced, lost = _spliced(trajectory, section, scaled.plan)
    section = replace(section, end_t=scaled.section.end_t)
    return SolvedSection(spliced, section, reference, solution, scaled.records(), lost)


def _layouts(model: InverseModel, request: PlannedSection) -> Iterator[tuple[Reference, bool]]:
    """Yield the section on knots with increasing time beyond its path, and whether its command must end gently.

    Always all of the time makes ten prints 0.67 % longer on average, not 0.44 %, and their contour error no smaller.
    Without gentle ends a peak of acceleration was 2.3 times as high. With all of the time, they are not required.
    """
    section, own = request.section, request.reference
    if request.reference.extent == WHOLE:
        flows = bool((np.diff(own.extrusion()) > FLOWS_MM).any())
        for room_s in rooms_of(section, model.settings, flows):
            reference = Reference(request.trajectory, section, model.settings, room_s=room_s)
            reference.take_offset_of(own)
            yield reference, True
    yield own, False


def _within_limits(model: InverseModel, request: PlannedSection, command: Command, gentle: bool) -> Command | None:
    """Invert a section plainly where its robust command exceeds a limit; None if that exceeds one too.

    command : on the same knots, without limits
    gentle : its ends must not need much more than its path and its middle
    """
    reference, solution = command
    offset = reference.robust_offset
    events = request.trajectory.start_t[after_events(request.program, request.section.first, request.section.last)]
    rounds = CALMED if request.reference.extent == WHOLE and offset is not None and len(offset) else 0
    for left in reversed(range(rounds + 1)):
        beyond = _beyond(model, reference, solution, gentle, events)
        if not beyond[slice(*reference.written)].any():
            return reference, solution
        if left:
            reference = copy(reference)
            reference.calm(beyond)
            solution = solve(model, reference, request.state)
    return None


def _beyond(
    model: InverseModel, reference: Reference, solution: Solution, gentle: bool, events: FloatArray
) -> BoolArray:
    """Find the segments (n,) of a command that exceed a limit, or that the firmware cannot execute in their time.

    gentle : nor may the ends exceed the path and the middle by much
    """
    # not finite means out of reach, where a lower speed does not help
    beyond = solution.demand.max(axis=(1, 2)) > 1.0
    if gentle:
        path = reference.at_knots(np.arange(reference.knots + 1))
        asked = solution.demand[:, ACCELERATION].max(axis=1)
        inner = asked[ENDS:-ENDS].max(initial=0.0)
        by_path = utilisation_from_rest(path, model.limits)[:, ACCELERATION].max()
        beyond |= asked > STEEP * max(by_path, inner)
    beyond[1] |= beyond[0]
    beyond[-2] |= beyond[-1]
    return np.asarray(beyond[1:-1] | late_segments(model, reference, solution.vertices, events))


def scale_around_cut(
    model: InverseModel, program: Program, cut: PathPosition, replanner: Replanner
) -> tuple[Moves, tuple[TimeScaling, ...]]:
    """Scale the moves around a cut in motion, once for the chunks on both sides; return them, and what became slower.

    None of 147 cuts in 20 real prints needed it on two machines; but without it a carriage that may go 45 mm/s has to
    go 47 where a cut lies in a path that is too fast for it.

    Raises LimitsError as `solve_feasible`.

    program : planned from rest to rest; moves near its ends are unchanged
    replanner : its plan has trapezoids
    """
    moves = program.moves
    plan = replanner.plan(moves, 0.0)
    reach_s = SCALED * context_s(moves, plan)
    t = cut.time_in(plan)
    inner = (plan.start_t >= t - reach_s) & (plan.start_t + plan.duration <= t + reach_s)
    if not inner.any():
        return moves, ()
    first, last = np.flatnonzero(inner)[[0, -1]].tolist()
    middle = Extent(PathPosition(first, 0.0), PathPosition(last, float(lines_of(moves).length[last])))
    state = model.machine.equilibrium(moves.start[0, :3])
    section = Section(0, len(moves), True, 0.0, plan.end_t)
    reference = Reference(plan, section, model.settings, middle)
    request = PlannedSection(program, plan, section, reference, state, replanner)
    scaled = ScaledSection(model, request, fixed=~inner)
    scaled.scale(NO_TOLERANCE_MM)
    return scaled.moves, scaled.records()


def _spliced(trajectory: Trajectory, section: Section, part: Trajectory) -> tuple[Trajectory, float]:
    """Replace a section of the plan; return the plan and by how much later what follows begins, s."""
    lost = part.end_t - section.end_t
    columns = {}
    for field in fields(trajectory):
        whole = getattr(trajectory, field.name).copy()
        whole[section.first : section.last] = getattr(part, field.name)
        columns[field.name] = whole
    # rounding must not let a move begin before the last one ends
    columns["start_t"][section.last :] = np.maximum(columns["start_t"][section.last :] + lost, part.end_t)
    return replace(trajectory, **columns), lost
