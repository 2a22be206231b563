"""Make the written part of a motion that is cut under way a whole number of segments, once it has become quicker."""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import numpy as np

from ffcomp.inverse.extent import Extent
from ffcomp.inverse.settings import Settings
from ffcomp.planner.program import firmware_plan
from ffcomp.planner.trajectory import Trajectory
from gcode.program import Moves, Program
from models.arrays import BoolArray, FloatArray
from models.machine import Machine

SLOWEST = 0.98  # share of their speed that moves keep
KNOT = 1e-6  # of a segment: nearer is at a knot


def in_whole_segments(
    program: Program, free: BoolArray, extent: Extent, machine: Machine, settings: Settings
) -> Program | None:
    """Slow the free moves (n,) down by as little as that takes; None: they are too short for it."""
    from scipy.optimize import brentq

    if extent.end is None:
        return program
    plan = firmware_plan(program, machine)
    written_s = _written_s(plan, extent, settings)
    missing_s = settings.segment_s * ceil(written_s / settings.segment_s - KNOT)

    def slower(factor: float) -> Program:
        return replace(program, moves=_slower(program.moves, plan, np.where(free, factor, 1.0)))

    def too_long_s(factor: float) -> float:
        return _written_s(firmware_plan(slower(factor), machine), extent, settings) - missing_s

    if too_long_s(SLOWEST) < 0.0:
        return None
    return slower(1.0 if too_long_s(1.0) >= 0.0 else float(brentq(too_long_s, SLOWEST, 1.0, xtol=1e-15, rtol=1e-14)))


def _written_s(plan: Trajectory, extent: Extent, settings: Settings) -> float:
    """Return the duration of what is written, s, up to the cut at its end."""
    begin, end = extent
    assert end is not None
    return end.time_in(plan) - (float(plan.start_t[0]) - settings.lead_s if begin is None else begin.time_in(plan))


def _slower(moves: Moves, plan: Trajectory, share: FloatArray) -> Moves:
    return replace(
        moves,
        speed=np.where(share < 1.0, np.minimum(moves.speed, plan.cruise_v) * share, moves.speed),
        acceleration=np.where(share < 1.0, moves.acceleration * share**2, moves.acceleration),
        square_corner_velocity=np.where(
            share < 1.0, moves.square_corner_velocity * share, moves.square_corner_velocity
        ),
    )
