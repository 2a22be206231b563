"""Cut a planned motion into sections, each from rest to rest without an extruder-only move or a stop inside.

The inverse solves one section at a time. Between sections the command rests, exactly on the path, and the file's other
lines (homing, waits, retractions, macros) are executed there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.planner.trajectory import PlannedMotion


@dataclass(frozen=True, slots=True)
class Section:
    """Consecutive moves of a plan, from rest to rest."""

    first: int  # moves first..last-1
    last: int
    travels: bool  # False: one extruder-only move
    begin_t: float  # s, on the plan's clock
    end_t: float


def split_sections(trajectory: PlannedMotion, stop_before: NDArray[np.bool_]) -> list[Section]:
    """Return the plan's sections in order; moves that go nowhere and take no time belong to the one they stand in."""
    travels = np.any(trajectory.direction[:, :3] != 0.0, axis=1)
    extrudes = ~travels & (trajectory.direction[:, 3] != 0.0)
    edge = stop_before.copy()
    edge |= extrudes
    edge[1:] |= extrudes[:-1]
    edge[:1] = True
    starts = np.flatnonzero(edge)
    ends = np.append(starts[1:], len(trajectory))
    end_t = trajectory.start_t + trajectory.duration
    return [
        Section(int(a), int(b), bool(travels[a:b].any()), float(trajectory.start_t[a]), float(end_t[b - 1]))
        for a, b in zip(starts, ends, strict=True)
        if travels[a:b].any() or extrudes[a]
    ]
