"""A place on a planned path, and what is written of a motion that is cut there."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np

from ffcomp.compensate.gcode_output.layout import CUT
from ffcomp.inverse.reference import Reference, Run
from ffcomp.inverse.settings import Settings
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from gcode.program import Moves

AROUND_S = 3.0  # of motion on either side of a cut: to plan, to settle and to look ahead
SETTLED = 3.0  # times what the slowest ramp takes, at least
CRUISE_RATIO = 0.5  # where the file says nothing


class Moment(NamedTuple):
    """A place on a program's path, whatever its plan."""

    move: int
    along_mm: float  # from the move's beginning

    def on(self, plan: Trajectory) -> float:
        """When it is passed, s on the plan's clock."""
        i, along = self.move, self.along_mm
        start, cruise, end = plan.start_v[i], plan.cruise_v[i], plan.end_v[i]
        rise, fall = 0.5 * (start + cruise) * plan.accel_t[i], 0.5 * (cruise + end) * plan.decel_t[i]
        left = rise + cruise * plan.cruise_t[i] + fall - along
        if along < rise:
            since = _ramp_s(along, start, plan.acceleration[i])
        elif left < fall:
            lasting = plan.accel_t[i] + plan.cruise_t[i] + plan.decel_t[i]
            since = lasting - _ramp_s(left, end, plan.acceleration[i])
        else:
            since = plan.accel_t[i] + (along - rise) / cruise
        return float(plan.start_t[i] + since)


def _ramp_s(length: float, v: float, acceleration: float) -> float:
    """How long a length takes from a speed on, mm, mm/s, mm/s²."""
    return float(2.0 * length / (v + np.sqrt(v**2 + 2.0 * acceleration * length))) if length > 0.0 else 0.0


class Ends(NamedTuple):
    """What is written of a run: between places where it is cut in motion. Such a run has no S-curves."""

    begin: Moment | None = None  # None: from its beginning
    end: Moment | None = None  # None: to its end

    def reference(self, plan: PlannedMotion, run: Run, settings: Settings) -> Reference:
        """The run with a knot where it begins to be written."""
        through = None if self.begin is None else (self.begin.on(cast(Trajectory, plan)), CUT)
        return Reference(plan, run, settings, through)

    def knots(self, wanted: Reference, plan: PlannedMotion) -> tuple[int, int]:
        """From which knot up to which it is written."""
        at = [None if each is None else wanted.knot_of(each.on(cast(Trajectory, plan))) for each in self]
        return 0 if at[0] is None else round(at[0]), wanted.knots if at[1] is None else round(at[1])

    def near(self, plan: Trajectory, within_s: float) -> list[slice]:
        """The moves under way so near to the cuts."""
        cuts = [each.on(plan) for each in self if each is not None]
        return [slice(int(plan.move_at(t - within_s)), int(plan.move_at(t + within_s)) + 1) for t in cuts]


WHOLE = Ends()


def around_s(moves: Moves, plan: Trajectory) -> float:
    """How much motion a cut needs on either side: so much that a third of it is longer than any ramp."""
    moving = plan.duration > 0.0
    ratio = np.nan_to_num(moves.minimum_cruise_ratio[moving], nan=CRUISE_RATIO)
    ramps = plan.cruise_v[moving] / (plan.acceleration[moving] * (1.0 - ratio))
    return max(AROUND_S, SETTLED * float(ramps.max(initial=0.0)))
