"""A printer as it really is: its numbers, what it does beyond them, what happens to its orders and to its readings."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any, TypeAlias

import numpy as np
import tomlkit
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

FloatArray = NDArray[np.float64]
Rng: TypeAlias = np.random.Generator
Tables: TypeAlias = dict[str, Any]  # of a machine file
Labels: TypeAlias = dict[str, dict[str, Any]]  # effect -> its table in a machine file
Range: TypeAlias = tuple[float, float]  # drawn evenly between


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


def larger(machine: Tables, key: str, share: float, n: int | None = None) -> Tables:
    """Return the machine with the number at table.key (or its n-th) larger by a share."""
    probed = copy.deepcopy(machine)
    *tables, name = key.split(".")
    numbers = reduce(dict.__getitem__, tables, probed)
    if n is None:
        numbers[name] *= 1 + share
    else:
        numbers[name][n] *= 1 + share
    return probed


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


# ---- readings that are spoiled ----------------------------------------------------------


def read_at(r: Reading, times: FloatArray) -> Reading:
    """Return what accelerometers read at other times; encoders keep the command's clock."""
    at = np.clip(times, r.t[0], r.t[-1])
    return replace(r, carriage=CubicSpline(r.t, r.carriage)(at), nozzle=CubicSpline(r.t, r.nozzle)(at))


def slowed(cutoff_hz: float, size: float) -> Reader:
    """Return readings whose nozzle went through a low-pass of second order."""

    def read(r: Reading) -> Reading:
        sections = butter(2, cutoff_hz, fs=1 / (r.t[1] - r.t[0]), output="sos")
        return replace(r, nozzle=sosfilt(sections, r.nozzle, axis=0)) if size > 0 else r

    return read
