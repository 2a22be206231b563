"""Compare a compensated file with its original on the design model: the reference path, before and after.

Everything is read from the compensated file: its segments are planned as the firmware plans them, the original is
restored from the comments that keep it, and the two clocks are aligned where the original's moves are noted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ffcomp.metrics import (
    ContourStatistics,
    Track,
    build_track,
    contour_error,
    contour_statistics,
    end_to_end,
    tracking,
)
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.machine_limits import known_to_the_firmware, planner_limits
from ffcomp.planner.program import PlannedProgram
from ffcomp.planner.reach import within_reach
from ffcomp.planner.sections import split_sections
from ffcomp.planner.trajectory import PlannedMotion
from ffcomp.simulate.alignment import section_clock
from ffcomp.simulate.command import command_peaks
from ffcomp.simulate.flow import Flow, flow_of
from ffcomp.simulate.linear import continuous_intervals, simulate_linear
from ffcomp.simulate.motion import motion_of, own_clock, path_corners_with_rests
from gcode.embedded import original_lines
from gcode.layers import labels, outer_walls
from gcode.program import Program
from gcode.reader import read_program
from models.arrays import BoolArray, FloatArray
from models.machine import Machine
from models.pressure import Pressure


@dataclass(frozen=True, slots=True)
class Curve:
    """One simulated motion of the nozzle."""

    t: FloatArray  # (m,) s on its own plan's clock
    nozzle: FloatArray  # (m, 3) mm
    reference: FloatArray  # (m, 3) mm, where the path is at that time
    contour: FloatArray  # (m,) mm, distance to the path
    extruding: BoolArray  # (m,) plastic flows
    outer_wall: BoolArray  # (m,) and it is a wall that is seen from outside
    peak: float = 0.0  # mm/s², largest acceleration of a carriage's command

    @property
    def track(self) -> Track:
        """The TRACK over the whole print; where others have moved the nozzle, its motion begins anew."""
        step = float(np.median(np.diff(self.t)))
        begins = np.flatnonzero(np.abs(np.diff(self.t) - step) > 0.5 * step) + 1
        joined = end_to_end(np.split(self.reference, begins), np.split(self.nozzle, begins))
        seconds = float(self.t[-1] - self.t[0])
        return build_track(tracking(*joined, step), self.contour, seconds, self.peak)

    @property
    def statistics(self) -> ContourStatistics:
        """The contour error over the whole print."""
        return contour_statistics(self.contour)


@dataclass(frozen=True, slots=True)
class Original:
    """What was compensated, within reach, and when its plan is at the references of both curves."""

    program: Program
    plan: PlannedMotion
    before_due: FloatArray  # (m,) s on the original plan's clock, for each sample of `before`
    after_due: FloatArray  # the same of `after`


@dataclass(frozen=True, slots=True)
class Preview:
    """Both prints on the design model."""

    path: FloatArray  # (n, 3) mm, corners of the reference path
    path_t: FloatArray  # (n,) s on the original plan's clock
    before: Curve
    after: Curve
    original: Original | None = None
    flows: tuple[Flow, Flow] | None = (
        None  # before and after, on their own clocks; None: no pressure in the machine file
    )


def preview(
    data: bytes, path: str, machine: Machine, offset: tuple[float, float] = (0.0, 0.0), flavor: str | None = None
) -> Preview:
    """Simulate the original and the compensated print with the design model.

    Parameters
    ----------
    data, path : bytes, str
        The compensated file and its name.
    machine : Machine
    offset : (float, float)
        By which the original's positions were shifted, mm.
    flavor : str, optional
        None: as the file says.
    """
    lines = data.splitlines(keepends=True)
    own = known_to_the_firmware(machine)
    original = read_program(b"".join(original_lines(lines)), path, offset_mm=offset, flavor=flavor, **own)
    compensated = read_program(data, path, flavor=flavor, **own)
    original, compensated = (within_reach(program, machine.kinematics) for program in (original, compensated))
    planned, compensation = _plan(original, machine), _plan(compensated, machine)
    reference, executed = planned.trajectory, compensation.trajectory
    path_t, corners = path_corners_with_rests(reference)
    before_t, before = simulate_linear(machine, reference)
    after_t, after = simulate_linear(machine, executed)
    before_reference = reference.position(before_t)[:, :3]
    after_due = section_clock(compensation, planned).plan_time(after_t)
    after_reference = reference.position(after_due)[:, :3]
    kinds = _kinds(original, reference)
    peaks = [_peak(machine, plan) for plan in (reference, executed)]
    contours = (contour_error(path_t, corners, t, xyz) for t, xyz in ((before_t, before), (after_due, after)))
    of_before, of_after = contours
    return Preview(
        corners,
        path_t,
        Curve(before_t, before, before_reference, of_before, *kinds(before_t), peaks[0]),
        Curve(after_t, after, after_reference, of_after, *kinds(after_due), peaks[1]),
        Original(original, reference, before_t, after_due),
        None if machine.pressure is None else _flows(reference, executed, machine.pressure),
    )


def _peak(machine: Machine, plan: PlannedMotion) -> float:
    """Return the largest acceleration of a carriage's command, mm/s²; jumps by others are left out."""
    actuators = motion_of(plan, own_clock(plan)).actuators(machine)
    return max(command_peaks(actuators, begin, end)[1] for begin, end in continuous_intervals(plan))


def _flows(before: PlannedMotion, after: PlannedMotion, pressure: Pressure) -> tuple[Flow, Flow]:
    return flow_of(before, pressure), flow_of(after, pressure)


def _kinds(program: Program, plan: PlannedMotion) -> Callable[[FloatArray], tuple[BoolArray, BoolArray]]:
    """Return what tells of instants whether plastic flows then, and whether into a wall seen from outside."""
    direction = plan.direction
    extrudes = (direction[:, 3] > 0.0) & np.any(direction[:, :3] != 0.0, axis=1)
    walls = extrudes & outer_walls(labels(program))

    def at(t: FloatArray) -> tuple[BoolArray, BoolArray]:
        move = np.clip(np.searchsorted(plan.start_t, t, side="right") - 1, 0, len(extrudes) - 1)
        return extrudes[move], walls[move]

    return at


def _plan(program: Program, machine: Machine) -> PlannedProgram:
    stop_before, wait_before = stops_and_waits(program)
    plan = plan_moves(program.moves, planner_limits(machine), stop_before=stop_before, wait_before=wait_before)
    return PlannedProgram(program, plan, split_sections(plan, stop_before), plan.end_t)
