"""The whole order, on one page: G-code text in, compensated G-code text out.

program     gcode.reader          lines → moves and events
trajectory  ffcomp.planner           moves → the firmware's own plan: when each move accelerates, cruises, brakes
runs        ffcomp.inverse.reference           the plan cut where the nozzle rests
vertices    ffcomp.inverse         each run → the command whose response is the run
lines       ffcomp.compensate.gcode_output.writer         commands and events → text, limits opened and closed around it
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ffcomp.compensate.gcode_output.layout import pieces, timeline
from ffcomp.compensate.gcode_output.writer import Writer
from ffcomp.compensate.prediction import Prediction, Samples
from ffcomp.errors import LimitsError, NothingToDo
from ffcomp.inverse.bandwidth import effort_curve
from ffcomp.inverse.command_limits import shares_from_rest
from ffcomp.inverse.extent import WHOLE, Ends, Moment
from ffcomp.inverse.model import Inverter, RunResult
from ffcomp.inverse.nonlinear.correction import Ran, corrected
from ffcomp.inverse.reference import Reference, Run, split_runs
from ffcomp.inverse.settings import Settings
from ffcomp.inverse.time_scaling import SlowDown, feasible_run
from ffcomp.planner.junctions import junction_limits
from ffcomp.planner.limits import DeltaReach, FirmwareLimits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.s_curve import SCurve, s_curve
from ffcomp.planner.segment_timing import OutputLimits
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from gcode.errors import GcodeError
from gcode.layers import labels, layer_starts
from gcode.limits import MotionLimits
from gcode.program import Event, EventKind, Moves, Program
from models.arrays import FloatArray
from models.effects.catalogue import design_machine
from models.errors import UnreachableError
from models.machine import DeltaKinematics, Kinematics, Machine, Steps
from models.vibration.scheduled import rest_state

SEGMENTS_PER_SECOND = 250.0
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
    slowed: list[SlowDown] = field(default_factory=list)
    predicted: Samples | None = None


@dataclass(frozen=True, slots=True)
class Planned:
    """A program with the firmware's plan for it."""

    program: Program
    trajectory: PlannedMotion
    runs: list[Run]
    firmware_s: float  # what the firmware's own plan takes


def firmware_limits(machine: Machine) -> FirmwareLimits:
    """What the printer's own configuration allows, as the machine file states it."""
    own, geometry = machine.limits, machine.kinematics
    return FirmwareLimits(
        velocity_mm_per_s=own.velocity_mm_per_s,
        acceleration_mm_per_s2=own.acceleration_mm_per_s2,
        square_corner_velocity_mm_per_s=own.square_corner_velocity_mm_per_s,
        z_velocity_mm_per_s=own.z_velocity_mm_per_s,
        z_acceleration_mm_per_s2=own.z_acceleration_mm_per_s2,
        delta=_slow_zones(geometry, machine.steps) if isinstance(geometry, DeltaKinematics) else None,
    )


def _slow_zones(geometry: DeltaKinematics, steps: Steps) -> DeltaReach:
    """Where the firmware slows a delta down."""
    half_step = 0.5 / float(np.max(steps.per_motor))
    return DeltaReach(float(geometry.delta_radii_mm.max()), float(geometry.arm_lengths_mm.min()), half_step)


def settings_for(machine: Machine, segments_per_second: float = SEGMENTS_PER_SECOND) -> Settings:
    """The settings for a machine: its bandwidth at the knee, and from its own limits what no G-code file can raise."""
    limits = firmware_limits(machine)
    output = OutputLimits(
        z_acceleration_mm_per_s2=limits.z_acceleration_mm_per_s2 or limits.acceleration_mm_per_s2,
        raised_axes="XYZ" if isinstance(machine.kinematics, DeltaKinematics) else "XY",
        retract_acceleration_mm_per_s2=limits.acceleration_mm_per_s2 * limits.extrusion_ratio,
    )
    segment_s = 1.0 / segments_per_second
    bandwidth = effort_curve(design_machine(machine)[0], segment_s).knee_hz
    return Settings(output=output, segment_s=segment_s, bandwidth_hz=bandwidth)


def plan_program(
    program: Program, machine: Machine, offset: tuple[float, float] = (0.0, 0.0), smooth: bool = False
) -> Planned:
    """Check that every move can be reached, and plan them all.

    offset : mm, what the program's positions were shifted by when they were read
    smooth : with S-curves, within a percent of the firmware's time
    """
    trajectory: PlannedMotion
    trajectory = plan = firmware_plan(program, machine, offset)
    stop_before, wait_before = stops_and_waits(program)
    if smooth:
        rests = stop_before | (wait_before > 0.0)
        trajectory = _smoothed(plan, program.moves, machine, firmware_limits(machine), rests)
    return Planned(program, trajectory, split_runs(trajectory, stop_before), plan.end_t)


