"""G2 and G3 as chords: circles in a plane, helical along its normal, given by centre (I J K) or radius (R).

A chord over the angle φ of a circle of radius r leaves it by the sagitta s = r (1 − cos φ/2), so the largest
angle for a tolerance is φ = 2 arccos(1 − s/r).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, atan2, ceil, copysign, hypot, sqrt, tau

import numpy as np
from numpy.typing import NDArray

from gcode.errors import GcodeError

FloatArray = NDArray[np.float64]
Point2 = tuple[float, float]

ARC_TOLERANCE_MM = 0.005
MAX_ARC_MM = 1e5  # a hundred metres: a slip of the slicer, and a million chords
MAX_CHORD_MM = 1.0  # so that very large circles still have vertices where accelerations change
_COARSEST_ANGLE = tau / 8  # a circle smaller than the tolerance still turns once round
_SAME_POINT_MM = 1e-6
_OFF_CIRCLE_MM, _OFF_CIRCLE_SHARE, _ROUNDING_MM = 0.5, 0.01, 0.02


@dataclass(frozen=True, slots=True)
class Arc:
    """An arc in the plane of two axes; it ends on `end` exactly, by a spiral where radii differ a little."""

    start: Point2  # mm
    end: Point2  # mm
    centre: Point2  # mm
    clockwise: bool

    @property
    def radii(self) -> tuple[float, float]:
        """Distance of start and of end from the centre, mm."""
        return _distance(self.centre, self.start), _distance(self.centre, self.end)

    @property
    def sweep(self) -> float:
        """Signed angle from start to end, rad, counter-clockwise positive; a full turn when they coincide."""
        turn = -1.0 if self.clockwise else 1.0
        if _distance(self.start, self.end) < _SAME_POINT_MM:
            return turn * tau
        return turn * ((turn * (self._angle(self.end) - self._angle(self.start))) % tau)

    def _angle(self, point: Point2) -> float:
        return atan2(point[1] - self.centre[1], point[0] - self.centre[0])

    def chords(self, tolerance: float = ARC_TOLERANCE_MM, longest: float = MAX_CHORD_MM) -> FloatArray:
        """Ends of the chords.

        Returns
        -------
        points : (n, 3), columns first axis mm, second axis mm, share of the way (0, 1]
        """
        first, last = self.radii
        sweep = self.sweep
        count = _chord_count(max(first, last), abs(sweep), tolerance, longest)
        share = np.arange(1, count + 1) / count
        angle = self._angle(self.start) + sweep * share
        radius = first + (last - first) * share
        points = np.empty((count, 3))
        points[:, 0] = self.centre[0] + radius * np.cos(angle)
        points[:, 1] = self.centre[1] + radius * np.sin(angle)
        points[:, 2] = share
        points[-1, :2] = self.end
        return points


def _chord_count(radius: float, sweep: float, tolerance: float, longest: float) -> int:
    angle = 2 * acos(1 - tolerance / radius) if radius > tolerance else _COARSEST_ANGLE
    return max(1, ceil(sweep / min(angle, _COARSEST_ANGLE) - 1e-9), ceil(sweep * radius / longest - 1e-9))


def arc_by_centre(start: Point2, end: Point2, offset: Point2, clockwise: bool, line: int | None = None) -> Arc:
    """The arc whose centre lies `offset` (I, J) from the start."""
    arc = _checked(Arc(start, end, (start[0] + offset[0], start[1] + offset[1]), clockwise), line)
    first, last = arc.radii
    if first < _SAME_POINT_MM:
        raise GcodeError("The arc's centre is its start (I, J, K are zero); a radius must be positive.", line)
    if abs(last - first) > _allowance(first):
        where = f"the arc starts {first:.3f} mm from its centre and ends {last:.3f} mm from it"
        raise GcodeError(f"{where}; the two may differ by {_allowance(first):.3f} mm at most.".capitalize(), line)
    return arc


def arc_by_radius(start: Point2, end: Point2, radius: float, clockwise: bool, line: int | None = None) -> Arc:
    """The arc of this radius: the shorter of two, the longer when R is negative (NIST RS274/NGC 3.5.3)."""
    chord = _distance(start, end)
    if chord < _SAME_POINT_MM:
        raise GcodeError("An arc given by R ends where it starts; a full circle needs I and J.", line)
    if chord / 2 > abs(radius) + _allowance(abs(radius)):
        raise GcodeError(f"R{radius:g} cannot span {chord:.3f} mm; a radius is at least half the chord.", line)
    # The centre stands on the chord's bisector, to the left of the way for a short counter-clockwise arc.
    height = copysign(sqrt(max(0.0, radius * radius - chord * chord / 4)), radius) * (-1 if clockwise else 1)
    along = ((end[0] - start[0]) / chord, (end[1] - start[1]) / chord)
    middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2)
    return _checked(Arc(start, end, (middle[0] - height * along[1], middle[1] + height * along[0]), clockwise), line)


def _checked(arc: Arc, line: int | None) -> Arc:
    length = abs(arc.sweep) * max(arc.radii)
    if length > MAX_ARC_MM:
        raise GcodeError(f"The arc is {length:.0f} mm long; arcs may be {MAX_ARC_MM:.0f} mm long at most.", line)
    return arc


def _allowance(radius: float) -> float:
    """How far an end may lie off the circle: rounding always, 1 % of the radius, never above 0.5 mm."""
    return min(_OFF_CIRCLE_MM, max(_ROUNDING_MM, _OFF_CIRCLE_SHARE * radius))


def _distance(a: Point2, b: Point2) -> float:
    return hypot(b[0] - a[0], b[1] - a[1])
