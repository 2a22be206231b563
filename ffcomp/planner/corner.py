"""The angle between two segments, as the firmware's rules for the speed of a junction see it."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, inline="always")
def corner_ratios(along: float) -> tuple[float, float]:
    """Return by how much each rule multiplies v²: junction deviation and centripetal; infinite on a straight path.

    A circle replaces the corner. Its radius is s/(1 - s) of its distance from the corner, s = sin(theta/2), and
    tan(theta/2) of the distance from the corner to where it touches the segments, which stays within half of either.

    along : cosine of the angle between the two directions
    """
    sine = np.sqrt(max(0.5 * (1.0 + along), 0.0))
    cosine = np.sqrt(max(0.5 * (1.0 - along), 0.0))
    if sine < 1.0 and cosine > 0.0:
        return sine / (1.0 - sine), sine / cosine
    return np.inf, np.inf
