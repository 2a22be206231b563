"""How fast each junction may be passed by itself, whether or not a plan reaches that speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ffcomp.planner.limits import PlannerLimits, bounds_of, lines_of
from ffcomp.planner.lookahead import corners
from gcode.program import Moves
from models.arrays import FloatArray


def junction_limits(moves: Moves, limits: PlannerLimits, stop_before: NDArray[np.bool_]) -> FloatArray:
    """Return the firmware's limit on the speed at the start of each move, (n,) mm/s: its corner, and both moves' own.

    stop_before : (n,) the motion comes to rest before the move, waits included
    """
    lines = lines_of(moves)
    kept, corner = corners(lines, bounds_of(moves, lines, limits), limits, stop_before)
    allowed = np.zeros(len(moves))
    allowed[kept] = np.sqrt(corner)
    return allowed
