"""The whole order, on one page: G-code text in, compensated G-code text out.

program     gcode.reader          lines → moves and events
trajectory  ffcomp.plan           moves → the firmware's own plan: when each move accelerates, cruises, brakes
runs        ffcomp.runs           the plan cut where the nozzle rests
vertices    ffcomp.invert         each run → the command whose response is the run
lines       ffcomp.writer         commands and events → text, limits opened and closed around it
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ffcomp.errors import LimitsError, NothingToDo
from ffcomp.invert.fbs import Inverter, RunResult
from ffcomp.invert.settings import Settings
from ffcomp.marks import timeline
from ffcomp.plan.limits import DeltaReach, FirmwareLimits
from ffcomp.plan.lookahead import plan_moves, stops_and_waits
from ffcomp.plan.trajectory import Trajectory
from ffcomp.played import OutputLimits
from ffcomp.predict import Prediction
from ffcomp.runs import Reference, Run, split_runs
from ffcomp.schedule import rest_state
from ffcomp.writer import Writer
from gcode.errors import GcodeError
from gcode.limits import MotionLimits
from gcode.program import Event, Program
from models.errors import UnreachableError
from models.kinematics.delta import check_reach
from models.machine import DeltaGeometry, Machine
from models.receptance import modes

FloatArray = NDArray[np.float64]


LOWEST_BANDWIDTH_HZ, HIGHEST_BANDWIDTH_HZ = 60.0, 115.0


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
    prediction: Prediction | None = None


@dataclass(frozen=True, slots=True)
class Planned:
    """A program with the firmware's plan for it."""

    program: Program
    trajectory: Trajectory
    runs: list[Run]


def firmware_limits(machine: Machine) -> FirmwareLimits:
    """What the printer's own configuration allows, as the machine file states it."""
    own, geometry = machine.limits, machine.kinematics
    return FirmwareLimits(
        velocity_mm_per_s=own.velocity_mm_per_s,
        acceleration_mm_per_s2=own.acceleration_mm_per_s2,
        square_corner_velocity_mm_per_s=own.square_corner_velocity_mm_per_s,
        delta=DeltaReach(
            float(geometry.delta_radii_mm.max()),
            float(geometry.arm_lengths_mm.min()),
            0.5 / machine.steps.steps_per_mm,
        ),
    )


def settings_for(machine: Machine) -> Settings:
    """The settings for a machine: what no G-code file can raise is taken from its own limits."""
    limits = firmware_limits(machine)
    output = OutputLimits(
        z_acceleration_mm_per_s2=limits.acceleration_mm_per_s2,
        retract_acceleration_mm_per_s2=limits.acceleration_mm_per_s2 * limits.extrusion_ratio,
    )
    return Settings(output=output, bandwidth_hz=_bandwidth(machine))


def _bandwidth(machine: Machine) -> float:
    """A good quarter above the fastest mode that rings and that knots can follow, within what 4 ms segments can do.

    Measured on the sample prints: below it the mode is left ringing, above it only the command's acceleration grows.
    """
    found = modes(machine, np.zeros(2))
    rings = (found.damping_ratios < 0.1) & (found.frequencies_hz < 0.5 / Settings().segment_s)
    fastest = float(found.frequencies_hz[rings].max(initial=0.0))
    return min(max(1.28 * fastest, LOWEST_BANDWIDTH_HZ), HIGHEST_BANDWIDTH_HZ)


def plan_program(program: Program, machine: Machine) -> Planned:
    """Check that every move can be reached, and plan them all."""
    moves = program.moves
    if not len(moves):
        raise NothingToDo(f"{program.path or 'The file'} holds no move whose start is known: nothing to compensate.")
    for ends in (moves.start, moves.end):
        try:
            check_reach(machine.kinematics, ends[:, :3])
        except UnreachableError as error:
            line = int(moves.line[error.indices[0]]) + 1
            raise GcodeError(f"{error} Does the file need --offset-mm?", line, program.path) from error
    stop_before, wait_before = stops_and_waits(program)
    trajectory = plan_moves(moves, firmware_limits(machine), stop_before=stop_before, wait_before=wait_before)
    return Planned(program, trajectory, split_runs(trajectory, stop_before))