def firmware_plan(program: Program, machine: Machine, offset: tuple[float, float] = (0.0, 0.0)) -> Trajectory:
    """Every move, once it is known that the nozzle can get there. offset : as for `plan_program`"""
    moves = program.moves
    if not len(moves):
        raise NothingToDo(f"{program.path or 'The file'} holds no move whose start is known: nothing to compensate.")
    for ends in (moves.start, moves.end):
        try:
            machine.kinematics.check_reach(ends[:, :3])
        except UnreachableError as error:
            line = program.first_line + int(moves.line[error.indices[0]]) + 1
            advice = machine.kinematics.advice(moves.end[:, :2] - offset)
            raise GcodeError(f"{error} {advice}", line, program.path) from error
    stop_before, wait_before = stops_and_waits(program)
    try:
        return plan_moves(moves, firmware_limits(machine), stop_before=stop_before, wait_before=wait_before)
    except GcodeError as error:
        raise error.located(program.path, program.first_line) from None


@dataclass(frozen=True, slots=True)
class Solved:
    """A run that travels, and the command whose response it is."""

    trajectory: PlannedMotion  # the plan, slower than it was before where limits asked for it
    run: Run
    wanted: Reference
    result: RunResult
    slowed: tuple[SlowDown, ...]
    knots: tuple[int, int]  # between which it is written


def solutions(
    planned: Planned,
    machine: Machine,
    inverter: Inverter,
    state: FloatArray | None,
    keep: Callable[[Reference], bool],
    layers_before: int = 0,
    ends: Ends = WHOLE,
) -> Iterator[Solved]:
    """The runs that travel, one after the other: what rings when one ends is known to the next.

    Parameters
    ----------
    state : (18,) of the plant as the first run begins; None: at rest
    keep : asked once for each run whether its response is wanted
    layers_before : of the file, before this program
    ends : what is written of the program, if it begins or ends in motion

    Raises
    ------
    LimitsError
        Where a limit cannot be held, and the plan must not or cannot be slowed down.
    """
    ran = _by_the_model(planned, machine, inverter, state, keep, layers_before, ends)
    if inverter.printer is None:
        yield from (solved for solved, _ in ran)
        return
    known = list(ran)
    results = corrected(inverter, inverter.printer, [Ran(s.wanted, s.result, rest) for s, rest in known])
    yield from (replace(solved, result=result) for (solved, _), result in zip(known, results, strict=True))


def _by_the_model(
    planned: Planned,
    machine: Machine,
    inverter: Inverter,
    state: FloatArray | None,
    keep: Callable[[Reference], bool],
    layers_before: int,
    ends: Ends,
) -> Iterator[tuple[Solved, float | None]]:
    """Each run with its answer, and how long the nozzle has rested before it; None: others have moved it."""
    program, trajectory, settings = planned.program, planned.trajectory, inverter.settings
    moved, limits = _moved_before(planned), firmware_limits(machine)
    replan = partial(_smooth_run, machine, limits) if settings.s_curve else None
    layers = Layers(program, layers_before)
    rested = later = 0.0
    for run in planned.runs:
        if not run.travels:
            continue
        start, rest_s = trajectory.origin[run.first, :3], run.begin_t - rested
        rested = run.end_t
        if state is None or moved[run.first]:
            state, rest = rest_state(machine, start), None
        else:
            state, rest = inverter.hold(state, start, rest_s), rest_s
        if later:
            run = replace(run, begin_t=run.begin_t + later, end_t=run.end_t + later)
        own = ends if run is planned.runs[0] else WHOLE
        if not settings.slow_down:
            wanted = own.reference(trajectory, run, settings)
            result = inverter.run(wanted, state, keep_response=keep(wanted))
            yield Solved(trajectory, run, wanted, result, (), own.knots(wanted, trajectory)), rest
        else:
            found = feasible_run(
                inverter,
                program.moves,
                limits,
                trajectory,
                run,
                state,
                tolerance_um=settings.tolerance_um,
                strict=settings.strict,
                keep_response=keep(own.reference(trajectory, run, settings)),
                first_line=program.first_line,
                layer_of=layers.of,
                replan=replan,
                ends=own,
            )
            trajectory, result, later = found.trajectory, found.result, later + found.lost_s
            knots = own.knots(found.wanted, trajectory)
            yield Solved(trajectory, found.run, found.wanted, result, found.records, knots), rest
        state = result.state


