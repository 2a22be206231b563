"""The part of a section that is written, where a motion is cut between two chunks."""

from __future__ import annotations

from typing import NamedTuple, cast

import numpy as np

from ffcomp.inverse.reference import Reference, Room
from ffcomp.inverse.settings import CUT, Settings
from ffcomp.planner.trajectory import PathPosition, PlannedMotion, Section, Trajectory
from gcode.program import Moves

LEAST_CONTEXT_S = 3.0  # of motion on either side of a cut: to plan, to settle and to look ahead
SLOWEST_RAMPS = 3.0  # times the duration of the slowest ramp, at least
CRUISE_RATIO = 0.5  # where the file says nothing


class WrittenReference(NamedTuple):
    """A section's reference and the knots between which its command is written."""

    reference: Reference
    first: int
    last: int


class Extent(NamedTuple):
    """Which part of a section is written. A section that is cut in motion has no S-curves."""

    begin: PathPosition | None = None  # None: from the section's beginning
    end: PathPosition | None = None  # None: to the section's end

    def written(
        self, plan: PlannedMotion, section: Section, settings: Settings, all_room: bool = False
    ) -> WrittenReference:
        """Lay the section's knots, one of them where the written part begins, and find those of the written part.

        all_room : give the command all the time before and after its path that it may have, not what it needs
        """
        begin_t, end_t = (None if cut is None else cut.time_in(cast(Trajectory, plan)) for cut in self)
        # both sides of a cut must find the same knots, whatever becomes slower on one of them
        room = None if self == WHOLE and not all_room else Room(settings.lead_s, settings.tail_s)
        reference = Reference(plan, section, settings, None if begin_t is None else (begin_t, CUT), room)
        first = 0 if begin_t is None else round(reference.knot_of(begin_t))
        last = reference.knots if end_t is None else round(reference.knot_of(end_t))
        return WrittenReference(reference, first, last)

    def near(self, plan: Trajectory, within_s: float) -> list[slice]:
        """Find the moves that are executed within a time of the cuts."""
        cuts = [each.time_in(plan) for each in self if each is not None]
        return [slice(int(plan.move_at(t - within_s)), int(plan.move_at(t + within_s)) + 1) for t in cuts]


WHOLE = Extent()


def context_s(moves: Moves, plan: Trajectory) -> float:
    """Return how much motion a cut needs on either side, s: a third of it must be longer than any ramp."""
    moving = plan.duration > 0.0
    ratio = np.nan_to_num(moves.minimum_cruise_ratio[moving], nan=CRUISE_RATIO)
    ramps = plan.cruise_v[moving] / (plan.acceleration[moving] * (1.0 - ratio))
    return max(LEAST_CONTEXT_S, SLOWEST_RAMPS * float(ramps.max(initial=0.0)))
