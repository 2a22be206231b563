"""A machine as frozen data, in the machine file's own units.

mm, s, kg, N; stiffness N/m, damping N s/m. Towers and carriages are always in the order A, B, C. Arrays are
read-only; parts compare by identity, so a machine may serve as the key of a cache.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from models.arrays import FloatArray, constant
from models.kinematics.base import Kinematics
from models.pressure import Pressure
from models.vibration.base import VibrationModel


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
    stated: tuple[str, ...] = ()  # keys that the machine file states; the others are what most printers have

    @property
    def per_motor(self) -> FloatArray:
        """(3,) microsteps/mm of motors A B C."""
        return constant(np.broadcast_to(self.steps_per_mm, 3))

    @property
    def full_per_motor(self) -> FloatArray:
        """(3,) full steps/mm of motors A B C."""
        return constant(np.broadcast_to(self.full_steps_per_mm, 3))


Four = tuple[float, float, float, float]


@dataclass(frozen=True)
class MarlinSettings:
    """Settings of Marlin's planner; four values are in the order X Y Z E (A B C E of a delta's towers)."""

    speed_mm_per_s: Four  # M203
    acceleration_mm_per_s2: Four  # M201
    printing_acceleration_mm_per_s2: float = 3000.0  # M204 P
    retract_acceleration_mm_per_s2: float = 3000.0  # M204 R
    travel_acceleration_mm_per_s2: float = 3000.0  # M204 T
    junction_deviation_mm: float | None = None  # M205 J; None: classic jerk
    jerk_mm_per_s: Four = (10.0, 10.0, 0.3, 5.0)  # M205 X Y Z E, of classic jerk
    lowest_speed_mm_per_s: float = 0.0  # M205 S, of moves that extrude
    lowest_travel_speed_mm_per_s: float = 0.0  # M205 T
    shortest_segment_s: float = 0.02  # M205 B, which SLOWDOWN heeds
    minimum_steps_per_segment: int = 6  # MIN_STEPS_PER_SEGMENT
    slowdown: bool = True  # SLOWDOWN: the first blocks after a rest take longer; no delta has it
    segments_per_second: float = 200.0  # DELTA_SEGMENTS_PER_SECOND
    stated: tuple[str, ...] = ()  # keys that the machine file states; the others are Marlin's defaults

    @classmethod
    def within(cls, limits: MotionLimits) -> MarlinSettings:
        """Return Marlin's defaults, with the nozzle's limits for the axes and a usual extruder's for the filament."""
        v, a = limits.velocity_mm_per_s, limits.acceleration_mm_per_s2
        return cls(
            (v, v, limits.z_velocity_mm_per_s or v, 120.0),
            (a, a, limits.z_acceleration_mm_per_s2 or a, 10_000.0),
            a,
            a,
            a,
        )


@dataclass(frozen=True, eq=False)
class Machine:
    """Everything a machine file says."""

    name: str
    kinematics: Kinematics
    vibration: VibrationModel
    limits: MotionLimits
    steps: Steps = Steps()
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # effect name -> its parameters
    uncertainty: Mapping[str, float] = field(default_factory=dict)  # "table.key" or "default" -> relative s.d.
    provenance: Mapping[str, Any] = field(default_factory=dict)  # "table.key" -> where the number is from; free
    sha256: str = ""  # of the file's bytes; empty: made in memory
    path: str = ""
    returns: tuple[str, ...] = ()  # macros after which the nozzle is where it was
    still: tuple[str, ...] = ()  # macros that move nothing
    homed_mm: tuple[float, float, float] | None = None  # where homing all axes ends; None: not known
    flavor: str = ""  # of its firmware: "klipper", "marlin" or "reprapfirmware"; empty: not said
    pressure: Pressure | None = None  # what the hot end keeps back; None: not said
    marlin: MarlinSettings | None = None  # of its planner; None: not said

    def __post_init__(self) -> None:
        """Bind the vibration model to the kinematics."""
        object.__setattr__(self, "vibration", self.vibration.on(self.kinematics))

    @property
    def home_mm(self) -> tuple[float, float, float] | None:
        """Where homing all axes ends, if motion from there can be planned."""
        home = self.homed_mm
        return home if home is not None and bool(self.kinematics.contains(np.array([home]))[0]) else None

    def equilibrium(self, nozzle: FloatArray) -> FloatArray:
        """Return the state of the vibration model at rest with the nozzle at (3,) mm."""
        return self.vibration.equilibrium(self.kinematics.inverse(nozzle[None])[0])
