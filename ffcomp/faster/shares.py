"""What limits a quicker print: shares of its time."""

from __future__ import annotations

import numpy as np

from ffcomp.faster.opened import Opened
from ffcomp.planner.trajectory import Trajectory
from gcode.program import Moves
from models.arrays import BoolArray, FloatArray

AS_SLICED, ALONE, COOLING = "as_sliced", "filament_alone", "cooling"
FLOW, SPEED, CARRIAGES, ERROR = "flow", "speed", "carriage_acceleration", "error_bound"
NEAR = 0.98  # of a limit: it binds


def limited_by(
    plan: Trajectory, moves: Moves, top: Opened, own: BoolArray, cooled: BoolArray, seconds: float
) -> dict[str, float]:
    """Return the time that goes to each limit, s; together all of it.

    Parameters
    ----------
    plan, moves : the quicker motion
    top : what its moves are allowed
    own : (n,) moves that keep the slicer's motion
    cooled : (n,) moves slowed down because their layer would be too short
    seconds : of the whole plan, waits included
    """
    alone = ~np.any(plan.direction[:, :3] != 0.0, axis=1)
    kept, free = own & ~alone, ~own & ~alone & ~cooled
    ramps = plan.accel_t + plan.decel_t
    at_top = plan.cruise_v >= NEAR * top.moves.speed
    hard = moves.acceleration >= NEAR * top.moves.acceleration

    def time(of: FloatArray, which: BoolArray) -> float:
        return float(of[which].sum())

    cruise = plan.cruise_t
    found = {
        AS_SLICED: time(plan.duration, kept),
        COOLING: time(plan.duration, cooled & ~alone & ~own),
        FLOW: time(cruise, free & at_top & top.at_flow),
        SPEED: time(cruise, free & at_top & ~top.at_flow),
        CARRIAGES: time(ramps, free & hard) + time(cruise, free & hard & ~at_top),
        ERROR: time(ramps, free & ~hard) + time(cruise, free & ~hard & ~at_top),
    }
    return {**found, ALONE: seconds - sum(found.values())}
