"""A linear delta: carriage heights from the nozzle's position and back, and their rates.

Equations 2-13 of "A Generalized and Efficient Control-Oriented Modeling Approach for Vibration-Prone Delta 3D
Printers Using Receptance Coupling" ("the paper" throughout), written with the joint vectors
s_i = (x − i_x, y − i_y, −h_i) of the arms i, where

    h_i = √(L_i² − (x − i_x)² − (y − i_y)²)

is how far the carriage joint stands above the effector joint. Everything but the carriages' heights depends
on (x, y) only.

mm, s; arrays of n points, arms in the order A, B, C.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.errors import UnreachableError
from models.machine import DeltaGeometry, FloatArray

LOWEST_Z_MM = -5.0  # below the bed: room for a calibrated or baby-stepped first layer
SLACK_MM = 1e-6  # a point on the rim, written with rounded digits, is inside


def inverse(geometry: DeltaGeometry, xyz: FloatArray) -> FloatArray:
    """Carriage heights q_i = z + H_ez + h_i (Eqs. 3-5).

    Parameters
    ----------
    xyz : (n, 3) mm, columns X Y Z of the nozzle.

    Returns
    -------
    (n, 3) mm, columns A B C: height of each carriage joint above the bed.
    """
    _, heights = _arms(geometry, xyz)
    return xyz[:, 2:3] + geometry.effector_height_mm + heights


def forward(geometry: DeltaGeometry, q: FloatArray) -> FloatArray:
    """Nozzle positions: the lower of the two points where the arms' spheres meet (Eqs. 3-5, solved exactly).

    With r the effector seen from joint A, differences of the spheres are linear, r_xy = u + v r_z; that makes
    sphere A a quadratic in r_z.

    Parameters
    ----------
    q : (n, 3) mm, columns A B C.

    Returns
    -------
    (n, 3) mm, columns X Y Z.
    """
    towers, arms = geometry.towers_mm, geometry.arm_lengths_mm
    to_towers = towers[1:] - towers[0]  # (2, 2), joints B and C seen from A
    rise = q[:, 1:] - q[:, :1]  # (n, 2)
    squared = np.sum(to_towers**2, axis=1) + rise**2
    offset = (squared + arms[0] ** 2 - arms[1:] ** 2) / 2
    to_plane = np.linalg.inv(to_towers)
    u, v = offset @ to_plane.T, -rise @ to_plane.T
    a, b = 1 + np.sum(v**2, axis=1), np.sum(u * v, axis=1)
    discriminant = b**2 - a * (np.sum(u**2, axis=1) - arms[0] ** 2)
    _require(
        discriminant >= 0,
        q,
        "The carriages at A = {:.3f}, B = {:.3f}, C = {:.3f} mm stand too far apart for the arms to meet.",
    )
    rz = -(b + np.sqrt(discriminant)) / a
    height = q[:, 0] - geometry.effector_height_mm
    return np.column_stack([towers[0] + u + v * rz[:, None], height + rz])


def jacobian(geometry: DeltaGeometry, xy: FloatArray) -> FloatArray:
    """J = −S⁻¹ diag(s_iᵀp), with Ẋ = J q̇ (Eq. 12); rows s_iᵀ of S, p = (0, 0, −1), so s_iᵀp = h_i.

    Parameters
    ----------
    xy : (n, 2) mm, columns X Y; further columns are ignored.

    Returns
    -------
    (n, 3, 3) mm/mm, rows X Y Z, columns A B C.
    """
    s, heights = _arms(geometry, xy)
    return -np.linalg.inv(s) * heights[:, None, :]


def jacobian_rate_term(geometry: DeltaGeometry, xyz: FloatArray, velocity: FloatArray) -> FloatArray:
    """J̇ q̇, the part of Ẍ = J q̈ + J̇ q̇ that is there without any carriage acceleration.

    Differentiating s_i·(Ẋ − ẑ q̇_i) = 0 once more: s_i·(Ẍ − ẑ q̈_i) + |Ẋ − ẑ q̇_i|² = 0, so
    J̇ q̇ = −S⁻¹ |ṡ_i|². NOTE: Eq. 13 of the paper has the opposite sign; finite differences agree with ours.

    Parameters
    ----------
    xyz : (n, 3) mm, columns X Y Z; z does not matter.
    velocity : (n, 3) mm/s, of the nozzle.

    Returns
    -------
    (n, 3) mm/s², columns X Y Z.
    """
    s, heights = _arms(geometry, xyz)
    carriage_velocity = -np.einsum("nij,nj->ni", s, velocity) / heights
    vertical = velocity[:, 2:3] - carriage_velocity
    rate_squared = velocity[:, 0:1] ** 2 + velocity[:, 1:2] ** 2 + vertical**2  # (n, 3) |ṡ_i|²
    return -np.linalg.solve(s, rate_squared[:, :, None])[:, :, 0]


def check_reach(geometry: DeltaGeometry, xyz: FloatArray) -> None:
    """Raise UnreachableError if any of the points lies outside the print volume.

    Parameters
    ----------
    xyz : (n, 3) mm, columns X Y Z.
    """
    z = xyz[:, 2]
    radius, height = geometry.print_radius_mm, geometry.print_height_mm
    inside = np.hypot(xyz[:, 0], xyz[:, 1]) <= radius + SLACK_MM
    place = "The point X = {:.3f}, Y = {:.3f}, Z = {:.3f} mm lies "
    _require(inside, xyz, f"{place}outside the print radius of {radius:g} mm.")
    _require(z <= height + SLACK_MM, xyz, f"{place}above the print height of {height:g} mm.")
    _require(z >= LOWEST_Z_MM - SLACK_MM, xyz, f"{place}below the bed, deeper than {LOWEST_Z_MM:g} mm.")


def _arms(geometry: DeltaGeometry, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Joint vectors s_i, (n, 3, 3) with rows A B C and columns X Y Z, and heights h_i, (n, 3); mm."""
    across = xy[:, None, :2] - geometry.towers_mm
    squared = geometry.arm_lengths_mm**2 - np.sum(across**2, axis=-1)
    _require(
        np.all(squared > 0, axis=1),
        xy,
        "The point X = {:.3f}, Y = {:.3f} mm is farther from a tower than its arm is long.",
    )
    heights = np.sqrt(squared)
    return np.concatenate([across, -heights[:, :, None]], axis=-1), heights


def _require(good: NDArray[np.bool_], points: FloatArray, sentence: str) -> None:
    """`sentence` is filled in with the first bad point."""
    bad = np.flatnonzero(~good)
    if bad.size:
        raise UnreachableError(sentence.format(*points[bad[0]]), bad)
