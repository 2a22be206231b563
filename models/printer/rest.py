"""Printers at rest: where belts, extruder and modes settle under a command that stands still."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.errors import UnreachableError
from models.kinematics.base import Kinematics
from models.machine import Machine
from models.printer.kernels.axes import FIRST, SHARE
from models.printer.kernels.equilibrium import find_equilibrium
from models.printer.kernels.record import LANES, STATES, PrinterParameters, Q, V, parameter_table
from models.printer.parameters import printer_modes

EQUILIBRIUM_TOLERANCE_M = 1e-9


def equilibrium_state(machine: Machine, command: FloatArray, p: PrinterParameters) -> FloatArray:
    """Return the state of equilibrium, SI, under the command : (3,) mm, with belts stretched by weight.

    Raises
    ------
    UnreachableError
        If the arms cannot join the carriages.
    ValueError
        If there is no equilibrium.
    """
    modes = printer_modes(machine)
    if len(modes):
        return axes_at_rest(modes, command / 1e3)
    (found,) = deltas_at_rest([effective_machine(machine).kinematics], command[None], [p])
    if isinstance(found, ValueError):
        raise found
    return found


def axes_at_rest(modes: FloatArray, command_m: FloatArray) -> FloatArray:
    """Return the state (rows, 3) of straight axes under a command (3,) m: nothing loads their belts."""
    state = np.zeros((FIRST + 2 * len(modes), 3))
    state[FIRST::2] = modes[:, SHARE] * command_m
    return state


def deltas_at_rest(
    kinematics: Sequence[Kinematics], commands: FloatArray, printers: Sequence[PrinterParameters]
) -> list[FloatArray | ValueError]:
    """Return the state of equilibrium (30,) of each delta under its command of (k, 3) mm, or why there is none."""
    found: dict[int, FloatArray | ValueError] = {}
    owners = {id(own): own for own in kinematics}
    for key, own in owners.items():
        members = [i for i, each in enumerate(kinematics) if id(each) == key]
        found |= zip(members, _joined(own, commands[members]), strict=True)
    joined = [i for i, error in found.items() if not isinstance(error, ValueError)]
    for first in range(0, len(joined), LANES):
        lanes = joined[first : first + LANES]
        found |= zip(lanes, _settled(commands[lanes], [printers[i] for i in lanes]), strict=True)
    return [found[i] for i in range(len(kinematics))]


def _joined(kinematics: Kinematics, commands: FloatArray) -> list[FloatArray | ValueError]:
    """Return the commands (k, 3) mm, an UnreachableError in place of those that the arms cannot join."""
    try:
        kinematics.forward(commands)
        return list(commands)
    except UnreachableError as error:
        return (
            [error] if len(commands) == 1 else [found for one in commands for found in _joined(kinematics, one[None])]
        )


def _settled(commands: FloatArray, printers: Sequence[PrinterParameters]) -> list[FloatArray | ValueError]:
    """Settle at most LANES deltas together."""
    states = np.zeros((len(commands), STATES))
    states[:, V : V + 3] = states[:, Q : Q + 3] = commands / 1e3
    moved = find_equilibrium(states, parameter_table(printers))
    rule = "The printer cannot rest with its carriages at {} mm: its motors do not hold it."
    return [
        state if m < EQUILIBRIUM_TOLERANCE_M else ValueError(rule.format(command))
        for state, m, command in zip(states, moved, commands, strict=True)
    ]
