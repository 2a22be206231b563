"""Printers at rest: equilibrium under a command, and the nozzle's deflection by weight."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyvander

from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.errors import UnreachableError
from models.kinematics.base import Kinematics, rings
from models.machine import Machine
from models.printer.kernels.axes import FIRST, SHARE
from models.printer.kernels.integrate import find_equilibrium
from models.printer.kernels.record import LANES, STATES, PrinterParameters, Q, V, parameter_table
from models.printer.parameters import printer_parameters

EQUILIBRIUM_TOLERANCE_M = 1e-9


def equilibrium_state(machine: Machine, command: FloatArray, p: PrinterParameters) -> FloatArray:
    """Return the state of equilibrium, SI, under the command : (3,) mm, with belts stretched by weight.

    UnreachableError: the arms cannot join the carriages. ValueError: there is no equilibrium.
    """
    effective = effective_machine(machine)
    modes = effective.vibration.printer_modes()
    if len(modes):
        return axes_at_rest(modes, command / 1e3)
    (state,) = deltas_at_rest([effective.kinematics], command[None], [p])
    if isinstance(state, ValueError):
        raise state
    return state


def axes_at_rest(modes: FloatArray, command_m: FloatArray) -> FloatArray:
    """Return the state (rows, 3) of straight axes under a command (3,) m: nothing loads their belts."""
    state = np.zeros((FIRST + 2 * len(modes), 3))
    state[FIRST::2] = modes[:, SHARE] * command_m
    return state


def deltas_at_rest(
    kinematics: Sequence[Kinematics], commands: FloatArray, printers: Sequence[PrinterParameters]
) -> list[FloatArray | ValueError]:
    """Return the state of equilibrium (30,) of each delta under its command of (k, 3) mm, or why there is none."""
    states: dict[int, FloatArray | ValueError] = {}
    distinct = {id(each): each for each in kinematics}
    for key, shared in distinct.items():
        members = [i for i, each in enumerate(kinematics) if id(each) == key]
        states |= zip(members, _joined(shared, commands[members]), strict=True)
    joined = [i for i, error in states.items() if not isinstance(error, ValueError)]
    for first in range(0, len(joined), LANES):
        lanes = joined[first : first + LANES]
        states |= zip(lanes, _settled(commands[lanes], [printers[i] for i in lanes]), strict=True)
    return [states[i] for i in range(len(kinematics))]


def _joined(kinematics: Kinematics, commands: FloatArray) -> list[FloatArray | ValueError]:
    """Return the commands (k, 3) mm, an UnreachableError in place of those that the arms cannot join."""
    try:
        kinematics.forward(commands)
        return list(commands)
    except UnreachableError as error:
        if len(commands) == 1:
            return [error]
        return [state for one in commands for state in _joined(kinematics, one[None])]


def _settled(commands: FloatArray, printers: Sequence[PrinterParameters]) -> list[FloatArray | ValueError]:
    """Settle at most LANES deltas together."""
    states = np.zeros((len(commands), STATES))
    states[:, V : V + 3] = states[:, Q : Q + 3] = commands / 1e3
    moved = find_equilibrium(states, parameter_table(printers))
    rule = "The printer has no equilibrium with its carriages at {} mm: its motors cannot hold it."
    return [
        state if m < EQUILIBRIUM_TOLERANCE_M else ValueError(rule.format(command))
        for state, m, command in zip(states, moved, commands, strict=True)
    ]


ORDER = 8
OF_X, OF_Y = np.nonzero(np.add.outer(np.arange(ORDER + 1), np.arange(ORDER + 1)) <= ORDER)  # (45,) powers
_RINGS, _ANGLES = 9, 18


def static_deflection(plant: Machine, nozzle: FloatArray) -> FloatArray:
    """Compute the static deflection at positions (m, 3) mm → (m, 3) mm.

    Zero for cartesian and CoreXY axes, whose weight does not load the belts.
    """
    if not plant.vibration.gravity_loaded:
        return np.zeros((len(nozzle), 3))
    reach = plant.kinematics.bed_radius_mm
    return np.asarray(_powers(nozzle[:, :2] / reach) @ _coefficients(plant))


def _powers(xy: FloatArray) -> FloatArray:
    """Compute x^i y^j for all i + j up to ORDER : (m, 45) of (m, 2)."""
    by_x, by_y = (polyvander(x, ORDER) for x in xy.T)
    return np.asarray(by_x[:, OF_X] * by_y[:, OF_Y])


@lru_cache(maxsize=64)
def _coefficients(plant: Machine) -> FloatArray:
    """Fit a polynomial of the eighth order over the bed, (45, 3) mm; its error is at most 10 nm."""
    reach = plant.kinematics.bed_radius_mm
    positions = np.pad(rings(reach * np.sqrt(np.linspace(0.0, 1.0, _RINGS)[1:]), _ANGLES), ((0, 0), (0, 1)))
    commands = plant.kinematics.compiled().inverse(positions)
    heavy, weightless = (printer_parameters(plant, gravity=g) for g in (True, False))
    kinematics = effective_machine(plant).kinematics
    bent, straight = (
        kinematics.forward(1e3 * np.array([equilibrium_state(plant, c, p)[Q : Q + 3] for c in commands]))
        for p in (heavy, weightless)
    )
    powers = _powers(positions[:, :2] / reach)
    return np.asarray(np.linalg.lstsq(powers, bent - straight, rcond=None)[0])
