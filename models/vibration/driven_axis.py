"""One axis by itself, driven by a position or by a force: one mass on a drive, or two with a coupling between them.

    m q̈ = F + F₀ − b q̇ − k (q − u) + (k_c (q_l − q) + c (q̇_l − q̇))        a force drives: u = 0; a position: F = 0
    M q̈_l = −k_c (q_l − q) − c (q̇_l − q̇)                                  without a load neither

It is the first actuator of its machine; there are no others. The states are (q, q̇) and, with a load, (q_l, q̇_l). SI;
of positions mm as well. `models/printer/kernels/one_axis.py` simulates it together with its effects.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.vibration.base import Description, Parameter, ParameterSet, PrinterFields, VibrationModel
from models.vibration.state_space import StateSpace

PREFIX = "axis."
TUNABLE = (
    "mass_kg",
    "stiffness_n_per_m",
    "damping_n_s_per_m",
    "load_mass_kg",
    "coupling_stiffness_n_per_m",
    "coupling_damping_n_s_per_m",
)


@dataclass(frozen=True)
class DrivenAxis(VibrationModel):
    """The `[axis]` table of a machine file."""

    input: Literal["position", "force"]
    mass_kg: float  # of the motor's side, or of all
    stiffness_n_per_m: float  # to the commanded position, or to the ground where a force drives; 0: none
    damping_n_s_per_m: float  # of the first mass against the ground
    load_mass_kg: float | None = None  # of a second mass that hangs at the first
    coupling_stiffness_n_per_m: float | None = None
    coupling_damping_n_s_per_m: float = 0.0
    offset_n: float = 0.0  # a force that is always there: a slope, or the zero of the force's sensor

    position_dependent: ClassVar[bool] = False
    channels: ClassVar[tuple[str, str, str]] = ("q", "", "")
    gravity_loaded: ClassVar[bool] = False  # its weight is in `offset_n`
    moves: ClassVar[Literal["carriages", "axes", "axis"]] = "axis"

    @property
    def by_force(self) -> bool:
        """Tell whether a force drives the axis, not a position."""
        return self.input == "force"

    @property
    def free(self) -> bool:
        """Tell whether nothing holds the axis at a place."""
        return self.stiffness_n_per_m == 0.0

    @property
    def moved_kg(self) -> float:
        """Return the mass of all that moves."""
        return self.mass_kg + (self.load_mass_kg or 0.0)

    @property
    def last_stiffness(self) -> float:
        """Return the stiffness of the spring at the end, which may have play and may harden; 0: there is none."""
        return self.coupling_stiffness_n_per_m or self.stiffness_n_per_m

    # ---- parameters

    @property
    def frequency_keys(self) -> tuple[str, ...]:
        """Return the machine file's keys that set the natural frequencies."""
        return tuple(key for key in self.tunable if key.endswith(("mass_kg", "stiffness_n_per_m")))

    @property
    def tunable(self) -> tuple[str, ...]:
        """Return the file's numbers that a measurement may correct."""
        return tuple(PREFIX + name for name in TUNABLE if getattr(self, name))

    def parameters(self) -> ParameterSet:
        """Return the numbers that decide how the axis moves."""
        each = [Parameter(key, self.value(key), TUNABLE.index(key.removeprefix(PREFIX)), key) for key in self.tunable]
        return ParameterSet(tuple(each), len(TUNABLE))

    def value(self, name: str) -> float:
        """Return one of the file's numbers, `axis.mass_kg`; KeyError if there is none of this name."""
        value = getattr(self, name.removeprefix(PREFIX), None) if name.startswith(PREFIX) else None
        if not isinstance(value, float | int):
            raise KeyError(name)
        return float(value)

    def with_parameters(self, values: Mapping[str, float]) -> DrivenAxis:
        """Return the axis with some of its numbers replaced; KeyError for an unknown name."""
        for name in values:
            self.value(name)
        return replace(self, **{name.removeprefix(PREFIX): float(x) for name, x in values.items()})  # type: ignore[arg-type]

    def with_belts(self, relative_change: FloatArray, motors: FloatArray) -> DrivenAxis:
        """Return the axis with the spring at its end stiffer by the first of (3,)."""
        spring = "stiffness_n_per_m" if self.coupling_stiffness_n_per_m is None else "coupling_stiffness_n_per_m"
        return self.with_parameters({PREFIX + spring: self.last_stiffness * (1 + float(relative_change[0]))})

    def with_guide_damping(self, added_n_s_per_m: FloatArray) -> DrivenAxis:
        """Return the axis with more friction of its guide, the first of (3,), in proportion to speed."""
        return replace(self, damping_n_s_per_m=self.damping_n_s_per_m + float(added_n_s_per_m[0]))

    # ---- the equations

    def state_space(self, xy: FloatArray) -> StateSpace:
        """Return the equations of motion, alike at each of the positions (g, 2); of a force, from N to m."""
        m, k, b = self.mass_kg, self.stiffness_n_per_m, self.damping_n_s_per_m
        n = 4 if self.load_mass_kg else 2
        a, command, last = np.zeros((n, n)), np.zeros((n, 3)), np.zeros((3, n))
        a[0, 1], a[1, 0], a[1, 1] = 1.0, -k / m, -b / m
        command[1, 0] = (1.0 if self.by_force else k) / m
        if self.load_mass_kg:
            pull = np.array([-1.0, 0.0, 1.0, 0.0]) * (self.coupling_stiffness_n_per_m or 0.0)
            pull += np.array([0.0, -1.0, 0.0, 1.0]) * self.coupling_damping_n_s_per_m
            a[1] += pull / m
            a[2, 3], a[3] = 1.0, -pull / self.load_mass_kg
        last[0, n - 2] = 1.0
        g, none = (len(xy), 1, 1), np.zeros((len(xy), n, 3))
        return StateSpace(
            a=np.tile(a, g),
            b_command=np.tile(command, g),
            b_slope=none,
            b_centripetal=none,
            carriage=last,
            names=("pos", "vel", "pos_load", "vel_load")[:n],
        )

    def carriage_response(self, xy: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return the last mass' motion to the command at s (k,) 1/s: (k, 3, 3), of which [0, 0] alone is not zero."""
        plant = self.state_space(np.zeros((1, 2)))
        resolvent = s[:, None, None] * np.eye(len(plant.a[0])) - plant.a[0]
        return np.asarray(plant.carriage @ np.linalg.solve(resolvent, plant.b_command[0].astype(np.complex128)[None]))

    def jacobian(self, xy: FloatArray) -> FloatArray:
        """Return J of the nozzle's motion from the actuators' at (n, 2) mm: (n, 3, 3)."""
        return np.tile(np.eye(3), (len(xy), 1, 1))

    def mechanics(self, xy: FloatArray) -> FloatArray:
        """Return d/dt of the m/2 coordinates and their rates with the motors held, (n, m, m), at (n, 2) mm."""
        plant = self.state_space(xy[:1])
        order = np.arange(plant.a.shape[1]).reshape(-1, 2).T.ravel()  # positions, then rates
        return np.tile(plant.a[0][np.ix_(order, order)], (len(xy), 1, 1))

    def nozzle_motion(self, xy: FloatArray) -> FloatArray:
        """Return the last mass' motion from the coordinates', (n, 3, m/2), at positions (n, 2) mm."""
        return np.tile(self.state_space(xy[:1]).carriage[:, ::2], (len(xy), 1, 1))

    def low_frequency(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return τ and C of the series G⁻¹(s) = I + τ s + C s² + …; ValueError where nothing is commanded a place."""
        if self.by_force:
            raise ValueError("A force drives this axis: it follows no commanded position.")
        tau, bend = np.zeros(3), np.zeros((3, 3))
        tau[0] = self.damping_n_s_per_m / self.stiffness_n_per_m
        bend[0, 0] = self.moved_kg / self.stiffness_n_per_m
        if self.load_mass_kg:
            bend[0, 0] += self.load_mass_kg / (self.coupling_stiffness_n_per_m or np.inf)
        return tau, np.tile(bend, (len(xy), 1, 1))

    def equilibrium(self, q: FloatArray) -> FloatArray:
        """Return the state at rest with the actuators at (3,) mm."""
        return self.steady_motion(q, np.zeros(3))

    def steady_motion(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Return the state with the actuators at (3,) mm, in motion at (3,) mm/s since long."""
        return np.tile([float(q[0]), float(qd[0])], 2 if self.load_mass_kg else 1)

    def undriven(self) -> DrivenAxis:
        """Return the model behind ideal drives: motors stand where they are told to."""
        return self

    def printer_parameters(self, gravity_m_per_s2: float) -> PrinterFields:
        """Return what the nonlinear kernels need of the axis, SI."""
        return {
            "mass": self.mass_kg,
            "stiffness": self.stiffness_n_per_m,
            "damping": self.damping_n_s_per_m,
            "offset": self.offset_n,
            "load": self.load_mass_kg or 0.0,
            "coupling": self.coupling_stiffness_n_per_m or 0.0,
            "coupling_damping": self.coupling_damping_n_s_per_m,
            "by_force": self.by_force,
            "motor_k": np.full(3, self.last_stiffness),
        }

    def describe(self) -> Description:
        """Return the words for headings."""
        return Description("one axis by itself", None)
