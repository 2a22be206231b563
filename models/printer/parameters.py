"""Convert a machine and its effects to the parameters of the nonlinear kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from models.arrays import FloatArray
from models.effects.catalogue import effective_machine, terms_of
from models.kinematics.base import Kinematics
from models.machine import Machine
from models.printer.kernels.record import PARAMETERS, PrinterParameters

GRAVITY_M_PER_S2 = 9.80665
KNOWN = frozenset(PARAMETERS.names or ())
NEUTRAL = {"peak_stretch": np.inf, "creep": np.ones(3), "joint_creep": 1.0}  # of absent effects, where not zero


class ConvertedPrinter(NamedTuple):
    """A machine with its effects, in the kernels' form, SI."""

    parameters: PrinterParameters
    modes: FloatArray  # (n, 7, 3), of `VibrationModel.printer_modes`
    kinematics: Kinematics  # with the effects on it


def converted_printer(machine: Machine, *, gravity: bool = True) -> ConvertedPrinter:
    """Convert a machine with its effects; ValueError for an incomplete effect."""
    effective = effective_machine(machine)
    model = effective.vibration.printer_parameters(GRAVITY_M_PER_S2 if gravity else 0.0)
    geometry = effective.kinematics.printer_parameters()
    motor_k = np.asarray(geometry.get("axis_matrix", np.eye(3))).T ** 2 @ np.broadcast_to(model["belt_k"], 3)
    terms = terms_of(effective, {**geometry, **model, "motor_k": motor_k, **NEUTRAL})
    record = np.zeros(1, dtype=PARAMETERS)
    for name in terms.keys() & KNOWN:
        record[name][0] = terms[name]
    parameters = record.view(np.recarray)[0]
    return ConvertedPrinter(parameters, effective.vibration.printer_modes(), effective.kinematics)
