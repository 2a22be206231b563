"""A printer as it really is: its numbers, what it does beyond them, what happens to its orders and to its readings."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from validation.blind.equations import rest, run
from validation.blind.machines import Tables
from validation.blind.motions import Motion, points
from validation.blind.numbers import FloatArray, carriages_of, printer_of

STEP_S = 1 / 12800
KEPT_EVERY = 2  # 6400 samples a second: what a sensor's clock then picks from
COARSE_STEP_S = 1 / 3200  # for derivatives of a printer without friction or play


@dataclass(frozen=True, eq=False)
class Reading:
    """What perfect sensors, or worse ones, would say: uniform samples."""

    t: FloatArray  # (n,) s
    carriage: FloatArray  # (n, 3) m/s², A B C
    nozzle: FloatArray  # (n, 3) m/s², x y z
    carriage_mm: FloatArray  # (n, 3)
    nozzle_mm: FloatArray  # (n, 3)


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
        return replace(self, fields={**self.fields, **fields})

    def changed(self, table: str, **numbers: Any) -> Real:
        machine = copy.deepcopy(self.machine)
        machine[table].update(numbers)
        return replace(self, machine=machine)

    def ordered(self, order: Order) -> Real:
        return replace(self, orders=(*self.orders, order))

    def read_by(self, reader: Reader) -> Real:
        return replace(self, readers=(*self.readers, reader))


def played(real: Real, firmware: Mapping[str, Any], motion: Motion, step_s: float = STEP_S) -> Reading:
    """What the real printer's sensors say of a motion, before their noise; 6400 samples a second, or one a step."""
    p = printer_of(real.machine, real.fields)
    path = points(motion, 2 / step_s)
    command = carriages_of(firmware, path)
    for order in real.orders:
        command = order(step_s / 2 * np.arange(len(command), dtype=np.float64), command)
    command = np.ascontiguousarray(command / 1e3)
    start = rest(path[0] / 1e3, command[0], p)
    every = KEPT_EVERY if step_s == STEP_S else 1
    out = run(command, _speed(command, step_s / 2), step_s, every, start, p)
    if not np.all(np.isfinite(out)):
        raise ValueError(f"The printer has come apart in the motion {motion.name}.")
    t = step_s * every * np.arange(len(out), dtype=np.float64)
    reading = Reading(t, out[:, 2], out[:, 3], out[:, 0] * 1e3, out[:, 1] * 1e3)
    for reader in real.readers:
        reading = reader(reading)
    return reading


def _speed(command: FloatArray, dt: float) -> FloatArray:
    """Central differences over five rows, fourth order; the ends rest."""
    speed = np.zeros_like(command)
    speed[2:-2] = (8 * (command[3:-1] - command[1:-3]) - (command[4:] - command[:-4])) / (12 * dt)
    return speed
