"""A place on a planned path, and what is written of a motion that is cut there."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np

from ffcomp.inverse.reference import Reference
from ffcomp.inverse.settings import CUT, Settings
from ffcomp.planner.path_position import PathPosition
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from gcode.program import Moves

AROUND_S = 3.0  # of motion on either side of a cut: to plan, to settle and to look ahead
SETTLED = 3.0  # times what the slowest ramp takes, at least
CRUISE_RATIO = 0.5  # where the file says nothing


class Extent(NamedTuple):
    """What is written of a run: between places where it is cut in motion. Such a run has no S-curves."""

    begin: PathPosition | None = None  # None: from its beginning
    end: PathPosition | None = None  # None: to its end

    def reference(self, plan: PlannedMotion, run: Section, settings: Settings) -> Reference:
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


WHOLE = Extent()


def around_s(moves: Moves, plan: Trajectory) -> float:
    """How much motion a cut needs on either side: so much that a third of it is longer than any ramp."""
    moving = plan.duration > 0.0
    ratio = np.nan_to_num(moves.minimum_cruise_ratio[moving], nan=CRUISE_RATIO)
    ramps = plan.cruise_v[moving] / (plan.acceleration[moving] * (1.0 - ratio))
    return max(AROUND_S, SETTLED * float(ramps.max(initial=0.0)))
