"""The error that a plan will have, foretold from the plan alone: no command is solved for.

The machine file's printer and those that are off answer a path as the robust inverse sees it: D r − r, with D of the
middle of a span (`ffcomp/inverse/sensitivity.py`). One transform forwards and one backwards for each direction of the
parameters, so a forecast costs a twentieth of a solution. What a robust inverse makes better is foretold by a share of
the plain one's error, which is found again for each move whenever a solution is there (`SectionSearch.prove`).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ffcomp.inverse.sensitivity import SPANS, Sensitivity, span_length
from ffcomp.planner.trajectory import Trajectory
from models.arrays import FloatArray

ShortArray = NDArray[np.float32]

AFTER_S = 0.05  # how long after its end a section is looked at
STANDING_MM = 2e-3  # from row to row: below, a motion has no direction, and all of an error counts


def forecast(
    sensitivity: Sensitivity, plan: Trajectory, begin_t: float, end_t: float
) -> tuple[FloatArray, FloatArray, ShortArray]:
    """Foretell the error of a section whose path is inverted as it is.

    Returns
    -------
    the moments (m,) s; across the path, the file's printer's error (m,) mm, and its changes (k, m, 3) mm in the
    directions of the parameters
    """
    margin, row_s = sensitivity.care.margin, sensitivity.row_s
    n = int(np.ceil((end_t - begin_t + AFTER_S) / row_s))
    t = begin_t + row_s * np.arange(-margin, n + margin, dtype=np.float64)
    nozzle, velocity = plan.motion_within(t, begin_t, end_t)
    missed = _missed(sensitivity, nozzle, n)
    nominal, changes = _across(missed, velocity[margin : margin + n], STANDING_MM / row_s)
    return t[margin : margin + n], nominal, changes


def _missed(sensitivity: Sensitivity, nozzle: FloatArray, n: int) -> ShortArray:
    """Return D r − r (1 + k, n, 3) mm of a path (n + 2 margin, 3) mm."""
    margin = sensitivity.care.margin
    step = SPANS[-1] - 2 * margin
    parts = []
    for first in range(0, n, step):
        rows = nozzle[first : min(first + step, n) + 2 * margin]
        length = span_length(len(rows))
        rates = np.diff(rows, axis=0, append=rows[-1:])
        fade = np.minimum(1.0, np.minimum(np.arange(len(rows)), np.arange(len(rows))[::-1]) * (2.0 / margin))
        answered = sensitivity.along(rows[:, :2], length).to_path((rates * fade[:, None]).astype(np.float32))
        parts.append(answered[:, margin : len(rows) - margin])
    return np.concatenate(parts, axis=1)


@njit(cache=True, nogil=True)
def _across(missed: ShortArray, velocity: FloatArray, standing: float) -> tuple[FloatArray, ShortArray]:
    """Take what lies along the motion out of errors (1 + k, m, 3): the first one's size, and the others."""
    k, m = missed.shape[0] - 1, missed.shape[1]
    nominal, changes = np.empty(m), np.empty((k, m, 3), np.float32)
    for i in range(m):
        v = velocity[i]
        speed = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        share = 1.0 / (speed * speed) if speed > standing else 0.0
        for a in range(k + 1):
            e = missed[a, i]
            along = share * (e[0] * v[0] + e[1] * v[1] + e[2] * v[2])
            x, y, z = e[0] - along * v[0], e[1] - along * v[1], e[2] - along * v[2]
            if a:
                changes[a - 1, i, 0], changes[a - 1, i, 1], changes[a - 1, i, 2] = x, y, z
            else:
                nominal[i] = np.sqrt(x * x + y * y + z * z)
    return nominal, changes
