"""The delta's equations for one point, compiled: for loops that cannot wait for arrays. See `delta.py`."""

from __future__ import annotations

import math

from numba import njit

from models.machine import FloatArray


@njit(cache=True)
def inverse_point(
    x: float, y: float, z: float, towers: FloatArray, arms_squared: FloatArray, effector_height: float
) -> tuple[float, float, float]:
    """Carriage heights A B C, mm, of one nozzle position; NaN where an arm is too short.

    Parameters
    ----------
    towers : (3, 2) mm, columns X Y (DeltaGeometry.towers_mm).
    arms_squared : (3,) mm².
    """
    base = z + effector_height
    return (
        base + math.sqrt(arms_squared[0] - (x - towers[0, 0]) ** 2 - (y - towers[0, 1]) ** 2),
        base + math.sqrt(arms_squared[1] - (x - towers[1, 0]) ** 2 - (y - towers[1, 1]) ** 2),
        base + math.sqrt(arms_squared[2] - (x - towers[2, 0]) ** 2 - (y - towers[2, 1]) ** 2),
    )
