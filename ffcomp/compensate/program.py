"""The whole order, on one page: G-code text in, compensated G-code text out.

program     gcode.reader          lines → moves and events
trajectory  ffcomp.planner           moves → the firmware's own plan: when each move accelerates, cruises, brakes
runs        ffcomp.inverse.reference           the plan cut where the nozzle rests
vertices    ffcomp.inverse         each run → the command whose response is the run
lines       ffcomp.compensate.gcode_output.writer         commands and events → text, limits opened and closed around it
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from ffcomp.compensate.gcode_output.layout import pieces, timeline
from ffcomp.compensate.gcode_output.writer import Writer
from ffcomp.compensate.prediction import Prediction, Samples
from ffcomp.compensate.solve import SolvedSection, solutions
from ffcomp.errors import LimitsError
from ffcomp.inverse.command_limits import utilisation_from_rest
from ffcomp.inverse.extent import WHOLE, Extent
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings
from ffcomp.inverse.solve import Solution
from ffcomp.inverse.time_scaling import TimeScaling
from ffcomp.planner.path_position import PathPosition
from ffcomp.planner.program import PlannedProgram
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from gcode.limits import MotionLimits
from gcode.program import Event, Program
from models.arrays import FloatArray
from models.machine import Kinematics, Machine

BEYOND = 1.001  # times a limit: what a warning says


@dataclass
class Summary:
    """What a compensation did; filled in while it runs."""

    moves: int = 0
    segments: int = 0
    windows: int = 0
    limited_windows: int = 0
    original_print_time_s: float = 0.0
    print_time_s: float = 0.0
    warnings: list[str] = field(default_factory=list)
    slowed: list[TimeScaling] = field(default_factory=list)
    predicted: Samples | None = None


def compensate(
    planned: PlannedProgram,
    machine: Machine,
    inverter: InverseModel,
    flavor: str,
    summary: Summary,
    progress: Callable[[float], None] = lambda done_s: None,
    offset: tuple[float, float] = (0.0, 0.0),
    watch: Callable[[Section, Solution], None] = lambda run, result: None,
    state: FloatArray | None = None,
    said: Mapping[bytes, bytes] | None = None,
    prediction: Prediction | None = None,
    layers_before: int = 0,
    ends: Extent = WHOLE,
) -> Iterator[bytes]:
    """The lines of the compensated file, in order; one piece may hold many. `summary` is complete at their end.

    progress : called with the print-seconds done so far
    offset : mm, what the program's positions were shifted by when they were read
    watch : called with every run and its answer before the first of its lines goes out
    state : (18,) of the plant as the program begins; None: at rest
    said : what earlier lines of the file have said of limits (`writer.limits_in_effect`)
    prediction : is given the runs that it wants
    ends : what is written, if it begins or ends in motion
    """
    program, settings = planned.program, inverter.settings
    writer = Writer(program, flavor, _own_limits(machine), settings, offset, said)
    events = _Queue(program.events)
    open_account(summary, planned, ends, settings)
    keep = prediction.wants if prediction is not None else lambda wanted: False
    answers = solutions(planned, machine, inverter, state, keep, layers_before, ends)
    for run in planned.runs:
        for event in events.up_to(run.first):
            yield from writer.event(event)
        if not run.travels:
            yield from writer.extrude(run.first)
            writer.now_s += run.end_t - run.begin_t
            continue
        answer = next(answers)
        watch(run, answer.result)
        heights = program.moves.end[run.first : run.last, 2]
        vertices = keep_inside(machine.kinematics, answer.result.vertices, heights)
        inside = events.up_to(run.last - 1)
        begin, end = answer.knots
        if ends.begin is not None and run is planned.runs[0]:
            writer.resume(ends.begin.move, [*vertices[begin].tolist(), float(answer.wanted.extrusion(begin, begin)[0])])
        for piece in pieces(answer.wanted.knots, begin=begin, end=end):
            part = vertices[piece.first : piece.last + 1]
            line_up = timeline(program, answer.trajectory, answer.run, answer.wanted, part, inside, piece)
            yield from writer.run(run.first, part, line_up)
        account(summary, answer, program, inverter, (end - begin) * settings.segment_s - counted_s(run, planned, ends))
        if prediction is not None and len(answer.result.response):
            prediction.add(answer.trajectory, answer.run, answer.wanted, answer.result)
        progress(run.end_t)
    if ends.end is None:
        for event in events.up_to(len(program.moves)):
            yield from writer.event(event)
        yield from writer.close()
    summary.segments += writer.segments


class _Queue:
    """Events in the file's order, taken out as the moves go by."""

    def __init__(self, events: list[Event]) -> None:
        self._events, self._taken = events, 0

    def up_to(self, move: int) -> list[Event]:
        """Those that stand before this move or an earlier one, and have not been taken yet."""
        first = self._taken
        while self._taken < len(self._events) and self._events[self._taken].move <= move:
            self._taken += 1
        return self._events[first : self._taken]


