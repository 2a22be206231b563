"""What a print takes at least: corners cost nothing, only speeds and accelerations along the path count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffcomp.faster.opened import SHARE, Opened, least_gain
from ffcomp.planner.limits import PlannerLimits, bounds_of, lines_of
from ffcomp.planner.ramps import sweep, total_time
from models.arrays import BoolArray, FloatArray
from models.machine import Machine


def lower_limit_s(
    top: Opened, machine: Machine, limits: PlannerLimits, stop_before: BoolArray, wait_before: FloatArray
) -> float:
    """Return a time that no plan of these moves can be quicker than, whatever the error, s.

    Speeds keep the flow, the machine's velocity and the carriages', accelerations what the carriages may have where
    they move least for the path; at corners the nozzle need not slow down at all, and no layer has a shortest time.
    """
    moves = top.moves
    most = machine.limits.carriage_acceleration_mm_per_s2 / least_gain(moves, machine)
    moves = replace(
        moves,
        acceleration=np.where(top.kept, moves.acceleration, most),
        speed=np.where(top.kept | top.at_flow, moves.speed, moves.speed / SHARE),
    )
    lines = lines_of(moves)
    bounds = bounds_of(moves, lines, limits)
    goes = np.flatnonzero(lines.length > 0.0)
    if not len(goes):
        return float(wait_before.sum())
    stops = np.logical_or.reduceat(stop_before | (wait_before > 0.0), _groups(goes))
    alone = stops | ~lines.travels[goes]
    alone[1:] |= ~lines.travels[goes][:-1]
    speed2 = bounds.speed[goes] ** 2
    corner = np.zeros(len(goes) + 1)
    corner[1:-1] = np.where(alone[1:], 0.0, np.minimum(speed2[1:], speed2[:-1]))
    ramps = bounds.acceleration[goes]
    start, peak = sweep(lines.length[goes], corner, speed2, ramps, ramps)
    return float(total_time(lines.length[goes], start, peak, ramps, ramps) + wait_before.sum())


def _groups(goes: np.typing.NDArray[np.int64]) -> np.typing.NDArray[np.int64]:
    """Return where the moves begin whose stops count for each move that goes somewhere."""
    return np.concatenate([[0], goes[:-1] + 1])
