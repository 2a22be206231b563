"""A section's command within all limits of machine and firmware: less of what is robust, or else more time."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass, fields, replace

import numpy as np

from ffcomp.errors import LimitsError
from ffcomp.inverse.command_limits import ACCELERATION, utilisation_from_rest
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import (
    WHOLE,
    Extent,
    WrittenReference,
    context_s,
    room_in,
    tighter_rooms,
)
from ffcomp.inverse.solve import Solution, solve
from ffcomp.inverse.time_scaling import (
    Free,
    LayerOf,
    Replan,
    ScaledSection,
    TimeScaling,
    late_segments,
    peak_utilisation,
)
from ffcomp.planner.limits import PlannerLimits, lines_of
from ffcomp.planner.trajectory import PathPosition, Section, Trajectory
from gcode.program import Moves, Program
from gcode.slicing import some
from models.arrays import BoolArray, FloatArray

ENDS = 6  # knots of a command at either end, where its motion begins and ends
STEEP = 1.4  # times the accelerations of its path and its middle: limit for the ends
CALMED = 3  # rounds in which more and more is inverted plainly
SCALED = 0.75  # share of the context of a cut that may become slower before the cut
NO_TOLERANCE_MM = 0.0  # around a cut: where no limit is active, both sides find the same command


@dataclass(frozen=True, slots=True)
class SectionRequest:
    """A section to be solved within the machine's limits."""

    program: Program  # whose moves the trajectory plans
    trajectory: Trajectory
    section: Section
    written: WrittenReference  # the section's reference by this plan
    state: FloatArray  # (18,) of the plant at the section's first knot
    limits: PlannerLimits  # as the trajectory was planned
    replan: Replan  # as the trajectory was planned
    extent: Extent = WHOLE
    keep_response: bool = False
    layer_of: LayerOf = lambda move: None


@dataclass(frozen=True, slots=True)
class FeasibleSection:
    """A section within the limits, and its command."""

    trajectory: Trajectory  # the whole plan; `lost_s` later after the section
    section: Section
    written: WrittenReference
    solution: Solution
    records: tuple[TimeScaling, ...] = ()
    lost_s: float = 0.0


def solve_feasible(model: InverseModel, request: SectionRequest) -> FeasibleSection:
    """Solve a section; where its limits cannot be kept within the tolerance, on a plan that is slower there.

    The model's settings say how far the nozzle may leave the path where a limit is active, and whether to refuse
    (`strict`) instead of slowing down.

    Raises
    ------
    LimitsError
        Where the path itself lies beyond a carriage's travel, where no slower plan is found, or when `strict`.
    """
    trajectory, section, settings = request.trajectory, request.section, model.settings
    if (tight := _with_less_room(model, request)) is not None:
        return tight
    written, keep = request.written, request.keep_response
    solution = solve(model, written.reference, request.state, keep_response=keep, enforce_limits=False)
    late = late_segments(model, written, solution.vertices)
    if not _exceeds(model, written, solution, late):
        return FeasibleSection(trajectory, section, written, solution)
    if (calm := _calmer(model, request, solution)) is not None:
        return calm
    if (roomy := _with_more_room(model, request)) is not None:
        return roomy
    moves = some(request.program.moves, slice(section.first, section.last))
    scaled = ScaledSection(
        model,
        moves,
        request.limits,
        request.replan,
        section.begin_t,
        request.extent,
        request.state,
        request.program.first_line,
        keep_response=keep,
    )
    written, solution = scaled.solve(settings.tolerance_um * 1e-3, Free(written, solution))
    if not scaled.reasons:
        return FeasibleSection(trajectory, section, written, solution)
    spliced, lost = _spliced(trajectory, section, scaled.plan)
    records = tuple(
        scaled.records(
            trajectory.duration[section.first : section.last], lambda move: request.layer_of(section.first + move)
        )
    )
    if settings.strict:
        _refuse(records)
    section = replace(section, end_t=scaled.section.end_t)
    return FeasibleSection(spliced, section, written, solution, records, lost)


def _with_less_room(model: InverseModel, request: SectionRequest) -> FeasibleSection | None:
    """Solve a section with less time before and after its path than needed; None if its ends exceed the limit.

    They may slightly exceed its path and its middle, but not the nozzle's own acceleration.
    """
    s, section, plan = model.settings, request.section, request.trajectory
    if request.extent != WHOLE:
        return None
    for room in tighter_rooms(section, request.written.reference.knots, s):
        written = request.extent.written(plan, section, s, room)
        written.reference.take_offset_of(request.written.reference)
        solution = solve(
            model, written.reference, request.state, keep_response=request.keep_response, enforce_limits=False
        )
        path = written.reference.at_knots(np.arange(written.reference.knots + 1))
        nozzle = np.sqrt((np.diff(path, 2, axis=0) ** 2).sum(axis=1)).max(initial=0.0) / s.segment_s**2
        asked, by_path = _accelerations(model, solution.vertices), _accelerations(model, path).max()
        inner = asked[ENDS:-ENDS].max(initial=0.0)
        most = max(inner, min(STEEP * max(by_path, inner), nozzle / model.limits.acceleration_mm_per_s2))
        if asked.max() <= most and not _exceeds(
            model, written, solution, late_segments(model, written, solution.vertices)
        ):
            return FeasibleSection(plan, section, written, solution)
    return None


