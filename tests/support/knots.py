"""A plan as the knots of a path, so close together that nothing is lost: steps and hosts are compared on it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import ceil

import numpy as np

from ffcomp.planner.trajectory import Trajectory
from ffcomp.steps.crossings import Knots

SPACING_S = 10e-6  # a chord is off by 0.04 nm at 3 m/s²


def trajectory_knots(trajectory: Trajectory, shift_t: float = 0.0, spacing_s: float = SPACING_S) -> Iterator[Knots]:
    """Yield each phase of each move, speeding up, cruising and braking; the plan's clock begins at `shift_t` s."""
    phases = np.column_stack([trajectory.accel_t, trajectory.cruise_t, trajectory.decel_t])
    edges = trajectory.start_t[:, None] + np.cumsum(np.insert(phases, 0, 0.0, axis=1), axis=1)
    for move in edges.tolist():
        for begin, end in pairwise(move):
            if begin < end:
                count = ceil((end - begin) / spacing_s)
                t = np.minimum(np.linspace(begin, end, count + 1), np.nextafter(move[-1], -np.inf))
                yield Knots(begin + shift_t, (end - begin) / count, trajectory.position(t))
