"""Plan a chunk as the firmware will, and find how long to wait until ringing dies away."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import ceil, isnan, log

import numpy as np

from ffcomp.compensation.chunks import Chunk
from ffcomp.compensation.faster import Faster, faster_chunk
from ffcomp.compensation.statistics import Statistics, of_plan, of_raw
from ffcomp.faster.bound import Bound
from ffcomp.firmware.program import PlannedProgram, plan_program, planner_of, raw_durations
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import WHOLE
from ffcomp.planner.trajectory import Section
from gcode.program import Event
from models.arrays import FloatArray
from models.machine import Machine


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
    waits_s: Mapping[int, float] = field(default_factory=dict)  # until ringing dies away, by a section's first move

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
    begun = planned.sections if chunk.extent.begin is None else planned.sections[1:]
    waits = settling_waits(planned, machine, raw_s, begun, chunk.since)
    by_plan = of_plan(planned, chunk.extent)
    if faster is not None and chunk.extent != WHOLE:  # the written part has another duration at the slicer's speed
        sliced = of_plan(plan_program(chunk.program, machine), chunk.extent)
        by_plan = replace(by_plan, original_print_time_s=sliced.original_print_time_s)
    changing_s, settling_s = sum(changes_s.values()), sum(waits.values())
    changes = Statistics(original_print_time_s=changing_s, print_time_s=changing_s)
    settling = Statistics(print_time_s=settling_s, settlings=len(waits), settling_s=settling_s)
    statistics = around + by_plan + of_raw(raw, raw_s) + changes + settling
    # of a motion in several chunks, a share of them is sampled
    share = min(context.share, 1.0)
    simulated = share > 0.0 if chunk.extent == WHOLE else ceil(share * (chunk.cuts + 1)) > ceil(share * chunk.cuts)
    return PlannedChunk(chunk, planned, simulated, statistics, raw_s | changes_s, waits)


# Vibration that is left at most when the first compensated extrusion begins. In the first 100 ms of a straight line
# after a travel, 5 µm make 0.5 to 0.6 µm rms (2 µm: 0.2, 1 µm: 0.1) on voron-300, ender-3 and kossel, and nothing next
# to the 4 to 25 µm of a corner there. Each wait would be 40 to 60 ms longer for 2 µm, 70 to 110 ms for 1 µm.
RESIDUAL_MM = 5e-3
EXCITED_SHARE = 0.05  # of the largest nozzle motion in a mode: less along an axis does not excite the mode
SHORTEST_S = 0.002  # not worth a line


def settling_waits(
    planned: PlannedProgram,
    machine: Machine,
    raw_s: Mapping[int, float],
    sections: Iterable[Section],
    earlier: Sequence[Event] = (),
) -> dict[int, float]:
    """Return how long to wait before sections, s, by their first move; sections without a wait are left out.

    Parameters
    ----------
    machine : its modes say how long it rings
    raw_s : durations of moves that pass through, s, by their line's index
    sections : those that are written from their beginning, in order
    earlier : the lines just before the program, after the last move
    """
    moves, events = planned.program.moves, planned.program.events
    travels = np.any(moves.end[:, :3] != moves.start[:, :3], axis=1)
    extruding = np.flatnonzero((moves.end[:, 3] > moves.start[:, 3]) & travels)
    disturbed = [event.move for event in events if event.moves_itself]
    pending = _lasting(earlier, raw_durations(earlier, planner_of(planned.program, machine)))
    waits = {}
    at = 0
    for section in sections:
        since = at
        while at < len(events) and events[at].move <= section.first:
            at += 1
        pending += _lasting(events[since:at], raw_s)
        needed = _needed_s(pending, machine, moves.start[section.first, :2])
        pending = []
        if needed <= 0.0:
            continue
        k = int(np.searchsorted(extruding, section.first))
        if k == len(extruding) or any(section.first < move <= extruding[k] for move in disturbed):
            continue  # nothing is extruded before the firmware moves by itself again
        wait = needed - (float(planned.trajectory.start_t[extruding[k]]) - section.begin_t)
        if wait > SHORTEST_S:
            waits[section.first] = ceil(1e3 * wait) / 1e3
    return waits


def ringing_s(machine: Machine, xy: FloatArray, acceleration: float, axes: Iterable[int]) -> float:
    """Return how long a ramp along some axes of the nozzle is felt, s.

    Parameters
    ----------
    xy : (2,), where the nozzle is, mm
    acceleration : of the ramp, mm/s²
    axes : along which it may have moved
    """
    modes, along, longest_s = machine.vibration.modes_at(xy), list(axes), 0.0
    motion = np.abs(modes.nozzle)
    takes_part = (motion[:, along] > EXCITED_SHARE * motion.max(initial=0.0)).any(axis=1)
    w = 2.0 * np.pi * modes.frequencies_hz[takes_part]
    for omega, damping in zip(w.tolist(), modes.damping_ratios[takes_part].tolist(), strict=True):
        too_much = 2.0 * acceleration / (omega * omega * RESIDUAL_MM)
        if too_much > 1.0 and damping > 0.0:
            longest_s = max(longest_s, log(too_much) / (damping * omega))
    return longest_s


def _lasting(events: Iterable[Event], raw_s: Mapping[int, float]) -> list[tuple[Event, float]]:
    """Return events with their known durations, s."""
    return [(event, event.dwell_s + raw_s.get(event.line, 0.0)) for event in events]


def _needed_s(events: list[tuple[Event, float]], machine: Machine, xy: FloatArray) -> float:
    """Return how long the printer still rings after the last of these events, s."""
    needed = since = 0.0
    for event, seconds in reversed(events):
        if event.moves_itself:
            axes = (0, 1, 2) if event.raw is None else event.raw.axes
            acceleration = machine.limits.acceleration_mm_per_s2
            if event.raw is not None and not isnan(event.raw.acceleration):
                acceleration = event.raw.acceleration
            if axes:
                needed = max(needed, ringing_s(machine, xy, acceleration, axes) - since)
        since += seconds
    return needed
