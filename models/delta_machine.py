"""The carriages and the effector of a machine, for what works for deltas only."""

from __future__ import annotations

from dataclasses import replace

from models.errors import MachineFileError
from models.machine import Machine
from models.vibration.delta import Carriage, DeltaVibration, Effector


def delta_vibration(machine: Machine) -> DeltaVibration:
    """Return the machine's carriages and effector.

    Raises
    ------
    MachineFileError
        If the machine's vibrations are told otherwise.
    """
    if not isinstance(machine.vibration, DeltaVibration):
        rule = "The machine is no delta (kinematics.type), and this works for deltas only."
        raise MachineFileError(machine.path or machine.name, [rule])
    return machine.vibration


def with_parts(machine: Machine, *, carriage: Carriage | None = None, effector: Effector | None = None) -> Machine:
    """Return the machine with another carriage or another effector; MachineFileError for a machine without them."""
    own = delta_vibration(machine)
    return replace(
        machine, vibration=replace(own, carriage=carriage or own.carriage, effector=effector or own.effector)
    )
