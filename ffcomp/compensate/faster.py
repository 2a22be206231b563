"""Make a chunk as quick as its bound allows, and count what that gives, by feature."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.compensate.chunks import Chunk
from ffcomp.compensate.solve import SolvedSection
from ffcomp.compensate.whole_segments import in_whole_segments
from ffcomp.errors import LimitsError
from ffcomp.faster.bound import Bound
from ffcomp.faster.program import FasterProgram, faster_program
from ffcomp.faster.shares import AS_SLICED
from ffcomp.inverse.extent import WHOLE, context_s
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings
from ffcomp.metrics import contour_error
from ffcomp.planner.program import PlannedProgram, firmware_plan, plan_program
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from gcode.layers import labels
from gcode.program import Program
from models.arrays import BoolArray

HELD = 1.02  # times the bound, that the 99th percentile may have: what becomes slower at the end may change it a little
SPOTS = 2.6  # times the bound, that single spots may have: a little more than in the search


@dataclass(frozen=True, slots=True)
class Faster:
    """What a bound has given: values of chunks that add up."""

    original_s: Mapping[str, float] = field(default_factory=dict)  # by feature, as sliced
    planned_s: Mapping[str, float] = field(default_factory=dict)  # by feature, now
    actuator_limit_s: float = 0.0  # what no plan of the moves can be quicker than
    limited_by: Mapping[str, float] = field(default_factory=dict)  # s, by what limits the motion
    warnings: tuple[str, ...] = ()

    def __add__(self, later: Faster) -> Faster:
        """Add what comes after this."""
        return Faster(
            _added(self.original_s, later.original_s),
            _added(self.planned_s, later.planned_s),
            self.actuator_limit_s + later.actuator_limit_s,
            _added(self.limited_by, later.limited_by),
        )


class BoundCheck:
    """Compares the response that was solved for, effects included, with the bound, section by section."""

    def __init__(self, bound: Bound, program: Program, feature: str) -> None:
        """Take the program that is written, and what is printed when it begins."""
        self.program, self.bound_mm = program, bound.errors_mm(labels(program, feature))
        self.beyond: list[tuple[float, int, float]] = []  # times the bound, line and µm of each section's worst

    def add(self, solved: SolvedSection, settings: Settings) -> None:
        """Look at a section."""
        section, trajectory, response = solved.section, solved.trajectory, solved.solution.response
        t = (
            solved.reference.t0
            + np.arange(1, len(response) + 1, dtype=np.float64) * settings.segment_s / settings.substeps
        )
        part = slice(section.first, section.last)
        corners = np.vstack([trajectory.origin[part, :3], solved.reference.nozzle(np.array([section.end_t]))])
        error = contour_error(np.append(trajectory.start_t[part], section.end_t), corners, t, response)
        move = np.clip(trajectory.move_at(t), section.first, section.last - 1)
        times = error / self.bound_mm[move]
        worst = int(times.argmax())
        if times[worst] > SPOTS:
            line = self.program.first_line + int(self.program.moves.line[move[worst]]) + 1
            self.beyond.append((float(times[worst]), line, 1e3 * float(error[worst])))

    def warnings(self, strict: bool = False) -> tuple[str, ...]:
        """Say where the bound is not kept; strict: refuse."""
        if not self.beyond:
            return ()
        _, line, um = max(self.beyond)
        where = "one section" if len(self.beyond) == 1 else f"{len(self.beyond)} sections"
        said = (
            f"line {line}: the predicted error is {um:.3g} µm here; it is above {SPOTS:g} times its bound in {where}."
        )
        if strict:
            raise LimitsError(said)
        return (said,)


def faster_chunk(chunk: Chunk, bound: Bound, model: InverseModel, smooth: bool) -> tuple[PlannedProgram, Faster]:
    """Plan a chunk as quick as the bound allows; around a cut in motion it keeps the slicer's motion.

    So the chunks on both sides of a cut find the same plan there, each by itself.
    """
    program, machine = chunk.program, model.given
    slicers = firmware_plan(program, machine)
    near = _near_cuts(chunk, slicers)
    found = faster_program(program, model, bound, chunk.layers, chunk.feature, near)
    said = (*_not_held(chunk, found), *_given_up(chunk, found))
    if said and model.settings.strict:
        raise LimitsError(said[0])
    quick: Program | None = found.program
    if near.any():
        quick = in_whole_segments(found.program, found.free, chunk.extent, machine, model.settings)
    if quick is None:
        own = _by_feature(program, slicers, chunk.feature)
        return plan_program(program, machine, smooth), Faster(
            own, own, slicers.end_t, {AS_SLICED: slicers.end_t}, (_not_faster(chunk),)
        )
    planned = plan_program(quick, machine, smooth)
    return (
        replace(planned, firmware_s=slicers.end_t),
        Faster(
            _by_feature(program, slicers, chunk.feature),
            _by_feature(program, planned.trajectory, chunk.feature),
            found.actuator_limit_s,
            found.limited_by,
            said,
        ),
    )


def _near_cuts(chunk: Chunk, slicers: Trajectory) -> BoolArray:
    near = np.zeros(len(chunk.program.moves), dtype=np.bool_)
    if chunk.extent != WHOLE:
        for part in chunk.extent.near(slicers, context_s(chunk.program.moves, slicers)):
            near[part] = True
    return near


def _by_feature(program: Program, plan: PlannedMotion, feature: str) -> dict[str, float]:
    named = labels(program, feature)
    seconds = np.bincount(named.feature, plan.duration, len(named.features))
    return {name: float(s) for name, s in zip(named.features, seconds, strict=True) if s > 0.0}


def _added(some: Mapping[str, float], more: Mapping[str, float]) -> dict[str, float]:
    return {name: some.get(name, 0.0) + more.get(name, 0.0) for name in (*some, *(n for n in more if n not in some))}


def _not_faster(chunk: Chunk) -> str:
    line = chunk.program.first_line + int(chunk.program.moves.line[0]) + 1
    return (
        f"line {line}: the motion from here on does not rest, and too little of it lies between cuts; "
        "it keeps the slicer's speed, and its error is not bounded."
    )


def _not_held(chunk: Chunk, found: FasterProgram) -> tuple[str, ...]:
    if found.p99 <= HELD:
        return ()
    line = chunk.program.first_line + int(chunk.program.moves.line[0]) + 1
    return (
        f"line {line}: the bound is not held from here on, however slow: for 1 % of the time the predicted error is "
        f"above {found.p99:.2g} times it. A higher bound would be, or fewer features that keep the slicer's motion.",
    )


def _given_up(chunk: Chunk, found: FasterProgram) -> tuple[str, ...]:
    if not found.given_up.any():
        return ()
    moves = np.flatnonzero(found.given_up)
    line = chunk.program.first_line + int(chunk.program.moves.line[moves[0]]) + 1
    seconds = float(found.plan.duration[moves].sum())
    return (
        f"line {line}: {len(moves)} moves from here on ({seconds:.2g} s) keep the slicer's motion: no quicker one was "
        "found that keeps the error under the bound.",
    )
