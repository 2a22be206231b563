"""Printers at rest: equilibrium under commands, and the nozzle's deflection by weight."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyvander

from models.arrays import FloatArray
from models.errors import UnreachableError
from models.kinematics.base import Kinematics, rings
from models.machine import Machine
from models.printer.kernels.axes import FIRST, SHARE
from models.printer.kernels.integrate import find_equilibrium
from models.printer.kernels.record import LANES, STATES, PrinterParameters, Q, V, active_effects, lanes, parameter_table
from models.printer.parameters import ConvertedPrinter, converted_printer

EQUILIBRIUM_TOLERANCE_M = 1e-9


def axes_at_rest(modes: FloatArray, command_m: FloatArray) -> FloatArray:
    """Return the state (rows, 3) of straight axes under a command (3,) m: nothing loads their belts."""
    state = np.zeros((FIRST + 2 * len(modes), 3))
    state[FIRST::2] = modes[:, SHARE] * command_m
    return state


def deltas_at_rest(printers: Sequence[ConvertedPrinter], commands: FloatArray) -> list[FloatArray | ValueError]:
    """Return the state of equilibrium (30,) of each delta under its command of (k, 3) mm, or why there is none."""
    states: dict[int, FloatArray | ValueError] = {}
    for shared in dict.fromkeys(each.kinematics for each in printers):
        members = [i for i, each in enumerate(printers) if each.kinematics is shared]
        states |= zip(members, _joined(shared, commands[members]), strict=True)
    joined = [i for i, error in states.items() if not isinstance(error, ValueError)]
    for first in range(0, len(joined), LANES):
        together = joined[first : first + LANES]
        states |= zip(together, _settled(commands[together], [printers[i].parameters for i in together]), strict=True)
    return [states[i] for i in range(len(printers))]


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
    parameters = parameter_table(printers)
    moved = find_equilibrium(lanes(states, parameters).ravel(), states, active_effects(parameters))
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
    if plant.vibration.moves != "carriages":
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
    bent, straight = (_rested(converted_printer(plant, gravity=g), commands) for g in (True, False))
    powers = _powers(positions[:, :2] / reach)
    return np.asarray(np.linalg.lstsq(powers, bent - straight, rcond=None)[0])


def _rested(delta: ConvertedPrinter, commands: FloatArray) -> FloatArray:
    """Return the nozzle (k, 3) mm of a delta at rest under commands (k, 3) mm; ValueError if it cannot rest there."""
    states = deltas_at_rest([delta] * len(commands), commands)
    for state in states:
        if isinstance(state, ValueError):
            raise state
    return delta.kinematics.forward(1e3 * np.array(states)[:, Q : Q + 3])
