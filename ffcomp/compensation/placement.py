"""Choose where a print is put: by how much its positions are shifted, X and Y, and why.

A print that the machine can print where it is stays there. Otherwise the slicer's bed is laid over the machine's, or
the print is put in the middle, and an offset counts only if every move then lies inside.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ffcomp.firmware.program import read_as_planned
from ffcomp.integrations.slicer import Bed, bed_in, between, offset_for, pair, place
from ffcomp.planner.reach import PartMoves
from gcode.container import Source, blocks_of, ends_of
from gcode.dialects import choose_flavor, sign_by_ends
from gcode.program import Program
from models.arrays import FloatArray
from models.compiled import kernel
from models.kinematics.base import SLACK_MM, Kinematics
from models.machine import Machine

Offset = tuple[float, float]
NOWHERE: Offset = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Footprint:
    """The convex hull of a print's moves, without an offset."""

    part: FloatArray  # (k, 2) mm, of the moves that extrude the part; of all moves where nothing is extruded
    everything: FloatArray  # (k, 2) mm

    @property
    def size(self) -> tuple[float, float]:
        """Width and depth of the part, mm."""
        x, y = np.ptp(self.part, axis=0).tolist()
        return x, y


@dataclass(frozen=True, slots=True)
class Placement:
    """An offset, mm, and a sentence why."""

    offset: Offset
    reason: str
    notable: bool = False  # something to look at: the print is moved, or lies where the slicer does not have its bed


def footprint_of(programs: Iterable[Program]) -> Footprint | None:
    """Return the footprint of a file's programs, read without an offset; None: nothing moves."""
    moves = PartMoves()
    part, everything = np.empty((0, 2)), np.empty((0, 2))
    for program in programs:
        which = moves.of(program)
        for ends in (program.moves.start[:, :2], program.moves.end[:, :2]):
            part, everything = _enclosing(part, ends[which]), _enclosing(everything, ends)
    if not len(everything):
        return None
    return Footprint(part if len(part) else everything, everything)


def _enclosing(known: FloatArray, more: FloatArray) -> FloatArray:
    points = np.unique(np.concatenate([known, more]), axis=0)
    return points if len(points) < 4 else np.asarray(_hull(points))


@kernel
def _hull(points: FloatArray) -> FloatArray:
    """Return the corners of the convex hull of points (n, 2) in the order of x, then y: Andrew's monotone chain."""
    n = len(points)
    corners, count, least = np.empty((2 * n, 2)), 0, 1
    for k in range(2 * n - 1):  # below from left to right, then above from right to left
        x, y = points[k if k < n else 2 * n - 2 - k]
        if k == n:
            least = count
        while count > least:
            x0, y0 = corners[count - 2]
            if (corners[count - 1, 0] - x0) * (y - y0) - (corners[count - 1, 1] - y0) * (x - x0) > 0.0:
                break
            count -= 1
        corners[count, 0], corners[count, 1] = x, y
        count += 1
    return corners[: count - 1].copy()


def place_print(source: Source, path: str, machine: Machine, flavor: str) -> Placement:
    """Choose the offset of a print that is not compensated yet, as `compensate` does.

    Parameters
    ----------
    flavor : "" for what the machine file says, or else the file
    """
    head, tail, _ = ends_of(source)
    stated = choose_flavor(flavor, machine.flavor, sign_by_ends(head, tail), path).flavor
    programs = read_as_planned(blocks_of(source), path, machine, stated)
    return choose_offset(machine.kinematics, bed_in(head, tail), lambda: footprint_of(programs))


def choose_offset(kinematics: Kinematics, bed: Bed | None, footprint: Callable[[], Footprint | None]) -> Placement:
    """Choose the offset of a print.

    Parameters
    ----------
    kinematics : those of the machine
    bed : the slicer's, if it is known
    footprint : finds where the print is
    """
    by_bed = NOWHERE if bed is None else offset_for(bed, kinematics.centre_mm)
    printed = footprint()
    if printed is None or _fits(kinematics, printed.part, NOWHERE):
        if bed is not None and by_bed == NOWHERE:
            return Placement(NOWHERE, "Offset 0,0: the slicer's bed lies about where the machine's does.")
        elsewhere = ""
        if bed is not None:
            elsewhere = f" ({_beds(kinematics, bed)}: --offset-mm {pair(by_bed)} would move it there)"
        return Placement(NOWHERE, f"Offset 0,0: the print lies inside without one{elsewhere}.", notable=bool(elsewhere))
    offset = _helping(kinematics, bed, printed)
    if offset is None:
        return Placement(NOWHERE, f"Offset 0,0: {no_offset(kinematics, printed)}.", notable=True)
    if bed is not None and offset == between(bed, kinematics.centre_mm):
        rule = f"{_beds(kinematics, bed)}, and the print would lie outside"
    else:
        rule = "the print would lie outside without one, and is centred on the bed"
    return Placement(offset, f"Offset {pair(offset)}: {rule}.", notable=True)


def advice(kinematics: Kinematics, bed: Bed | None, footprint: Footprint | None, refused: Offset) -> str:
    """Say in a sentence which offset would bring a refused print inside; checked with every move of it."""
    if footprint is None:
        return ""
    if _fits(kinematics, footprint.part, refused):
        return "No offset helps: the print is too high or too low."
    offset = _helping(kinematics, bed, footprint)
    if offset is None:
        sentence = no_offset(kinematics, footprint)
        return f"{sentence[:1].upper()}{sentence[1:]}."
    if not _fits(kinematics, footprint.everything, offset):
        return f"--offset-mm {pair(offset)} brings the part inside; moves outside the volume stay uncompensated."
    return f"A print made for a bed with its origin elsewhere? --offset-mm {pair(offset)} brings it inside."


def _helping(kinematics: Kinematics, bed: Bed | None, footprint: Footprint) -> Offset | None:
    """Return an offset that brings all moves inside, or at least the part; None: there is none."""
    for points in (footprint.everything, footprint.part):
        by_bed = [] if bed is None else [between(bed, kinematics.centre_mm)]
        for offset in (*by_bed, kinematics.centring(points)):
            if _fits(kinematics, points, offset):
                return offset
    return None


def no_offset(kinematics: Kinematics, footprint: Footprint) -> str:
    """Say that a print is too large."""
    width, depth = footprint.size
    volume = kinematics.volume_text()
    return f"the print needs {width:.0f} × {depth:.0f} mm, and the print volume {volume}: no offset helps"


def _fits(kinematics: Kinematics, points: FloatArray, offset: Offset) -> bool:
    return bool(kinematics.contains(points + offset, SLACK_MM).all())


def _beds(kinematics: Kinematics, bed: Bed) -> str:
    return f"the slicer's bed lies about {place(bed.centre)}, the machine's about {place(kinematics.centre_mm)}"
