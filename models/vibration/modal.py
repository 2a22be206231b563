"""Independent axes described by their modes, the numbers that a shaper calibration or an FRF gives.

An axis q with commanded position u is the sum of oscillators side by side, q = Σ p_i, with shares Σ σ_i = 1:

    p̈_i = k_i (σ_i u − p_i) + c_i (σ_i u̇ − ṗ_i) − b_i ṗ_i
    q/u = Σ σ_i (c_i s + k_i)/(s² + (c_i + b_i) s + k_i)

A mode of natural frequency ω and damping ratio ζ has k = ω² and b + c = 2 ζ ω per modal mass, where c is in the belts.
A rigid axis is one stiff oscillator, damped by c, which causes no lag. The states are (p_i, ṗ_i) of every oscillator,
those of x first. mm, s.

If the same belts drive x and y, they may exchange motion by δ (`belt_stiffness` in `models/effects`). Instead of u,
the springs of each axis follow u + δ (w − q_d), with the other axis' w and driven point q_d. Otherwise the axes are
independent.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.vibration.base import ModelParameter, ParameterSet, PrinterFields, VibrationModel
from models.vibration.state_space import StateSpace

RIGID_HZ, RIGID_DAMPING = 1500.0, 1.1
AXES = ("x", "y", "z")
KINDS = ("stiffness", "belt_damping", "damping")
FILE_KINDS = ("frequency_hz", "damping_ratio", "share")
MOUNT = re.compile(r"axes\.(?P<axis>[xyz])\.mount_frequency_hz")
EDGE = 1e-3  # fraction of the distance between two modes: a mount is no closer to either
LEAST_WEIGHT = 1e-6  # smallest part of the belt's force on a mode
NAME = re.compile(r"axes\.(?P<axis>[xyz])\.(?P<kind>\w+)\[(?P<mode>\d+)\]")
# what a draw of 20 deviates moves, as when an axis had exactly two oscillators: the same seeds give the same machines
COLUMNS = 20
FIRST_MODE = {"stiffness": 3, "belt_damping": 6, "damping": 9}
SECOND_MODE = {"stiffness": 14, "damping": 17}


@dataclass(frozen=True)
class Axis:
    """One axis of a machine file; without modes it is rigid."""

    frequency_hz: Sequence[float] = ()  # undamped
    damping_ratio: Sequence[float] = ()
    share: Sequence[float] = (1.0,)
    mass_kg: float | None = None  # all that the belt moves; None: forces are per kilogram of it
    mount_frequency_hz: float | None = None  # of the nozzle with the driven point held; None: unknown
    belt_damping_share: float = 0.0  # fraction of the damping in the belts, not in the guides

    @property
    def oscillators(self) -> tuple[Oscillator, ...]:
        """Return the axis' modes; the last one takes the remaining share."""
        if not self.frequency_hz:
            omega = 2 * np.pi * RIGID_HZ
            return (Oscillator(omega**2, 0.0, 2 * RIGID_DAMPING * omega, rigid=True),)
        shares = [*self.share[: len(self.frequency_hz) - 1]]
        shares.append(1.0 - sum(shares))
        modes = zip(self.frequency_hz, self.damping_ratio, shares, strict=True)
        each = ((2 * np.pi * f, zeta, share) for f, zeta, share in modes)
        return tuple(Oscillator(omega**2, 2 * zeta * omega, share=share) for omega, zeta, share in each)


@dataclass(frozen=True)
class Oscillator:
    """One mode of an axis."""

    stiffness: float  # k, 1/s²: ω²
    damping: float  # b, 1/s
    belt_damping: float = 0.0  # c, 1/s
    share: float = 1.0  # σ, of either sign
    rigid: bool = False  # it stands for an axis that does not vibrate

    @property
    def frequency_hz(self) -> float:
        """Return the undamped natural frequency."""
        return float(np.sqrt(self.stiffness) / (2 * np.pi))

    @property
    def damping_ratio(self) -> float:
        """Return ζ of the mode with its motor held."""
        return float((self.damping + self.belt_damping) / (2 * np.sqrt(self.stiffness)))

    def with_value(self, kind: str, value: float) -> Oscillator:
        """Return the mode with one number replaced."""
        if kind == "frequency_hz":
            more = value / self.frequency_hz
            stiffness, damping, belts = self.stiffness * more**2, self.damping * more, self.belt_damping * more
            return replace(self, stiffness=stiffness, damping=damping, belt_damping=belts)
        if kind == "damping_ratio":
            total = 2 * value * float(np.sqrt(self.stiffness))
            belts = self.belt_damping if self.rigid else total * self.belt_share
            return replace(self, damping=total - belts, belt_damping=belts)
        return replace(self, **{kind: value})  # type: ignore[arg-type]

    @property
    def belt_share(self) -> float:
        """Return how much of the damping the belts hold."""
        return self.belt_damping / (self.damping + self.belt_damping) if self.belt_damping else 0.0

    def with_belt_damping(self, moved: float) -> Oscillator:
        """Return the mode with so much of its damping, 1/s, in its belts instead of its guides."""
        return replace(self, damping=self.damping - moved, belt_damping=self.belt_damping + moved)


