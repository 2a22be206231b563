"""Receptance coupling: carriages and effector joined into one position-dependent model (paper, Eqs. 26-29).

    G(s) = [(m s² + (c+b) s + k) I + Γ W(s) J]⁻¹ (c s + k) G_e(s)

which is Eq. 29 multiplied through by the carriage's impedance. Its poles come from the same equations written
with masses, in the carriages q and the extruder's displacement relative to the nozzle holder, η = X₂ − X:

    ⎡ m I + Γ M₁ J + Γ M₂ J   Γ M₂ ⎤ ⎡q̈⎤   ⎡(c+b) I  0⎤ ⎡q̇⎤   ⎡k I  0⎤ ⎡q⎤
    ⎣         M₂ J             M₂  ⎦ ⎣η̈⎦ + ⎣   0     B⎦ ⎣η̇⎦ + ⎣ 0   K⎦ ⎣η⎦ = 0
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.carriage import ComplexArray, belt, drive_frf, impedance
from models.effector import effector_impedance, load_map
from models.kinematics.delta import jacobian
from models.machine import FloatArray, Machine


@dataclass(frozen=True, eq=False)
class Modes:
    """The vibrations at one place, slowest first; the drive filter's own poles are not among them."""

    frequencies_hz: FloatArray  # (k,) undamped natural frequencies; k = 6 unless a mode is overdamped
    damping_ratios: FloatArray  # (k,)


def carriage_frf(machine: Machine, xy: FloatArray, frequency_hz: FloatArray) -> ComplexArray:
    """G of Eq. 29 at one place: commanded to real carriage position.

    Parameters
    ----------
    xy : (2,) mm, columns X Y.
    frequency_hz : (k,) Hz.

    Returns
    -------
    (k, 3, 3), rows real carriage A B C, columns commanded carriage A B C.
    """
    j, gamma = jacobian(machine.kinematics, xy[None])[0], load_map(machine, xy[None])[0]
    s = np.asarray(2j * np.pi * frequency_hz, dtype=np.complex128)
    load = (gamma * effector_impedance(machine, s)[:, None, :]) @ j
    stiffness = load + impedance(machine.carriage, s)[:, None, None] * np.eye(3)
    drive = belt(machine.carriage, s) * drive_frf(machine.carriage.drive, s)
    return np.linalg.inv(stiffness) * drive[:, None, None]


def nozzle_frf(machine: Machine, xy: FloatArray, frequency_hz: FloatArray) -> ComplexArray:
    """J G J⁻¹ at one place: commanded to real nozzle position, for small motion; see `carriage_frf`."""
    j = jacobian(machine.kinematics, xy[None])[0]
    return j @ carriage_frf(machine, xy, frequency_hz) @ np.linalg.inv(j)


def poles(machine: Machine, xy: FloatArray) -> ComplexArray:
    """The twelve mechanical poles at each place.

    Parameters
    ----------
    xy : (n, 2) mm, columns X Y.

    Returns
    -------
    (n, 12) 1/s.
    """
    mass, damping, stiffness = _matrices(machine, xy)
    state = np.zeros((len(xy), 12, 12))
    state[:, :6, 6:] = np.eye(6)
    state[:, 6:, :6] = -np.linalg.solve(mass, np.broadcast_to(stiffness, mass.shape))
    state[:, 6:, 6:] = -np.linalg.solve(mass, np.broadcast_to(damping, mass.shape))
    return np.linalg.eigvals(state).astype(np.complex128)


def modes(machine: Machine, xy: FloatArray) -> Modes:
    """Natural frequencies and damping ratios at one place.

    Parameters
    ----------
    xy : (2,) mm, columns X Y.
    """
    every = poles(machine, xy[None])[0]
    upper = every[every.imag > 0]
    upper = upper[np.argsort(np.abs(upper))]
    return Modes(np.abs(upper) / (2 * np.pi), -upper.real / np.abs(upper))


def _matrices(machine: Machine, xy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mass (n, 6, 6) kg, damping (6, 6) N s/m, stiffness (6, 6) N/m, of (q_A, q_B, q_C, η_x, η_y, η_z)."""
    carriage, effector = machine.carriage, machine.effector
    j, gamma = jacobian(machine.kinematics, xy), load_map(machine, xy)
    extruder = effector.extruder_mass_kg
    carriages = carriage.moving_mass_kg * np.eye(3) + (machine.nozzle_side_mass_kg + extruder) * gamma @ j
    relative = np.broadcast_to(extruder * np.eye(3), j.shape)
    mass = np.block([[carriages, extruder * gamma], [extruder * j, relative]])
    viscous = carriage.belt_damping_n_s_per_m + carriage.guide_damping_n_s_per_m
    damping = np.diag([*[viscous] * 3, *effector.extruder_damping_n_s_per_m])
    stiffness = np.diag([*[carriage.belt_stiffness_n_per_m] * 3, *effector.extruder_stiffness_n_per_m])
    return mass, damping, stiffness
