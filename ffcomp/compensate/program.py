"""Compensate a chunk of a program: the one loop over its sections, whatever is written.

The stages of a file, each with frozen data for the next one:

    bytes -read-> Program -split-> Chunk -plan-> PlannedChunk -solve-> SolvedSection* -render-> bytes | steps

read      gcode.reader             text → moves and events
split     compensate.chunks        a print of any length → chunks of some minutes
plan      compensate.plan          a chunk → the firmware's plan: when each move accelerates, cruises, brakes
solve     compensate.solve         each section, from rest to rest → the command whose response is the section
render    compensate.gcode_output  command and events → text, limits opened and closed around it
          compensate.step_output   command → times of steps
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import replace
from typing import Protocol

from ffcomp.compensate.faster import BoundCheck
from ffcomp.compensate.plan import Context, PlannedChunk
from ffcomp.compensate.prediction import Prediction
from ffcomp.compensate.pressure import PressureCheck
from ffcomp.compensate.solve import SolvedSection, solutions
from ffcomp.compensate.statistics import Statistics, of_section
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.planner.sections import Section
from ffcomp.planner.segment_timing import TimedSegments


class Renderer(Protocol):
    """What turns a chunk's solved sections into output: pieces of text, or none where it writes elsewhere."""

    @property
    def segments(self) -> int:
        """How many segments have been written."""

    @property
    def late_s(self) -> float:
        """By how much what has been written takes longer than its knots, s."""

    def before(self, section: Section) -> Iterable[bytes]:
        """Write what stands before a section."""

    def extrude(self, section: Section) -> Iterable[bytes]:
        """Write a section in which only the extruder moves."""

    def section(self, section: Section, solved: SolvedSection) -> Iterable[bytes]:
        """Write a section that travels, and what stands in it."""

    def written(self) -> Sequence[TimedSegments]:
        """Return the last section's segments where joining made them other than the command; s since its first knot."""

    def finish(self) -> Iterable[bytes]:
        """Write what stands after the last section."""


def compensate(
    chunk: PlannedChunk,
    context: Context,
    model: InverseModel,
    renderer: Renderer,
    *,
    progress: Callable[[float], None] = lambda done_s: None,
) -> Generator[bytes, None, Statistics]:
    """Yield a chunk's output in order, pieces of whole lines, and return the statistics.

    Parameters
    ----------
    chunk : PlannedChunk
        What is compensated.
    context : Context
        The machine, and how much of the print is simulated.
    model : InverseModel
        The machine's inverse, with the settings.
    renderer : Renderer
        Writes this chunk.
    progress : callable
        Called with the print-seconds done so far.
    """
    planned, extent = chunk.planned, chunk.chunk.extent
    prediction = Prediction(model, context.share) if chunk.simulated else None
    check = None
    if context.bound is not None:
        check = BoundCheck(context.bound, planned.program, chunk.chunk.feature)
    hot_end = model.settings.pressure
    pressure = None if hot_end is None else PressureCheck(hot_end, planned.program)

    wanted = deque[bool]()  # by the prediction, of the sections that are solved and not yet written

    def keep(reference: Reference) -> bool:
        wanted.append(prediction is not None and prediction.wants(reference))
        return wanted[-1] or check is not None

    solved_sections = solutions(planned, context.machine, model, chunk.state, keep, chunk.chunk.layers, extent)
    statistics = chunk.statistics
    for section in planned.sections:
        yield from renderer.before(section)
        if not section.travels:
            yield from renderer.extrude(section)
            continue
        solved = next(solved_sections)
        yield from renderer.section(section, solved)
        statistics += of_section(section, solved, planned, extent, model)
        if check is not None:
            check.add(solved, model.settings)
        if pressure is not None:
            pressure.add(solved)
        if prediction is not None and wanted.popleft() and len(solved.solution.response):
            prediction.add(solved, renderer.written())
        progress(section.end_t)
    yield from renderer.finish()
    if check is not None:
        statistics += Statistics(warnings=check.warnings(model.settings.strict))
    if pressure is not None:
        statistics += Statistics(warnings=pressure.warnings())
    samples = prediction.samples if prediction is not None else None
    print_s = statistics.print_time_s + renderer.late_s
    return replace(statistics, print_time_s=print_s, segments=renderer.segments, predicted=samples)
