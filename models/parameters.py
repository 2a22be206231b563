"""A machine's numbers by name, as its file names them: `carriage.belt_stiffness_n_per_m`.

Elements of lists carry their index: `effector.extruder_stiffness_n_per_m[2]`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from models.machine import Machine, constant

NAME = re.compile(r"(?P<path>[\w.]+?)(\[(?P<index>\d)\])?")


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
