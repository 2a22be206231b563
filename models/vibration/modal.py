"""Axes that vibrate by themselves, told by their modes: the numbers that a shaper calibration or an FRF gives.

An axis q with commanded position u is the sum of oscillators side by side, q = Σ p_i, with shares Σ σ_i = 1:

    m_i p̈_i = k_i (σ_i u − p_i) + c_i (σ_i u̇ − ṗ_i) − b_i ṗ_i
    q/u = Σ σ_i (c_i s + k_i)/(m_i s² + (c_i + b_i) s + k_i)

A mode of natural frequency ω and damping ratio ζ has k = ω² m, b = 2 ζ ω m and c = 0; only ratios to the modal mass
matter. A rigid axis is one stiff oscillator, damped by c, which does not make it lag. The states are (p_i, ṗ_i) of
every oscillator, those of x first; nothing couples them. mm, s.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.vibration.base import Description, Parameter, ParameterSet, PrinterFields, VibrationModel
from models.vibration.state_space import StateSpace

SILENT_HZ, SILENT_DAMPING = 400.0, 1.1  # of a second oscillator that takes no part; it does not swing
RIGID_HZ, RIGID_DAMPING = 1500.0, 1.1
AXES = ("x", "y", "z")
KINDS = ("mass", "stiffness", "belt_damping", "damping")
PRINTER_MODES = 2  # of an axis, that the nonlinear printer's kernels hold
NAME = re.compile(r"axes\.(?P<axis>[xyz])\.(?P<kind>\w+)\[(?P<mode>\d+)\]")
# what a draw of 20 deviates moves, as when an axis had exactly two oscillators: the same seeds give the same machines
COLUMNS = 20
SECOND_MASS, SECOND_STIFFNESS, SECOND_DAMPING = 13, 14, 17


@dataclass(frozen=True)
class Axis:
    """One axis as a machine file tells it; without modes it is rigid."""

    frequency_hz: Sequence[float] = ()  # undamped
    damping_ratio: Sequence[float] = ()
    share: Sequence[float] = (1.0,)

    @property
    def oscillators(self) -> tuple[Oscillator, ...]:
        """Return the axis' modes; the last one takes what share the others leave."""
        if not self.frequency_hz:
            omega = 2 * np.pi * RIGID_HZ
            return (Oscillator(omega**2, 0.0, 2 * RIGID_DAMPING * omega),)
        shares = [*self.share[: len(self.frequency_hz) - 1]]
        shares.append(1.0 - sum(shares))
        modes = zip(self.frequency_hz, self.damping_ratio, shares, strict=True)
        return tuple(_oscillator(2 * np.pi * f, zeta, share) for f, zeta, share in modes)


@dataclass(frozen=True)
class Oscillator:
    """One mode of an axis."""

    stiffness: float  # k, 1/s² a unit of modal mass
    damping: float  # b, 1/s
    belt_damping: float = 0.0  # c, 1/s
    share: float = 1.0  # σ, of either sign
    mass: float = 1.0  # m


def _oscillator(omega: float, zeta: float, share: float) -> Oscillator:
    return Oscillator(omega**2, 2 * zeta * omega, share=share)


