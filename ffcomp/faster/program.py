"""Plan a program faster: every section by itself, and no layer quicker than it may be."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ffcomp.faster.bound import SHORTEST_LAYER_S, Bound
from ffcomp.faster.lower_limit import lower_limit_s
from ffcomp.faster.opened import opened, part_of, some
from ffcomp.faster.response import printers_of
from ffcomp.faster.search import SectionSearch, search
from ffcomp.faster.shares import limited_by
from ffcomp.inverse.model import InverseModel
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.machine_limits import planner_limits
from ffcomp.planner.sections import split_sections
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from gcode.layers import UNNAMED, LayerLookup, labels
from gcode.program import Moves, Program
from models.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class FasterProgram:
    """A program whose moves have other limits, and what became of the bound."""

    program: Program
    plan: Trajectory  # of the slicer's moves
    given_up: BoolArray  # (n,) moves that keep the slicer's motion because nothing quicker keeps the bound
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
    """Return a program as quick as the bound allows.

    Parameters
    ----------
    program : Program
        From rest to rest.
    model : InverseModel
        The machine's inverse.
    bound : Bound
        What was asked for.
    layers_before : int
        Layers of the file that have begun before this program.
    feature : str
        What is printed when it begins.
    kept : (n,) array, optional
        Moves that keep the slicer's motion whatever they are.
    """
    limits, moves = planner_limits(model.machine), program.moves
    named, layer = labels(program, feature), _layers(program, layers_before)
    stop_before, wait_before = stops_and_waits(program)
    plan = plan_moves(moves, limits, stop_before=stop_before, wait_before=wait_before)
    kept = np.zeros(len(moves), dtype=np.bool_) if kept is None else kept
    if bound.keeps_first_layer:
        kept = kept | (layer == 0)
    top = opened(moves, named, kept, bound, model.machine, limits)
    found, given_up, still_s = top.moves, np.zeros(len(moves), dtype=np.bool_), plan.end_t
    printers, searched = printers_of(model, bound.safety), list[tuple[slice, SectionSearch]]()
    for section in split_sections(plan, stop_before):
        part = slice(section.first, section.last)
        if not section.travels or top.kept[part].all():
            continue
        searched.append((part, SectionSearch(model, printers, limits, some(moves, part), part_of(top, part))))
        still_s -= section.end_t - section.begin_t
    p99 = search([each for _, each in searched], still_s)
    for part, each in searched:
        found = _with(found, part, each.moves)
        given_up[part] = each.given_up
    quick = plan_moves(found, limits, stop_before=stop_before, wait_before=wait_before)
    shortest_s = SHORTEST_LAYER_S if bound.min_layer_time_s is None else bound.min_layer_time_s
    own = top.kept | given_up
    found, cooled = _cooled(found, ~own, layer, plan, quick, shortest_s)
    if cooled.any():
        quick = plan_moves(found, limits, stop_before=stop_before, wait_before=wait_before)
    shares = limited_by(quick, found, top, own, cooled, quick.end_t)
    least_s = lower_limit_s(top, model.machine, limits, stop_before, wait_before)
    return FasterProgram(replace(program, moves=found), plan, given_up, least_s, shares, ~own, p99)


def _layers(program: Program, before: int) -> IntArray:
    lookup = LayerLookup(program, before)
    return np.array([lookup.of(move) for move in range(len(program.moves))], dtype=np.int64)


def _with(moves: Moves, part: slice, own: Moves) -> Moves:
    columns = {}
    for field in fields(moves):
        columns[field.name] = getattr(moves, field.name).copy()
        columns[field.name][part] = getattr(own, field.name)
    return replace(moves, **columns)


def _cooled(
    moves: Moves, free: BoolArray, layer: IntArray, slicers: PlannedMotion, quick: PlannedMotion, shortest_s: float
) -> tuple[Moves, BoolArray]:
    """Slow layers down that would be shorter than they may be, and than the slicer's; say which moves."""
    was_s, now_s = (np.bincount(layer, plan.duration, layer.max(initial=0) + 1) for plan in (slicers, quick))
    free_s = np.bincount(layer, quick.duration * free, len(now_s))
    lacking_s = np.maximum(np.minimum(was_s, shortest_s) - now_s, 0.0)
    share = np.where(lacking_s > 0.0, free_s / np.maximum(free_s + lacking_s, 1e-9), 1.0)[layer]
    share = np.where(free & (share < 1.0), share, 1.0)
    slower = replace(
        moves,
        speed=np.where(share < 1.0, _top(quick, moves.speed) * share, moves.speed),
        acceleration=np.where(share < 1.0, moves.acceleration * share**2, moves.acceleration),
        square_corner_velocity=np.where(
            share < 1.0, moves.square_corner_velocity * share, moves.square_corner_velocity
        ),
    )
    return slower, share < 1.0


def _top(plan: PlannedMotion, otherwise: FloatArray) -> FloatArray:
    """Return the speed at which each move cruises, (n,) mm/s."""
    reached = plan.cruise_v if isinstance(plan, Trajectory) else otherwise
    return np.where(reached > 0.0, reached, otherwise)
