"""Compare a compensated file with its original on the design model: the reference path, before and after.

Everything is read from the compensated file: its segments are planned as the firmware plans them, the original is
restored from the comments that keep it, and the two clocks are aligned where the original's moves are noted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.metrics import Track, build_track, contour_error, end_to_end, tracking
from ffcomp.planner.trajectory import Trajectory
from ffcomp.simulation.command import (
    Motion,
    command_peaks,
    motion_of,
    path_corners,
    planned_motion,
)
from ffcomp.simulation.command_files import read_compensated
from ffcomp.simulation.expectation import Piece, expectation, pieces_of
from ffcomp.simulation.forecast import WAYS, Forecast
from ffcomp.simulation.linear import LinearPlayback, continuous_intervals, simulate_linear
from gcode.dialect import KLIPPER
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
    nozzle: FloatArray  # (m, 3) mm
    reference: FloatArray  # (m, 3) mm, where the path is at that time
    contour: FloatArray  # (m,) mm, distance to the path
    extruding: BoolArray  # (m,) plastic flows
    outer_wall: BoolArray  # (m,) and it is a wall that is seen from outside
    peak: float = 0.0  # mm/s², largest acceleration of a carriage's command

    def by_height(self) -> tuple[FloatArray, FloatArray]:
        """Return Z (n,) mm and the contour error there where plastic flows, (n,) µm rms, from the bottom up."""
        z, which = np.unique(np.round(self.reference[self.extruding, 2] / HEIGHT_MM), return_inverse=True)
        squares = np.bincount(which, (1e3 * self.contour[self.extruding]) ** 2) / np.bincount(which)
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
class Original:
    """The original within reach, and when its plan is at the references of both curves."""

    program: Program
    plan: Trajectory
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
    pieces: Sequence[Piece] = ()  # of both prints; none where something else moves the nozzle
    flavor: str = KLIPPER  # the firmware that plans them

    def forecast(self, machine: Machine) -> Forecast:
        """Evaluate both prints of a file that keeps no forecast."""
        tracks = dict(zip(WAYS, (self.before.track, self.after.track), strict=True))
        expected = expectation(machine, self.pieces, self.flavor)
        return Forecast(tracks, self.before.track.print_time_s, expected=expected)


def preview(data: bytes, path: str, machine: Machine) -> Preview:
    """Simulate the original and the compensated print, both in one file, with the design model.

    Raises
    ------
    GcodeError
        If the file is not compensated.
    """
    both = read_compensated(data, path, machine)
    if both is None:
        raise GcodeError("The file is not compensated.", path=path)
    original, reference, executed = both.original.program, both.original.trajectory, both.written.trajectory
    path_t, corners = path_corners(reference)
    playback = LinearPlayback(design_machine(machine)[0])
    before_t, before = simulate_linear(playback, reference)
    after_t, after = simulate_linear(playback, executed, both.by_axis)
    before_reference = reference.position(before_t)[:, :3]
    after_due = both.clock.plan_time(after_t)
    after_reference = reference.position(after_due)[:, :3]
    kinds = _kinds(original, reference)
    motions = planned_motion(reference), motion_of(executed, both.clock, both.by_axis)
    peaks = [_peak(machine, *each) for each in zip(motions, (reference, executed), strict=True)]
    of_before, of_after = (
        contour_error(path_t, corners, t, xyz) for t, xyz in ((before_t, before), (after_due, after))
    )
    return Preview(
        corners,
        path_t,
        Curve(before_t, before, before_reference, of_before, *kinds(before_t), peaks[0]),
        Curve(after_t, after, after_reference, of_after, *kinds(after_due), peaks[1]),
        Original(original, reference, before_t, after_due),
        pieces_of(*motions, (path_t, corners)),
        original.flavor,
    )


def _peak(machine: Machine, motion: Motion, plan: Trajectory) -> float:
    """Return the largest acceleration of a carriage's command, mm/s²; jumps by others are left out."""
    actuators = motion.actuators(machine)
    return max(command_peaks(actuators, begin, end)[1] for begin, end in continuous_intervals(plan))


def _kinds(program: Program, plan: Trajectory) -> Callable[[FloatArray], tuple[BoolArray, BoolArray]]:
    direction = plan.direction
    extrudes = (direction[:, 3] > 0.0) & np.any(direction[:, :3] != 0.0, axis=1)
    walls = extrudes & outer_walls(labels(program))

    def at(t: FloatArray) -> tuple[BoolArray, BoolArray]:
        move = np.clip(np.searchsorted(plan.start_t, t, side="right") - 1, 0, len(extrudes) - 1)
        return extrudes[move], walls[move]

    return at