def _own_limits(machine: Machine) -> MotionLimits:
    """What is put back where the file itself has set nothing."""
    own = machine.limits
    return MotionLimits(own.velocity_mm_per_s, own.acceleration_mm_per_s2, own.square_corner_velocity_mm_per_s, 0.5)


def keep_inside(geometry: Kinematics, vertices: FloatArray, heights: FloatArray) -> FloatArray:
    """The command where the firmware lets it go: it aborts a print over a µm outside the radius or below the bed.

    vertices : (n, 3) mm;  heights : (m,) mm, of the path itself
    """
    if not np.isfinite(vertices).all():
        raise LimitsError("The command leaves the arms' reach; the path runs too close to it.")
    return geometry.drawn_in(vertices, heights)


def open_account(summary: Summary, planned: PlannedProgram, ends: Extent, settings: Settings) -> None:
    """Add up what a program takes by its plan, or what is written of it."""
    moves, plan = planned.program.moves, planned.trajectory
    begin = _on(ends.begin, plan, 0.0)
    summary.moves -= int(np.searchsorted(plan.start_t, begin))
    if ends.end is not None:
        until = _on(ends.end, plan, 0.0)
        summary.moves += int(np.searchsorted(plan.start_t, until))
        summary.original_print_time_s += until - begin
        return
    summary.moves += len(moves)
    summary.original_print_time_s += planned.firmware_s - begin
    summary.print_time_s += float(plan.end_t) - begin


def counted_s(run: Section, planned: PlannedProgram, ends: Extent) -> float:
    """How much of a run's time `open_account` has counted as print time."""
    if ends.end is not None:
        return 0.0
    return run.end_t - (_on(ends.begin, planned.trajectory, run.begin_t) if run is planned.runs[0] else run.begin_t)


def _on(place: PathPosition | None, plan: PlannedMotion, otherwise: float) -> float:
    return otherwise if place is None else place.time_in(cast(Trajectory, plan))


def account(summary: Summary, answer: SolvedSection, program: Program, inverter: InverseModel, longer_s: float) -> None:
    """Add up what a run took, which lasts longer than it was planned."""
    result = answer.result
    summary.windows += result.windows
    summary.limited_windows += len(result.constrained)
    summary.print_time_s += longer_s
    summary.slowed += answer.slowed
    if result.utilisation > BEYOND:
        summary.warnings += _excesses(answer, program, inverter)


def _excesses(answer: SolvedSection, program: Program, inverter: InverseModel) -> Iterator[str]:
    """A sentence, if more than a limit is asked for where the run is written."""
    begin, end = answer.knots
    asked = utilisation_from_rest(answer.result.vertices, inverter.limits)[begin : end + 2].max(axis=(1, 2))
    worst = int(asked.argmax())
    if asked[worst] > BEYOND:
        t = answer.wanted.t0 + (begin + worst) * inverter.settings.segment_s
        move = min(max(int(answer.trajectory.move_at(t)), answer.run.first), answer.run.last - 1)
        line = program.first_line + int(program.moves.line[move]) + 1
        yield f"line {line}: a carriage is asked for {asked[worst]:.2f} times its limit here."
