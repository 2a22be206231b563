"""The order of `pipeline` with steps at its end: a chapter's commands as times at which the motors step.

Nothing plans the motion again, so it lasts as it was computed: the nozzle goes from knot to knot at constant speed, and
where the plan rests, so do the motors. A line that is not a move gets the tick of its move.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import cast

import numpy as np

from ffcomp.compensate.prediction import Prediction
from ffcomp.compensate.program import Summary, account, counted_s, keep_inside, open_account
from ffcomp.compensate.solve import SolvedSection, solutions
from ffcomp.inverse.extent import WHOLE, Extent
from ffcomp.inverse.model import InverseModel
from ffcomp.planner.program import PlannedProgram
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import Trajectory
from ffcomp.steps.pieces import knot_pieces, trajectory_pieces
from ffcomp.steps.sink import StepSink
from gcode.program import Event
from models.arrays import FloatArray
from models.machine import Machine

SAMPLE_S = 1e-3  # of moves of the extruder alone
BEFORE_S = 0.1  # at rest before the first motion


@dataclass
class Stepping:
    """Steps of chapter after chapter on one clock."""

    sink: StepSink
    clock_s: float = BEFORE_S
    _events: list[Event] = field(default_factory=list)
    _lines: list[bytes] = field(default_factory=list)

    def plain(self, planned: PlannedProgram, summary: Summary) -> None:
        """The plan as it is, uncompensated. It must be the firmware's own, of trapezoids."""
        self._open(planned)
        summary.moves += len(planned.program.moves)
        summary.original_print_time_s += planned.firmware_s
        summary.print_time_s += planned.trajectory.end_t
        trajectory, begun = cast(Trajectory, planned.trajectory), self.clock_s
        for pieces in trajectory_pieces(trajectory, begun):
            self.sink.pieces(pieces)
        due = np.append(begun + trajectory.start_t, begun + trajectory.end_t)
        while self._events:
            event = self._events.pop()
            self.sink.event(float(due[event.move]), self._lines[event.line])
        self.clock_s = begun + trajectory.end_t

    def compensated(
        self,
        planned: PlannedProgram,
        machine: Machine,
        inverter: InverseModel,
        summary: Summary,
        state: FloatArray | None,
        prediction: Prediction | None,
        layers_before: int = 0,
        ends: Extent = WHOLE,
    ) -> None:
        """The commands whose response is the plan; see `pipeline.compensate`."""
        self._open(planned)
        open_account(summary, planned, ends, inverter.settings)
        segment_s, rested = inverter.settings.segment_s, 0.0
        keep = prediction.wants if prediction is not None else lambda wanted: False
        answers = solutions(planned, machine, inverter, state, keep, layers_before, ends)
        for run in planned.runs:
            in_motion = ends.begin is not None and run is planned.runs[0]
            self.clock_s += 0.0 if in_motion else run.begin_t - rested
            rested = run.end_t
            if not in_motion:
                self._tell_up_to(run.first)
            if not run.travels:
                self._extrude(planned, run)
                continue
            answer = next(answers)
            self._run(planned, machine, answer, segment_s)
            longer_s = (answer.knots[1] - answer.knots[0]) * segment_s - counted_s(run, planned, ends)
            account(summary, answer, planned.program, inverter, longer_s)
            if prediction is not None and len(answer.result.response):
                prediction.add(answer.trajectory, answer.run, answer.wanted, answer.result)
        if ends.end is None:
            self._tell_up_to(len(planned.program.moves))

    def _open(self, planned: PlannedProgram) -> None:
        self._events, self._lines = list(reversed(planned.program.events)), planned.program.lines

    def _tell_up_to(self, move: int) -> None:
        """The lines before a move that begins now."""
        while self._events and self._events[-1].move <= move:
            self.sink.event(self.clock_s, self._lines[self._events.pop().line])

    def _extrude(self, planned: PlannedProgram, run: Section) -> None:
        n = max(round((run.end_t - run.begin_t) / SAMPLE_S), 1)
        spacing = (run.end_t - run.begin_t) / n
        t = np.minimum(run.begin_t + spacing * np.arange(n + 1, dtype=np.float64), np.nextafter(run.end_t, -np.inf))
        place = planned.trajectory.position(t)
        place[-1] = planned.program.moves.end[run.last - 1]
        vertices = np.repeat(place[:1, :3], n + 1, axis=0)
        self.sink.pieces(knot_pieces(self.clock_s, spacing, vertices, place[:, 3]))
        self.clock_s += run.end_t - run.begin_t

    def _run(self, planned: PlannedProgram, machine: Machine, answer: SolvedSection, segment_s: float) -> None:
        run, moves, wanted, (first, last) = answer.run, planned.program.moves, answer.wanted, answer.knots
        heights = moves.end[run.first : run.last, 2]
        vertices = keep_inside(machine.kinematics, answer.result.vertices[first : last + 1], heights)
        filament = wanted.extrusion(first, last)
        if last == wanted.knots:
            filament[-1] = moves.end[run.last - 1, 3]
        while self._events and self._events[-1].move < run.last:
            at = min(max(wanted.knot_of(float(answer.trajectory.start_t[self._events[-1].move])), 0.0), wanted.knots)
            if at >= last < wanted.knots:
                break
            event = self._events.pop()
            if at >= first:
                self.sink.event(self.clock_s + segment_s * (at - first), self._lines[event.line])
        self.sink.pieces(knot_pieces(self.clock_s, segment_s, vertices, filament))
        self.clock_s += segment_s * (last - first)
