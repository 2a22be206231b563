"""Plan a program faster: every section by itself, and no layer quicker than it may be."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ffcomp.faster.bound import (
    PATH_SHARE,
    SHORTEST_LAYER_S,
    Bound,
    RaisedLimits,
    least_carriage_gain,
    raised_limits,
    slowed,
)
from ffcomp.faster.predicted_error import ensemble_of
from ffcomp.faster.search import SectionSearch, search
from ffcomp.firmware.program import planner_of
from ffcomp.inverse.model import InverseModel
from ffcomp.planner.limits import PlannerLimits, bounds_of, lines_of, planner_limits
from ffcomp.planner.lookahead import phases_from_corners, plan_moves, stops_and_waits
from ffcomp.planner.trajectory import Trajectory, split_sections
from gcode.dialect import KLIPPER
from gcode.layers import UNNAMED, labels
from gcode.program import Moves, Program
from gcode.slicing import some
from models.arrays import BoolArray, FloatArray, IntArray
from models.machine import Machine


@dataclass(frozen=True, slots=True)
class FasterProgram:
    """A program whose moves have other limits, and what became of the bound."""

    program: Program
    plan: Trajectory  # of the slicer's moves
    actuator_limit_s: float  # what the moves take at least
    limited_by: dict[str, float]  # s of the quicker plan, by what limits it
    free: BoolArray  # (n,) moves that do not keep the slicer's motion
    p99: float  # of the predicted error at the safety's quantile, times the bound


def faster_program(
    program: Program,
    model: InverseModel,
    bound: Bound,
    layers_before: int = 0,
    feature: str = UNNAMED,
    kept: BoolArray | None = None,
) -> FasterProgram:
    """Return a program, from rest to rest, as quick as the bound allows.

    layers_before : layers of the file that have begun before this program
    feature : the feature at its start
    kept : (n,), moves that keep the slicer's motion whatever they are
    """
    limits, moves = planner_limits(model.machine), program.moves
    named = labels(program, feature, layers_before)
    stop_before, wait_before = stops_and_waits(program)
    plan = planner_of(program, model.machine)(moves, stop_before=stop_before, wait_before=wait_before)
    kept = np.zeros(len(moves), dtype=np.bool_) if kept is None else kept
    if bound.keeps_first_layer:
        kept = kept | (named.layer == 0)
    ceiling = raised_limits(moves, named, kept, bound, model.machine, limits)
    quicker, still_s = ceiling.moves, plan.end_t
    ensemble, searches = ensemble_of(model, bound.safety), list[tuple[slice, SectionSearch]]()
    for section in split_sections(plan, stop_before):
        part = slice(section.first, section.last)
        if not section.travels or ceiling.kept[part].all():
            continue
        searches.append((part, SectionSearch(model, ensemble, limits, some(moves, part), ceiling.part(part))))
        still_s -= section.end_t - section.begin_t
    p99 = search([each for _, each in searches], still_s)
    for part, each in searches:
        quicker = _with(quicker, part, each.moves)
    quick = plan_moves(quicker, limits, stop_before=stop_before, wait_before=wait_before)
    shortest_s = SHORTEST_LAYER_S if bound.min_layer_time_s is None else bound.min_layer_time_s
    quicker, cooled = _cooled(quicker, ~ceiling.kept, named.layer, plan, quick, shortest_s)
    if cooled.any():
        quick = plan_moves(quicker, limits, stop_before=stop_before, wait_before=wait_before)
    shares = time_by_limit(quick, quicker, ceiling, cooled, quick.end_t)
    least_s = actuator_limit_s(ceiling, model.machine, limits, stop_before, wait_before)
    own = replace(program, moves=quicker, flavor=KLIPPER)  # its motion is ours: no other firmware plans what is raised
    return FasterProgram(own, plan, least_s, shares, ~ceiling.kept, p99)


def _with(moves: Moves, part: slice, replacement: Moves) -> Moves:
    columns = {}
    for field in fields(moves):
        columns[field.name] = getattr(moves, field.name).copy()
        columns[field.name][part] = getattr(replacement, field.name)
    return replace(moves, **columns)


def _cooled(
    moves: Moves, free: BoolArray, layer: IntArray, slicers: Trajectory, quick: Trajectory, shortest_s: float
) -> tuple[Moves, BoolArray]:
    """Slow layers down that would be shorter than they may be, and than the slicer's; say which moves."""
    was_s, now_s = (np.bincount(layer, plan.duration, layer.max(initial=0) + 1) for plan in (slicers, quick))
    free_s = np.bincount(layer, quick.duration * free, len(now_s))
    lacking_s = np.maximum(np.minimum(was_s, shortest_s) - now_s, 0.0)
    share = np.where(lacking_s > 0.0, free_s / np.maximum(free_s + lacking_s, 1e-9), 1.0)[layer]
    share = np.where(free & (share < 1.0), share, 1.0)
    return slowed(moves, share, np.where(quick.cruise_v > 0.0, quick.cruise_v, moves.speed)), share < 1.0


