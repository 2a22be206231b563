"""What a printer can be told: a nozzle command over time, and where on the wanted plan each instant of it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ffcomp.planner.trajectory import PlannedMotion
from models.arrays import FloatArray

Position = Callable[[FloatArray], FloatArray]  # t : (k,) s → (k, 3) mm


@dataclass(frozen=True, slots=True)
class Clock:
    """m stretches of a played motion. Stretch i begins at played_t[i], which is plan_t[i] on the wanted plan's clock;
    the wanted path itself moves only from begin_t[i] to end_t[i] of that clock, and rests around it."""

    played_t: FloatArray  # (m,) s
    plan_t: FloatArray  # (m,) s
    begin_t: FloatArray  # (m,) s
    end_t: FloatArray  # (m,) s

    def plan_time(self, t: FloatArray) -> FloatArray:
        """The wanted plan's time at each played time, (k,) s → (k,) s."""
        i = np.maximum(np.searchsorted(self.played_t, t, side="right") - 1, 0)
        return np.clip(self.plan_t[i] + (t - self.played_t[i]), self.begin_t[i], self.end_t[i])


@dataclass(frozen=True, slots=True)
class Motion:
    """What is played: the nozzle's command at any time from begin_t to end_t, and where on the wanted plan that is."""

    position: Position
    begin_t: float  # s
    end_t: float  # s
    clock: Clock


def motion_of(trajectory: PlannedMotion, clock: Clock) -> Motion:
    """A plan, played as it stands."""
    begin, end = float(trajectory.start_t[0]), trajectory.end_t
    return Motion(lambda t: trajectory.position(np.clip(t, begin, end))[:, :3], begin, end, clock)


def own_clock(trajectory: PlannedMotion) -> Clock:
    """Of the wanted plan itself."""
    begin, end = trajectory.start_t[:1], np.array([trajectory.end_t])
    return Clock(begin, begin, begin, end)


def planned_motion(trajectory: PlannedMotion) -> Motion:
    """The wanted plan itself, on its own clock."""
    return motion_of(trajectory, own_clock(trajectory))


def path_corners(trajectory: PlannedMotion) -> tuple[FloatArray, FloatArray]:
    """When each corner of the path is due (n + 1,) s, and where it is (n + 1, 3) mm."""
    end = trajectory.position(np.array([trajectory.end_t]))
    return np.append(trajectory.start_t, trajectory.end_t), np.vstack([trajectory.origin, end])[:, :3]
