"""Wipes: filament that is pulled back while the nozzle moves."""

from __future__ import annotations

import numpy as np
from numba import njit

from models.arrays import FloatArray

FLOWS_MM = 1e-6  # filament per segment from which on it flows


@njit(cache=True, nogil=True)
def even_wipes(e: FloatArray, vertices: FloatArray, first: int, cut: int) -> None:
    """Share out filament that is pulled back while the nozzle moves by the command's path, in place.

    When exactly a retraction pulls does not matter; but firmwares hold its acceleration down and slow down wherever it
    changes against the path, and a wipe pulls so hard that every unevenness would cost time.

    Parameters
    ----------
    e : (n + 1,) mm of filament at the knots, the first of which has the number `first`
    vertices : (n + 1, 3) mm
    cut : nothing is shared across a knot whose number is a multiple of it
    """
    n = len(e) - 1
    begin = 0
    while begin < n:
        end = begin
        while end < n and e[end + 1] - e[end] < -FLOWS_MM and (end == begin or (first + end) % cut):
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