@dataclass(frozen=True, eq=False)
class ModalAxes(VibrationModel):
    """Three straight axes with one or more modes each, the same at every position."""

    axes: tuple[tuple[Oscillator, ...], tuple[Oscillator, ...], tuple[Oscillator, ...]]
    masses_kg: tuple[float | None, ...] = (None, None, None)  # M of each axis, if known
    exchange: float = 0.0  # δ between x and y, such as by the belts of a CoreXY
    mounts_hz: tuple[float | None, ...] = (None, None, None)  # frequency where each axis' driven point stands still

    position_dependent: ClassVar[bool] = False
    channels: ClassVar[tuple[str, str, str]] = AXES
    moves: ClassVar[Literal["carriages", "axes", "axis"]] = "axes"

    @classmethod
    def of(cls, axes: Sequence[Axis], exchange: float = 0.0) -> ModalAxes:
        """Return the model of three axes X Y Z, with the exchange between x and y."""
        x, y, z = (axis.oscillators for axis in axes)
        mounts = tuple(axis.mount_frequency_hz for axis in axes)
        guided = cls((x, y, z), tuple(axis.mass_kg for axis in axes), exchange, mounts)
        return guided.with_belt_damping(np.array([axis.belt_damping_share for axis in axes]))

    def _each(self) -> Iterator[tuple[int, int, Oscillator]]:
        """Yield axis, number on the axis and oscillator, in the order of the states."""
        for axis, modes in enumerate(self.axes):
            for i, mode in enumerate(modes):
                yield axis, i, mode

    @property
    def frequency_keys(self) -> tuple[str, ...]:
        """Return the frequencies of each axis that is not rigid."""
        vibrating = (name for name, modes in zip(AXES, self.axes, strict=True) if not modes[0].rigid)
        return tuple(f"axes.{name}.frequency_hz" for name in vibrating)

    # ---- parameters

    def parameters(self) -> ParameterSet:
        """Return the uncertain numbers of the model; the geometry is calibrated and not among them."""
        parameters = [
            ModelParameter(
                f"axes.{AXES[axis]}.{kind}[{i}]", getattr(mode, kind), _column(axis, i, known), *_of_file(axis, known)
            )
            for axis, i, mode in self._each()
            for kind in KINDS
            for known in ("damping" if kind == "belt_damping" and mode.belt_damping and not mode.rigid else kind,)
        ]
        return ParameterSet(tuple(parameters), max(COLUMNS, *(p.column + 1 for p in parameters)))

    def value(self, name: str) -> float:
        """Return one parameter, also by the file's own keys; KeyError if there is none of this name."""
        if (mount := MOUNT.fullmatch(name)) is not None:
            of = AXES.index(mount["axis"])
            if not _is_chain(self.axes[of]):
                raise KeyError(name)
            return self.mounts_hz[of] or _middle(self.axes[of])
        axis, i, kind = _parsed(name)
        if i >= len(self.axes[axis]):
            raise KeyError(name)
        return float(getattr(self.axes[axis][i], kind))

    def with_parameters(self, values: Mapping[str, float]) -> ModalAxes:
        """Return the model with some parameters replaced; KeyError for an unknown name.

        By the file's keys, a frequency keeps its damping ratio, and a mount stays between the modes.
        """
        axes, mounts = [list(modes) for modes in self.axes], list(self.mounts_hz)
        for name, value in values.items():
            if (mount := MOUNT.fullmatch(name)) is not None:
                mounts[AXES.index(mount["axis"])] = float(value)
                continue
            axis, i, kind = _parsed(name)
            axes[axis][i] = axes[axis][i].with_value(kind, float(value))
        limited = [_within(modes, mount) for modes, mount in zip(axes, mounts, strict=True)]
        return replace(self._with_axes(axes), mounts_hz=tuple(limited))

    def _with_axes(self, axes: Sequence[Sequence[Oscillator]]) -> ModalAxes:
        x, y, z = (tuple(modes) for modes in axes)
        return replace(self, axes=(x, y, z))

    @property
    def tunable(self) -> tuple[str, ...]:
        """Return the file's numbers that a measurement may correct: frequency and damping of every mode, and mounts."""
        modes = tuple(
            f"axes.{AXES[axis]}.{key}[{i}]"
            for axis, i, mode in self._each()
            if not mode.rigid
            for key in ("frequency_hz", "damping_ratio")
        )
        return (*modes, *(f"axes.{AXES[axis]}.mount_frequency_hz" for axis in range(3) if _is_chain(self.axes[axis])))

    @property
    def guessed(self) -> Mapping[str, float]:
        """Return the entries of `tunable` missing from the file, with the relative standard deviation of the guess."""
        return {
            f"axes.{AXES[axis]}.mount_frequency_hz": abs(modes[1].frequency_hz - modes[0].frequency_hz)
            / (4 * _middle(modes))
            for axis, modes in enumerate(self.axes)
            if self.mounts_hz[axis] is None and _is_chain(modes)
        }

    # ---- forces

    @property
    def moved_kg(self) -> FloatArray:
        """Return M of each axis, (3,) kg; 1 if unknown."""
        return np.array([1.0 if mass is None else mass for mass in self.masses_kg])

    @property
    def drive_stiffness(self) -> FloatArray:
        """Return k between motor and driven point of each axis, (3,) N/m, or per kilogram."""
        slack = [
            sum(w / o.stiffness for w, o in zip(self._weights(axis), modes, strict=True))
            for axis, modes in enumerate(self.axes)
        ]
        return self.moved_kg / np.array(slack)

    def _weights(self, axis: int) -> FloatArray:
        """Return how much of the driven point's motion at rest each mode has, (modes,), together 1.

        The belt drives mode i, of unit mass, by φ_i = √(w_i ω_i²/k). In a chain of two masses where the belt drives
        the first, the first stands still at the mount's frequency ω_m, so that w_i = σ_i (1 − ω_i²/ω_m²).
        """
        modes, mount = self.axes[axis], self.mounts_hz[axis]
        share = np.array([o.share for o in modes])
        if mount is None or not _is_chain(modes):
            return np.asarray(np.abs(share) / np.sum(np.abs(share)))
        square = np.array([o.frequency_hz for o in modes]) ** 2 / mount**2
        weights = np.maximum(share * (1 - square), LEAST_WEIGHT)
        return np.asarray(weights / weights.sum())

    @property
    def per_kilogram(self) -> bool:
        """Return whether forces are per moving kilogram, because the mass is unknown."""
        return all(mass is None for mass in self.masses_kg)

    def with_belts(self, relative_change: FloatArray, motors: FloatArray) -> ModalAxes:
        """Return the model with belts stiffer by (3,), of motors that move as (3, 3) of the axes says."""
        seen = np.linalg.inv(motors) @ np.diag(relative_change) @ motors  # by the axes
        stiffer = self._changed(stiffer=np.diag(seen))
        return replace(stiffer, exchange=self.exchange + float(seen[0, 1] / (1 + seen[0, 0])))

    def with_guide_damping(self, added_n_s_per_m: FloatArray) -> ModalAxes:
        """Return the model with more friction (3,) of the guides, in proportion to speed."""
        return self._changed(damped=added_n_s_per_m)

    def with_belt_damping(self, share: FloatArray) -> ModalAxes:
        """Return the model with so much (3,) of its guides' damping in its belts instead."""
        return self._with_axes([self._damped_by_belts(axis, part) for axis, part in enumerate(share.tolist())])

    def _damped_by_belts(self, axis: int, share: float) -> tuple[Oscillator, ...]:
        """Return the modes of an axis with this share of the damping, of the mode that they move most, in its belts.

        A belt's damper c is parallel to its spring k and acts on every mode with c/k of the spring's effect: each mode
        follows the motor's rate in proportion to its stiffness. The loss goes by w, as for the spring's motion; a mode
        that it drives more than it damps gets the difference back.
        """
        if not share:
            return self.axes[axis]
        modes, weights = self.axes[axis], self._weights(axis)
        most = int(np.argmax(weights))
        slower = share * modes[most].damping / (float(weights[most]) * modes[most].stiffness)  # c/k, s
        return tuple(mode.with_belt_damping(slower * mode.stiffness) for mode in modes)

    def _changed(self, stiffer: FloatArray | float = 0.0, damped: FloatArray | float = 0.0) -> ModalAxes:
        changes = np.stack([np.broadcast_to(x, 3) for x in (stiffer, damped)], axis=1)
        weights = [self._weights(axis) for axis in range(3)]
        each = zip(self.axes, weights, self.drive_stiffness, changes.tolist(), strict=True)
        return self._with_axes(
            [_with_forces(modes, w, k, *change) if any(change) else modes for modes, w, k, change in each]
        )

    # ---- the equations

    def axis_frf(self, s: ComplexArray) -> ComplexArray:
        """Return q/u of each axis: (k, 3) for s (k,) 1/s."""
        response = np.zeros((len(s), 3), dtype=np.complex128)
        for axis, _, o in self._each():
            drive = o.belt_damping * s + o.stiffness
            response[:, axis] += o.share * drive / (s**2 + (o.belt_damping + o.damping) * s + o.stiffness)
        return response

    def _part(self, axis: int, i: int) -> float:
        """Return the part of a mode's p in q_d: w/σ."""
        share = self.axes[axis][i].share
        return float(self._weights(axis)[i] / share) if share else 0.0

    def carriage_response(self, xy: FloatArray, s: ComplexArray) -> ComplexArray:
        """Return G, commanded to real actuator positions, at (2,) mm and s (k,) 1/s: (k, 3, 3)."""
        if self.exchange:
            return super().carriage_response(xy, s)
        return np.asarray(self.axis_frf(s)[:, None, :] * np.eye(3))

    def state_space(self, xy: FloatArray) -> StateSpace:
        """Return the equations of motion frozen at each of the positions (g, 2) mm, in the model's own states."""
        each = list(self._each())
        n = 2 * len(each)
        a, command, slope, carriage = np.zeros((n, n)), np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((3, n))
        for m, (axis, _, o) in enumerate(each):
            p, rate = 2 * m, 2 * m + 1
            a[p, rate] = 1.0
            a[rate, p], a[rate, rate] = -o.stiffness, -(o.belt_damping + o.damping)
            command[rate, axis], slope[rate, axis] = o.share * o.stiffness, o.share * o.belt_damping
            carriage[axis, p] = 1.0
        for m, (axis, _, o) in enumerate(each if self.exchange else ()):
            other, rate = 1 - axis, 2 * m + 1
            if axis < 2:
                command[rate, other] = o.share * o.stiffness * self.exchange
                for k, (of, mode, _) in enumerate(each):
                    if of == other:
                        a[rate, 2 * k] -= command[rate, other] * self._part(of, mode)
        names = tuple(f"{kind}_{AXES[axis]}{i + 1}" for axis, i, _ in each for kind in ("pos", "vel"))
        axes = np.array([axis for axis, _, _ in each])
        return StateSpace(a, command, slope, slope, carriage, names, oscillators=axes).everywhere(len(xy))

    def steady_motion(self, q: FloatArray, qd: FloatArray) -> FloatArray:
        """Return the state with the actuators at (3,) mm, in steady motion at (3,) mm/s."""
        tau, _ = self.low_frequency(np.zeros((1, 2)))
        u = q + tau * qd
        each = ((o.share, u[a] - o.damping / o.stiffness * qd[a], qd[a]) for a, _, o in self._each())
        return np.array([(share * place, share * rate) for share, place, rate in each]).ravel()

    # ---- the nonlinear printer

    def printer_parameters(self, gravity_m_per_s2: float) -> PrinterFields:
        """Return the model's numbers for the nonlinear printer's kernels, SI."""
        k = self.drive_stiffness
        mobility = [
            sum(w * o.stiffness for w, o in zip(self._weights(axis), modes, strict=True))
            for axis, modes in enumerate(self.axes)
        ]
        return {
            "carriage_mass": self.moved_kg,
            "belt_k": k,
            "uneven": np.array([self.exchange, -self.exchange, 0.0]),
            "ideal_drive": True,
            "holder_mass": 1.0,
            "extruder_mass": 1.0,
            "least_inertia": float(np.min(k / np.array(mobility))),
        }

    def printer_modes(self) -> FloatArray:
        """Return the modes of the axes, (n, 7, 3).

        ω², b/m, c/m, σ, part of q_d, N s²/m of the frame's reaction, and 1 for the axis' highest mode.
        """
        table = np.zeros((max(map(len, self.axes)), 7, 3))
        table[:, 0] = table[:, 1] = 1.0  # for an idle mode
        for axis, (modes, k) in enumerate(zip(self.axes, self.drive_stiffness, strict=True)):
            for i, (o, weight) in enumerate(zip(modes, self._weights(axis), strict=True)):
                omega2, part = o.stiffness, weight / o.share if o.share else 0.0
                highest = all(o is mode or o.frequency_hz > mode.frequency_hz for mode in modes)
                table[i, :2, axis] = omega2, o.damping
                table[i, 2:, axis] = o.belt_damping, o.share, part, k * part / omega2, highest
        return table


