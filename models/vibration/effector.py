"""Sub-model 2: the force the effector's motion asks for, and how three arms share it (paper, Eqs. 14-27 and 50-62)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from models.arrays import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class Effector:
    """Nozzle holder and extruder, joined by a spring and a damper per axis: sub-model 2 (Eqs. 50-62)."""

    nozzle_mass_kg: float  # m_1, without the arms' halves
    extruder_mass_kg: float  # m_2
    extruder_stiffness_n_per_m: FloatArray  # (3,) k_x k_y k_z
    extruder_damping_n_s_per_m: FloatArray  # (3,) b_x b_y b_z
    joint_radius_mm: float  # D_e
    center_of_mass_mm: FloatArray  # (3,) delta_x delta_y delta_z, from the joints' centroid
    force_map: Literal["virtual_work", "paper"] = "virtual_work"  # "paper": Eqs. 22-27


def apparent_mass(effector: Effector, nozzle_side_kg: float, s: ComplexArray) -> ComplexArray:
    """Return W(s)/s², (k, 3) kg: the mass the effector appears to have when it is excited.

    W(s) = M₁s² + Bs + K − (Bs+K)(M₂s²+Bs+K)⁻¹(Bs+K) (Eq. 61), for three uncoupled axes.
    """
    s = s[:, None]
    mount = effector.extruder_damping_n_s_per_m * s + effector.extruder_stiffness_n_per_m
    # Eq. 61 with its two mount terms joined: Bs + K − (Bs+K)²/(M₂s²+Bs+K) = M₂s² (Bs+K)/(M₂s²+Bs+K),
    # which keeps its digits where stiffness cancels stiffness, at low frequency.
    return nozzle_side_kg + effector.extruder_mass_kg * mount / (effector.extruder_mass_kg * s**2 + mount)


def load_distribution(tower_angles_rad: FloatArray, effector: Effector) -> FloatArray:
    """Return the matrices P_i: arm i's share of the force on the effector, minimum norm (Eqs. 19-23).

    Returns
    -------
    (3, 3, 3) N/N: arms A B C, rows X Y Z of the arm's force, columns X Y Z of the whole force.
    """
    angles = tower_angles_rad
    joints = effector.joint_radius_mm * np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=-1)
    moments = [_cross_matrix(r) for r in joints - effector.center_of_mass_mm]  # S(r_i), Eq. 20
    balance = np.block([[np.eye(3)] * 3, moments])  # L of Eq. 21
    return np.linalg.pinv(balance)[:, :3].reshape(3, 3, 3)


def _cross_matrix(r: FloatArray) -> FloatArray:
    """Return S(r), with S(r) f = r × f."""
    x, y, z = r
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
