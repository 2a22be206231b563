"""Plan a chunk as the firmware will."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import ceil

from ffcomp.compensation.chunks import Chunk
from ffcomp.compensation.faster import Faster, faster_chunk
from ffcomp.compensation.statistics import Statistics, of_plan, of_raw
from ffcomp.faster.bound import Bound
from ffcomp.firmware.program import PlannedProgram, plan_program, planner_of, raw_durations
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import WHOLE


@dataclass(frozen=True, slots=True)
class Context:
    """The same for every chunk of a file."""

    model: InverseModel
    flavor: str
    offset: tuple[float, float] = (0.0, 0.0)  # mm, added to the program's positions when they were read
    share: float = 0.0  # of the print that is simulated for the prediction; above 1: all of it
    bound: Bound | None = None  # on the error: the quickest print that keeps it; None: the slicer's speed


@dataclass(frozen=True, slots=True)
class PlannedChunk:
    """A chunk with the firmware's plan for it."""

    chunk: Chunk
    planned: PlannedProgram
    simulated: bool = False  # whether the prediction may sample it
    statistics: Statistics = field(default_factory=Statistics)  # of its plan
    raw_s: Mapping[int, float] = field(default_factory=dict)  # durations of raw moves and filament changes

    @staticmethod
    def whole(planned: PlannedProgram) -> PlannedChunk:
        """Take a planned program as one chunk."""
        return PlannedChunk(Chunk(planned.program), planned, statistics=of_plan(planned, WHOLE))


def plan_chunk(chunk: Chunk, context: Context) -> PlannedChunk:
    """Plan a chunk."""
    model, machine = context.model, context.model.full_machine
    faster: Faster | None = None
    if context.bound is None:
        planned = plan_program(chunk.program, machine)
    else:
        planned, faster = faster_chunk(chunk, context.bound, model)
    lost_s, waits_s = sum(each.seconds for each in chunk.slowed), 0.0
    warnings = [*chunk.program.warnings, *(faster.warnings if faster is not None else ())]
    if chunk.extent.end is None:
        moves = len(chunk.program.moves)
        waits_s = sum(event.dwell_s for event in chunk.program.events if event.move == moves)
    around = Statistics(
        original_print_time_s=waits_s - lost_s,
        print_time_s=waits_s,
        warnings=tuple(warnings),
        slowed=tuple(each for each in chunk.slowed if each.seconds > 0.0),
        faster=faster,
    )
    begin, end = chunk.extent
    written = [
        event
        for event in chunk.program.events
        if (begin is None or event.move > begin.move) and (end is None or event.move <= end.move)
    ]
    raw = [event for event in written if event.raw is not None]
    raw_s = raw_durations(raw, planner_of(chunk.program, machine))
    changes_s = {event.line: event.lasts_s for event in written if event.lasts_s}
    by_plan = of_plan(planned, chunk.extent)
    if faster is not None and chunk.extent != WHOLE:  # the written part has another duration at the slicer's speed
        sliced = of_plan(plan_program(chunk.program, machine), chunk.extent)
        by_plan = replace(by_plan, original_print_time_s=sliced.original_print_time_s)
    changing_s = sum(changes_s.values())
    changes = Statistics(original_print_time_s=changing_s, print_time_s=changing_s)
    statistics = around + by_plan + of_raw(raw, raw_s) + changes
    # of a motion in several chunks, a share of them is sampled
    share = min(context.share, 1.0)
    simulated = share > 0.0 if chunk.extent == WHOLE else ceil(share * (chunk.cuts + 1)) > ceil(share * chunk.cuts)
    return PlannedChunk(chunk, planned, simulated, statistics, raw_s | changes_s)
