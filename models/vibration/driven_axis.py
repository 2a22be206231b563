"""One axis by itself, driven by a position or by a force: one mass on a drive, or two with a coupling between them.

    m q̈ = F + F₀ − b q̇ − k (q − u) − c_d (q̇ − u̇) + (k_c (q_l − q) + c (q̇_l − q̇))
    M q̈_l = −k_c (q_l − q) − c (q̇_l − q̇)

Without a load there is no coupling. A force input has u = 0 and c_d = 0, a position input F = 0. An electric
motor gives F = k_t i from a current, F = k_t/R (V − k_t q̇) from a voltage, and V = g (u − q) + h (u̇ − q̇) in a servo:
its back EMF damps, and its law is a spring and a damper.

It is the first actuator of its machine; there are no others. The states are (q, q̇) and, with a load, (q_l, q̇_l). SI;
of positions mm as well. An axis that turns has rad for m and N m for N (`models/quantities.py`).
`models/printer/kernels/one_axis.py` simulates it together with its effects.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import ClassVar, Literal

import numpy as np

from models.arrays import FloatArray
from models.quantities import Quantities
from models.vibration.base import ModelParameter, ParameterSet, PrinterFields, VibrationModel, number_at, with_numbers
from models.vibration.state_space import StateSpace

PREFIX = "axis."
TUNABLE = (
    "mass_kg",
    "stiffness_n_per_m",
    "damping_n_s_per_m",
    "load_mass_kg",
    "coupling_stiffness_n_per_m",
    "coupling_damping_n_s_per_m",
    "drive_damping_n_s_per_m",
    "drive.force_constant_n_per_a",
)
Input = Literal["position", "force", "current", "voltage", "duty"]
Hold = Literal["straight", "steps"]


@dataclass(frozen=True)
class Drive:
    """`[axis.drive]`: how a motor makes a force from its input."""

    force_constant_n_per_a: float | None = None  # k_t; None: forces are per ampere, or per volt
    resistance_ohm: float | None = None  # R, for voltages
    supply_v: float | None = None  # the highest voltage; a duty is a fraction of it
    gain_v_per_m: float = 0.0  # g of a servo: volts per metre of error
    rate_gain_v_s_per_m: float = 0.0  # h
    current_limit_a: float | None = None
    force_limit_n: float | None = None  # of any drive
    hold: Hold = "straight"  # between samples of a force, a current, a voltage or a duty
    delay_s: float = 0.0  # by which it acts later than its recording says; only effects and diagnosis follow it

    @property
    def force_per_volt(self) -> float:
        """Return k_t/R, N/V; 1 where forces are per volt."""
        return (self.force_constant_n_per_a or 1.0) / (self.resistance_ohm or 1.0)

    @property
    def back_emf(self) -> float:
        """Return k_t²/R, the motor's own damping, N s/m."""
        return 0.0 if self.resistance_ohm is None else self.force_per_volt * (self.force_constant_n_per_a or 0.0)


