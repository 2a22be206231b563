"""Make a chunk as quick as its bound allows, and count the time saved, by feature."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.compensation.chunks import Chunk
from ffcomp.errors import LimitsError
from ffcomp.faster.bound import Bound, slowed
from ffcomp.faster.program import AS_SLICED, FasterProgram, faster_program
from ffcomp.firmware.program import PlannedProgram, firmware_plan, plan_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import WHOLE, Extent, context_s
from ffcomp.inverse.settings import Settings
from ffcomp.inverse.time_scaling import whole_segments
from ffcomp.planner.trajectory import Trajectory
from gcode.layers import labels
from gcode.program import Program
from models.arrays import BoolArray
from models.machine import Machine

P99_LEVEL = 1.02  # times the bound, that the 99th percentile may have: the last slowed moves may change it a little


@dataclass(frozen=True, slots=True)
class Faster:
    """Times under a bound; the values of chunks add up."""

    original_s: Mapping[str, float] = field(default_factory=dict)  # by feature, as sliced
    planned_s: Mapping[str, float] = field(default_factory=dict)  # by feature, now
    # lower bound for any plan of the same moves: no slower corners, only the limits of carriages and flow
    actuator_limit_s: float = 0.0
    # number [s]: the time by what limits it: `flow`, `error_bound`, `carriage_acceleration`, `speed`,
    # `cooling`, `as_sliced` (kept), `filament_alone`
    limited_by: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    bound_um: float = 0.0  # the largest error that a feature may have

    @property
    def by_feature(self) -> Mapping[str, Mapping[str, float]]:
        """Seconds of each kind of line: as sliced, and now."""
        longest_first = sorted(self.original_s.items(), key=lambda each: -each[1])
        return {name: {"original_s": s, "print_time_s": self.planned_s.get(name, 0.0)} for name, s in longest_first}

    def __add__(self, later: Faster) -> Faster:
        return Faster(
            _added(self.original_s, later.original_s),
            _added(self.planned_s, later.planned_s),
            self.actuator_limit_s + later.actuator_limit_s,
            _added(self.limited_by, later.limited_by),
            bound_um=max(self.bound_um, later.bound_um),
        )


def faster_chunk(chunk: Chunk, bound: Bound, model: InverseModel) -> tuple[PlannedProgram, Faster]:
    """Plan a chunk as quick as the bound allows; around a cut in motion it keeps the slicer's motion.

    So the chunks on both sides of a cut find the same plan there, each by itself.
    """
    program, machine = chunk.program, model.full_machine
    slicers = firmware_plan(program, machine)
    near = np.zeros(len(program.moves), dtype=np.bool_)
    if chunk.extent != WHOLE:
        for part in chunk.extent.near(slicers, context_s(program.moves, slicers)):
            near[part] = True
    quicker = faster_program(program, model, bound, chunk.layers, chunk.feature, near)
    warnings = _bound_exceeded(chunk, quicker, bound)
    if warnings and model.settings.slowing.strict:
        raise LimitsError(warnings[0])
    quick: Program | None = quicker.program
    if near.any() and chunk.extent.end is not None:
        quick = in_whole_segments(quicker.program, quicker.free, chunk.extent, machine, model.settings)
    seconds = _by_feature(program, slicers, chunk.feature)
    if quick is None:
        kept = (
            f"line {program.line_of(0)}: the motion from here on does not rest, and too little of it lies between "
            "cuts; it keeps the slicer's speed, and its error is not bounded."
        )
        as_sliced = Faster(seconds, seconds, slicers.end_t, {AS_SLICED: slicers.end_t}, (kept,), max(bound.all_um))
        return plan_program(program, machine), as_sliced
    planned = plan_program(quick, machine)
    now = _by_feature(program, planned.trajectory, chunk.feature)
    times = seconds, now, quicker.actuator_limit_s, quicker.limited_by
    return replace(planned, firmware_s=slicers.end_t), Faster(*times, warnings, max(bound.all_um))


def _by_feature(program: Program, plan: Trajectory, feature: str) -> dict[str, float]:
    named = labels(program, feature)
    seconds = np.bincount(named.feature, plan.duration, len(named.features))
    return {name: float(s) for name, s in zip(named.features, seconds, strict=True) if s > 0.0}


def _added(some: Mapping[str, float], more: Mapping[str, float]) -> dict[str, float]:
    return {name: some.get(name, 0.0) + more.get(name, 0.0) for name in (*some, *(n for n in more if n not in some))}


def _bound_exceeded(chunk: Chunk, quicker: FasterProgram, bound: Bound) -> tuple[str, ...]:
    if quicker.p99 <= P99_LEVEL:
        return ()
    line = chunk.program.line_of(0)
    held = f"{quicker.p99:.2g} times the bound"
    if not bound.of_features_um:
        held = f"{quicker.p99 * bound.max_error_um:.2g} µm, not {bound.max_error_um:g}"
    return (
        f"line {line}: the bound is not held from here on, however slow: for 99 % of the time the predicted error is "
        f"below {held}. A higher bound would be, or fewer features that keep the slicer's motion.",
    )


LEAST_SPEED_SHARE = 0.98  # that moves keep


def in_whole_segments(
    program: Program, free: BoolArray, extent: Extent, machine: Machine, settings: Settings
) -> Program | None:
    """Slow the free moves (n,) down by as little as that takes; None: they are too short for it."""
    plan = firmware_plan(program, machine)

    def slower(factor: float) -> Program:
        speed = np.minimum(program.moves.speed, plan.cruise_v)
        return replace(program, moves=slowed(program.moves, np.where(free, factor, 1.0), speed))

    def written_s(factor: float) -> float:
        changed = firmware_plan(slower(factor), machine)
        return extent.written_s(changed, float(changed.start_t[0]) - settings.lead_s)

    factor = whole_segments(written_s, settings.segment_s, LEAST_SPEED_SHARE)
    return None if factor is None else slower(factor)
