"""Parameters of a machine's vibrations by name, as its file names them: `carriage.belt_stiffness_n_per_m`.

Elements of lists carry their index: `effector.extruder_stiffness_n_per_m[2]`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from models.machine import Machine


def value_of(machine: Machine, name: str) -> float:
    """Return one parameter.

    Raises
    ------
    KeyError
        If the machine has no such parameter.
    """
    return machine.vibration.value(name)


def with_values(machine: Machine, values: Mapping[str, float]) -> Machine:
    """Return the machine with some of its parameters replaced."""
    return replace(machine, vibration=machine.vibration.with_parameters(values))
