"""Lifts and wipes: stretches of a command that are written as one segment, or evenly, although their speed changes.

A segment is executed with ramps at the firmware's acceleration, and passes its ends no faster than its neighbours: a
ramp in several segments needs twice the acceleration that it has itself. A printer's own acceleration of Z is often no
more than the plan's, and no G-code file can raise it. But while only Z moves and no filament flows, the
height's timing does not matter: one segment with the firmware's own ramps takes the planned time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.arrays import BoolArray, FloatArray, IntArray
from models.compiled import kernel

FLOWS_MM = 1e-6  # filament per segment that counts as flow


@kernel
def even_wipes(e: FloatArray, vertices: FloatArray, known: BoolArray) -> None:
    """Share out filament that is pulled back while the nozzle moves by the command's path, in place.

    When exactly a retraction pulls does not matter; but firmwares hold its acceleration down and slow down wherever it
    changes against the path, and a wipe pulls so hard that every unevenness would cost time.

    Parameters
    ----------
    e : (n + 1,) mm of filament at the knots
    vertices : (n + 1, 3) mm
    known : (n + 1,) knots across which nothing is shared
    """
    n = len(e) - 1
    begin = 0
    while begin < n:
        end = begin
        while end < n and e[end + 1] - e[end] < -FLOWS_MM and (end == begin or not known[end]):
            end += 1
        if end > begin + 1:
            gone = np.zeros(end - begin + 1)
            for k in range(begin, end):
                x, y = vertices[k + 1, 0] - vertices[k, 0], vertices[k + 1, 1] - vertices[k, 1]
                z = vertices[k + 1, 2] - vertices[k, 2]
                gone[k + 1 - begin] = gone[k - begin] + np.sqrt(x * x + y * y + z * z)
            if gone[-1] > 0.0:
                before, pulled = e[begin], e[end] - e[begin]
                for k in range(begin, end + 1):
                    e[k] = before + pulled * gone[k - begin] / gone[-1]
        begin = max(end, begin + 1)


STRAIGHT_MM = 0.02  # from the straight line between its ends, at most
STEEP = 1.0  # times as far in Z as in XY, in every part
FEWEST = 2  # parts


class Joined(NamedTuple):
    """The points of a command that are left when lifts have been joined."""

    stay: IntArray  # (m,) their indices
    pinned: BoolArray  # (m,) which of them must stay: the ends of lifts too


def join_lifts(points: FloatArray, e: FloatArray, pinned: BoolArray) -> Joined:
    """Leave out the points inside lifts.

    Parameters
    ----------
    points : (n, 3) mm;  e : (n,) mm of filament
    pinned : (n,) points that must stay
    """
    stay, must = _joined(np.ascontiguousarray(points), e, pinned)
    left = np.flatnonzero(stay)
    return Joined(left, must[left])


@kernel
def _joined(points: FloatArray, e: FloatArray, pinned: BoolArray) -> tuple[BoolArray, BoolArray]:
    n = len(points) - 1
    stay, must = np.ones(n + 1, dtype=np.bool_), pinned.copy()
    k = 0
    while k < n:
        up = points[k + 1, 2] - points[k, 2]
        end = k
        while end < n and (end == k or not pinned[end]) and _is_steep(points, e, end, up):
            end += 1
        first, last = _straight_part(points, k, end)
        if last - first >= FEWEST:
            stay[first + 1 : last] = False
            must[first] = must[last] = True
        k = max(end, k + 1)
    return stay, must


@kernel
def _is_steep(points: FloatArray, e: FloatArray, k: int, up: float) -> bool:
    """Whether the part from point k on leads up (or down, as `up` does) steeply, without filament."""
    x, y, z = points[k + 1, 0] - points[k, 0], points[k + 1, 1] - points[k, 1], points[k + 1, 2] - points[k, 2]
    return z * up > 0.0 and z * z >= STEEP**2 * (x * x + y * y) and abs(e[k + 1] - e[k]) <= FLOWS_MM


@kernel
def _straight_part(points: FloatArray, first: int, last: int) -> tuple[int, int]:
    """Shorten a steep stretch at the end where it bends, until it is straight."""
    while last - first >= FEWEST:
        rise = points[last, 2] - points[first, 2]
        worst, where = STRAIGHT_MM, -1
        for k in range(first + 1, last):
            f = (points[k, 2] - points[first, 2]) / rise
            for i in range(2):
                away = abs(points[first, i] + f * (points[last, i] - points[first, i]) - points[k, i])
                if away > worst:
                    worst, where = away, k
        if where < 0:
            break
        if where - first < last - where:
            first = where
        else:
            last = where
    return first, last
