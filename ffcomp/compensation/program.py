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

import numpy as np

from ffcomp.compensation.gcode_writer import GcodeRenderer
from ffcomp.compensation.plan import Context, PlannedChunk
from ffcomp.compensation.prediction import Prediction
from ffcomp.compensation.solve import solutions
from ffcomp.compensation.statistics import Statistics, of_section, of_unsafe
from ffcomp.compensation.step_output import StepRenderer
from ffcomp.errors import LimitsError
from ffcomp.faster.bound import Bound
from ffcomp.inverse.feasible import SolvedSection
from ffcomp.inverse.settings import Settings
from ffcomp.metrics import contour_error
from gcode.layers import labels
from gcode.program import Program


class Output(NamedTuple):
    """The output of a part of a chunk."""

    text: Sequence[bytes]  # pieces of whole lines; none where the renderer writes elsewhere
    statistics: Statistics  # of this part
    done: float  # bytes of the print that the chunk's output up to here is of


def compensated_sections(
    chunk: PlannedChunk, context: Context, renderer: GcodeRenderer | StepRenderer
) -> Iterator[Output]:
    """Yield a chunk's output section by section; its statistics add up to those of the chunk.

    Parameters
    ----------
    chunk : to be compensated
    context : of its file
    renderer : writes this chunk
    """
    planned, extent, model, size = chunk.planned, chunk.chunk.extent, context.model, chunk.chunk.program.size
    prediction = Prediction(model, context.share, context.flavor) if chunk.simulated else None
    check: BoundCheck | None = None
    if context.bound is not None:
        check = BoundCheck(context.bound, planned.program, chunk.chunk.feature, model.settings)
    yield Output((), chunk.statistics, 0.0)
    end_t = planned.trajectory.end_t or 1.0
    for section, solved in solutions(
        planned,
        model,
        chunk.before,
        wants=None if prediction is None else prediction.wants,
        keep_responses=context.bound is not None,
        layers_before=chunk.chunk.layers,
        extent=extent,
    ):
        text, statistics = [*renderer.before(section)], Statistics()
        if solved is None:
            text += renderer.sliced(section)
        elif solved.fault:
            text += renderer.sliced(section)
            statistics = of_unsafe(section, planned, solved.fault)
        else:
            text += renderer.section(section, solved)
            statistics = of_section(section, solved, planned, extent, model)
            if check is not None:
                check.add(solved)
            if prediction is not None:
                prediction.add(solved, renderer.written)
        yield Output(text, statistics, min(section.end_t / end_t, 1.0) * size)
    text = [*renderer.finish()]
    statistics = Statistics(
        segments=renderer.segments,
        print_time_s=renderer.late_s,
        warnings=() if check is None else check.warnings(),
        predicted=None if prediction is None else prediction.samples,
    )
    yield Output(text, statistics, size)


PEAK_LEVEL = 2.6  # times the bound, that single spots may have: a little more than in the search


class BoundCheck:
    """Compares the response that was solved for, effects included, with the bound, section by section."""

    def __init__(self, bound: Bound, program: Program, feature: str, settings: Settings) -> None:
        self.program, self.bound_mm = program, bound.errors_mm(labels(program, feature))
        self.settings = settings
        self.beyond: list[tuple[float, int, float]] = []  # times the bound, line and µm of each section's worst

    def add(self, solved: SolvedSection) -> None:
        """Look at a section."""
        section, reference, response, settings = (
            solved.section,
            solved.reference,
            solved.solution.response,
            self.settings,
        )
        t = reference.t0 + np.arange(1, len(response) + 1, dtype=np.float64) * settings.segment_s / settings.substeps
        error = contour_error(*reference.path(), t, response)
        move = np.clip(solved.trajectory.move_at(t), section.first, section.last - 1)
        times = error / self.bound_mm[move]
        worst = int(times.argmax())
        if times[worst] > PEAK_LEVEL:
            line = self.program.line_of(move[worst])
            self.beyond.append((float(times[worst]), line, 1e3 * float(error[worst])))

    def warnings(self) -> tuple[str, ...]:
        """Say where the bound is not kept; where the settings are strict, refuse."""
        if not self.beyond:
            return ()
        _, line, um = max(self.beyond)
        where = "one section" if len(self.beyond) == 1 else f"{len(self.beyond)} sections"
        above = f"it is above {PEAK_LEVEL:g} times its bound in {where}"
        sentence = f"line {line}: the predicted error is {um:.3g} µm here; {above}."
        if self.settings.slowing.strict:
            raise LimitsError(sentence)
        return (sentence,)
