"""What a machine is, as frozen data: one part per table of the machine file, in the file's own units.

mm, s, kg, N; stiffness N/m, damping N s/m. Towers and carriages are always in the order A, B, C. Arrays are
read-only; parts compare by identity, so a machine may serve as the key of a cache.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from models.arrays import FloatArray, constant
from models.errors import MachineFileError
from models.kinematics.base import Kinematics
from models.kinematics.delta import DeltaKinematics

__all__ = [
    "Carriage",
    "DeltaKinematics",
    "Drive",
    "Effector",
    "Kinematics",
    "Machine",
    "MotionLimits",
    "Steps",
]


@dataclass(frozen=True)
class Drive:
    """Electrical dynamics of the stepper, (d₁ s + d₀)/(s² + d₂ s + d₀) (paper, Eq. 34)."""

    d0_per_s2: float
    d1_per_s: float
    d2_per_s: float


@dataclass(frozen=True)
class Carriage:
    """One carriage on its belt: sub-model 1 of the paper (Eqs. 30-34). Where carriages differ, numbers are (3,)."""

    mass_kg: float  # m_c
    arm_pair_mass_kg: float  # m_f
    belt_stiffness_n_per_m: float  # k
    belt_damping_n_s_per_m: float  # c, between motor and carriage
    guide_damping_n_s_per_m: float  # b, between carriage and rail
    drive: Drive | None = None  # None: an ideal drive

    @property
    def moving_mass_kg(self) -> float:
        """m = m_c + m_f / 2 (Eq. 30)."""
        return self.mass_kg + self.arm_pair_mass_kg / 2


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


@dataclass(frozen=True)
class MotionLimits:
    """Of the nozzle, for planning; of the command to each motor, for compensation."""

    velocity_mm_per_s: float
    acceleration_mm_per_s2: float
    square_corner_velocity_mm_per_s: float = 5.0
    carriage_velocity_mm_per_s: float = 500.0
    carriage_acceleration_mm_per_s2: float = 30000.0
    z_velocity_mm_per_s: float | None = None  # of the nozzle along Z; None: as in any direction
    z_acceleration_mm_per_s2: float | None = None
    carriage_travel_mm: tuple[float, float] | None = None  # lowest and highest place of a carriage; None: not known
    step_rate_hz: float | None = None  # of each motor, microsteps; None: whatever its velocity needs


@dataclass(frozen=True)
class Steps:
    """Of the carriage motors, and of the extruder's."""

    steps_per_mm: float | tuple[float, ...] = 80.0  # microsteps; of all motors, or of each
    full_steps_per_mm: float | tuple[float, ...] = 5.0
    extruder_steps_per_mm: float | None = None  # of filament; None: not said

    @property
    def per_motor(self) -> FloatArray:
        """(3,) microsteps/mm of motors A B C."""
        return constant(np.broadcast_to(self.steps_per_mm, 3))

    @property
    def full_per_motor(self) -> FloatArray:
        """(3,) full steps/mm of motors A B C."""
        return constant(np.broadcast_to(self.full_steps_per_mm, 3))


@dataclass(frozen=True, eq=False)
class Machine:
    """Everything a machine file says."""

    name: str
    kinematics: Kinematics
    carriage: Carriage
    effector: Effector
    limits: MotionLimits
    steps: Steps = Steps()
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # effect name -> its parameters
    uncertainty: Mapping[str, float] = field(default_factory=dict)  # "table.key" or "default" -> relative s.d.
    provenance: Mapping[str, Any] = field(default_factory=dict)  # "table.key" -> where the number is from; free
    sha256: str = ""  # of the file's bytes; empty: made in memory
    path: str = ""
    first_share: FloatArray | None = None  # (3,) of straight axes, see `models/vibration/modal.py`; None: a delta

    @property
    def has_straight_axes(self) -> bool:
        """Cartesian or CoreXY: axes with modes of their own instead of carriages that carry an effector."""
        return self.first_share is not None

    @property
    def delta(self) -> DeltaKinematics:
        """Its geometry as a delta's; MachineFileError if it is none."""
        if not isinstance(self.kinematics, DeltaKinematics):
            rule = "The machine is no delta (kinematics.type), and this works for deltas only."
            raise MachineFileError(self.path or self.name, [rule])
        return self.kinematics

    @property
    def nozzle_side_mass_kg(self) -> float:
        """M₁ of Eq. 61: the nozzle holder and the lower halves of the three arm pairs, m_1 + 3 m_f / 2."""
        return self.effector.nozzle_mass_kg + 1.5 * self.carriage.arm_pair_mass_kg