class Layers:
    """The layers of a program's moves, worked out when somebody asks."""

    def __init__(self, program: Program, before: int) -> None:
        """before : layers of the file that have begun before this program"""
        self.program, self.before = program, before

    @cached_property
    def _starts(self) -> list[int]:
        return layer_starts(self.program)

    @cached_property
    def _by_height(self) -> NDArray[np.int64]:
        return labels(self.program).layer

    def of(self, move: int) -> int:
        """Counted from 0."""
        if not self._starts and not self.before:
            return int(self._by_height[move])
        return max(self.before + bisect_right(self._starts, move) - 1, 0)


def _smooth_run(machine: Machine, limits: FirmwareLimits, moves: Moves, begin_t: float) -> PlannedMotion:
    """One run from rest to rest, with S-curves."""
    n = len(moves)
    rests = np.zeros(n, dtype=np.bool_)
    plan = plan_moves(moves, limits, stop_before=rests, wait_before=np.zeros(n), start_t=begin_t)
    return _smoothed(plan, moves, machine, limits, rests)


def _smoothed(
    plan: Trajectory, moves: Moves, machine: Machine, limits: FirmwareLimits, rests: NDArray[np.bool_]
) -> PlannedMotion:
    most = SCurve(limit_mm_per_s2=machine.limits.acceleration_mm_per_s2)
    allowed = junction_limits(moves, limits, rests)
    return s_curve(plan, machine.kinematics.compiled().inverse, most, allowed_v=allowed)


def _moved_before(planned: Planned) -> dict[int, bool]:
    """For the first move of each run that travels: has something else moved the nozzle since the run before?"""
    others = {e.move for e in planned.program.events if e.kind in (EventKind.STOP, EventKind.RAW_MOVE)}
    found, pending, last = {}, False, -1
    for run in planned.runs:
        pending = pending or any(move in others for move in range(last + 1, run.first + 1))
        last = run.first
        if run.travels:
            found[run.first], pending, last = pending, False, run.last - 1
    return found


def compensate(
    planned: Planned,
    machine: Machine,
    inverter: Inverter,
    flavor: str,
    summary: Summary,
    progress: Callable[[float], None] = lambda done_s: None,
    offset: tuple[float, float] = (0.0, 0.0),
    watch: Callable[[Run, RunResult], None] = lambda run, result: None,
    state: FloatArray | None = None,
    said: Mapping[bytes, bytes] | None = None,
    prediction: Prediction | None = None,
    layers_before: int = 0,
    ends: Ends = WHOLE,
) -> Iterator[bytes]:
    """The lines of the compensated file, in order; one piece may hold many. `summary` is complete at their end.

    progress : called with the print-seconds done so far
    offset : mm, what the program's positions were shifted by when they were read
    watch : called with every run and its answer before the first of its lines goes out
    state : (18,) of the plant as the program begins; None: at rest
    said : what earlier lines of the file have said of limits (`writer.limits_said`)
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


def open_account(summary: Summary, planned: Planned, ends: Ends, settings: Settings) -> None:
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


def counted_s(run: Run, planned: Planned, ends: Ends) -> float:
    """How much of a run's time `open_account` has counted as print time."""
    if ends.end is not None:
        return 0.0
    return run.end_t - (_on(ends.begin, planned.trajectory, run.begin_t) if run is planned.runs[0] else run.begin_t)


def _on(place: Moment | None, plan: PlannedMotion, otherwise: float) -> float:
    return otherwise if place is None else place.on(cast(Trajectory, plan))


def account(summary: Summary, answer: Solved, program: Program, inverter: Inverter, longer_s: float) -> None:
    """Add up what a run took, which lasts longer than it was planned."""
    result = answer.result
    summary.windows += result.windows
    summary.limited_windows += result.limited
    summary.print_time_s += longer_s
    summary.slowed += answer.slowed
    if result.excess > BEYOND:
        summary.warnings += _excesses(answer, program, inverter)


def _excesses(answer: Solved, program: Program, inverter: Inverter) -> Iterator[str]:
    """A sentence, if more than a limit is asked for where the run is written."""
    begin, end = answer.knots
    asked = shares_from_rest(answer.result.vertices, inverter.limits)[begin : end + 2].max(axis=(1, 2))
    worst = int(asked.argmax())
    if asked[worst] > BEYOND:
        t = answer.wanted.t0 + (begin + worst) * inverter.settings.segment_s
        move = min(max(int(answer.trajectory.move_at(t)), answer.run.first), answer.run.last - 1)
        line = program.first_line + int(program.moves.line[move]) + 1
        yield f"line {line}: a carriage is asked for {asked[worst]:.2f} times its limit here."
