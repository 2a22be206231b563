"""Receptance coupling: carriages and effector joined into one position-dependent model (paper, Eqs. 26-29).

    G(s) = Z(s)⁻¹ (c s + k) G_e(s),   Z(s) = (m s² + (c+b) s + k) I + Γ W(s) J

which is Eq. 29 multiplied through by the carriage's impedance. Its poles come from the same equations written
with masses, in the carriages q and the extruder's displacement relative to the nozzle holder, η = X₂ − X:

    ⎡ m I + Γ M₁ J + Γ M₂ J   Γ M₂ ⎤ ⎡q̈⎤   ⎡(c+b) I  0⎤ ⎡q̇⎤   ⎡k I  0⎤ ⎡q⎤
    ⎣         M₂ J             M₂  ⎦ ⎣η̈⎦ + ⎣   0     B⎦ ⎣η̇⎦ + ⎣ 0   K⎦ ⎣η⎦ = 0

The carriages' k, c and b may be three numbers, A B C (`effective_machine` makes them so).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.machine import Machine
from models.vibration.carriage import belt, damping, drive_frf, impedance
from models.vibration.effector import effector_impedance, load_map
from models.vibration.modal import axis_frf
from models.vibration.state_space import continuous_plant

SWINGING = 1e-6  # imaginary part of a pole over its size; below, rounding alone keeps two real poles from meeting

Output = Literal["carriage", "nozzle", "acceleration"]  # what answers; acceleration: of the nozzle holder, s² X
Input = Literal["carriage", "nozzle"]  # what is commanded: three carriages, or the nozzle's three axes


@dataclass(frozen=True, eq=False)
class Modes:
    """The vibrations at one place, slowest first; the drive filter's own poles are not among them."""

    frequencies_hz: FloatArray  # (k,) undamped natural frequencies; k = 6 unless a mode is overdamped
    damping_ratios: FloatArray  # (k,)
    shapes: ComplexArray  # (k, 6) amplitudes of q_A q_B q_C η_x η_y η_z, length 1


def receptance(machine: Machine, xy: FloatArray, frequency_hz: FloatArray) -> ComplexArray:
    """Z⁻¹ at one place, motors held: forces on the carriages to their positions.

    Parameters
    ----------
    xy : (2,) mm, columns X Y.
    frequency_hz : (k,) Hz.

    Returns
    -------
    (k, 3, 3) m/N, rows position of carriage A B C, columns force on carriage A B C.
    """
    j, gamma = machine.kinematics.jacobian(xy[None])[0], load_map(machine, xy[None])[0]
    s = _s(frequency_hz)
    load = (gamma * effector_impedance(machine, s)[:, None, :]) @ j
    return np.linalg.inv(load + impedance(machine.carriage, s[:, None])[:, :, None] * np.eye(3))


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
    if machine.has_straight_axes:
        return np.asarray(axis_frf(machine, _s(frequency_hz))[:, None, :] * np.eye(3))
    s = _s(frequency_hz)[:, None]  # against carriages that may differ
    drive = belt(machine.carriage, s) * drive_frf(machine.carriage.drive, s)
    return receptance(machine, xy, frequency_hz) * drive[:, None, :]


def nozzle_frf(machine: Machine, xy: FloatArray, frequency_hz: FloatArray) -> ComplexArray:
    """J G J⁻¹ at one place: commanded to real nozzle position, for small motion; see `assembly_frf`."""
    return assembly_frf(machine, xy, frequency_hz, "nozzle", "nozzle")


def assembly_frf(
    machine: Machine, xy: FloatArray, frequency_hz: FloatArray, of: Output = "carriage", per: Input = "carriage"
) -> ComplexArray:
    """The whole printer at one place, for small motion: G, J G, G J⁻¹, J G J⁻¹, or one of them times s².

    Parameters
    ----------
    xy : (2,) mm, columns X Y.
    frequency_hz : (k,) Hz.

    Returns
    -------
    (k, 3, 3) mm/mm, of acceleration 1/s²; rows what answers (A B C or X Y Z), columns what is commanded.
    """
    g = carriage_frf(machine, xy, frequency_hz)
    j = machine.kinematics.jacobian(xy[None])[0]
    if of != "carriage":
        g = j @ g
    if per == "nozzle":
        g = g @ np.linalg.inv(j)
    return g * _s(frequency_hz)[:, None, None] ** 2 if of == "acceleration" else g


