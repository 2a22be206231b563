"""The nearest command within the limits of `command_limits.py`, for one that exceeds them.

Of the heights u of all motors at the knots, those nearest to the command's own:

    minimise ‖ u − u* ‖²    subject to    |D u / S + o| ≤ v,   |D² u / S² + c| ≤ a,   low ≤ u ≤ high − m

D u / S is the mean velocity of a segment. What the two ends of a segment have beyond it (o, from both c) and how far
its highest point lies above both ends (m) changes little with u: both are the present command's. Both ends of a command
are given. Where the path itself is well beyond a limit, its own demand is the limit: following it is always possible.

Such a change is short, a few µm where the excess is a tenth of a limit, and most of it lies beyond the bandwidth: the
nozzle hardly follows. The rows are taken one after the other, each moved by what it lacks or gives back what it took:
G. T. Herman & A. Lent, A family of iterative quadratic optimization algorithms for pairs of inequalities, with
application in diagnostic radiology, Math. Programming Study 9 (1978) 15-29.
"""

from __future__ import annotations

import numpy as np

from ffcomp.inverse.command_limits import TOLERANCE, CommandLimits, Demand
from models.arrays import FloatArray
from models.compiled import kernel
from models.kinematics.base import Compiled

MARGIN, TRAVEL_MARGIN_MM = 2e-3, 1e-3  # distance to the limits, for changes of o, c and m
AROUND = 48  # knots on either side of an excess that may move
LINEARISATIONS = 4
MOST_SWEEPS = 20_000  # a long stretch at a limit takes thousands
STILL_MM = 1e-7  # a sweep that moves nothing farther is the last
HEIGHT, STEP, BEND = (np.array(stencil) for stencil in ([1.0], [-1.0, 1.0], [1.0, -2.0, 1.0]))


def nearest_within_limits(
    vertices: FloatArray, path: FloatArray, limits: CommandLimits, kinematics: Compiled
) -> FloatArray:
    """Return the nearest command within the limits, (n + 1, 3) mm; where there is none, it still exceeds one.

    vertices, path : (n + 1, 3) mm, the nozzle's command and its path at the knots
    """
    now, planned = (np.concatenate([each[:1], each, each[-1:]]) for each in (vertices, path))
    own, start = limits.demand(planned), kinematics.inverse(now) @ limits.motors.T
    for _ in range(LINEARISATIONS):
        asked = limits.demand(now)
        beyond = np.flatnonzero(asked.utilisation(limits).max(axis=(1, 2)) > 1.0)
        if not len(beyond):
            break
        u = kinematics.inverse(now) @ limits.motors.T
        rows = _bounds(u, asked, own, limits)
        for part in np.split(beyond, np.flatnonzero(np.diff(beyond) > 2 * AROUND) + 1):
            first, last = max(int(part[0]) - AROUND, 0), min(int(part[-1]) + AROUND, len(u))
            inside = slice(first, last)
            u[first + 2 : last - 2] = start[first + 2 : last - 2]
            for_part = [(stencil, low[inside], high[inside]) for stencil, low, high in rows]
            _row_actions(u[inside], *(each for row in for_part for each in row))
        now = kinematics.forward(u @ np.linalg.inv(limits.motors).T)
    return now[1:-1]


def _bounds(
    u: FloatArray, asked: Demand, path: Demand, limits: CommandLimits
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Return stencils along the knots, and the lowest and highest that each may give, mm.

    u : (n + 1, 3) mm, the motors' heights;  asked : their demand;  path : the demand of the path itself
    """
    s, rows = limits.segment_s, []
    for stencil, now, planned, limit, unit in (
        (STEP, asked.velocity, path.velocity, limits.velocity_mm_per_s, s),
        (BEND, asked.acceleration(s), path.acceleration(s), limits.acceleration_mm_per_s2, s**2),
    ):
        largest = np.abs(planned).max(axis=2)
        most = np.maximum((1.0 - MARGIN) * limit, np.where(largest > TOLERANCE * limit, largest, 0.0))
        straight = np.diff(u, len(stencil) - 1, axis=0)
        low, high = straight - unit * (now.min(axis=2) + most), straight - unit * (now.max(axis=2) - most)
        rows.append((stencil, low, high))
    above = asked.height[..., 1] - np.maximum(u[:-1], u[1:])
    low_mm, high_mm = limits.travel_mm
    lowest, highest = np.full_like(u, low_mm + TRAVEL_MARGIN_MM), np.full_like(u, high_mm - TRAVEL_MARGIN_MM)
    lowest[1:-1] = np.minimum(lowest[1:-1], np.minimum(path.height[:-1, :, 0], path.height[1:, :, 0]))
    highest[1:-1] = np.maximum(highest[1:-1], np.maximum(path.height[:-1, :, 1], path.height[1:, :, 1]))
    highest[1:-1] -= np.maximum(above[:-1], above[1:])
    return [*rows, (HEIGHT, lowest, highest)]


@kernel
def _row_actions(
    u: FloatArray,
    step: FloatArray, least_step: FloatArray, most_step: FloatArray,
    bend: FloatArray, least_bend: FloatArray, most_bend: FloatArray,
    height: FloatArray, lowest: FloatArray, highest: FloatArray,
) -> None:  # fmt: skip
    """Move u (m, 3) mm to the nearest whose rows lie between their bounds; two knots at either end are given."""
    of_steps, of_bends, of_heights = np.zeros_like(u), np.zeros_like(u), np.zeros_like(u)
    for _ in range(MOST_SWEEPS):
        moved = _sweep(u, step, least_step, most_step, of_steps)
        moved = max(moved, _sweep(u, bend, least_bend, most_bend, of_bends))
        if max(moved, _sweep(u, height, lowest, highest, of_heights)) < STILL_MM:
            return


@kernel
def _sweep(u: FloatArray, stencil: FloatArray, low: FloatArray, high: FloatArray, dual: FloatArray) -> float:
    """Bring each row in turn between its bounds, or back towards where it was; return the farthest move, mm."""
    moved, end = 0.0, len(u) - 2
    for k in range(len(u) - len(stencil) + 1):
        for i in range(3):
            x, square = 0.0, 0.0
            for j in range(len(stencil)):
                x += stencil[j] * u[k + j, i]
                square += stencil[j] ** 2 if 1 < k + j < end else 0.0
            if square > 0.0:
                by = min(max(dual[k, i], (low[k, i] - x) / square), (high[k, i] - x) / square)
                dual[k, i] -= by
                moved = max(moved, abs(by))
                for j in range(len(stencil)):
                    u[k + j, i] += by * stencil[j] if 1 < k + j < end else 0.0
    return moved