@dataclass(frozen=True, eq=False)
class ModalAxes(VibrationModel):
    """Three straight axes with one or more modes each, the same at every position."""

    axes: tuple[tuple[Oscillator, ...], tuple[Oscillator, ...], tuple[Oscillator, ...]]

    position_dependent: ClassVar[bool] = False
    channels: ClassVar[tuple[str, str, str]] = AXES
    gravity_loaded: ClassVar[bool] = False  # weight stands on the frame, not on what vibrates
    diagnosable: ClassVar[bool] = False

    @classmethod
    def of(cls, axes: Sequence[Axis]) -> ModalAxes:
        """Return the model of three axes X Y Z."""
        x, y, z = (axis.oscillators for axis in axes)
        return cls((x, y, z))

    def _each(self) -> Iterator[tuple[int, int, Oscillator]]:
        """Yield axis, number on the axis and oscillator, in the order of the states."""
        for axis, modes in enumerate(self.axes):
            for i, mode in enumerate(modes):
                yield axis, i, mode

    @property
    def frequency_keys(self) -> tuple[str, ...]:
        """Return the frequencies of each axis that is not rigid; c damps rigid axes only."""
        vibrating = (name for name, modes in zip(AXES, self.axes, strict=True) if not modes[0].belt_damping)
        return tuple(f"axes.{name}.frequency_hz" for name in vibrating)

    # ---- parameters

    def parameters(self) -> ParameterSet:
        """Return the numbers that decide how the machine vibrates; its geometry is calibrated, not guessed."""
        found = [
            Parameter(
                f"axes.{AXES[axis]}.{kind}[{i}]", getattr(mode, kind), _column(axis, i, kind), *_of_file(axis, kind)
            )
            for axis, i, mode in self._each()
            for kind in KINDS
        ]
        return ParameterSet(tuple(found), max(COLUMNS, *(p.column + 1 for p in found)))

    def value(self, name: str) -> float:
        """Return one parameter; KeyError if there is none of this name."""
        axis, i, kind = _parsed(name)
        return float(getattr(self.axes[axis][i], kind))

    def with_parameters(self, values: Mapping[str, float]) -> ModalAxes:
        """Return the model with some parameters replaced; KeyError for an unknown name."""
        axes = [list(modes) for modes in self.axes]
        for name, value in values.items():
            axis, i, kind = _parsed(name)
            axes[axis][i] = replace(axes[axis][i], **{kind: float(value)})
        x, y, z = (tuple(modes) for modes in axes)
        return ModalAxes((x, y, z))

    # ---- the equations

    def jacobian(self, xy: FloatArray) -> FloatArray:
        """Return J of the nozzle's motion from the actuators' at (n, 2) mm: (n, 3, 3)."""
        return np.tile(np.eye(3), (len(xy), 1, 1))

    def axis_frf(self, s: ComplexArray) -> ComplexArray:
        """Return q/u of each axis: (k, 3) for s (k,) 1/s."""
        found = np.zeros((len(s), 3), dtype=np.complex128)
        for axis, _, o in self._each():
            drive = o.belt_damping * s + o.stiffness
            found[:, axis] += o.share * drive / (o.mass * s**2 + (o.belt_damping + o.damping) * s + o.stiffness)
        return found

    def carriage_response(self, xy: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return G, commanded to real actuator positions, at (2,) mm and s (k,) 1/s: (k, 3, 3)."""
        return np.asarray(self.axis_frf(s)[:, None, :] * np.eye(3))

    def mechanics(self, xy: FloatArray) -> FloatArray:
        """Return d/dt of the m/2 coordinates and their rates with the motors held, (n, m, m), at (n, 2) mm."""
        plant = self.state_space(xy[:1])
        order = np.arange(plant.a.shape[1]).reshape(-1, 2).T.ravel()  # positions, then rates
        return np.tile(plant.a[0][np.ix_(order, order)], (len(xy), 1, 1))

    def nozzle_motion(self, xy: FloatArray) -> FloatArray:
        """Return the nozzle's motion from the coordinates', (n, 3, m/2), at positions (n, 2) mm."""
        return np.tile(np.eye(3)[:, [axis for axis, _, _ in self._each()]], (len(xy), 1, 1))

    def state_space(self, xy: FloatArray) -> StateSpace:
        """Return the equations of motion frozen at each of the positions (g, 2) mm, in the model's own states."""
        each = list(self._each())
        n = 2 * len(each)
        a, command, slope, carriage = np.zeros((n, n)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((3, n))
        for m, (axis, _, o) in enumerate(each):
            p, rate = 2 * m, 2 * m + 1
            a[p, rate] = 1.0
            a[rate, p], a[rate, rate] = -o.stiffness / o.mass, -(o.belt_damping + o.damping) / o.mass
            command[rate, axis], slope[rate, axis] = o.share * o.stiffness / o.mass, o.share * o.belt_damping / o.mass
            carriage[axis, p] = 1.0

        def everywhere(matrix: FloatArray) -> FloatArray:
            return np.tile(matrix, (len(xy), 1, 1))

        return StateSpace(
            everywhere(a),
            everywhere(command),
            everywhere(slope),
            everywhere(np.zeros((n, 3))),
            carriage,
            tuple(f"{kind}_{AXES[axis]}{i + 1}" for axis, i, _ in each for kind in ("pos", "vel")),
            oscillators=np.array([axis for axis, _, _ in each]),
        )

    def low_frequency(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return τ and C: the sums' series at s = 0, turned over."""
        tau, bend = np.zeros(3), np.zeros(3)
        for axis, _, o in self._each():
            lag = o.damping / o.stiffness
            tau[axis] += o.share * lag
            bend[axis] += o.share * (o.mass / o.stiffness - lag * (o.belt_damping / o.stiffness + lag))
        return tau, np.tile(np.diag(bend + tau**2), (len(xy), 1, 1))

    def equilibrium(self, q: FloatArray) -> FloatArray:
        """Return the state at rest with the actuators at (3,) mm."""
        return self.steady_motion(q, np.zeros(3))

    def steady_motion(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Return the state with the actuators at (3,) mm, in motion at (3,) mm/s since long."""
        tau, _ = self.low_frequency(np.zeros((1, 2)))
        u = q + tau * qd
        states = [
            (o.share * (u[axis] - o.damping / o.stiffness * qd[axis]), o.share * qd[axis])
            for axis, _, o in self._each()
        ]
        return np.array(states).ravel()

    def undriven(self) -> ModalAxes:
        """Return the model behind ideal drives: motors stand where they are told to."""
        return self

    # ---- the nonlinear printer

    def printer_parameters(self, gravity_m_per_s2: float) -> PrinterFields:
        """Return what the nonlinear printer's kernels need of the model, SI."""
        if max(map(len, self.axes)) > PRINTER_MODES:
            raise ValueError(f"The nonlinear printer holds at most {PRINTER_MODES} modes an axis.")
        silent = _oscillator(2 * np.pi * SILENT_HZ, SILENT_DAMPING, 0.0)
        first, second = [modes[0] for modes in self.axes], [(*modes, silent)[1] for modes in self.axes]
        return {
            "first_share": np.array([o.share for o in first]),
            "carriage_mass": 1.0,
            "belt_k": np.array([o.stiffness / o.mass for o in first]),
            "belt_c": np.array([o.belt_damping / o.mass for o in first]),
            "guide_b": np.array([o.damping / o.mass for o in first]),
            "ideal_drive": True,
            "shares": np.stack([np.eye(3)] * 3),
            "holder_mass": 1.0,
            "extruder_mass": 1.0,
            "mount_k": np.array([o.stiffness / o.mass for o in second]),
            "mount_b": np.array([o.damping / o.mass for o in second]),
            "least_inertia": 1.0,
        }

    def describe(self) -> Description:
        """Return the words for headings."""
        return Description("straight axes", None)


def _parameter(axis: int, mode: int, kind: str, value: float) -> Parameter:
    name = f"axes.{AXES[axis]}.{kind}[{mode}]"
    return Parameter(name, value, _column(axis, mode, kind), *_of_file(axis, kind))


def _column(axis: int, mode: int, kind: str) -> int:
    first = 3 * KINDS.index(kind) + axis
    if mode == 0:
        return first
    if mode == 1:
        second = {"mass": SECOND_MASS, "stiffness": SECOND_STIFFNESS + axis, "damping": SECOND_DAMPING + axis}
        return second.get(kind, first)
    return COLUMNS + 12 * (mode - 2) + first


def _of_file(axis: int, kind: str) -> tuple[str, float]:
    """Return the file's key that tells how well a parameter is known, and its power in it."""
    powers = {"stiffness": ("frequency_hz", 2.0), "damping": ("damping_ratio", 1.0)}
    key, power = powers.get(kind, ("", 1.0))
    return (f"axes.{AXES[axis]}.{key}" if key else ""), power


def _parsed(name: str) -> tuple[int, int, str]:
    match = NAME.fullmatch(name)
    if match is None or match["kind"] not in KINDS:
        raise KeyError(name)
    return AXES.index(match["axis"]), int(match["mode"]), match["kind"]
