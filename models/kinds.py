"""Access to the parts of one kind of machine: a delta's carriages and effector; one axis by itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from models.arrays import constant
from models.errors import MachineFileError
from models.kinematics.cartesian import CARTESIAN, CartesianKinematics
from models.machine import Machine, MotionLimits
from models.vibration.delta import Carriage, DeltaVibration, Effector
from models.vibration.driven_axis import DrivenAxis


def delta_vibration(machine: Machine) -> DeltaVibration:
    """Return the carriages and effector of a delta; MachineFileError for another machine."""
    if not isinstance(machine.vibration, DeltaVibration):
        rule = "The machine is not a delta (kinematics.type); this works for deltas only."
        raise MachineFileError(machine.path or machine.name, [rule])
    return machine.vibration


def with_parts(machine: Machine, *, carriage: Carriage | None = None, effector: Effector | None = None) -> Machine:
    """Return the machine with another carriage or another effector; MachineFileError for a machine without them."""
    vibration = delta_vibration(machine)
    parts = replace(vibration, carriage=carriage or vibration.carriage, effector=effector or vibration.effector)
    return replace(machine, vibration=parts)


def is_one_axis(machine: Machine) -> bool:
    """Whether the machine is one axis by itself and not a printer."""
    return isinstance(machine.vibration, DrivenAxis)


def driven_axis(machine: Machine) -> DrivenAxis:
    """Return the axis of a machine of one axis; MachineFileError for a printer."""
    if not isinstance(machine.vibration, DrivenAxis):
        rule = "The machine is a printer (kinematics.type); this works for one axis by itself only."
        raise MachineFileError(machine.path or machine.name, [rule])
    return machine.vibration


def machine_of_axis(name: str, axis: DrivenAxis, **parts: Any) -> Machine:
    """Return the machine of one axis, along x, without ends and without limits; `parts` are fields of `Machine`."""
    endless = CartesianKinematics(constant([[-np.inf, np.inf]] * 3), CARTESIAN)
    return Machine(name, endless, axis, MotionLimits(np.inf, np.inf), **parts)
