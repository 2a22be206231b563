"""A linear delta: carriage heights from the nozzle's position and back, and their rates.

Equations 2-13 of "A Generalized and Efficient Control-Oriented Modeling Approach for Vibration-Prone Delta 3D
Printers Using Receptance Coupling" ("the paper" throughout), written with the joint vectors
s_i = (x − i_x, y − i_y, −h_i) of the arms i, where

    h_i = √(L_i² − (x − i_x)² − (y − i_y)²)

is the height of the carriage joint above the effector joint. Everything but the carriages' heights depends
on (x, y) only.

mm, s; arrays of n points, arms in the order A, B, C.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from models.arrays import BoolArray, FloatArray, constant
from models.kinematics import base
from models.kinematics.base import ALONG, AXES, INSIDE_MM, SLACK_MM, TOWERS, Compiled, Kinematics

LOWEST_Z_MM = -5.0  # below the bed: room for a calibrated or baby-stepped first layer
OUTER_SHARE = 0.8  # of the print radius: a position where the vibrations differ from the centre's


@dataclass(frozen=True, eq=False)
class DeltaKinematics(Kinematics):
    """A linear delta. The radii are effective: tower joint radius minus effector joint radius (Eqs. 3-5)."""

    arm_lengths_mm: FloatArray  # (3,) L
    delta_radii_mm: FloatArray  # (3,)
    tower_angles_deg: FloatArray  # (3,) counter-clockwise from +x
    effector_height_mm: float  # H_ez: the joint plane above the nozzle tip
    print_radius_mm: float
    print_height_mm: float

    calibration_tolerances: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"arm_lengths_mm": 1.0, "delta_radii_mm": 1.0, "tower_angles_deg": 0.5, "effector_height_mm": 1.0}
    )
    excitation_directions: ClassVar[Mapping[str, tuple[str, ...]]] = MappingProxyType(
        {"towers": TOWERS, "xyz": AXES, "all": TOWERS + AXES, **ALONG}
    )
    raisable_axes: ClassVar[str] = "XYZ"

    @property
    def tower_angles_rad(self) -> FloatArray:
        """Return (3,) rad."""
        return np.radians(self.tower_angles_deg)

    @property
    def towers_mm(self) -> FloatArray:
        """Return (3, 2) mm, columns X Y: each arm's carriage joint relative to the effector's centre."""
        angles = self.tower_angles_rad
        return self.delta_radii_mm[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)

    @property
    def bed_radius_mm(self) -> float:
        """Return how far from the middle of the bed the nozzle may go."""
        return self.print_radius_mm

    @property
    def height_mm(self) -> float:
        """Return the greatest height of the nozzle."""
        return self.print_height_mm

    @property
    def slow_zones(self) -> tuple[float, float]:
        """Return radius and shortest arm, mm, which decide where carriages outrun the nozzle."""
        return (float(self.delta_radii_mm.max()), float(self.arm_lengths_mm.min()))

    @property
    def tower_directions(self) -> Mapping[str, FloatArray]:
        """Return the unit vectors (2,) from the centre to each tower."""
        return dict(zip(TOWERS, self.towers_mm / self.delta_radii_mm[:, None], strict=True))

    @property
    def sample_positions(self) -> Mapping[str, FloatArray]:
        """Return name -> position (2,) mm: the few that show how the vibrations change over the bed."""
        towards_a = OUTER_SHARE * self.print_radius_mm / self.delta_radii_mm[0] * self.towers_mm[0]
        share = f"{OUTER_SHARE:.0%}".replace("%", " %")
        return {**super().sample_positions, f"{share} towards A": towards_a, f"{share} away from A": -towards_a}

    @property
    def actuator_names(self) -> tuple[str, str, str]:
        """Return the names of carriages or motors A B C in messages about limits."""
        return "carriage A", "carriage B", "carriage C"

    @property
    def setup_notes(self) -> list[str]:
        """Return a checklist for the printer before its vibrations are measured."""
        return [
            "- The firmware's arm lengths, delta radius and tower angles are those of the machine file:",
            f"  L {_listed(self.arm_lengths_mm)}, R {_listed(self.delta_radii_mm)} mm, "
            f"towers {_listed(self.tower_angles_deg)} degrees.",
        ]

    @property
    def model_reach_mm(self) -> float:
        """Return how far from the origin the vibrations change with position; zero where they are the same."""
        return self.print_radius_mm

    @property
    def spare_reach_mm(self) -> float:
        """Return how far beyond `model_reach_mm` the arms could still go before one lies flat."""
        return float((self.arm_lengths_mm - self.delta_radii_mm).min()) - self.print_radius_mm

    @property
    def motor_rows(self) -> FloatArray:
        """Return (3, 8), a row per motor: tower x y mm, L² mm², base mm, and weights of X Y Z E."""
        up = np.array([0.0, 0.0, 1.0, 0.0])
        heights = np.full((3, 1), self.effector_height_mm)
        return np.hstack([self.towers_mm, self.arm_lengths_mm[:, None] ** 2, heights, np.tile(up, (3, 1))])

    def compiled(self) -> Compiled:
        """Return the compiled equations, for inner loops."""
        from models.kinematics.delta_kernels import FastDelta  # numba is slow to import

        return FastDelta(self.towers_mm, self.arm_lengths_mm, self.effector_height_mm)

    def recalibrated(self, arm_length_mm: FloatArray, delta_radius_mm: FloatArray) -> DeltaKinematics:
        """Return these kinematics with changes (3,) mm added to arms and radii."""
        return replace(
            self,
            arm_lengths_mm=constant(self.arm_lengths_mm + arm_length_mm),
            delta_radii_mm=constant(self.delta_radii_mm + delta_radius_mm),
        )

    def printer_parameters(self) -> dict[str, FloatArray | float]:
        """Return the fields of the nonlinear printer's record that follow from the kinematics, SI."""
        towers, arms = self.towers_mm / 1e3, self.arm_lengths_mm / 1e3
        to_towers = towers[1:] - towers[0]
        return {
            "towers": towers,
            "arms_squared": arms**2,
            "height": self.effector_height_mm / 1e3,
            "to_plane": np.linalg.inv(to_towers),
            "offset": (np.sum(to_towers**2, axis=1) + arms[0] ** 2 - arms[1:] ** 2) / 2,
        }

    def inverse(self, xyz: FloatArray) -> FloatArray:
        """Return the heights (n, 3) mm of the carriages' joints above the bed, q_i = z + H_ez + h_i (Eqs. 3-5)."""
        _, heights = self._arms(xyz)
        return xyz[:, 2:3] + self.effector_height_mm + heights

    def forward(self, q: FloatArray) -> FloatArray:
        """Return nozzle positions, the lower of the two points where the arms' spheres meet (Eqs. 3-5)."""
        xyz = self.compiled().forward(q)
        apart = "The carriages at A = {:.3f}, B = {:.3f}, C = {:.3f} mm stand too far apart for the arms to meet."
        base.require(np.isfinite(xyz[:, 2]), q, apart)
        return xyz

    def jacobian(self, xy: FloatArray) -> FloatArray:
        """Return J = −S⁻¹ diag(s_iᵀp), with Ẋ = J q̇ (Eq. 12); rows s_iᵀ of S, p = (0, 0, −1), so s_iᵀp = h_i.

        (n, 3, 3) mm/mm, rows X Y Z, columns A B C, at xy (n, 2) mm; further columns are ignored.
        """
        if len(xy) == 1:  # a fit needs the same position thousands of times
            return _jacobian_at(self, float(xy[0, 0]), float(xy[0, 1])).copy()
        return self._jacobian(xy)

    def volume_rules(self, xyz: FloatArray) -> list[tuple[BoolArray, str]]:
        """Return which of the points (n, 3) mm obey each rule of the print volume, and where the others lie."""
        z, radius, height = xyz[:, 2], self.print_radius_mm, self.print_height_mm
        inside: BoolArray = np.hypot(xyz[:, 0], xyz[:, 1]) <= radius + SLACK_MM
        return [
            (inside, f"outside the print radius of {radius:g} mm"),
            (z <= height + SLACK_MM, f"above the print height of {height:g} mm"),
            (z >= LOWEST_Z_MM - SLACK_MM, f"below the bed, deeper than {LOWEST_Z_MM:g} mm"),
        ]

    def contains(self, xyz: FloatArray, margin_mm: float = 0.0) -> BoolArray:
        """Return which of the points (n, 2) or (n, 3) mm lie over the bed and, if z is given, in the volume."""
        inside: BoolArray = np.hypot(xyz[:, 0], xyz[:, 1]) <= self.print_radius_mm + margin_mm
        if xyz.shape[1] > 2:
            inside &= (xyz[:, 2] >= -margin_mm) & (xyz[:, 2] <= self.print_height_mm + margin_mm)
        return inside

    def volume_text(self) -> str:
        """Describe the print volume as the end of a sentence: "has a radius of 60 mm and …"."""
        return f"has a radius of {self.print_radius_mm:g} mm and a height of {self.print_height_mm:g} mm"

    def drawn_in(self, xyz: FloatArray, heights: FloatArray) -> FloatArray:
        """Return a command (n, 3) mm clipped to the firmware's limits, for a path with these heights (m,) mm."""
        radius = np.hypot(xyz[:, 0], xyz[:, 1])
        shrink = np.minimum(1.0, (self.print_radius_mm - INSIDE_MM) / np.maximum(radius, 1e-9))
        floor, ceiling = min(0.0, float(heights.min())), max(self.print_height_mm, float(heights.max()))
        inside = xyz * shrink[:, None]
        inside[:, 2] = np.clip(xyz[:, 2], floor, ceiling)
        return np.asarray(inside)

    def centring(self, xy: FloatArray) -> tuple[float, float]:
        """Return the shift, whole mm, that puts points (n, 2) mm in the middle of the bed.

        Centre of the smallest enclosing circle, by steps towards the farthest point (Badoiu & Clarkson, 2003).
        """
        places = np.unique(np.round(xy, 1), axis=0)
        centre = 0.5 * (places.min(axis=0) + places.max(axis=0))
        for step in range(1, 400):
            away = np.hypot(*(places - centre).T)
            centre = centre + (places[int(np.argmax(away))] - centre) / (step + 1)
        x, y = (np.round(-centre) + 0.0).tolist()  # no minus before a zero
        return x, y

    def widening(self, xyz: FloatArray) -> str:
        """Return the machine-file keys that would make these points reachable; empty if none would."""
        radius, height = float(np.ceil(np.hypot(*xyz[:, :2].T).max())), float(np.ceil(xyz[:, 2].max()))
        keys = [f"print_radius_mm = {radius:g}"] if radius > self.print_radius_mm else []
        keys += [f"print_height_mm = {height:g}"] if height > self.print_height_mm else []
        return f"write {', '.join(keys)} in [kinematics] of the machine file" if keys else ""

    def rings(self, radii: int, directions: int) -> FloatArray:
        """Return the origin and circles of these radii (k,) around it, (1 + k · directions, 2)."""
        return base.rings(np.linspace(0, self.print_radius_mm, radii + 1)[1:], directions)

    def around(self, share: float, margin_mm: float) -> FloatArray:
        """Return six positions (6, 2) mm around the centre, at a share of the way out and a margin from the border."""
        radius = min(share * self.print_radius_mm, self.print_radius_mm - margin_mm)
        angles = np.deg2rad(self.tower_angles_deg[0] + 60.0 * np.arange(6))
        return np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])

    def _jacobian(self, xy: FloatArray) -> FloatArray:
        s, heights = self._arms(xy)
        return -np.linalg.inv(s) * heights[:, None, :]

    def _arms(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return joint vectors s_i, (n, 3, 3) with rows A B C and columns X Y Z, and heights h_i, (n, 3); mm."""
        across = xy[:, None, :2] - self.towers_mm
        squared = self.arm_lengths_mm**2 - np.sum(across**2, axis=-1)
        base.require(
            np.all(squared > 0, axis=1),
            xy,
            "The point X = {:.3f}, Y = {:.3f} mm is farther from a tower than the length of its arm.",
        )
        heights = np.sqrt(squared)
        return np.concatenate([across, -heights[:, :, None]], axis=-1), heights


def _listed(values: Sequence[float] | FloatArray) -> str:
    return " ".join(f"{value:g}" for value in values)


@lru_cache(maxsize=64)
def _jacobian_at(kinematics: DeltaKinematics, x: float, y: float) -> FloatArray:
    return kinematics._jacobian(np.array([[x, y]]))
