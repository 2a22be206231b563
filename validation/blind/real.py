"""A printer as it really is: its numbers, what it does beyond them, what happens to its orders and to its readings."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
import tomlkit
from numba import njit
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

FloatArray = NDArray[np.float64]
Rng: TypeAlias = np.random.Generator
Tables: TypeAlias = dict[str, Any]  # of a machine file
Labels: TypeAlias = dict[str, dict[str, Any]]  # effect -> its table in a machine file
Range: TypeAlias = tuple[float, float]  # drawn evenly between
SLIP_S = 0.006


@dataclass(frozen=True, eq=False)
class Reading:
    """What perfect sensors, or worse ones, would read: uniform samples."""

    t: FloatArray  # (n,) s
    carriage: FloatArray  # (n, 3) m/s², A B C
    nozzle: FloatArray  # (n, 3) m/s², x y z
    carriage_mm: FloatArray  # (n, 3)
    nozzle_mm: FloatArray  # (n, 3)
    force: FloatArray | None = None  # (n,) N, of an axis that a force drives


Order: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]  # (n,) s, (n, motors) mm → the same, spoiled
Reader: TypeAlias = Callable[[Reading], Reading]


@dataclass(frozen=True, eq=False)
class Real:
    """`machine` : tables of a machine file. `fields` : of the plant's record."""

    machine: Tables
    fields: Mapping[str, Any] = field(default_factory=dict)
    orders: tuple[Order, ...] = ()
    readers: tuple[Reader, ...] = ()

    def having(self, **fields: Any) -> Real:
        """Return the printer with these fields set."""
        return replace(self, fields={**self.fields, **fields})

    def changed(self, table: str, **numbers: Any) -> Real:
        """Return the printer with other numbers in one table."""
        machine = copy.deepcopy(self.machine)
        machine[table].update(numbers)
        return replace(self, machine=machine)

    def ordered(self, order: Order) -> Real:
        """Return the printer whose orders are spoiled so."""
        return replace(self, orders=(*self.orders, order))

    def read_by(self, reader: Reader) -> Real:
        """Return the printer whose readings are spoiled so."""
        return replace(self, readers=(*self.readers, reader))

    def order(self, command: FloatArray, dt: float) -> FloatArray:
        """Return what the motors are ordered in place of a command (n, motors) mm each dt."""
        for order in self.orders:
            command = order(dt * np.arange(len(command), dtype=np.float64), command)
        return command

    def read(self, reading: Reading, name: str) -> Reading:
        """Return a reading as the sensors spoil it.

        Raises
        ------
        ValueError
            If the motion of this name has ended in numbers that are not finite.
        """
        if not np.all(np.isfinite(reading.nozzle)):
            raise ValueError(f"The printer has come apart in the motion {name}.")
        for reader in self.readers:
            reading = reader(reading)
        return reading


Hide: TypeAlias = Callable[[Rng, float, Real], tuple[Tables, Real]]


@dataclass(frozen=True)
class Drawn:
    """How large the effects of one kind of printer are. Forces are drawn as numbers times `loads`, one a motor."""

    motors: int
    loads: Callable[[Real], FloatArray]  # (motors,), what a force of one is on each motor, N
    forces: Callable[..., Tables]  # of a printer and arrays (motors,) by key: a file's table of forces
    springs: Callable[[Real], FloatArray]  # (motors,) N/m
    stiffened: Callable[[Real, FloatArray], Real]  # by these shares, (motors,)
    of_belts: Callable[..., Tables]  # as `forces`, of the belts
    stretch_m: Callable[[Real], Range]  # at which a belt that hardens is half as stiff again
    uneven: Range  # where motors differ, each is so many times the middle
    friction: Range
    stiction: Range
    grease: Range
    slope_per_m: Range
    centre_mm: Range
    play_mm: Range
    stepper_mm: Range
    ripple_mm: Range
    frame_kg: Range
    frame_hz: Range
    # outside the catalogue
    pulley_m: Range
    pulley_share: Range
    warm_share: Range
    warm_s: Range
    cable: Range  # kg, or a share of what `loads` has
    fan: Range
    felt: tuple[float, ...]  # (6,): 1 where a sensor of carriages or nozzle is
    notch: Range
    softens: float = 0.0  # share of the belts that harden which soften
    bends: bool = True  # whether dry friction may bend before it slides

    def each(self, rng: Rng, value: float) -> FloatArray:
        """Draw the same for every motor, or as often as not different ones: (motors,)."""
        uneven = rng.uniform(*self.uneven, self.motors)
        return value * (uneven if rng.random() < 0.35 else np.ones(self.motors))

    def some(self, rng: Rng) -> FloatArray:
        """Draw one motor, or all: (motors,), ones and zeros."""
        return np.eye(self.motors)[rng.integers(self.motors)] if rng.random() < 0.5 else np.ones(self.motors)


