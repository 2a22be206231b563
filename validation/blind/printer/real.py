"""A printer as it really is: its numbers, what it does beyond them, what happens to its orders and to its readings."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

FloatArray = NDArray[np.float64]
Tables: TypeAlias = dict[str, Any]  # of a machine file
Labels: TypeAlias = dict[str, dict[str, Any]]  # effect -> its table in a machine file


@dataclass(frozen=True, eq=False)
class Reading:
    """What perfect sensors, or worse ones, would say: uniform samples."""

    t: FloatArray  # (n,) s
    carriage: FloatArray  # (n, 3) m/s², A B C
    nozzle: FloatArray  # (n, 3) m/s², x y z
    carriage_mm: FloatArray  # (n, 3)
    nozzle_mm: FloatArray  # (n, 3)
    force: FloatArray | None = None  # (n,) N, of an axis that a force drives


Order: TypeAlias = Callable[[FloatArray, FloatArray], FloatArray]  # (n,) s, (n, 3) mm of carriages → the same, spoiled
Reader: TypeAlias = Callable[[Reading], Reading]


@dataclass(frozen=True, eq=False)
class Real:
    """`machine` : tables of a machine file. `fields` : of numbers.PRINTER."""

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


Rng: TypeAlias = np.random.Generator
Hide: TypeAlias = Callable[[Rng, float, Real], tuple[dict[str, Any], Real]]


def sign(rng: Rng) -> float:
    """Draw one of either sign."""
    return float(rng.choice([-1.0, 1.0]))


def turned(angles: FloatArray) -> FloatArray:
    """(3, 3), columns the axes of a frame turned by a rotation vector: the series of exp, to rounding."""
    x, y, z = angles
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    term, total = np.eye(3), np.eye(3)
    for n in range(1, 16):
        term = term @ cross / n
        total = total + term
    return total


def read_at(r: Reading, times: FloatArray) -> Reading:
    """Return the accelerometers sample at other times; encoders keep the command's clock."""
    at = np.clip(times, r.t[0], r.t[-1])
    return replace(r, carriage=CubicSpline(r.t, r.carriage)(at), nozzle=CubicSpline(r.t, r.nozzle)(at))


def combined(machine: Any, probed: Sequence[Any], times: Sequence[float]) -> Any:
    """Return the tables (or what is in them) moved so many times as far as each of the probed ones is."""
    if isinstance(machine, Mapping):
        return {key: combined(value, [p[key] for p in probed], times) for key, value in machine.items()}
    if isinstance(machine, list | tuple):
        return [combined(value, [p[i] for p in probed], times) for i, value in enumerate(machine)]
    if isinstance(machine, bool | str) or all(np.array_equal(p, machine) for p in probed):
        return machine
    return machine + sum(n * (p - machine) for n, p in zip(times, probed, strict=True))
