"""Sub-model 1: one carriage on its belt, without the effector (paper, Eqs. 30-44).

`s` is the Laplace variable, 1/s, of any shape; results have its shape.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.arrays import ComplexArray


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
        """Return ν = (1 − share at the ends) m_f/6: what the kinetic energy lacks, per arm pair, is ½ ν |Ẋ − ẑ q̇|²."""
        return (1.0 - self.arm_mass_share_at_ends) * self.arm_pair_mass_kg / 6

    @property
    def moving_mass_kg(self) -> float:
        """Return m = m_c + m_f / 2 (Eq. 30)."""
        return self.mass_kg + self.arm_pair_mass_kg / 2


def with_added_mass(carriage: Carriage, added_mass_kg: float) -> Carriage:
    """Return the same carriage with a mass screwed on, m' = m + m_add: `command_frf` is then G'_qd of Eq. 37."""
    return replace(carriage, mass_kg=carriage.mass_kg + added_mass_kg)


def damping(carriage: Carriage) -> float:
    """Return c + b, N s/m: belt and guide, which the carriage feels as one."""
    return carriage.belt_damping_n_s_per_m + carriage.guide_damping_n_s_per_m


def impedance(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """Return m s² + (c + b) s + k, N/m: the carriage's characteristic polynomial (Eq. 44)."""
    return carriage.moving_mass_kg * s**2 + damping(carriage) * s + carriage.belt_stiffness_n_per_m


def belt(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """Return c s + k, N/m: what the motor's motion does to the carriage (numerator of Eq. 32)."""
    return carriage.belt_damping_n_s_per_m * s + carriage.belt_stiffness_n_per_m


def drive_frf(drive: Drive | None, s: ComplexArray) -> ComplexArray:
    """Return G_qd,e (Eq. 34), -: command to motor position."""
    if drive is None:
        return np.ones_like(s)
    return (drive.d1_per_s * s + drive.d0_per_s2) / (s**2 + drive.d2_per_s * s + drive.d0_per_s2)


def command_frf(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """Return G_qd (Eq. 31), -: command to carriage position."""
    return belt(carriage, s) / impedance(carriage, s) * drive_frf(carriage.drive, s)


def force_frf(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """Return G_Fq (Eq. 44), m/N: the effector's load to carriage position. Negative: a load holds it back."""
    return -1 / impedance(carriage, s)
