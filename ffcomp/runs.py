"""Cut the planned motion into runs: the nozzle moves from rest to rest, without an extruder-only move or a stop inside.

A run is what is inverted in one go. Between runs the command rests, exactly on the path, and whatever is not ours
(homing, waits, retractions, macros) happens there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.invert.fbs import Reference, Settings
from ffcomp.plan.trajectory import Trajectory

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Run:
    first: int  # moves first..last-1
    last: int
    travels: bool  # False: one extruder-only move
    begin_t: float  # s, on the plan's clock
    end_t: float


def split_runs(trajectory: Trajectory, stop_before: NDArray[np.bool_]) -> list[Run]:
    """The plan's runs in order; moves that go nowhere and take no time belong to the run they stand in."""
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
        Run(int(a), int(b), bool(travels[a:b].any()), float(trajectory.start_t[a]), float(end_t[b - 1]))
        for a, b in zip(starts, ends, strict=True)
        if travels[a:b].any() or extrudes[a]
    ]


@dataclass(frozen=True, slots=True)
class Timing:
    """Where a run's knots lie on the plan's clock."""

    t0: float  # s, plan time of knot 0 (before the run begins: the command may start earlier than the path)
    knots: int  # segments of the run


def timing(run: Run, settings: Settings) -> Timing:
    """The knots of a run: some before it begins, for the plant answers late, and some after its end."""
    length = settings.lead_s + (run.end_t - run.begin_t) + settings.tail_s
    return Timing(run.begin_t - settings.lead_s, int(np.ceil(length / settings.segment_s - 1e-9)))


def reference(trajectory: Trajectory, run: Run, when: Timing, settings: Settings) -> Reference:
    """The wanted motion of a run at the substeps of its segments, and the rest after it."""
    segments = when.knots + settings.preview
    t = when.t0 + np.arange(segments * settings.substeps + 1) * (settings.segment_s / settings.substeps)
    position = trajectory.position(np.clip(t, run.begin_t, run.end_t))
    velocity = trajectory.velocity(t)[:, :3] * ((t >= run.begin_t) & (t < run.end_t))[:, None]
    return Reference(
        np.ascontiguousarray(position[:, :3]),
        np.ascontiguousarray(velocity),
        np.diff(position[:: settings.substeps, 3]),
        settings.preview,
    )