@dataclass(frozen=True)
class DrivenAxis(VibrationModel):
    """The `[axis]` table of a machine file."""

    input: Input
    mass_kg: float  # of the motor's side, or of all
    stiffness_n_per_m: float  # to the commanded position, or to the ground where a force drives; 0: none
    damping_n_s_per_m: float  # of the first mass against the ground
    load_mass_kg: float | None = None  # of a second mass on the first
    coupling_stiffness_n_per_m: float | None = None
    coupling_damping_n_s_per_m: float = 0.0
    offset_n: float = 0.0  # a constant force: a slope, or the offset of the force sensor
    drive_damping_n_s_per_m: float = 0.0  # across the spring to the commanded position
    unit: Literal["", "mm", "rad"] = ""  # of its position; '': not stated, mm
    drive: Drive = Drive()

    position_dependent: ClassVar[bool] = False
    channels: ClassVar[tuple[str, str, str]] = ("q", "", "")
    moves: ClassVar[Literal["carriages", "axes", "axis"]] = "axis"

    @property
    def by_force(self) -> bool:
        """Whether the input is a force or a motor's electrical input, and not a position."""
        return self.input != "position"

    @property
    def quantities(self) -> Quantities:
        """Return how its file and reports name and scale its numbers."""
        per = self.input if self.drive.force_constant_n_per_a is None else ""
        force: Literal["N", "A", "V"] = {"current": "A", "voltage": "V", "duty": "V"}.get(per, "N")  # type: ignore[assignment]
        return Quantities("rad" if self.unit == "rad" else "m", force)

    @property
    def spring_n_per_m(self) -> float:
        """Return the stiffness of its drive or of its spring to the ground; a servo law counts."""
        return self.stiffness_n_per_m + self.drive.gain_v_per_m * self.drive.force_per_volt

    @property
    def spring_damping(self) -> float:
        """Return the damping across that spring, N s/m."""
        return self.drive_damping_n_s_per_m + self.drive.rate_gain_v_s_per_m * self.drive.force_per_volt

    @property
    def ground_damping(self) -> float:
        """Return the damping against the ground, N s/m, with the motor's back EMF where a voltage drives it."""
        return self.damping_n_s_per_m + (self.back_emf if self.drive.resistance_ohm is not None else 0.0)

    @property
    def back_emf(self) -> float:
        """Return the back EMF of a motor that a voltage drives, N s/m: all of the damping without its constants."""
        by_voltage = self.input in ("voltage", "duty") or self.drive.gain_v_per_m > 0.0
        if not by_voltage:
            return 0.0
        return self.damping_n_s_per_m if self.drive.resistance_ohm is None else self.drive.back_emf

    @property
    def drive_limit_n(self) -> float:
        """Return the largest force of the drive, N: its own, or what a servo makes of its supply."""
        limit = self.drive.force_limit_n or np.inf
        if self.drive.gain_v_per_m and self.drive.supply_v:
            limit = min(limit, self.drive.supply_v * self.drive.force_per_volt)
        return float(limit)

    def force_of(self, command: FloatArray, supply_v: FloatArray | None = None) -> FloatArray:
        """Return the drive's force, (n,) N, from its command, (n,) N, A, V or a duty of -1 to 1.

        supply_v : (n,) as recorded; None: the file's.
        """
        drive = self.drive
        if self.input == "current":
            most = drive.current_limit_a or np.inf
            return np.asarray(np.clip(command, -most, most) * (drive.force_constant_n_per_a or 1.0))
        if self.input in ("voltage", "duty"):
            supply = drive.supply_v if supply_v is None else supply_v
            by_duty = self.input == "duty"
            volts = np.clip(command, -1.0, 1.0) * (1.0 if supply is None else supply) if by_duty else command
            return np.asarray((volts if supply is None else np.clip(volts, -supply, supply)) * drive.force_per_volt)
        return command

    @property
    def free(self) -> bool:
        """Whether nothing holds the axis at a position."""
        return self.spring_n_per_m == 0.0

    @property
    def moved_kg(self) -> float:
        """Return the total moving mass."""
        return self.mass_kg + (self.load_mass_kg or 0.0)

    @property
    def last_stiffness(self) -> float:
        """Return the stiffness of the spring at the end, which may have backlash and may harden; 0: there is none."""
        return self.coupling_stiffness_n_per_m or self.spring_n_per_m

    # ---- parameters

    @property
    def frequency_keys(self) -> tuple[str, ...]:
        """Return the machine file's keys that set the natural frequencies."""
        return tuple(key for key in self.tunable if key.endswith(("mass_kg", "stiffness_n_per_m")))

    @property
    def tunable(self) -> tuple[str, ...]:
        """Return the file's numbers that a measurement may correct."""
        return tuple(PREFIX + name for name in TUNABLE if attrgetter(name)(self))

    def parameters(self) -> ParameterSet:
        """Return the numbers that decide how the axis moves."""
        each = [
            ModelParameter(key, self.value(key), TUNABLE.index(key.removeprefix(PREFIX)), key) for key in self.tunable
        ]
        return ParameterSet(tuple(each), len(TUNABLE))

    def value(self, name: str) -> float:
        """Return one of the file's numbers, `axis.mass_kg`; KeyError if there is none of this name."""
        return float(number_at(self, name.removeprefix(PREFIX)))

    def with_parameters(self, values: Mapping[str, float]) -> DrivenAxis:
        """Return the axis with some of its numbers replaced; KeyError for an unknown name."""
        for name in values:
            self.value(name)
        changed: DrivenAxis = with_numbers(self, {name.removeprefix(PREFIX): float(x) for name, x in values.items()})
        return changed

    def with_belts(self, relative_change: FloatArray, motors: FloatArray) -> DrivenAxis:
        """Return the axis with the spring at its end stiffer by the first of (3,)."""
        factor = 1 + float(relative_change[0])
        if self.coupling_stiffness_n_per_m is None:
            return self.with_drive(factor)
        return replace(self, coupling_stiffness_n_per_m=factor * self.coupling_stiffness_n_per_m)

    def with_drive(self, factor: float) -> DrivenAxis:
        """Return the axis with a drive, or a spring to the ground, so many times as stiff."""
        drive = replace(self.drive, gain_v_per_m=factor * self.drive.gain_v_per_m)
        return replace(self, stiffness_n_per_m=factor * self.stiffness_n_per_m, drive=drive)

    def with_belt_damping(self, share: FloatArray) -> DrivenAxis:
        """Return the axis with the first of (3,) of its damping across the drive's spring, not against the ground."""
        moved = float(share[0]) * self.damping_n_s_per_m
        across = self.drive_damping_n_s_per_m + moved
        return replace(self, damping_n_s_per_m=self.damping_n_s_per_m - moved, drive_damping_n_s_per_m=across)

    def with_guide_damping(self, added_n_s_per_m: FloatArray) -> DrivenAxis:
        """Return the axis with more friction of its guide, the first of (3,), in proportion to speed."""
        return replace(self, damping_n_s_per_m=self.damping_n_s_per_m + float(added_n_s_per_m[0]))

    # ---- the equations

    def state_space(self, xy: FloatArray) -> StateSpace:
        """Return the equations of motion, alike at each of the positions (g, 2); of a force, from N to m."""
        m, k, c = self.mass_kg, self.spring_n_per_m, self.spring_damping
        n = 4 if self.load_mass_kg else 2
        a, command, slope, last = np.zeros((n, n)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((3, n))
        a[0, 1], a[1, 0], a[1, 1] = 1.0, -k / m, -(self.ground_damping + c) / m
        command[1, 0], slope[1, 0] = (1.0 if self.by_force else k) / m, c / m
        if self.load_mass_kg:
            pull = np.array([-1.0, 0.0, 1.0, 0.0]) * (self.coupling_stiffness_n_per_m or 0.0)
            pull += np.array([0.0, -1.0, 0.0, 1.0]) * self.coupling_damping_n_s_per_m
            a[1] += pull / m
            a[2, 3], a[3] = 1.0, -pull / self.load_mass_kg
        last[0, n - 2] = 1.0
        names = ("pos", "vel", "pos_load", "vel_load")[:n]
        return StateSpace(a, command, slope, slope, last, names).everywhere(len(xy))

    def steady_motion(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Return the state with the actuators at (3,) mm, in steady motion at (3,) mm/s."""
        return np.tile([float(q[0]), float(qd[0])], 2 if self.load_mass_kg else 1)

    def printer_parameters(self, gravity_m_per_s2: float) -> PrinterFields:
        """Return the axis' numbers for the nonlinear kernels, SI."""
        return {
            "mass": self.mass_kg,
            "stiffness": self.spring_n_per_m,
            "damping": self.ground_damping,
            "drive_damping": self.spring_damping,
            "drive_limit": self.drive_limit_n,
            "back_emf": self.back_emf,
            "offset": self.offset_n,
            "load": self.load_mass_kg or 0.0,
            "coupling": self.coupling_stiffness_n_per_m or 0.0,
            "coupling_damping": self.coupling_damping_n_s_per_m,
            "by_force": self.by_force,
            "delay": self.drive.delay_s,
            "motor_k": np.full(3, self.last_stiffness),
        }
