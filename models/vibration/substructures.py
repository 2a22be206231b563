"""The paper's two sub-models: a carriage on its belt (Eqs. 30-44), the effector on three arms (Eqs. 14-27, 50-62).

`s` is the Laplace variable, 1/s, of any shape; results have its shape.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from models.arrays import ComplexArray, FloatArray


@dataclass(frozen=True)
class Drive:
    """Electrical dynamics of the stepper, (d₁ s + d₀)/(s² + d₂ s + d₀) (paper, Eq. 34)."""

    d0_per_s2: float
    d1_per_s: float
    d2_per_s: float

    @property
    def lag(self) -> tuple[float, float]:
        """Return p s and q s² of the filter's inverse, 1 + p s + q s² + …."""
        d0, d1, d2 = self.d0_per_s2, self.d1_per_s, self.d2_per_s
        return (d2 - d1) / d0, 1.0 / d0 - (d2 - d1) * d1 / d0**2


@dataclass(frozen=True)
class Carriage:
    """One carriage on its belt: sub-model 1 of the paper (Eqs. 30-34). Where carriages differ, numbers are (3,)."""

    mass_kg: float  # m_c
    arm_pair_mass_kg: float  # m_f
    belt_stiffness_n_per_m: float  # k
    belt_damping_n_s_per_m: float  # c, between motor and carriage
    guide_damping_n_s_per_m: float  # b, between carriage and rail
    drive: Drive | None = None  # None: an ideal drive
    arm_mass_share_at_ends: float = 1.0  # of m_f; the rest lies evenly along the arms

    @property
    def arm_inertia_kg(self) -> float:
        """Return ν = (1 − share at the ends) m_f/6: the kinetic energy is lower per arm pair by ½ ν |Ẋ − ẑ q̇|²."""
        return (1.0 - self.arm_mass_share_at_ends) * self.arm_pair_mass_kg / 6

    @property
    def moving_mass_kg(self) -> float:
        """Return m = m_c + m_f / 2 (Eq. 30)."""
        return self.mass_kg + self.arm_pair_mass_kg / 2


def with_added_mass(carriage: Carriage, added_mass_kg: float) -> Carriage:
    """Return the same carriage with a mass screwed on, m' = m + m_add: `command_frf` is then G'_qd of Eq. 37."""
    return replace(carriage, mass_kg=carriage.mass_kg + added_mass_kg)


def damping(carriage: Carriage) -> float:
    """Return c + b, N s/m: belt and guide, which act on the carriage as one."""
    return carriage.belt_damping_n_s_per_m + carriage.guide_damping_n_s_per_m


def impedance(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """Return m s² + (c + b) s + k, N/m: the carriage's characteristic polynomial (Eq. 44)."""
    return carriage.moving_mass_kg * s**2 + damping(carriage) * s + carriage.belt_stiffness_n_per_m


def belt(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """Return c s + k, N/m: the motor's action on the carriage (numerator of Eq. 32)."""
    return carriage.belt_damping_n_s_per_m * s + carriage.belt_stiffness_n_per_m


def drive_frf(drive: Drive | None, s: ComplexArray) -> ComplexArray:
    """Return G_qd,e (Eq. 34), -: command to motor position."""
    if drive is None:
        return np.ones_like(s)
    return (drive.d1_per_s * s + drive.d0_per_s2) / (s**2 + drive.d2_per_s * s + drive.d0_per_s2)


def command_frf(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """Return G_qd (Eq. 31), -: command to carriage position."""
    return belt(carriage, s) / impedance(carriage, s) * drive_frf(carriage.drive, s)


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
    """Return W(s)/s², (k, 3) kg: the effector's apparent mass.

    W(s) = M₁s² + Bs + K − (Bs+K)(M₂s²+Bs+K)⁻¹(Bs+K) (Eq. 61), for three uncoupled axes.
    """
    s = s[:, None]
    mount = effector.extruder_damping_n_s_per_m * s + effector.extruder_stiffness_n_per_m
    # Eq. 61 with its two mount terms joined: Bs + K − (Bs+K)²/(M₂s²+Bs+K) = M₂s² (Bs+K)/(M₂s²+Bs+K),
    # which keeps its digits where stiffness cancels stiffness, at low frequency.
    return nozzle_side_kg + effector.extruder_mass_kg * mount / (effector.extruder_mass_kg * s**2 + mount)


def load_distribution(tower_angles_rad: FloatArray, effector: Effector) -> FloatArray:
    """Return the matrices P_i: arm i's share of the force on the effector, minimum norm (Eqs. 19-23).

    (3, 3, 3) N/N: arms A B C, rows X Y Z of the arm's force, columns X Y Z of the whole force.
    """
    angles = tower_angles_rad
    joints = effector.joint_radius_mm * np.stack([np.cos(angles), np.sin(angles), np.zeros(3)], axis=-1)
    # S(r_i) of Eq. 20, with S(r) f = r × f
    moments = [np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) for x, y, z in joints - effector.center_of_mass_mm]
    balance = np.block([[np.eye(3)] * 3, moments])  # L of Eq. 21
    return np.linalg.pinv(balance)[:, :3].reshape(3, 3, 3)
