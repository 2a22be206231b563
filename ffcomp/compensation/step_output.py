"""Render a chunk's commands as times of motor steps.

Nothing plans the motion again, so it keeps its computed duration: the nozzle moves from knot to knot at constant speed,
and where the plan rests, so do the motors. A line that is not a move gets the tick of its move.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ffcomp.compensation.plan import Context, PlannedChunk
from ffcomp.inverse.feasible import SolvedSection
from ffcomp.planner.segment_timing import TimedSegments
from ffcomp.planner.trajectory import Section
from ffcomp.steps.crossings import Knots, on_grid
from ffcomp.steps.motion import Sink
from gcode.program import Event, EventKind, EventQueue

SAMPLE_S = 1e-3  # of moves of the extruder alone


class StepRenderer:
    """Writes the steps of one chunk, with the methods of `gcode_writer.GcodeRenderer`; it yields no text."""

    segments, late_s = 0, 0.0  # steps keep any time,
    written: Sequence[TimedSegments] = ()  # and follow the solved command

    def __init__(self, sink: Sink, chunk: PlannedChunk, context: Context) -> None:
        self._sink, self._planned, self._extent = sink, chunk.planned, chunk.chunk.extent
        self._kinematics = context.model.full_machine.kinematics
        self._segment_s = context.model.settings.segment_s
        self._events = EventQueue(chunk.planned.program.events)

    def before(self, section: Section) -> Iterable[bytes]:
        """Give the lines before a section their tick."""
        if self._extent.begin is None or section is not self._planned.sections[0]:
            self._between(section.first)
        return ()

    def sliced(self, section: Section) -> Iterable[bytes]:
        """Write a section by its plan, and give the lines in it their ticks."""
        self._tell_height(section.first)
        lasts_s = section.end_t - section.begin_t
        n = max(round(lasts_s / SAMPLE_S), 1)
        spacing = lasts_s / n
        t = section.begin_t + spacing * np.arange(n + 1, dtype=np.float64)
        position = self._planned.trajectory.position(np.minimum(t, np.nextafter(section.end_t, -np.inf)))
        position[-1] = self._planned.program.moves.end[section.last - 1]
        for event in self._events.up_to(section.last - 1):
            due_s = float(self._planned.trajectory.start_t[event.move]) - section.begin_t
            self._tell(event, self._sink.clock_s + due_s)
        self._sink.knots(Knots(self._sink.clock_s, spacing, on_grid(position)))
        self._sink.clock_s += lasts_s
        return ()

    def section(self, section: Section, solved: SolvedSection) -> Iterable[bytes]:
        """Write a section that travels, and give the lines in it their ticks."""
        run, reference, (first, last) = solved.section, solved.reference, solved.reference.written
        moves = self._planned.program.moves
        self._tell_height(run.first)
        heights = moves.end[run.first : run.last, 2]
        vertices = self._kinematics.drawn_in(solved.solution.vertices[first : last + 1], heights)
        filament = reference.extrusion(first, last)
        if last == reference.knots:
            filament[-1] = moves.end[run.last - 1, 3]
        sink, segment_s = self._sink, self._segment_s
        for event in self._events.up_to(run.last - 1):
            knot = reference.knot_of(float(solved.trajectory.start_t[event.move]))
            at = min(max(knot, 0.0), reference.knots)
            if at >= last < reference.knots:  # the next chunk's
                break
            if at >= first:
                self._tell(event, sink.clock_s + segment_s * (at - first))
        sink.knots(Knots(sink.clock_s, segment_s, on_grid(np.column_stack([vertices, filament]))))
        sink.clock_s += segment_s * (last - first)
        return ()

    def finish(self) -> Iterable[bytes]:
        """Give the lines after the last section their tick."""
        if self._extent.end is None:
            self._between(len(self._planned.program.moves))
        return ()

    def _tell_height(self, move: int) -> None:
        program = self._planned.program
        self._sink.height(program.frames[program.moves.frame[move]].z_known)

    def _between(self, move: int) -> None:
        """Give the lines that stand between sections to the sink, and wait where they wait."""
        for event in self._events.up_to(move):
            self._tell(event, self._sink.clock_s)
            self._sink.clock_s += event.dwell_s
        self._sink.rest(self._sink.clock_s)

    def _tell(self, event: Event, t: float) -> None:
        """Give a line to the sink; what passes moves nothing, even where it looks like a move."""
        program = self._planned.program
        self._sink.event(t, program.lines[event.line], still=event.kind is EventKind.PASS)
        frame = program.frames[event.frame]
        self._sink.factors(t, frame.feed_factor, frame.flow)