def _calmer(model: InverseModel, request: SectionRequest, robust: Solution) -> FeasibleSection | None:
    """Invert a section plainly where its robust command exceeds a limit; None where that does not help."""
    written, solution = request.written, robust
    if request.extent != WHOLE or written.reference.robust_offset is None or not len(written.reference.robust_offset):
        return None
    written = written._replace(reference=copy(written.reference))
    for _ in range(CALMED):
        beyond = utilisation_from_rest(solution.vertices, model.limits)[1:-1].max(axis=(1, 2)) > 1.0
        written.reference.calm(beyond | late_segments(model, written, solution.vertices))
        solution = solve(
            model, written.reference, request.state, keep_response=request.keep_response, enforce_limits=False
        )
        if not _exceeds(model, written, solution, late_segments(model, written, solution.vertices)):
            return FeasibleSection(request.trajectory, request.section, written, solution)
    return None


def _accelerations(model: InverseModel, vertices: FloatArray) -> FloatArray:
    """Return the largest fraction of a carriage's acceleration limit at every knot of a command."""
    return np.asarray(utilisation_from_rest(vertices, model.limits)[:, ACCELERATION].max(axis=1))


def _with_more_room(model: InverseModel, request: SectionRequest) -> FeasibleSection | None:
    """Solve a section with more time before and after its path, at most all that a command may have.

    A few ms there are less than what slower moves would take. None where even all of it is too little.
    """
    s, section = model.settings, request.section
    if request.extent != WHOLE:
        return None
    most = math.ceil((section.end_t - section.begin_t + s.lead_s + s.tail_s) / s.segment_s)
    for segments in range(request.written.reference.knots + 1, most + 1):
        room = room_in(section, segments, s, s.lead_s / (s.lead_s + s.tail_s))
        written = request.extent.written(request.trajectory, section, s, room)
        written.reference.take_offset_of(request.written.reference)
        solution = solve(
            model, written.reference, request.state, keep_response=request.keep_response, enforce_limits=False
        )
        if not _exceeds(model, written, solution, late_segments(model, written, solution.vertices)):
            return FeasibleSection(request.trajectory, section, written, solution)
    return None


def scale_around_cut(
    model: InverseModel,
    program: Program,
    limits: PlannerLimits,
    cut: PathPosition,
    replan: Replan,
    layer_of: LayerOf = lambda move: None,
) -> tuple[Moves, tuple[TimeScaling, ...]]:
    """Scale the moves around a position where a motion is to be cut, once for the chunks on both sides.

    Parameters
    ----------
    program : planned from rest to rest; moves near its ends are unchanged
    limits, replan, layer_of : as in `SectionRequest`; the plan has trapezoids

    Returns
    -------
    the moves, slower where they have to be; the records of what became slower

    Raises
    ------
    LimitsError
        As `solve_feasible`.
    """
    moves = program.moves
    plan = replan(moves, 0.0)
    reach_s = SCALED * context_s(moves, plan)
    t = cut.time_in(plan)
    inner = (plan.start_t >= t - reach_s) & (plan.start_t + plan.duration <= t + reach_s)
    if not inner.any():
        return moves, ()
    first, last = np.flatnonzero(inner)[[0, -1]].tolist()
    middle = Extent(PathPosition(first, 0.0), PathPosition(last, float(lines_of(moves).length[last])))
    state = model.machine.equilibrium(moves.start[0, :3])
    scaled = ScaledSection(model, moves, limits, replan, 0.0, middle, state, program.first_line, fixed=~inner)
    scaled.scale(NO_TOLERANCE_MM)
    records = tuple(scaled.records(plan.duration, layer_of)) if scaled.reasons else ()
    if records and model.settings.strict:
        _refuse(records)
    return scaled.moves, records


def _refuse(records: tuple[TimeScaling, ...]) -> None:
    raise LimitsError(" ".join(record.sentence("would have to be slowed") for record in records))


def _exceeds(model: InverseModel, written: WrittenReference, solution: Solution, late: BoolArray) -> bool:
    # not finite means out of reach, where a lower speed does not help
    return peak_utilisation(model, written, solution) > 1.0 or bool(late[written.first : written.last].any())


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
