"""A machine as frozen data, in the machine file's own units.

mm, s, kg, N; stiffness N/m, damping N s/m. Towers and carriages are always in the order A, B, C. Arrays are
read-only; parts compare by identity, so a machine may serve as the key of a cache.

Parameters of its vibrations have the names of the file, `carriage.belt_stiffness_n_per_m`; elements of lists carry
their index, `effector.extruder_stiffness_n_per_m[2]`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from models.arrays import FloatArray, constant
from models.kinematics.base import Kinematics
from models.vibration.base import VibrationModel


@dataclass(frozen=True)
class MotionLimits:
    """Limits of the nozzle for planning, and of each motor's command for compensation."""

    velocity_mm_per_s: float
    acceleration_mm_per_s2: float
    square_corner_velocity_mm_per_s: float = 5.0
    carriage_velocity_mm_per_s: float = 500.0
    carriage_acceleration_mm_per_s2: float = 30000.0
    z_velocity_mm_per_s: float | None = None  # of the nozzle along Z; None: as in any direction
    z_acceleration_mm_per_s2: float | None = None
    carriage_travel_mm: tuple[float, float] | None = None  # lowest and highest place of a carriage; None: not known
    step_rate_hz: float | None = None  # of each motor, microsteps; None: no limit

    @property
    def of_axes(self) -> tuple[Four, Four]:
        """Speeds, mm/s, and accelerations, mm/s², of X Y Z, with a usual extruder's of the filament."""
        v, a = self.velocity_mm_per_s, self.acceleration_mm_per_s2
        speeds = (v, v, self.z_velocity_mm_per_s or v, 120.0)
        return speeds, (a, a, self.z_acceleration_mm_per_s2 or a, 10_000.0)


@dataclass(frozen=True)
class Steps:
    """Step sizes of the carriage motors and of the extruder."""

    steps_per_mm: float | tuple[float, ...] = 80.0  # microsteps; of all motors, or of each
    full_steps_per_mm: float | tuple[float, ...] = 5.0
    extruder_steps_per_mm: float | None = None  # of filament; None: unknown
    stated: tuple[str, ...] = ()  # keys in the machine file; the others are typical values

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
    shortest_segment_s: float = 0.02  # M205 B, used by SLOWDOWN
    minimum_steps_per_segment: int = 6  # MIN_STEPS_PER_SEGMENT
    slowdown: bool = True  # SLOWDOWN: the first blocks after a rest take longer; not on deltas
    segments_per_second: float = 200.0  # DELTA_SEGMENTS_PER_SECOND
    stated: tuple[str, ...] = ()  # keys in the machine file; the others are Marlin's defaults

    @classmethod
    def within(cls, limits: MotionLimits, towers: bool) -> MarlinSettings:
        """Return Marlin's defaults, with the nozzle's limits for the axes and a usual extruder's for the filament.

        towers : X Y Z are the towers of a delta
        """
        a, jerk = limits.acceleration_mm_per_s2, limits.square_corner_velocity_mm_per_s
        return cls(*limits.of_axes, a, a, a, jerk_mm_per_s=(jerk, jerk, jerk if towers else 0.3, 5.0))


@dataclass(frozen=True, slots=True)
class RepRapFirmwareSettings:
    """Settings of RepRapFirmware's planner; four values are in the order X Y Z E."""

    speed_mm_per_s: Four  # M203 over 60
    acceleration_mm_per_s2: Four  # M201
    jerk_mm_per_s: Four  # M566 over 60
    printing_acceleration_mm_per_s2: float  # M204 P
    travel_acceleration_mm_per_s2: float  # M204 T
    jerk_policy: int = 0  # M566 P: 0 stops where a move extrudes and its neighbour does not, 1 never for that alone
    queue_moves: int = 40  # M595 P
    stated: tuple[str, ...] = ()  # keys in the machine file

    @classmethod
    def within(cls, limits: MotionLimits, delta: bool) -> RepRapFirmwareSettings:
        """Return settings with the nozzle's limits for the axes, and a usual extruder's for the filament."""
        a, jerk = limits.acceleration_mm_per_s2, limits.square_corner_velocity_mm_per_s
        return cls(*limits.of_axes, (jerk, jerk, jerk if delta else 0.2, 5.0), a, a)