def compensate(
    planned: Planned,
    machine: Machine,
    inverter: Inverter,
    flavor: str,
    summary: Summary,
    progress: Callable[[float], None] = lambda done_s: None,
) -> Iterator[bytes]:
    """The lines of the compensated file, in order. `summary` is complete when they are exhausted.

    progress : called with the print-seconds done so far.
    """
    program, trajectory, settings = planned.program, planned.trajectory, inverter.settings
    own = machine.limits
    limits = MotionLimits(own.velocity_mm_per_s, own.acceleration_mm_per_s2, own.square_corner_velocity_mm_per_s, 0.5)
    writer = Writer(program, flavor, limits, settings)
    events = iter(program.events)
    event = next(events, None)
    state, rested = np.zeros(0), -np.inf  # the plant's state, and the plan's time at which it was so
    summary.moves = len(program.moves)
    summary.original_print_time_s = summary.print_time_s = float(trajectory.end_t)
    for run in planned.runs:
        stopped = False
        while event is not None and event.move <= run.first:
            yield from writer.event(event)
            stopped |= event.move == run.first and event.kind.name in ("STOP", "RAW_MOVE")
            event = next(events, None)
        if not run.travels:
            yield from writer.extrude(run.first)
            continue
        wanted = Reference(trajectory, run, settings)
        start = trajectory.origin[run.first, :3]
        hold = run.begin_t - rested
        state = (
            rest_state(machine, start) if stopped or hold > 0.5 or not state.size else inverter.hold(state, start, hold)
        )
        predicted = summary.prediction is not None and summary.prediction.wants(wanted)
        result = inverter.run(wanted, state, keep_response=predicted)
        state, rested = result.state, run.end_t
        inside: list[Event] = []
        while event is not None and event.move < run.last:
            inside.append(event)
            event = next(events, None)
        line_up = timeline(program, trajectory, run, wanted, inside)
        inside_reach = keep_inside(
            machine.kinematics, result.vertices, moves_z=program.moves.end[run.first : run.last, 2]
        )
        yield from writer.run(run.first, inside_reach, line_up)
        _account(summary, run, wanted, result, trajectory, settings, predicted)
        progress(float(rested))
    while event is not None:
        yield from writer.event(event)
        event = next(events, None)
    yield from writer.close()
    summary.segments = writer.segments


def keep_inside(geometry: DeltaGeometry, vertices: FloatArray, moves_z: FloatArray) -> FloatArray:
    """The command where the firmware lets it go: it aborts a print over a µm outside the radius or below the bed.

    vertices : (n, 3) mm;  moves_z : (m,) mm, heights that the path itself goes to
    """
    if not np.isfinite(vertices).all():
        raise LimitsError("The command leaves the arms' reach; the path runs too close to it.")
    radius = np.hypot(vertices[:, 0], vertices[:, 1])
    shrink = np.minimum(1.0, (geometry.print_radius_mm - 1e-4) / np.maximum(radius, 1e-9))
    floor, ceiling = min(0.0, float(moves_z.min())), max(geometry.print_height_mm, float(moves_z.max()))
    inside = vertices * shrink[:, None]
    inside[:, 2] = np.clip(vertices[:, 2], floor, ceiling)
    return inside


def _account(
    summary: Summary,
    run: Run,
    wanted: Reference,
    result: RunResult,
    trajectory: Trajectory,
    settings: Settings,
    predicted: bool,
) -> None:
    summary.windows += result.windows
    summary.limited_windows += result.limited
    summary.print_time_s += wanted.knots * settings.segment_s - (run.end_t - run.begin_t)
    if result.excess > 1.0 + 1e-3:
        summary.warnings.append(
            f"Between {wanted.t0:.3f} and {wanted.t0 + wanted.knots * settings.segment_s:.3f} s a carriage is asked for "
            f"{result.excess:.2f} times its limit."
        )
    if summary.prediction is not None and predicted:
        summary.prediction.add(trajectory, run, wanted, result)


__all__ = ["LimitsError", "Planned", "Summary", "compensate", "firmware_limits", "plan_program"]
