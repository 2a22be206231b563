"""How fast each junction may be passed by itself, whether or not a plan reaches that speed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ffcomp.plan.limits import FirmwareLimits, bounds_of, lines_of
from ffcomp.plan.lookahead import _corners, _pick, _spread, _stops_of_kept
from gcode.program import Moves

FloatArray = NDArray[np.float64]


def junction_limits(moves: Moves, limits: FirmwareLimits, stop_before: NDArray[np.bool_]) -> FloatArray:
    """The firmware's limit on the speed at the start of each move, (n,) mm/s: its corner, and both moves' own.

    stop_before : (n,) the motion comes to rest before the move, waits included
    """
    lines = lines_of(moves)
    kept = np.flatnonzero(lines.length > 0.0)
    picked, picked_lines = _pick(moves, kept), _pick(lines, kept)
    bounds = bounds_of(picked, picked_lines, limits)
    gain = 2.0 * picked_lines.length * bounds.acceleration
    corner = _corners(picked_lines, bounds, gain, limits.instantaneous_corner_velocity_mm_per_s)
    corner[_stops_of_kept(stop_before, kept)] = 0.0
    return _spread(np.sqrt(corner), kept, len(moves))
