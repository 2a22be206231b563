"""An accelerometer that is mounted a few degrees off the printer's axes, as a nuisance of the fit.

At 2° a thirtieth of the motion along one axis shows in the other two. The responses across the axes are small, so there
it is most of what is measured, and no parameter of the machine explains it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ffcomp.measurement.frf import FrequencyResponse
from models.arrays import ComplexArray, FloatArray, IntArray

PRIOR_SD_DEG = 3.0
_OUTPUTS = ("acc_x", "acc_y", "acc_z")


def of_one_capture(responses: Sequence[FrequencyResponse]) -> IntArray:
    """Return which responses are the three axes of one capture, (g, 3); those of a laboratory have no clock."""
    found: dict[tuple[object, ...], dict[str, int]] = {}
    for number, r in enumerate(responses):
        if r.clock and r.setup == "assembly" and r.output in _OUTPUTS:
            repeat = 0
            while r.output in found.setdefault((r.clock, r.input, r.position_mm, repeat), {}):
                repeat += 1  # the same experiment, captured again
            found[r.clock, r.input, r.position_mm, repeat][r.output] = number
    rows = [[axes[name] for name in _OUTPUTS] for axes in found.values() if len(axes) == len(_OUTPUTS)]
    alike = [row for row in rows if len({len(responses[i].frequency_hz) for i in row}) == 1]
    return np.array(alike, dtype=np.int64).reshape(-1, 3)


def rotated(predictions: Sequence[ComplexArray], captures: IntArray, angles_rad: FloatArray) -> list[ComplexArray]:
    """Turn the predicted responses of captures (g, 3) as a sensor turned by a rotation vector (3,) measures them."""
    turned = list(predictions)
    matrix = Rotation.from_rotvec(angles_rad).as_matrix()
    for row in captures:
        three = matrix @ np.stack([predictions[i] for i in row])
        for i, each in zip(row, three, strict=True):
            turned[i] = each
    return turned
