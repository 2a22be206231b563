"""Sub-model 1: one carriage on its belt, without the effector (paper, Eqs. 30-44).

`s` is the Laplace variable, 1/s, of any shape; results have its shape.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.arrays import ComplexArray
from models.machine import Carriage, Drive


def with_added_mass(carriage: Carriage, added_mass_kg: float) -> Carriage:
    """The same carriage with a mass screwed on, m' = m + m_add: `command_frf` is then G'_qd of Eq. 37."""
    return replace(carriage, mass_kg=carriage.mass_kg + added_mass_kg)


def damping(carriage: Carriage) -> float:
    """c + b, N s/m: belt and guide, which the carriage feels as one."""
    return carriage.belt_damping_n_s_per_m + carriage.guide_damping_n_s_per_m


def impedance(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """m s² + (c + b) s + k, N/m: the carriage's characteristic polynomial (Eq. 44)."""
    return carriage.moving_mass_kg * s**2 + damping(carriage) * s + carriage.belt_stiffness_n_per_m


def belt(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """c s + k, N/m: what the motor's motion does to the carriage (numerator of Eq. 32)."""
    return carriage.belt_damping_n_s_per_m * s + carriage.belt_stiffness_n_per_m


def drive_frf(drive: Drive | None, s: ComplexArray) -> ComplexArray:
    """G_qd,e (Eq. 34), -: command to motor position."""
    if drive is None:
        return np.ones_like(s)
    return (drive.d1_per_s * s + drive.d0_per_s2) / (s**2 + drive.d2_per_s * s + drive.d0_per_s2)


def command_frf(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """G_qd (Eq. 31), -: command to carriage position."""
    return belt(carriage, s) / impedance(carriage, s) * drive_frf(carriage.drive, s)


def force_frf(carriage: Carriage, s: ComplexArray) -> ComplexArray:
    """G_Fq (Eq. 44), m/N: the effector's load to carriage position. Negative: a load holds it back."""
    return -1 / impedance(carriage, s)
