"""Compensate a chunk of a program: the one loop over its sections, whatever is written.

The stages of a file, each with frozen data for the next one:

    bytes -read-> Program -split-> Chunk -plan-> PlannedChunk -solve-> SolvedSection* -render-> bytes | steps

read      gcode.reader             text → moves and events
split     compensate.chunks        a print of any length → chunks of some minutes
plan      compensate.plan          a chunk → the firmware's plan: when each move accelerates, cruises, brakes
solve     compensate.solve         each section, from rest to rest → the command whose response is the section
render    compensate.gcode_writer  command and events → text, limits opened and closed around it
          compensate.step_output   command → times of steps
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from ffcomp.compensation.gcode_writer import GcodeRenderer
from ffcomp.compensation.plan import Context, PlannedChunk
from ffcomp.compensation.prediction import Prediction
from ffcomp.compensation.solve import solutions
from ffcomp.compensation.statistics import Statistics, of_section, of_unsafe
from ffcomp.compensation.step_output import StepRenderer


class Output(NamedTuple):
    """The output of a part of a chunk."""

    text: Sequence[bytes]  # pieces of whole lines; none where the renderer writes elsewhere
    statistics: Statistics  # of this part
    done: float  # bytes of the print that the chunk's output up to here is of


def compensated_sections(
    chunk: PlannedChunk, context: Context, renderer: GcodeRenderer | StepRenderer
) -> Iterator[Output]:
    """Yield a chunk's output section by section; its statistics add up to those of the chunk.

    chunk : to be compensated
    context : of its file
    renderer : writes this chunk
    """
    planned, extent, model, size = chunk.planned, chunk.chunk.extent, context.model, chunk.chunk.program.size
    prediction = Prediction(model, context.share, context.flavor) if chunk.simulated else None
    yield Output((), chunk.statistics, 0.0)
    end_t = planned.trajectory.end_t or 1.0
    for section, solved in solutions(planned, model, chunk.chunk.layers, extent):
        text, statistics = [*renderer.before(section)], Statistics()
        if solved is None or solved.fault:
            text += renderer.sliced(section)
            statistics = statistics if solved is None else of_unsafe(section, planned, solved.fault)
        else:
            text += renderer.section(section, solved)
            statistics = of_section(section, solved, planned, model)
            if prediction is not None:
                prediction.add(solved, renderer.written)
        yield Output(text, statistics, min(section.end_t / end_t, 1.0) * size)
    text = [*renderer.finish()]
    statistics = Statistics(
        segments=renderer.segments,
        print_time_s=renderer.late_s,
        predicted=None if prediction is None else prediction.samples,
    )
    yield Output(text, statistics, size)
