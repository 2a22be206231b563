"""The modes of a machine at a place, and of its parts alone, each with a number, a frequency and a damping ratio."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ffcomp.measurement.frf import AXES
from ffcomp.numerics.serialise import keys
from models.arrays import FloatArray
from models.kinds import delta_vibration
from models.machine import Machine
from models.vibration.mode_map import kinds, numbers
from models.vibration.substructures import damping, with_added_mass

RINGS = 0.3  # modes damped more than this make no peak


@dataclass(frozen=True)
class NumberedMode:
    """A mode at one station."""

    json_keys: ClassVar = keys("number", "frequency_hz", "damping_ratio", "kind")

    number: int | None  # as over the whole bed, by frequency at its centre; None: the drive's own, electrical
    frequency_hz: float
    damping_ratio: float
    kind: str
    axis: str | None = None  # "x": seen along this axis only

    @property
    def sign(self) -> str:
        """Label in figures."""
        return "D" if self.number is None else str(self.number or "–")

    @property
    def rings(self) -> bool:
        """Whether the mode makes a peak."""
        return self.damping_ratio < RINGS


def modes_at(machine: Machine, xy: FloatArray) -> tuple[NumberedMode, ...]:
    """Return the modes at a place, (2,) mm, by the numbers they have over the whole bed."""
    modes = machine.vibration.modes_at(xy)
    hertz, zeta = modes.frequencies_hz.tolist(), modes.damping_ratios.tolist()
    if not machine.vibration.position_dependent:
        along = [AXES[i] for i in np.argmax(np.abs(modes.nozzle), axis=1)]
        each = zip(range(1, len(along) + 1), hertz, zeta, [f"along {axis}" for axis in along], along, strict=True)
        return tuple(NumberedMode(*row) for row in each)
    vibration = delta_vibration(machine)
    found = sorted(zip(numbers(vibration, xy), hertz, zeta, kinds(vibration, xy, modes), strict=True))
    return (*(NumberedMode(*row) for row in found), *_drive_mode(machine))


def carriage_modes(machine: Machine, added_kg: float) -> tuple[NumberedMode, ...]:
    """Return ω_n = √(k/m), ζ = (c + b)/(2 √(k m)) of a carriage on its belt (Eqs. 35, 36), and the drive's mode."""
    carriage = with_added_mass(delta_vibration(machine).carriage, added_kg)
    m, k = carriage.moving_mass_kg, carriage.belt_stiffness_n_per_m
    on_belt = NumberedMode(1, *_mode(np.sqrt(k / m), damping(carriage) / m), "on its belt")
    return on_belt, *_drive_mode(machine)


def effector_modes(machine: Machine) -> tuple[NumberedMode, ...]:
    """Return ω_p of Eq. 48 along each axis, ζ = b ω_p/(2 k), slowest first."""
    effector = delta_vibration(machine).effector
    m1, m2, k = effector.nozzle_mass_kg, effector.extruder_mass_kg, effector.extruder_stiffness_n_per_m
    omega = np.sqrt((m1 + m2) * k / (m1 * m2))
    each = map(_mode, omega, effector.extruder_damping_n_s_per_m * omega**2 / k)
    found = sorted((*mode, axis) for mode, axis in zip(each, AXES, strict=True))
    return tuple(NumberedMode(number, f, z, f"along {axis}", axis) for number, (f, z, axis) in enumerate(found, 1))


def _drive_mode(machine: Machine) -> tuple[NumberedMode, ...]:
    """Return the pole of Eq. 34, where it swings."""
    drive = delta_vibration(machine).carriage.drive
    if drive is None or drive.d2_per_s >= 2 * np.sqrt(drive.d0_per_s2):
        return ()
    return (NumberedMode(None, *_mode(np.sqrt(drive.d0_per_s2), drive.d2_per_s), "drive"),)


def _mode(omega: float, decay: float) -> tuple[float, float]:
    """Return frequency, Hz, and damping ratio of s² + decay s + omega²."""
    return float(omega / (2 * np.pi)), float(decay / (2 * omega))
