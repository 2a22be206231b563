"""Render a chunk's solved sections as G-code."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

from ffcomp.compensate.gcode_output.layout import tiles, timeline
from ffcomp.compensate.gcode_output.writer import Writer
from ffcomp.compensate.plan import Context, PlannedChunk
from ffcomp.compensate.solve import SolvedSection, keep_inside
from ffcomp.planner.sections import Section
from ffcomp.planner.segment_timing import TimedSegments
from gcode.limits import MotionLimits
from gcode.program import EventQueue
from models.machine import Machine

REFIT_MM = 1e-3  # so near the border no end of a segment is moved from the command that is inside


class GcodeRenderer:
    """Lines of the compensated file, of one chunk; see `compensate.program.Renderer`."""

    def __init__(self, chunk: PlannedChunk, context: Context) -> None:
        self._planned, self._extent, self._kinematics = chunk.planned, chunk.chunk.extent, context.machine.kinematics
        program, settings = chunk.planned.program, context.settings
        own = _own_limits(context.machine)
        inside = partial(self._kinematics.contains, margin_mm=-REFIT_MM)
        known = chunk.chunk.limits, chunk.raw_s, inside
        self._writer = Writer(program, context.flavor, own, settings, context.offset, *known)
        self._events, self._waits_s = EventQueue(program.events), chunk.waits_s
        self._writer.told(chunk.chunk.since)

    @property
    def segments(self) -> int:
        """How many segments have been written."""
        return self._writer.segments

    @property
    def late_s(self) -> float:
        """By how much the segments written take longer than their knots, s."""
        return self._writer.late_s

    def before(self, section: Section) -> Iterator[bytes]:
        """Write the lines before a section."""
        yield from self._events_before(section.first)
        if wait_s := self._waits_s.get(section.first):
            yield from self._writer.wait(wait_s)

    def extrude(self, section: Section) -> Iterator[bytes]:
        """Write a section in which only the extruder moves."""
        yield from self._writer.extrude(section.first)
        self._writer.now_s += section.end_t - section.begin_t

    def section(self, section: Section, solved: SolvedSection) -> Iterator[bytes]:
        """Write the segments of a section, tile by tile, and the lines in it."""
        planned, reference, (begin, end) = self._planned, solved.reference, solved.knots
        heights = planned.program.moves.end[section.first : section.last, 2]
        vertices = keep_inside(self._kinematics, solved.solution.vertices, heights)
        inside = self._events.up_to(section.last - 1)
        if self._extent.begin is not None and section is planned.sections[0]:
            position = [*vertices[begin].tolist(), float(reference.extrusion(begin, begin)[0])]
            self._writer.resume(self._extent.begin.move, position)
        for tile in tiles(reference.knots, begin=begin, end=end):
            part = vertices[tile.first : tile.last + 1]
            events = timeline(planned.program, solved.trajectory, solved.section, reference, part, inside, tile)
            yield from self._writer.section(section.first, part, events)

    def written(self) -> Sequence[TimedSegments]:
        """Return the last section's segments, piece by piece."""
        return self._writer.written

    def finish(self) -> Iterator[bytes]:
        """Write the lines after the last section, and restore the file's limits."""
        if self._extent.end is None:
            yield from self._events_before(len(self._planned.program.moves))
            yield from self._writer.close()

    def _events_before(self, move: int) -> Iterator[bytes]:
        for event in self._events.up_to(move):
            yield from self._writer.event(event)


def _own_limits(machine: Machine) -> MotionLimits:
    """Return what is put back where the file itself has set nothing."""
    own = machine.limits
    return MotionLimits(own.velocity_mm_per_s, own.acceleration_mm_per_s2, own.square_corner_velocity_mm_per_s, 0.5)