def _is_chain(modes: Sequence[Oscillator]) -> bool:
    """Whether an axis may be two masses in series: in the higher mode they move against each other."""
    if len(modes) != 2:
        return False
    low, high = sorted(modes, key=lambda mode: mode.frequency_hz)
    return low.share > 0 > high.share and low.frequency_hz < high.frequency_hz


def _middle(modes: Sequence[Oscillator]) -> float:
    """Guess where the first of two masses stands still, Hz: the belt then drives both modes equally."""
    return float(np.sqrt(np.mean([o.frequency_hz**2 for o in modes])))


def _within(modes: Sequence[Oscillator], mount_hz: float | None) -> float | None:
    """Return a mount's frequency limited to between the modes: two masses allow no other."""
    if mount_hz is None or not _is_chain(modes):
        return mount_hz
    low, high = sorted(o.frequency_hz for o in modes)
    edge = EDGE * (high - low)
    return float(np.clip(mount_hz, low + edge, high - edge))


def _with_forces(
    modes: Sequence[Oscillator], weights: FloatArray, k: float, stiffer: float, damped: float
) -> tuple[Oscillator, ...]:
    """Return the modes of an axis with k (1 + stiffer), and with more damping at its driven point.

    In coordinates of unit mass the belt drives mode i by φ_i, φ_i² = w_i ω_i²/k, and K + r k φφᵀ has new modes. Each
    keeps its own damping; the rest of the damping matrix would couple them. A rigid axis has no numbers that a file
    could change.
    """
    if modes[0].rigid:
        return tuple(modes)
    omega2 = np.array([o.stiffness for o in modes])
    share = np.array([o.share for o in modes])
    phi = np.sqrt(weights * omega2 / k)
    shown = np.divide(share * omega2, k * phi, out=np.zeros_like(phi), where=phi > 0)  # of the nozzle
    more = np.outer(phi, phi)
    squares, shapes = np.linalg.eigh(np.diag(omega2) + stiffer * k * more) if stiffer else (omega2, np.eye(len(phi)))
    damping = shapes.T @ (np.diag([o.damping for o in modes]) + damped * more) @ shapes
    belts = shapes.T @ np.diag([o.belt_damping for o in modes]) @ shapes
    shares = k * (1 + stiffer) * (shapes.T @ phi) * (shapes.T @ shown) / squares
    each = zip(squares.tolist(), np.diag(damping).tolist(), np.diag(belts).tolist(), shares.tolist(), strict=True)
    return tuple(Oscillator(square, guide, belt, share=sigma) for square, guide, belt, sigma in each)


def _column(axis: int, mode: int, kind: str) -> int:
    first = FIRST_MODE[kind] + axis
    if mode < 2:
        return SECOND_MODE[kind] + axis if mode and kind in SECOND_MODE else first
    return COLUMNS + 12 * (mode - 2) + first


def _of_file(axis: int, kind: str) -> tuple[str, float]:
    """Return the file's key with a parameter's uncertainty, and its power in it."""
    powers = {"stiffness": ("frequency_hz", 2.0), "damping": ("damping_ratio", 1.0)}
    key, power = powers.get(kind, ("", 1.0))
    return (f"axes.{AXES[axis]}.{key}" if key else ""), power


def _parsed(name: str) -> tuple[int, int, str]:
    match = NAME.fullmatch(name)
    if match is None or match["kind"] not in (*KINDS, *FILE_KINDS):
        raise KeyError(name)
    return AXES.index(match["axis"]), int(match["mode"]), match["kind"]