def actuator_limit_s(
    ceiling: RaisedLimits, machine: Machine, limits: PlannerLimits, stop_before: BoolArray, wait_before: FloatArray
) -> float:
    """Return a time that no plan of these moves can be quicker than, whatever the error, s.

    Speeds keep the flow, the machine's velocity and the carriages', accelerations what the carriages may have where
    they move least for the path; at corners the nozzle need not slow down at all, and no layer has a shortest time.
    """
    moves = ceiling.moves
    most = machine.limits.carriage_acceleration_mm_per_s2 / least_carriage_gain(moves, machine)
    moves = replace(
        moves,
        acceleration=np.where(ceiling.kept, moves.acceleration, most),
        speed=np.where(ceiling.kept | ceiling.at_flow, moves.speed, moves.speed / PATH_SHARE),
    )
    lines = lines_of(moves)
    bounds = bounds_of(moves, lines, limits)
    goes = np.flatnonzero(lines.length > 0.0)
    if not len(goes):
        return float(wait_before.sum())
    groups = np.concatenate([[0], goes[:-1] + 1])  # where the moves begin whose stops count for each that goes
    stops = np.logical_or.reduceat(stop_before | (wait_before > 0.0), groups)
    alone = stops | ~lines.travels[goes]
    alone[1:] |= ~lines.travels[goes][:-1]
    speed2 = bounds.speed[goes] ** 2
    corner = np.zeros(len(goes))
    corner[1:] = np.where(alone[1:], 0.0, np.minimum(speed2[1:], speed2[:-1]))
    ramps = bounds.acceleration
    accel_t, cruise_t, decel_t, *_ = phases_from_corners(goes, corner, lines.length, bounds.speed, ramps, ramps)
    return float((accel_t + cruise_t + decel_t + wait_before).sum())


AS_SLICED, ALONE, COOLING = "as_sliced", "filament_alone", "cooling"
FLOW, SPEED, CARRIAGES, ERROR = "flow", "speed", "carriage_acceleration", "error_bound"
BINDING = 0.98  # of a limit: it binds


def time_by_limit(
    plan: Trajectory, moves: Moves, ceiling: RaisedLimits, cooled: BoolArray, seconds: float
) -> dict[str, float]:
    """Return the time of the quicker motion that goes to each limit, s; together all of it.

    cooled : (n,) moves that are slowed down for a layer too short
    seconds : of the whole plan, waits included
    """
    alone, as_sliced = ~plan.travels, ceiling.kept
    kept, free = as_sliced & ~alone, ~as_sliced & ~alone & ~cooled
    ramps, cruise = plan.accel_t + plan.decel_t, plan.cruise_t
    at_top = plan.cruise_v >= BINDING * ceiling.moves.speed
    hard = moves.acceleration >= BINDING * ceiling.moves.acceleration

    def time(of: FloatArray, which: BoolArray) -> float:
        return float(of[which].sum())

    seconds_by_limit = {
        AS_SLICED: time(plan.duration, kept),
        COOLING: time(plan.duration, cooled & ~alone & ~as_sliced),
        FLOW: time(cruise, free & at_top & ceiling.at_flow),
        SPEED: time(cruise, free & at_top & ~ceiling.at_flow),
        CARRIAGES: time(ramps, free & hard) + time(cruise, free & hard & ~at_top),
        ERROR: time(ramps, free & ~hard) + time(cruise, free & ~hard & ~at_top),
    }
    return {**seconds_by_limit, ALONE: seconds - sum(seconds_by_limit.values())}
