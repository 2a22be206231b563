"""A small G-code for viewers: the sliced moves, coloured by contour error instead of by feature.

Viewers of slicers and hosts colour lines by the feature that a comment names. Here the name is the size of the
error; moves are cut where it changes. Nothing heats, homes or waits: view it, do not print it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ffcomp.firmware.program import PlannedProgram
from ffcomp.simulation.preview import Curve
from gcode.dialects import detect_slicer
from gcode.layers import begins_feature
from gcode.program import Event, EventQueue, Program
from models.arrays import IntArray

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
