"""Do a machine's numbers agree with each other, with what was measured, and does the model hold still?

The paper's identification measures some numbers twice (Eqs. 30-49). A machine file may keep the measurements
in `[provenance.measured]`; those that are there are compared:

    natural_frequency_rad_per_s          ω_n   carriage without effector
    damping_ratio                        ζ
    added_mass_kg                        m_add
    loaded_natural_frequency_rad_per_s   ω'_n  the same with m_add on it
    loaded_damping_ratio                 ζ'
    hammer_zero_rad_per_s                ω_z   effector struck by a hammer
    hammer_pole_rad_per_s                ω_p
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.machine import FloatArray, Machine
from models.receptance import poles

TOLERANCE = 0.05  # of the file's number; what two careful measurements of one quantity may differ by


@dataclass(frozen=True)
class _Check:
    key: str  # what of the file is compared, for the sentence
    rule: str
    needs: tuple[str, ...]  # keys of [provenance.measured]
    of_file: Callable[[Machine], float]
    of_measured: Callable[..., float]  # (machine, *needs)


def _mass(machine: Machine) -> float:
    return machine.carriage.moving_mass_kg


def _damping(machine: Machine) -> float:
    return machine.carriage.belt_damping_n_s_per_m + machine.carriage.guide_damping_n_s_per_m


def _stiffness(machine: Machine) -> float:
    return machine.carriage.belt_stiffness_n_per_m


def _loaded_mass(_: Machine, omega: float, loaded: float, added: float) -> float:
    return loaded**2 / (omega**2 - loaded**2) * added


CHECKS = (
    _Check(
        "mass_kg + arm_pair_mass_kg/2 (kg)",
        "m = ω'_n²/(ω_n² − ω'_n²) m_add (Eqs. 30, 41)",
        ("natural_frequency_rad_per_s", "loaded_natural_frequency_rad_per_s", "added_mass_kg"),
        _mass,
        _loaded_mass,
    ),
    _Check(
        "belt_stiffness_n_per_m",
        "k = m ω_n² (Eqs. 30, 36)",
        ("natural_frequency_rad_per_s",),
        _stiffness,
        lambda machine, omega: _mass(machine) * omega**2,
    ),
    _Check(
        "belt_damping + guide_damping (N s/m)",
        "c + b = 2 ζ ω_n m (Eq. 35)",
        ("natural_frequency_rad_per_s", "damping_ratio"),
        _damping,
        lambda machine, omega, zeta: 2 * zeta * omega * _mass(machine),
    ),
    _Check(
        "belt_damping + guide_damping (N s/m)",
        "c + b = 2 ζ' ω'_n (m + m_add) (Eq. 39)",
        ("loaded_natural_frequency_rad_per_s", "loaded_damping_ratio", "added_mass_kg"),
        _damping,
        lambda machine, omega, zeta, added: 2 * zeta * omega * (_mass(machine) + added),
    ),
    _Check(
        "nozzle_mass_kg",
        "m_1 = (ω_z/ω_p)² (m_1 + m_2) (Eq. 49)",
        ("hammer_zero_rad_per_s", "hammer_pole_rad_per_s"),
        lambda machine: machine.effector.nozzle_mass_kg,
        lambda machine, zero, pole: (
            (zero / pole) ** 2 * (machine.effector.nozzle_mass_kg + machine.effector.extruder_mass_kg)
        ),
    ),
    _Check(
        "the stiffest of extruder_stiffness_n_per_m",
        "k = m_2 ω_z² (Eq. 47), if the hammer struck along that axis",
        ("hammer_zero_rad_per_s",),
        lambda machine: float(np.max(machine.effector.extruder_stiffness_n_per_m)),
        lambda machine, zero: machine.effector.extruder_mass_kg * zero**2,
    ),
)


def inconsistencies(machine: Machine) -> list[str]:
    """Sentences about numbers that disagree by more than 5 %."""
    measured: Mapping[str, Any] = machine.provenance.get("measured", {})
    return [sentence for check in CHECKS for sentence in _compare(check, machine, measured)]


def _compare(check: _Check, machine: Machine, measured: Mapping[str, Any]) -> Iterator[str]:
    if not all(key in measured for key in check.needs):
        return
    ours, theirs = check.of_file(machine), check.of_measured(machine, *(measured[key] for key in check.needs))
    if abs(theirs - ours) > TOLERANCE * abs(ours):
        yield (
            f"{check.key} = {ours:.4g}, but the measured numbers give {theirs:.4g} by {check.rule}: "
            f"{100 * (theirs / ours - 1):+.0f} %."
        )


def unstable_places(machine: Machine, radii: int = 6, directions: int = 24) -> FloatArray:
    """Where, on a polar grid over the bed, a vibration of the model grows (or never decays).

    Returns
    -------
    (k, 2) mm, columns X Y; empty for a sound machine.
    """
    radius = np.linspace(0, machine.kinematics.print_radius_mm, radii)
    angle = np.linspace(0, 2 * np.pi, directions, endpoint=False)
    xy = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], axis=-1).reshape(-1, 2)
    return xy[poles(machine, xy).real.max(axis=1) >= 0]