def told(values: FloatArray) -> Any:
    """Return values as a machine file has them: one number if all are equal, else a list of three."""
    lacking = [0.0] * (3 - len(values))
    return float(values[0]) if np.ptp(values) == 0 else [*(float(x) for x in values), *lacking]


def sign(rng: Rng) -> float:
    """Draw one of either sign."""
    return float(rng.choice([-1.0, 1.0]))


def off_by(error: float, rng: Rng) -> Callable[[float], float]:
    """Return a function that makes a number wrong by a normal error, within two deviations."""
    return lambda value: value * (1 + error * float(np.clip(rng.standard_normal(), -2.0, 2.0)))


def combined(machine: Any, probed: Sequence[Any], times: Sequence[float]) -> Any:
    """Return the tables (or what is in them) moved so many times as far as each of the probed ones is."""
    if isinstance(machine, Mapping):
        return {key: combined(value, [p[key] for p in probed], times) for key, value in machine.items()}
    if isinstance(machine, list | tuple):
        return [combined(value, [p[i] for p in probed], times) for i, value in enumerate(machine)]
    if isinstance(machine, bool | str) or all(np.array_equal(p, machine) for p in probed):
        return machine
    return machine + sum(n * (p - machine) for n, p in zip(times, probed, strict=True))


def toml_of(machine: Tables, name: str) -> str:
    """Write the tables of a machine file as its text."""
    return tomlkit.dumps({"format": "ffcomp-machine/1", "name": name, **_plain(machine)})


def _plain(value: Any) -> Any:
    """Return tables with Python's numbers, six digits each."""
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_plain(each) for each in value]
    return value if isinstance(value, str) else float(f"{value:.6g}")


# ---- orders and readings that are spoiled ----------------------------------------------------------


def behind(fastest_mm_per_s: float) -> Order:
    """Return orders that a driver follows by at most so much a second."""
    return lambda t, command: _behind(np.ascontiguousarray(command), fastest_mm_per_s * (t[1] - t[0]))


@njit(cache=True)
def _behind(command: FloatArray, most: float) -> FloatArray:
    """Follow (n, motors) by at most so much a row."""
    out = command.copy()
    for n in range(1, len(command)):
        for i in range(command.shape[1]):
            out[n, i] = out[n - 1, i] + min(max(command[n, i] - out[n - 1, i], -most), most)
    return out


def slipped(rng: Rng, slip_mm: float, motors: int) -> Order:
    """Return orders with six slips of one motor, anywhere in a run."""
    motor, shares = int(rng.integers(motors)), np.sort(rng.uniform(0.1, 0.9, 6))
    steps = slip_mm * rng.choice([-1.0, 1.0], 6)

    def slipping(t: FloatArray, command: FloatArray) -> FloatArray:
        out = command.copy()
        for share, step in zip(shares, steps, strict=True):
            x = np.clip((t - share * t[-1]) / SLIP_S, 0.0, 1.0)
            out[:, motor] += step * x**2 * (3 - 2 * x)
        return out

    return slipping


def read_at(r: Reading, times: FloatArray) -> Reading:
    """Return what accelerometers read at other times; encoders keep the command's clock."""
    at = np.clip(times, r.t[0], r.t[-1])
    return replace(r, carriage=CubicSpline(r.t, r.carriage)(at), nozzle=CubicSpline(r.t, r.nozzle)(at))


def hummed(rng: Rng, level: FloatArray) -> Reader:
    """Return readings with a tone of 44 to 110 Hz, (6,) m/s² on carriages and nozzle."""
    hertz, phase = rng.uniform(44.0, 110.0), rng.uniform(0, 2 * np.pi, 6)

    def read(r: Reading) -> Reading:
        tone = level * np.sin(2 * np.pi * hertz * r.t[:, None] + phase)
        return replace(r, carriage=r.carriage + tone[:, :3], nozzle=r.nozzle + tone[:, 3:])

    return read


def slowed(cutoff_hz: float, size: float) -> Reader:
    """Return readings whose nozzle went through a low-pass of second order."""

    def read(r: Reading) -> Reading:
        sections = butter(2, cutoff_hz, fs=1 / (r.t[1] - r.t[0]), output="sos")
        return replace(r, nozzle=sosfilt(sections, r.nozzle, axis=0)) if size > 0 else r

    return read


def clipped_at(most_m_per_s2: float, size: float) -> Reader:
    """Return readings whose nozzle ends at so much."""
    return lambda r: replace(r, nozzle=np.clip(r.nozzle, -most_m_per_s2, most_m_per_s2)) if size > 0 else r
