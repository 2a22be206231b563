"""The interface of a linear model of a machine's vibrations: commanded actuators in, real actuators and nozzle out.

`DeltaVibration` (carriages that carry an effector) and `ModalAxes` (independent axes) implement it. A model is frozen
and bound to its kinematics (`on`). Positions are (x, y) in mm, since nothing depends on z; small motion around a
position is linear.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.kinematics.base import AXES, Kinematics
from models.quantities import Quantities
from models.vibration.state_space import StateSpace

if TYPE_CHECKING:
    from control import StateSpace as ControlStateSpace

KINDS = {"carriage": "pos", "nozzle": "pos", "acceleration": "acc"}
SWINGING = 1e-6  # imaginary part of a pole over its size; below, rounding alone keeps two real poles from meeting

Output = Literal["carriage", "nozzle", "acceleration"]  # the output; acceleration: of the nozzle, s² X
Input = Literal["carriage", "nozzle"]  # the command: three actuators, or the nozzle's three axes
PrinterFields = dict[str, FloatArray | float | bool]  # fields of the nonlinear printer's record, SI


@dataclass(frozen=True, eq=False)
class Modes:
    """The vibrations at one position, slowest first; a drive filter's own poles are not among them."""

    frequencies_hz: FloatArray  # (k,) undamped natural frequencies, without overdamped ones
    damping_ratios: FloatArray  # (k,)
    shapes: ComplexArray  # (k, m) amplitudes of the model's own coordinates, length 1
    nozzle: ComplexArray  # (k, 3) of the nozzle along x, y, z, in the same scale


@dataclass(frozen=True)
class ModelParameter:
    """One number of a vibration model.

    `column` is which of a draw's normal deviates moves it: parameters of one column move together. Its relative
    standard deviation is that of `file_key` in `[uncertainty]`, times `power` (a stiffness is a frequency squared).
    """

    name: str  # "carriage.belt_stiffness_n_per_m", "effector.extruder_stiffness_n_per_m[2]"
    value: float
    column: int
    file_key: str = ""  # '' if no entry gives its uncertainty: exact
    power: float = 1.0


@dataclass(frozen=True)
class ParameterSet:
    """The parameters of a model by name, in a fixed order."""

    parameters: tuple[ModelParameter, ...]
    columns: int  # normal deviates of a draw

    def __iter__(self) -> Iterator[ModelParameter]:
        return iter(self.parameters)

    def __len__(self) -> int:
        return len(self.parameters)

    @property
    def names(self) -> list[str]:
        """Return every name, in order."""
        return [each.name for each in self.parameters]

    def relative_sd(self, uncertainty: Mapping[str, float]) -> FloatArray:
        """Return (n,) relative standard deviations, from a machine file's `[uncertainty]`."""
        default = uncertainty.get("default", 0.0)
        return np.array(
            [
                uncertainty.get(p.name, p.power * uncertainty.get(p.file_key, default)) if p.file_key else 0.0
                for p in self.parameters
            ]
        )

    def scaled(self, deviates: FloatArray, relative_sd: FloatArray | float, least: float = 0.0) -> dict[str, float]:
        """Return name -> value of one draw, each at least `least` of its value.

        The number in the file is normal: a value is multiplied by (1 + sd · deviate / power) ** power.

        deviates : (columns,) standard normal
        """
        scaled = {}
        for p, sd in zip(self.parameters, np.broadcast_to(relative_sd, len(self.parameters)).tolist(), strict=True):
            factor = max(1.0 + sd / p.power * float(deviates[p.column]), 0.0) ** p.power
            scaled[p.name] = p.value * max(factor, least)
        return scaled


def number_at(part: object, name: str) -> Any:
    """Return the number, or the array, at a path such as "drive.d0_per_s2"; KeyError if there is none."""
    for key in name.split("."):
        part = getattr(part, key, None)
    if not isinstance(part, float | int | np.ndarray):
        raise KeyError(name)
    return part


def with_numbers(part: Any, values: Mapping[str, Any]) -> Any:
    """Return a part with the numbers at these paths replaced."""
    inside: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        key, _, path = name.partition(".")
        inside.setdefault(key, {})[path] = value
    return replace(part, **{k: v[""] if "" in v else with_numbers(getattr(part, k), v) for k, v in inside.items()})


