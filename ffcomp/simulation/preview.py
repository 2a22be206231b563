"""Compare a compensated file with its original on the design model: the reference path, before and after.

Everything is read from the compensated file: its segments are planned as the firmware plans them, the original is
restored from the comments that keep it, and the two clocks are aligned where the original's moves are noted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.firmware.program import PlannedProgram
from ffcomp.metrics import Track, build_track, contour_error, end_to_end, tracking
from ffcomp.planner.trajectory import Trajectory
from ffcomp.shapers import Shaper
from ffcomp.simulation.command import Motion, command_peaks, motion_of, path_corners, planned_motion
from ffcomp.simulation.command_files import read_compensated
from ffcomp.simulation.expectation import Piece, expectation, pieces_of
from ffcomp.simulation.forecast import WAYS, Forecast
from ffcomp.simulation.linear import LinearPlayback, continuous_intervals, simulate_linear
from gcode.errors import GcodeError
from gcode.layers import labels, outer_walls
from gcode.program import Program
from models.arrays import BoolArray, FloatArray
from models.effects.catalogue import design_machine
from models.machine import Machine

HEIGHT_MM = 0.05  # heights that differ by less are one layer


@dataclass(frozen=True, slots=True)
class Curve:
    """One simulated motion of the nozzle."""

    t: FloatArray  # (m,) s on its own plan's clock
    due: FloatArray  # (m,) s on the original plan's clock, when it is at the reference
    nozzle: FloatArray  # (m, 3) mm
    reference: FloatArray  # (m, 3) mm, where the path is at that time
    contour: FloatArray  # (m,) mm, distance to the path
    extruding: BoolArray  # (m,) plastic flows
    outer_wall: BoolArray  # (m,) and it is a wall that is seen from outside
    peak: float = 0.0  # mm/s², largest acceleration of a carriage's command

    @property
    def shows(self) -> BoolArray:
        """(m,) plastic flows; all of them if it flows nowhere."""
        return self.extruding | (not self.extruding.any())

    def by_height(self) -> tuple[FloatArray, FloatArray]:
        """Return Z (n,) mm and the contour error there, (n,) µm rms, from the bottom up: of what `shows`."""
        z, which = np.unique(np.round(self.reference[self.shows, 2] / HEIGHT_MM), return_inverse=True)
        squares = np.bincount(which, (1e3 * self.contour[self.shows]) ** 2) / np.bincount(which)
        return HEIGHT_MM * z, np.sqrt(squares)

    @property
    def track(self) -> Track:
        """The TRACK over the whole print; its motion restarts where something else moved the nozzle."""
        step = float(np.median(np.diff(self.t)))
        begins = np.flatnonzero(np.abs(np.diff(self.t) - step) > 0.5 * step) + 1
        joined = end_to_end(np.split(self.reference, begins), np.split(self.nozzle, begins))
        seconds = float(self.t[-1] - self.t[0])
        return build_track(tracking(*joined, step), self.contour, seconds, self.peak)


@dataclass(frozen=True, slots=True)
class Preview:
    """Both prints on the design model."""

    before: Curve
    after: Curve
    original: PlannedProgram  # within reach
    pieces: Sequence[Piece] = ()  # of both prints; none where something else moves the nozzle

    def forecast(self, machine: Machine) -> Forecast:
        """Evaluate both prints of a file that keeps no forecast."""
        tracks = dict(zip(WAYS, (self.before.track, self.after.track), strict=True))
        expected = expectation(machine, self.pieces, self.original.program.flavor)
        return Forecast(tracks, self.before.track.print_time_s, expected=expected)


def preview(data: bytes, path: str, machine: Machine) -> Preview:
    """Simulate the original and the compensated print, both in one file, with the design model.

    Raises GcodeError if the file is not compensated.
    """
    both = read_compensated(data, path, machine)
    if both is None:
        raise GcodeError("The file is not compensated.", path=path)
    plan, kinds = both.original.trajectory, _kinds(both.original.program, both.original.trajectory)
    corners, playback = path_corners(plan), LinearPlayback(design_machine(machine)[0])

    def curve(motion: Motion, executed: Trajectory, by_axis: Sequence[Shaper] = ()) -> Curve:
        t, nozzle = simulate_linear(playback, executed, by_axis)
        due, actuators = motion.clock.plan_time(t), motion.actuators(machine)
        # jumps by others are left out
        peak = max(command_peaks(actuators, begin, end)[1] for begin, end in continuous_intervals(executed))
        contour = contour_error(*corners, due, nozzle)
        return Curve(t, due, nozzle, plan.position(due)[:, :3], contour, *kinds(due), peak)

    executed = both.written.trajectory
    before, after = planned_motion(plan), motion_of(executed, both.clock, both.by_axis)
    curves = curve(before, plan), curve(after, executed, both.by_axis)
    return Preview(*curves, both.original, pieces_of(before, after, corners))


def _kinds(program: Program, plan: Trajectory) -> Callable[[FloatArray], tuple[BoolArray, BoolArray]]:
    direction = plan.direction
    extrudes = (direction[:, 3] > 0.0) & np.any(direction[:, :3] != 0.0, axis=1)
    walls = extrudes & outer_walls(labels(program))

    def at(t: FloatArray) -> tuple[BoolArray, BoolArray]:
        move = np.clip(np.searchsorted(plan.start_t, t, side="right") - 1, 0, len(extrudes) - 1)
        return extrudes[move], walls[move]

    return at
