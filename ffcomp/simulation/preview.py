"""Compare a compensated file with its original on the design model: the reference path, before and after.

Everything is read from the compensated file: its segments are planned as the firmware plans them, the original is
restored from the comments that keep it, and the two clocks are aligned where the original's moves are noted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ffcomp.firmware.program import PlannedProgram
from ffcomp.metrics import Track, build_track, contour_error, end_to_end, tracking
from ffcomp.planner.trajectory import Trajectory
from ffcomp.shapers import Shaper
from ffcomp.simulation.command import Motion, command_peaks, motion_of, path_corners, planned_motion, read_compensated
from ffcomp.simulation.expectation import Piece, expectation, pieces_of
from ffcomp.simulation.forecast import WAYS, Forecast
from ffcomp.simulation.linear import LinearPlayback, continuous_intervals, simulate_linear
from gcode.dialects import detect_slicer
from gcode.errors import GcodeError
from gcode.layers import begins_feature, labels, outer_walls
from gcode.program import Event, EventQueue, Program
from models.arrays import BoolArray, FloatArray, IntArray
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
    extrudes = plan.extrudes
    walls = extrudes & outer_walls(labels(program))

    def at(t: FloatArray) -> tuple[BoolArray, BoolArray]:
        move = plan.move_at(t)
        return extrudes[move], walls[move]

    return at


# ---- as G-code for viewers -----------------------------------------------------------------------
#
# Viewers of slicers and hosts colour lines by the feature that a comment names. Here the name is the size of the error;
# moves are cut where it changes. Nothing heats, homes or waits: view it, do not print it.

EDGES_UM = (5.0, 15.0, 50.0, 150.0)  # between the levels; a line is some 400 wide
PIECE_MM = 1.0  # a move is cut no finer
MOST_PIECES = 100
NOT_FOR_PRINTING = b"; For viewers, NOT FOR PRINTING: ffcomp's preview. Each colour is a contour error:\n"

# From small to large errors: features that viewers draw green or grey, yellow, orange, red and dark red.
_PRUSA = ("Support material", "Perimeter", "External perimeter", "Top solid infill", "Internal infill")
_ORCA = ("Support", "Inner wall", "Outer wall", "Top surface", "Sparse infill")
_CURA = ("SUPPORT", "SKIN", "WALL-OUTER", "FILL", "WALL-INNER")
_NAMES = {"OrcaSlicer": _ORCA, "BambuStudio": _ORCA, "Cura": _CURA}
_MARKS = {"BambuStudio": "; FEATURE: "}


@dataclass(frozen=True, slots=True)
class Levels:
    """How large the error is along each of n moves."""

    count: IntArray  # (n,) pieces of equal length of each move
    first: IntArray  # (n,) its first piece
    level: IntArray  # (pieces,) 0 to len(EDGES_UM)


def gcode_preview(original: PlannedProgram, curve: Curve, offset: tuple[float, float] = (0.0, 0.0)) -> Iterator[bytes]:
    """Yield the lines of the preview: the original's moves in the colours of a curve's error.

    offset : shift of the print, mm: the preview is at the slicer's position
    """
    program = original.program
    slicer = detect_slicer(program.lines)
    names = [_MARKS.get(slicer, ";TYPE:") + name for name in _NAMES.get(slicer, _PRUSA)]
    levels, queue = error_levels(original, curve), EventQueue(program.events)
    comments = _comments(program, queue.up_to(0))
    yield next(comments, b"; ffcomp\n")  # viewers know the slicer by the first line
    yield NOT_FOR_PRINTING
    between = [f"{low:g} to {high:g} um" for low, high in pairwise(EDGES_UM)]
    texts = [f"below {EDGES_UM[0]:g} um", *between, f"above {EDGES_UM[-1]:g} um"]
    yield from (f"; {text}: {name.split(':')[1].strip()}\n".encode() for text, name in zip(texts, names, strict=True))
    yield b"G21\nG90\nM83\n"
    yield from comments
    shown, at = -1, dict[str, str]()  # level and words of the piece before
    for number in range(len(program.moves)):
        if number:
            yield from _comments(program, queue.up_to(number))
        for level, words, filament in _pieces(program, levels, number, offset):
            if level not in (shown, -1):
                shown = level
                yield f"{names[level]}\n".encode()
            new = [name + value for name, value in words.items() if at.get(name) != value]
            new += [f"E{filament}"] if float(filament) else []
            at = words
            if new:
                yield f"G1 {' '.join(new)}\n".encode()
    yield from _comments(program, queue.up_to(len(program.moves)))


def error_levels(original: PlannedProgram, curve: Curve) -> Levels:
    """Find the largest error on each piece of each move."""
    moves = original.program.moves
    start, way = moves.start[:, :3], moves.end[:, :3] - moves.start[:, :3]
    length = np.sqrt((way**2).sum(axis=1))
    extrudes = (moves.end[:, 3] > moves.start[:, 3]) & (length > 0.0)
    count = np.where(extrudes, np.clip(np.ceil(length / PIECE_MM), 1, MOST_PIECES), 1).astype(np.int64)
    first = np.cumsum(count) - count
    move = np.clip(original.trajectory.move_at(curve.due), 0, len(moves) - 1)
    along = ((curve.reference - start[move]) * way[move]).sum(axis=1) / np.maximum(length[move] ** 2, 1e-12)
    piece = first[move] + np.minimum(np.clip(along, 0.0, 1.0) * count[move], count[move] - 1).astype(np.int64)
    worst = np.full(int(count.sum()), -1.0)
    np.maximum.at(worst, piece, 1e3 * curve.contour)
    known = np.maximum.accumulate(np.where(worst >= 0.0, np.arange(len(worst)), 0))  # pieces between two samples too
    return Levels(count, first, np.searchsorted(EDGES_UM, np.maximum(worst[known], 0.0), side="right"))


def _comments(program: Program, events: Iterable[Event]) -> Iterator[bytes]:
    """Yield the comments among lines: layers, sizes, thumbnails and settings; not the features."""
    for event in events:
        line = program.lines[event.line]
        if line.lstrip().startswith(b";") and not begins_feature(line):
            yield line if line.endswith(b"\n") else line + b"\n"


def _pieces(
    program: Program, levels: Levels, number: int, offset: tuple[float, float]
) -> Iterator[tuple[int, dict[str, str], str]]:
    """Yield the pieces of a move: level (-1: no plastic flows), words X Y Z F, and filament along it."""
    moves = program.moves
    start, end, feed = moves.start[number], moves.end[number], 60.0 * float(moves.speed[number])
    filament, count = float(end[3] - start[3]), int(levels.count[number])
    flows = filament > 0.0 and bool(np.any(end[:3] != start[:3]))
    level = levels.level[levels.first[number] : levels.first[number] + count]
    stops = [*(np.flatnonzero(np.diff(level)) + 1).tolist(), count]
    for begin, stop in pairwise((0, *stops)):
        x, y, z = (start[:3] + (end[:3] - start[:3]) * (stop / count)).tolist()
        words = {"X": f"{x - offset[0]:.3f}", "Y": f"{y - offset[1]:.3f}", "Z": f"{z:.3f}", "F": f"{feed:.0f}"}
        yield int(level[begin]) if flows else -1, words, f"{filament * (stop - begin) / count:.5f}"
