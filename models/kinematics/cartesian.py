"""Cartesian and CoreXY machines: three straight axes that do not disturb each other.

What vibrates are the axes, so the axes are the carriages, and J is the identity. The two kinds differ in what their
motors do: one axis each, or x + y and x − y (https://www.corexy.com/theory.html).

mm, s; arrays of n points, axes in the order X Y Z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.arrays import FloatArray, constant
from models.kinematics.base import INSIDE_MM, SLACK_MM, Compiled, Kinematics, require, rings

CARTESIAN = constant(np.eye(3))
COREXY = constant([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class CartesianKinematics(Kinematics):
    """Three axes and the box that the nozzle may move in."""

    range_mm: FloatArray  # (3, 2) lowest and highest place of X Y Z
    motor_matrix: FloatArray  # (3, 3) motors A B C from axes X Y Z: CARTESIAN or COREXY

    def inverse(self, xyz: FloatArray) -> FloatArray:
        return np.array(xyz, dtype=np.float64)

    def forward(self, q: FloatArray) -> FloatArray:
        return np.array(q, dtype=np.float64)

    def rate_term(self, xyz: FloatArray, velocity: FloatArray) -> FloatArray:
        return np.zeros(xyz.shape)

    jacobian_rate_term = rate_term

    def jacobian(self, xy: FloatArray) -> FloatArray:
        return np.tile(np.eye(3), (len(xy), 1, 1))

    def compiled(self) -> Compiled:
        return self

    def check_reach(self, xyz: FloatArray) -> None:
        for axis, name in enumerate("XYZ"):
            low, high = self.range_mm[axis]
            inside = (xyz[:, axis] >= low - SLACK_MM) & (xyz[:, axis] <= high + SLACK_MM)
            place = "The point X = {:.3f}, Y = {:.3f}, Z = {:.3f} mm lies "
            require(inside, xyz, f"{place}outside the range of {name}, {low:g} to {high:g} mm.")

    def drawn_in(self, xyz: FloatArray, heights: FloatArray) -> FloatArray:
        low, high = self.range_mm.T
        return np.asarray(np.clip(xyz, np.where(high > low, low + INSIDE_MM, low), high - INSIDE_MM))

    def advice(self, xy: FloatArray) -> str:
        needed, room = np.ptp(xy, axis=0), np.ptp(self.range_mm[:2], axis=1)
        if (needed > room).any():
            return f"The print needs {needed[0]:.0f} × {needed[1]:.0f} mm: no offset helps."
        x, y = np.round(self.centre_mm - 0.5 * (xy.min(axis=0) + xy.max(axis=0))) + 0.0  # no minus before a zero
        return f"A print made for a bed with its origin elsewhere? --offset-mm {x:.0f},{y:.0f} brings it inside."

    def rings(self, radii: int, directions: int) -> FloatArray:
        share = rings(np.linspace(0, 1, radii + 1)[1:], directions)
        return np.asarray(self.centre_mm + 0.5 * np.ptp(self.range_mm[:2], axis=1) * share)

    @property
    def centre_mm(self) -> tuple[float, float]:
        x, y = self.range_mm[:2].mean(axis=1).tolist()
        return x, y

    @property
    def model_reach_mm(self) -> float:
        return 0.0

    @property
    def spare_reach_mm(self) -> float:
        return np.inf

    @property
    def motors(self) -> FloatArray:
        return self.motor_matrix

    @property
    def motor_rows(self) -> FloatArray:
        return np.hstack([np.zeros((3, 4)), self.motor_matrix, np.zeros((3, 1))])
