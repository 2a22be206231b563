"""A print of any length in chapters, so that each can be planned and compensated alone.

They are cut where the nozzle rests. A print that does not rest for long, a vase in one spiral, is cut in motion, at a
knot: both chapters then hold the moves around the cut, and each writes its own side of it.

A chapter brings along what the ones before it leave behind: the moves of which the printer may still ring, and what the
file has said of limits. So chapters can be worked at side by side, and what comes out does not depend on how many are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffcomp.marks import CUT
from ffcomp.plan.limits import lines_of
from ffcomp.plan.lookahead import stops_and_waits
from ffcomp.plan.trajectory import PlannedMotion
from ffcomp.writer import limits_said
from gcode.cutting import join, split
from gcode.labels import layer_starts
from gcode.program import EventKind, Program

IntArray = NDArray[np.int64]
PlanOf = Callable[[Program], PlannedMotion]

REMEMBERED_S = 0.5  # of motion before a chapter: more than twice what the printer remembers
LONGEST = 50_000  # moves without a rest, before they are cut in motion
AROUND_S = 3.0  # of motion on either side of such a cut: to plan, to settle and to look ahead
CLEAR = 0.25  # knots around such a cut in which no line may have its place


class Moment(NamedTuple):
    """A time of a program's plan."""

    move: int
    since_s: float  # its beginning

    def on(self, plan: PlannedMotion) -> float:
        """On the plan's clock, s."""
        return float(plan.start_t[self.move]) + self.since_s


@dataclass(frozen=True, slots=True)
class Chapter:
    """A program from rest to rest, or what is written of it."""

    program: Program
    before: Program | None  # the moves just before it, from a rest on; None: nothing of ours has moved the nozzle
    said: dict[bytes, bytes]  # of limits, in the lines before
    layers: int  # that have begun in them
    last: bool
    begin: Moment | None = None  # what is written begins here, in motion
    knots: int | None = None  # and lasts for so many segments, to end in motion


def chapters(parts: Iterable[Program], segment_s: float, lead_s: float, plan_of: PlanOf | None) -> Iterator[Chapter]:
    """Programs that follow each other, cut anew. A part without rests goes together with the next one.

    plan_of : plans what is to be cut in motion; None: never do that
    """
    said: dict[bytes, bytes] = {}
    layers = 0
    before: Program | None = None
    pending: Program | None = None
    begin: Moment | None = None
    for program in parts:
        pending = program if pending is None else join(pending, program)
        rests = rests_of(pending)
        if rests.size:
            chapter, pending = split(pending, int(rests[-1]))
            yield Chapter(chapter, before, said, layers, last=False, begin=begin)
            said, before, begin = limits_said(chapter, said), _remembered(chapter), None
            layers += len(layer_starts(chapter))
        elif plan_of is not None and len(pending.moves) > LONGEST:
            plan = plan_of(pending)
            start_t = begin.on(plan) if begin is not None else float(plan.start_t[0]) - lead_s
            knots = _clear_cut(plan, start_t, segment_s)
            if not knots:
                continue
            yield Chapter(pending, before, said, layers, last=False, begin=begin, knots=knots)
            own, around, begin = _in_motion(pending, plan, start_t + knots * segment_s)
            said = limits_said(split(pending, own)[0], said)
            layers += len(layer_starts(split(pending, own)[0]))
            pending, before = split(pending, around)[1], None
    if pending is not None:
        yield Chapter(pending, before, said, layers, last=True, begin=begin)


def _clear_cut(plan: PlannedMotion, start_t: float, segment_s: float) -> int:
    """After how many segments the plan can be cut: far enough from its end, and from any line's place; 0: nowhere."""
    at = (plan.start_t - start_t) / segment_s
    last = int((plan.end_t - AROUND_S - start_t) / segment_s) // CUT * CUT
    for knots in range(last, 0, -CUT):
        i = int(np.searchsorted(at, knots))
        if np.abs(at[max(i - 1, 0) : i + 1] - knots).min() > CLEAR:
            return knots
    return 0


def _in_motion(program: Program, plan: PlannedMotion, t: float) -> tuple[int, int, Moment]:
    """A program cut at a time of its plan.

    Returns
    -------
    the first move whose line is still to be written; the first one that is needed for it; the cut, counted from there
    """
    line = program.moves.line
    under_way = int(plan.move_at(t))
    around = int(np.searchsorted(line, line[int(plan.move_at(t - AROUND_S))]))
    own = int(np.searchsorted(line, line[under_way], side="right"))
    return own, around, Moment(under_way - around, t - float(plan.start_t[under_way]))


def rests_of(program: Program) -> IntArray:
    """The moves before whose lines the nozzle rests, but for the first."""
    moves = program.moves
    stops, _ = stops_and_waits(program)
    travels = lines_of(moves).travels
    rests = stops | ~travels
    rests[1:] |= ~travels[:-1]
    rests[1:] &= moves.line[1:] != moves.line[:-1]
    rests[:1] = False
    return np.flatnonzero(rests)


def _remembered(chapter: Program) -> Program | None:
    """The last moves of a chapter, from a rest on, that take half a second at least."""
    moves = chapter.moves
    if any(e.move == len(moves) and e.kind in (EventKind.STOP, EventKind.RAW_MOVE) for e in reversed(chapter.events)):
        return None
    quickest = lines_of(moves).length / moves.speed
    left = np.cumsum(quickest[::-1])[::-1]  # until the end, at least
    rests = rests_of(chapter)
    enough = rests[left[rests] >= REMEMBERED_S]
    return split(chapter, int(enough[-1]))[1] if enough.size else chapter
