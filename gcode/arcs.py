"""G2 and G3 as chords: circles in a plane, helical along its normal, given by centre (I J K) or radius (R).

A chord over the angle φ of a circle of radius r leaves it by the sagitta s = r (1 − cos φ/2), so the largest
angle for a tolerance is φ = 2 arccos(1 − s/r).

Where start and end lie at different distances from the centre, Klipper and Marlin go round on the start's circle, and
their last segment goes straight to the end (planArc in `gcode_arcs.py`, `plan_arc`). So do the chords.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, atan2, ceil, copysign, cos, dist, sin, sqrt, tau

import numpy as np

from gcode.errors import GcodeError
from gcode.program import FloatArray

Point2 = tuple[float, float]

ARC_TOLERANCE_MM = 0.005
MAX_ARC_MM = 1e5  # a longer arc is a slicer's error, and would make a million chords
MAX_CHORD_MM = 1.0  # so that very large circles still have vertices where accelerations change
_COARSEST_ANGLE = tau / 8  # so that a circle smaller than the tolerance stays a circle
_SAME_POINT_MM = 1e-6
_OFF_CIRCLE_MM, _OFF_CIRCLE_SHARE, _ROUNDING_MM = 0.5, 0.01, 0.02


@dataclass(frozen=True, slots=True)
class Arc:
    """An arc in the plane of two axes; it ends on `end` exactly, by a spiral where its radii differ by rounding."""

    start: Point2  # mm
    end: Point2  # mm
    centre: Point2  # mm
    clockwise: bool

    @property
    def radii(self) -> tuple[float, float]:
        """Distance of start and of end from the centre, mm."""
        return dist(self.centre, self.start), dist(self.centre, self.end)

    @property
    def sweep(self) -> float:
        """Signed angle from start to end, rad, counter-clockwise positive; a full turn when they coincide."""
        turn = -1.0 if self.clockwise else 1.0
        if dist(self.start, self.end) < _SAME_POINT_MM:
            return turn * tau
        return turn * ((turn * (self._angle(self.end) - self._angle(self.start))) % tau)

    def _angle(self, point: Point2) -> float:
        return atan2(point[1] - self.centre[1], point[0] - self.centre[0])

    def chords(self, tolerance: float = ARC_TOLERANCE_MM, multiple_of: int = 1) -> FloatArray:
        """Return the ends of the chords, (n, 3): first axis mm, second axis mm, fraction of the arc (0, 1].

        multiple_of : chords, so that they meet wherever the firmware's do
        """
        (first, last), sweep, begin = self.radii, self.sweep, self._angle(self.start)
        radius = max(first, last)
        angle = 2 * acos(1 - tolerance / radius) if radius > tolerance else _COARSEST_ANGLE
        pieces = abs(sweep) / min(angle, _COARSEST_ANGLE), abs(sweep) * radius / MAX_CHORD_MM
        count = multiple_of * max(1, *(ceil(each / multiple_of - 1e-9) for each in pieces))
        spiral = last - first if abs(last - first) <= _ROUNDING_MM else 0.0
        points = []
        for share in ((k + 1) / count for k in range(count)):
            angle, radius = begin + sweep * share, first + spiral * share
            points.append((self.centre[0] + radius * cos(angle), self.centre[1] + radius * sin(angle), share))
        points[-1] = (*self.end, 1.0)
        return np.array(points)


def arc_by_centre(start: Point2, end: Point2, offset: Point2, clockwise: bool, line: int | None = None) -> Arc:
    """Return the arc whose centre lies `offset` (I, J) from the start."""
    arc = _checked(Arc(start, end, (start[0] + offset[0], start[1] + offset[1]), clockwise), line)
    if arc.radii[0] < _SAME_POINT_MM:
        raise GcodeError("The arc's centre is its start (I, J, K are zero); a radius must be positive.", line)
    return arc


def arc_by_radius(start: Point2, end: Point2, radius: float, clockwise: bool, line: int | None = None) -> Arc:
    """Return the arc of this radius: the shorter of two, the longer when R is negative (NIST RS274/NGC 3.5.3)."""
    chord = dist(start, end)
    if chord < _SAME_POINT_MM:
        raise GcodeError("An arc given by R ends where it starts; a full circle needs I and J.", line)
    shorter = min(_OFF_CIRCLE_MM, max(_ROUNDING_MM, _OFF_CIRCLE_SHARE * abs(radius)))  # a radius may be by so much
    if chord / 2 > abs(radius) + shorter:
        raise GcodeError(f"R{radius:g} cannot span {chord:.3f} mm; a radius is at least half the chord.", line)
    # The centre stands on the chord's bisector, left of the direction of travel for a short counter-clockwise arc.
    height = copysign(sqrt(max(0.0, radius * radius - chord * chord / 4)), radius) * (-1 if clockwise else 1)
    along = ((end[0] - start[0]) / chord, (end[1] - start[1]) / chord)
    middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    return _checked(Arc(start, end, (middle[0] - height * along[1], middle[1] + height * along[0]), clockwise), line)


def _checked(arc: Arc, line: int | None) -> Arc:
    length = abs(arc.sweep) * max(arc.radii)
    if length > MAX_ARC_MM:
        raise GcodeError(f"The arc is {length:.0f} mm long; arcs may be {MAX_ARC_MM:.0f} mm long at most.", line)
    return arc
