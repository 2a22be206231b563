"""A machine's numbers by name, as its file names them: `carriage.belt_stiffness_n_per_m`.

Elements of lists carry their index: `effector.extruder_stiffness_n_per_m[2]`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from models.arrays import constant
from models.machine import Machine

NAME = re.compile(r"(?P<path>[\w.]+?)(\[(?P<index>\d)\])?")


CARRIAGE = ("mass_kg", "belt_stiffness_n_per_m", "belt_damping_n_s_per_m", "guide_damping_n_s_per_m")
DRIVE = ("d0_per_s2", "d1_per_s", "d2_per_s")
EFFECTOR = ("nozzle_mass_kg", "extruder_mass_kg")
MOUNT = ("extruder_stiffness_n_per_m", "extruder_damping_n_s_per_m")


def dynamic_numbers(machine: Machine) -> list[str]:
    """The numbers that decide how a machine vibrates; its geometry is calibrated, not guessed."""
    names = []
    for key in CARRIAGE:  # three of them, where an effect has made towers differ
        several = np.ndim(getattr(machine.carriage, key)) > 0
        names += [f"carriage.{key}[{i}]" for i in range(3)] if several else [f"carriage.{key}"]
    if machine.carriage.drive is not None:
        names += [f"carriage.drive.{key}" for key in DRIVE]
    return names + [f"effector.{key}" for key in EFFECTOR] + [f"effector.{key}[{i}]" for key in MOUNT for i in range(3)]


def value_of(machine: Machine, name: str) -> float:
    """One number.

    Raises
    ------
    KeyError
        If the machine has no such number.
    """
    path, index = _parsed(name)
    part: Any = machine
    for key in path:
        part = getattr(part, key, None)
        if part is None:
            raise KeyError(name)
    return float(part if index is None else part[index])


def with_values(machine: Machine, values: Mapping[str, float]) -> Machine:
    """The machine with some of its numbers replaced."""
    for name, value in values.items():
        path, index = _parsed(name)
        machine = _with(machine, path, index, value)
    return machine


def _with(part: Any, path: list[str], index: int | None, value: float) -> Any:
    old = getattr(part, path[0])
    if len(path) > 1:
        return replace(part, **{path[0]: _with(old, path[1:], index, value)})
    if index is None:
        return replace(part, **{path[0]: float(value)})
    array = np.array(old, dtype=float)
    array[index] = value
    return replace(part, **{path[0]: constant(array)})


def _parsed(name: str) -> tuple[list[str], int | None]:
    match = NAME.fullmatch(name)
    if match is None:
        raise KeyError(name)
    index = match["index"]
    return match["path"].split("."), None if index is None else int(index)
