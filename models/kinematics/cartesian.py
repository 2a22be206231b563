"""Cartesian and CoreXY machines: three independent straight axes.

The axes vibrate, so the axes are the carriages, and J is the identity. The two kinds differ in their motors: one per
axis, or x + y and x − y (https://www.corexy.com/theory.html).

mm, s; arrays of n points, axes in the order X Y Z.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from models.arrays import BoolArray, FloatArray, constant
from models.kinematics.base import ALONG, AXES, INSIDE_MM, SLACK_MM, Compiled, Kinematics, rings

CARTESIAN = constant(np.eye(3))
COREXY = constant([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class CartesianKinematics(Kinematics):
    """Three axes and the box that the nozzle may move in."""

    range_mm: FloatArray  # (3, 2) lowest and highest place of X Y Z
    motor_matrix: FloatArray  # (3, 3) motors A B C from axes X Y Z: CARTESIAN or COREXY

    calibration_tolerances: ClassVar[Mapping[str, float]] = MappingProxyType({"motor_matrix": 0.0})
    excitation_directions: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType({**ALONG, "xyz": AXES})
    raisable_axes: ClassVar[str] = "XY"

    def inverse(self, xyz: FloatArray) -> FloatArray:
        """Return carriages of nozzle positions, mm."""
        return np.array(xyz, dtype=np.float64)

    def forward(self, q: FloatArray) -> FloatArray:
        """Return nozzle positions of carriages, mm."""
        return np.array(q, dtype=np.float64)

    def rate_term(self, xyz: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return zeros (n, 3): a constant J has no rate."""
        return np.zeros(xyz.shape)

    def jacobian(self, xy: FloatArray) -> FloatArray:
        """Return J with Ẋ = J q̇ at positions (n, 2) mm; further columns are ignored. (n, 3, 3), rows X Y Z."""
        return np.tile(np.eye(3), (len(xy), 1, 1))

    def compiled(self) -> Compiled:
        """Return the compiled equations, for inner loops."""
        return self

    def volume_rules(self, xyz: FloatArray) -> list[tuple[BoolArray, str]]:
        """Return which of the points (n, 3) mm obey each rule of the print volume, and where the others lie."""
        each = zip("XYZ", self.range_mm.tolist(), xyz.T, strict=True)
        return [
            ((x >= low - SLACK_MM) & (x <= high + SLACK_MM), f"outside the range of {name}, {low:g} to {high:g} mm")
            for name, (low, high), x in each
        ]

    def contains(self, xyz: FloatArray, margin_mm: float = 0.0) -> BoolArray:
        """Return which of the points (n, 2) or (n, 3) mm lie over the bed and, if z is given, in the volume."""
        low, high = self.range_mm[: xyz.shape[1]].T
        return np.asarray(np.all((xyz >= low - margin_mm) & (xyz <= high + margin_mm), axis=1))

    def volume_text(self) -> str:
        """Describe the print volume as the end of a sentence: "has a radius of 60 mm and …"."""
        ranges = (f"{axis} {low:g} to {high:g}" for axis, (low, high) in zip("XYZ", self.range_mm, strict=True))
        return f"is {', '.join(ranges)} mm"

    def drawn_in(self, xyz: FloatArray, heights: FloatArray) -> FloatArray:
        """Return a command (n, 3) mm clipped to the firmware's limits, for a path with these heights (m,) mm."""
        low, high = self.range_mm.T
        return np.asarray(np.clip(xyz, np.where(high > low, low + INSIDE_MM, low), high - INSIDE_MM))

    def centring(self, xy: FloatArray) -> tuple[float, float]:
        """Return the shift, whole mm, that puts points (n, 2) mm in the middle of the bed."""
        x, y = (np.round(self.centre_mm - 0.5 * (xy.min(axis=0) + xy.max(axis=0))) + 0.0).tolist()  # no minus zero
        return x, y

    def widening(self, xyz: FloatArray) -> str:
        """Return the machine-file keys that would make these points (n, 3) mm reachable."""
        low = np.minimum(self.range_mm[:, 0], np.floor(10 * xyz.min(axis=0)) / 10)
        high = np.maximum(self.range_mm[:, 1], np.ceil(10 * xyz.max(axis=0)) / 10)
        changed = np.flatnonzero((low < self.range_mm[:, 0]) | (high > self.range_mm[:, 1])).tolist()
        keys = ", ".join(f"{AXES[axis]}_range_mm = [{low[axis]:g}, {high[axis]:g}]" for axis in changed)
        return f"write {keys} in [kinematics] of the machine file"

    def rings(self, radii: int, directions: int) -> FloatArray:
        """Return the origin and circles of these radii (k,) around it, (1 + k · directions, 2)."""
        share = rings(np.linspace(0, 1, radii + 1)[1:], directions)
        return np.asarray(self.centre_mm + 0.5 * np.ptp(self.range_mm[:2], axis=1) * share)

    def around(self, share: float, margin_mm: float) -> FloatArray:
        """Return six positions (6, 2) mm around the centre, at a share of the way out and a margin from the border."""
        half = 0.5 * np.ptp(self.range_mm[:2], axis=1)
        return np.asarray(self.centre_mm + np.minimum(share * half, half - margin_mm) * rings(np.ones(1), 6)[1:])

    @property
    def bed_radius_mm(self) -> float:
        """Return how far from the middle of the bed the nozzle may go."""
        return float(0.5 * np.ptp(self.range_mm[:2], axis=1).max())

    @property
    def height_mm(self) -> float:
        """Return the greatest height of the nozzle."""
        return float(self.range_mm[2, 1])

    @property
    def actuator_names(self) -> tuple[str, str, str]:
        """Return the names of carriages or motors A B C in messages about limits."""
        by_belts = np.array_equal(self.motor_matrix, COREXY)
        return ("motor A", "motor B", "axis Z") if by_belts else ("axis X", "axis Y", "axis Z")

    @property
    def setup_notes(self) -> list[str]:
        """Return a checklist for the printer before its vibrations are measured."""
        if np.array_equal(self.motor_matrix, COREXY):
            return ["- The firmware's kinematics is CoreXY: both motors' belts move the nozzle along x and along y."]
        bed = (
            "- Where the bed itself moves along y, the accelerometer is screwed to the bed for the experiments along y:"
        )
        return [bed, "  plan these by themselves, with --axes y."]

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Return the middle of the bed; the origin of an unlimited axis."""
        bed = self.range_mm[:2]
        x, y = bed.mean(axis=1).tolist() if np.isfinite(bed).all() else (0.0, 0.0)
        return x, y

    def printer_parameters(self) -> dict[str, FloatArray | float]:
        """Return the fields of the nonlinear printer's record that follow from the kinematics, SI."""
        to_axes: FloatArray = np.linalg.inv(self.motor_matrix).astype(np.float64)
        return {"motor_matrix": self.motor_matrix, "axis_matrix": to_axes}

    @property
    def motors(self) -> FloatArray:
        """Return (3, 3) mm/mm: the motors' motion from the carriages'."""
        return self.motor_matrix

    @property
    def motor_rows(self) -> FloatArray:
        """Return (3, 8), a row per motor: tower x y mm, L² mm², base mm, and weights of X Y Z E."""
        return np.hstack([np.zeros((3, 4)), self.motor_matrix, np.zeros((3, 1))])
