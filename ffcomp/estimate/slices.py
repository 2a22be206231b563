"""Cut a file of any length into planned slices: each move is planned with all that its speed depends on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.compensate.chunks import LONGEST, rests_of
from ffcomp.inverse.extent import LEAST_CONTEXT_S
from ffcomp.planner.trajectory import PlannedMotion
from gcode.program import Event, Program
from gcode.slicing import join, split

PlanOf = Callable[[Program], PlannedMotion]


@dataclass(frozen=True, slots=True)
class PlannedSlice:
    """A planned program, of which the moves first … last - 1 and the lines between them are counted."""

    program: Program
    plan: PlannedMotion | None  # None: nothing in it moves
    first: int
    last: int

    @property
    def lines(self) -> range:
        """The lines that are counted."""
        moves = self.program.moves
        begin = int(moves.line[self.first]) if self.first else 0
        end = int(moves.line[self.last]) if self.last < len(moves) else len(self.program.lines)
        return range(begin, end)

    @property
    def events(self) -> Iterator[Event]:
        """The events that are counted."""
        own = self.lines
        return (event for event in self.program.events if event.line in own)


def planned_slices(parts: Iterable[Program], plan_of: PlanOf) -> Iterator[PlannedSlice]:
    """Join programs that follow each other, and cut them anew where the nozzle rests.

    A print without rests, a vase in one spiral, is cut in motion: the moves of some seconds around the cut are planned
    twice, from rest on either side, which the moves at the cut no longer feel.
    """
    pending: Program | None = None
    counted = 0  # moves of `pending` that an earlier slice counts
    for part in parts:
        program = replace(part, frames=[])  # how numbers are written does not matter here, and each speed has its own
        pending = program if pending is None else join(pending, program)
        if not len(pending.moves):
            yield PlannedSlice(pending, None, 0, 0)
            pending = None
            continue
        rests = rests_of(pending)
        if rests.size:
            head, pending = split(pending, int(rests[-1]))
            yield PlannedSlice(head, plan_of(head), counted, len(head.moves))
            counted = 0
        elif len(pending.moves) > LONGEST:
            plan = plan_of(pending)
            begun = _line_begun(pending, plan, plan.end_t - LEAST_CONTEXT_S)
            around = _line_begun(pending, plan, float(plan.start_t[begun]) - LEAST_CONTEXT_S)
            if begun > counted and around > 0:
                yield PlannedSlice(pending, plan, counted, begun)
                pending, counted = split(pending, around)[1], begun - around
    if pending is not None:
        yield PlannedSlice(pending, plan_of(pending), counted, len(pending.moves))


def _line_begun(program: Program, plan: PlannedMotion, t: float) -> int:
    """Return the first move of the line that is executed at a time."""
    line = program.moves.line
    return int(np.searchsorted(line, line[int(plan.move_at(t))]))