def poles(machine: Machine, xy: FloatArray) -> ComplexArray:
    """The twelve mechanical poles at each place.

    Parameters
    ----------
    xy : (n, 2) mm, columns X Y.

    Returns
    -------
    (n, 12) 1/s.
    """
    return np.linalg.eigvals(_state_matrix(machine, xy)).astype(np.complex128)


def modes(machine: Machine, xy: FloatArray) -> Modes:
    """Natural frequencies, damping ratios and shapes at one place.

    Parameters
    ----------
    xy : (2,) mm, columns X Y.
    """
    return modes_at(machine, xy[None])[0]


def modes_at(machine: Machine, xy: FloatArray) -> list[Modes]:
    """`modes` at many places at once: a list of n for xy (n, 2) mm, columns X Y."""
    values, vectors = np.linalg.eig(_state_matrix(machine, xy))
    return [_vibrations(pole, vector[:6]) for pole, vector in zip(values, vectors, strict=True)]


def _vibrations(pole: ComplexArray, shape: ComplexArray) -> Modes:
    """Of 12 poles (12,) and their shapes (6, 12), those that swing."""
    upper = np.flatnonzero(pole.imag > SWINGING * np.abs(pole))
    upper = upper[np.argsort(np.abs(pole[upper]))]
    natural = np.abs(pole[upper])
    swinging = shape[:, upper].T
    length = np.linalg.norm(swinging, axis=1, keepdims=True)
    return Modes(natural / (2 * np.pi), -pole[upper].real / natural, swinging / length)


def _s(frequency_hz: FloatArray) -> ComplexArray:
    return np.asarray(2j * np.pi * frequency_hz, dtype=np.complex128)


def _state_matrix(machine: Machine, xy: FloatArray) -> FloatArray:
    """d/dt of (q, η, q̇, η̇), (n, 12, 12)."""
    if machine.has_straight_axes:
        order = np.arange(12).reshape(4, 3)[[0, 2, 1, 3]].ravel()  # of q, q̇, η, η̇
        return continuous_plant(machine, xy).a[:, 6:, 6:][:, order][:, :, order]
    mass, damper, stiffness = _matrices(machine, xy)
    state = np.zeros((len(xy), 12, 12))
    state[:, :6, 6:] = np.eye(6)
    state[:, 6:, :6] = -np.linalg.solve(mass, np.broadcast_to(stiffness, mass.shape))
    state[:, 6:, 6:] = -np.linalg.solve(mass, np.broadcast_to(damper, mass.shape))
    return state


def _matrices(machine: Machine, xy: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mass (n, 6, 6) kg, damping (6, 6) N s/m, stiffness (6, 6) N/m, of (q_A, q_B, q_C, η_x, η_y, η_z)."""
    carriage, effector = machine.carriage, machine.effector
    j, gamma = machine.kinematics.jacobian(xy), load_map(machine, xy)
    extruder = effector.extruder_mass_kg
    carriages = carriage.moving_mass_kg * np.eye(3) + (machine.nozzle_side_mass_kg + extruder) * gamma @ j
    relative = np.broadcast_to(extruder * np.eye(3), j.shape)
    mass = np.block([[carriages, extruder * gamma], [extruder * j, relative]])
    damper = np.diag([*np.broadcast_to(damping(carriage), 3), *effector.extruder_damping_n_s_per_m])
    stiffness = np.diag([*np.broadcast_to(carriage.belt_stiffness_n_per_m, 3), *effector.extruder_stiffness_n_per_m])
    return mass, damper, stiffness