@dataclass(frozen=True, eq=False)
class Machine:
    """The content of a machine file."""

    json_keys: ClassVar = {key: key for key in ("name", "sha256", "path", "assumed")} | {"effects": "effect_names"}

    name: str
    kinematics: Kinematics
    vibration: VibrationModel
    limits: MotionLimits
    steps: Steps = Steps()
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # effect name -> its parameters
    uncertainty: Mapping[str, float] = field(default_factory=dict)  # "table.key" or "default" -> relative s.d.
    provenance: Mapping[str, Any] = field(default_factory=dict)  # "table.key" -> source of the number, free text
    sha256: str = ""  # of the file's bytes; empty: made in memory
    path: str = ""
    returns: tuple[str, ...] = ()  # macros that return the nozzle to its position, or do not move it
    input_shaper: tuple[str, ...] | None = None  # commands that switch the firmware's own on; None: unknown
    flavor: str = ""  # of its firmware: "klipper", "marlin" or "reprapfirmware"; empty: unknown
    firmware_version: tuple[int, ...] = ()  # its numbers, such as (2, 1, 2); empty: unknown
    marlin: MarlinSettings | None = None  # None: unknown
    reprapfirmware: RepRapFirmwareSettings | None = None  # likewise

    def __post_init__(self) -> None:
        """Bind the vibration model to the kinematics."""
        object.__setattr__(self, "vibration", self.vibration.on(self.kinematics))

    @property
    def assumed(self) -> str | None:
        """The warning of `assumed_modes`."""
        return assumed_modes(self)

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Its effects."""
        return tuple(self.effects)

    def __repr__(self) -> str:
        """Return the name, the kinematics and the file."""
        return f"<Machine: {self.name}, {type(self.kinematics).__name__}, {self.path or 'made in memory'}>"

    def equilibrium(self, nozzle: FloatArray) -> FloatArray:
        """Return the state of the vibration model at rest with the nozzle at (3,) mm."""
        return self.vibration.steady_motion(self.kinematics.inverse(nozzle[None])[0], np.zeros(3))


def value_of(machine: Machine, name: str) -> float:
    """Return one parameter; KeyError if the machine has none of this name."""
    return machine.vibration.value(name)


def with_values(machine: Machine, values: Mapping[str, float]) -> Machine:
    """Return the machine with some of its parameters replaced."""
    return replace(machine, vibration=machine.vibration.with_parameters(values))


ASSUMED = "assumed"  # beginning of the provenance of an assumed value
START = "as a start"  # part of the provenance of a rough value

SOURCES = "sources"  # the table in [provenance] with the titles of origins


def is_assumed(origin: str) -> bool:
    """Whether a provenance marks an assumed value."""
    return origin.startswith(ASSUMED) or START in origin


def assumed_modes(machine: Machine) -> str | None:
    """Return a warning that a machine's modes are assumed, with the remedy; None if they are not.

    A compensation is only as good as its modes, so every command that uses them prints this.
    """
    keys = machine.vibration.frequency_keys
    assumed = [key for key in keys if is_assumed(str(machine.provenance.get(key, "")))]
    if not assumed:
        return None
    name = Path(machine.path).stem or machine.name
    part = "" if len(assumed) == len(keys) else f" in part ({', '.join(assumed)})"
    return (
        f"The modes of {name} are assumed{part}, not measured, so the effect on your printer is unknown. "
        f"Measure them with {way_to_measure(machine)}, then `ffcomp identify fit`."
    )


def way_to_measure(machine: Machine, options: str = "") -> str:
    """Return the command whose captures `ffcomp identify fit` reads: the firmware's own test where it suffices.

    options : of the command of ffcomp
    """
    if machine.flavor == "klipper" and machine.kinematics.model_reach_mm == 0.0:  # a straight axis is alike everywhere
        return "`TEST_RESONANCES AXIS=X OUTPUT=raw_data` (and Y) on the printer"
    return f"`ffcomp record plan --for identify{options}`"


def sources(machine: Machine) -> dict[str, str]:
    """Return the addresses of the sources by title."""
    named = machine.provenance.get(SOURCES, {})
    return {str(title): str(address) for title, address in named.items()} if isinstance(named, dict) else {}