class VibrationModel(ABC):
    """Linear response of actuators and nozzle to commanded actuator positions."""

    position_dependent: ClassVar[bool]
    """Whether the response changes over the bed."""
    channels: ClassVar[tuple[str, str, str]]
    """Names of the actuators."""
    moves: ClassVar[Literal["carriages", "axes", "axis"]] = "carriages"
    """What the motors move, which decides the possible effects."""

    @property
    @abstractmethod
    def frequency_keys(self) -> tuple[str, ...]:
        """Return the machine file's keys that set the natural frequencies and that only a measurement gives."""

    def on(self, kinematics: Kinematics) -> Self:
        """Return the model bound to a machine's kinematics."""
        return self

    @abstractmethod
    def parameters(self) -> ParameterSet:
        """Return the uncertain numbers of the model; the geometry is calibrated and not among them."""

    @abstractmethod
    def value(self, name: str) -> float:
        """Return one parameter; KeyError if there is none of this name."""

    @abstractmethod
    def with_parameters(self, values: Mapping[str, float]) -> Self:
        """Return the model with some parameters replaced; KeyError for an unknown name."""

    def carriage_response(self, xy: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return G, commanded to real actuator positions, at (2,) mm and s (k,) 1/s: (k, 3, 3)."""
        plant = self.state_space(xy[None])
        s = s[:, None, None]
        resolvent = s * np.eye(len(plant.a[0])) - plant.a[0]
        return np.asarray(plant.carriage @ np.linalg.solve(resolvent, plant.b_command[0] + s * plant.b_slope[0]))

    def jacobian(self, xy: FloatArray) -> FloatArray:
        """Return J of the nozzle's motion from the actuators' at (n, 2) mm: (n, 3, 3); of straight axes 1."""
        return np.tile(np.eye(3), (len(xy), 1, 1))

    def frequency_response(
        self, xy: FloatArray, frequency_hz: FloatArray, output: Output = "carriage", input: Input = "carriage"
    ) -> ComplexArray:
        """Return G, J G, G J⁻¹ or J G J⁻¹, for small motion around xy (2,) mm, or one of them times s².

        (k, 3, 3) mm/mm, of acceleration 1/s², at (k,) Hz; rows outputs (actuators or X Y Z), columns inputs.
        """
        s = np.asarray(2j * np.pi * frequency_hz, dtype=np.complex128)
        g = self.carriage_response(xy, s)
        j = self.jacobian(xy[None])[0]
        if output != "carriage":
            g = j @ g
        if input == "nozzle":
            g = g @ np.linalg.inv(j)
        return g * s[:, None, None] ** 2 if output == "acceleration" else g

    @abstractmethod
    def state_space(self, xy: FloatArray) -> StateSpace:
        """Return the equations of motion frozen at each of the positions (g, 2) mm, in the model's own states."""

    def poles(self, xy: FloatArray) -> ComplexArray:
        """Return the mechanical poles (n, m) 1/s at positions (n, 2) mm."""
        return np.linalg.eigvals(self.mechanics(xy)).astype(np.complex128)

    def modes(self, xy: FloatArray) -> list[Modes]:
        """Return natural frequencies, damping ratios and shapes at each of the positions (n, 2) mm."""
        values, vectors = np.linalg.eig(self.mechanics(xy))
        half, nozzle = values.shape[1] // 2, self.nozzle_motion(xy)
        vibrations = (_vibrations(pole, vector[:half]) for pole, vector in zip(values, vectors, strict=True))
        return [
            Modes(f, zeta, shape, shape @ rows.T) for (f, zeta, shape), rows in zip(vibrations, nozzle, strict=True)
        ]

    def modes_at(self, xy: FloatArray) -> Modes:
        """Return the modes at one position (2,) mm."""
        return self.modes(xy[None])[0]

    def mechanics(self, xy: FloatArray) -> FloatArray:
        """Return d/dt of the m/2 coordinates and their rates with the motors held, (n, m, m), at (n, 2) mm."""
        plant = self.state_space(xy[:1])
        order = np.arange(plant.a.shape[1]).reshape(-1, 2).T.ravel()  # positions, then rates
        return np.tile(plant.a[0][np.ix_(order, order)], (len(xy), 1, 1))

    def nozzle_motion(self, xy: FloatArray) -> FloatArray:
        """Return the nozzle's motion from the coordinates', (n, 3, m/2), at positions (n, 2) mm."""
        return np.tile(self.state_space(xy[:1]).carriage[:, ::2], (len(xy), 1, 1))

    def low_frequency(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return τ (3,) s and C (n, 3, 3) s² of G⁻¹(s) = I + τ s + C s² + …, at positions (n, 2) mm.

        With (s I − A)⁻¹ = −A⁻¹ − s A⁻² − s² A⁻³ …, G = I + G₁ s + G₂ s² + …, and its inverse has −G₁ and G₁² − G₂.
        """
        plant = self.state_space(xy)
        back = np.linalg.inv(plant.a)
        first = back @ (-back @ plant.b_command - plant.b_slope)
        g1, g2 = plant.carriage @ first, plant.carriage @ (back @ first)
        return -np.diagonal(g1[0]), g1 @ g1 - g2

    @abstractmethod
    def steady_motion(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Return the state with the actuators at (3,) mm, in steady motion at (3,) mm/s."""

    def undriven(self) -> Self:
        """Return the model with ideal drives: motors follow their command exactly."""
        return self

    @abstractmethod
    def printer_parameters(self, gravity_m_per_s2: float) -> PrinterFields:
        """Return the model's numbers for the nonlinear printer's kernels, SI."""

    def printer_modes(self) -> FloatArray:
        """Return the modes of straight axes, (n, 7, 3), see `models/printer/kernels/axes.py`; none of other models."""
        return np.zeros((0, 7, 3))

    @property
    def per_kilogram(self) -> bool:
        """Return whether forces are per moving kilogram, because the mass is unknown."""
        return False

    @property
    def quantities(self) -> Quantities:
        """Return how files and reports name and scale the machine's numbers."""
        return Quantities(per_kilogram=self.per_kilogram)

    @property
    @abstractmethod
    def tunable(self) -> tuple[str, ...]:
        """Return the machine file's numbers that a measurement of vibrations may correct."""

    @property
    def guessed(self) -> Mapping[str, float]:
        """Return the entries of `tunable` missing from the file, with the relative standard deviation of the guess."""
        return {}

    @abstractmethod
    def with_belts(self, relative_change: FloatArray, motors: FloatArray) -> Self:
        """Return the model with belts stiffer by (3,), of motors that move as (3, 3) of the actuators says."""

    @abstractmethod
    def with_guide_damping(self, added_n_s_per_m: FloatArray) -> Self:
        """Return the model with more friction (3,) of the guides, in proportion to speed."""

    def with_belt_damping(self, share: FloatArray) -> Self:
        """Return the model with so much (3,) of its guides' damping in its belts instead."""
        raise ValueError("belt_damping is only for straight axes; this machine's file has the belts' damping.")

    def to_control(
        self, xy: Sequence[float] | FloatArray, output: Output = "carriage", input: Input = "carriage"
    ) -> ControlStateSpace:
        """Return the model at one position (2,) mm as a state space of python-control.

        Inputs cmd_A … or cmd_x …, outputs pos_A …, pos_x … or acc_x …; states in mm and mm/s. An ideal drive's states
        are left out. It hands the belt's damper the command's slope, ẋ = A x + B u + Bₛ u̇. The states z = x − Bₛ u need
        no slope: ż = A z + (B + A Bₛ) u, and only velocities differ between z and x, so positions read the same.

        Raises
        ------
        ValueError
            For the acceleration with an ideal drive and a damped belt: it follows the command's slope, so no state
            space of the command has it.
        ImportError
            Without python-control.
        """
        try:
            import control
        except ImportError as error:
            raise ImportError("to_control() needs python-control: pip install 'ffcomp[control]'.") from error

        at = np.asarray(xy, dtype=np.float64)[None]
        plant, jacobian = self.state_space(at), self.jacobian(at)[0]
        a, slope, c = plant.a[0], plant.b_slope[0], plant.carriage
        b = plant.b_command[0] + a @ slope
        rows = c if output == "carriage" else jacobian @ c
        direct = np.zeros((3, 3))
        if output == "acceleration":
            if np.any(slope):
                raise ValueError(
                    "The acceleration has no state space of the command: a drive is ideal and its belt is damped, so "
                    "the acceleration follows the command's slope at once; give the machine a drive, or use 'nozzle' "
                    "and differentiate."
                )
            rate = jacobian @ (c @ a)
            rows, direct = rate @ a, rate @ b
        turn = np.eye(3) if input == "carriage" else np.linalg.inv(jacobian)
        drives = plant.drive_states
        keep = np.arange(drives if not np.any(a[drives:, :drives]) else 0, len(a))
        names = {
            "inputs": [f"cmd_{name}" for name in (self.channels if input == "carriage" else AXES)],
            "outputs": [f"{KINDS[output]}_{name}" for name in (self.channels if output == "carriage" else AXES)],
            "states": [plant.names[i] for i in keep],
        }
        matrices = a[np.ix_(keep, keep)], b[keep] @ turn, rows[:, keep], direct @ turn
        return control.StateSpace(*matrices, **names, name=f"{output}_per_{input}")


def _vibrations(pole: ComplexArray, shape: ComplexArray) -> tuple[FloatArray, FloatArray, ComplexArray]:
    """Return frequencies, ratios and shapes of the oscillating ones of m poles (m,) with shapes (m/2, m)."""
    upper = np.flatnonzero(pole.imag > SWINGING * np.abs(pole))
    upper = upper[np.argsort(np.abs(pole[upper]))]
    natural = np.abs(pole[upper])
    swinging = shape[:, upper].T
    length = np.linalg.norm(swinging, axis=1, keepdims=True)
    return natural / (2 * np.pi), -pole[upper].real / natural, swinging / length
