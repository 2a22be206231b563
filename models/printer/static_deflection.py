"""How far weight alone bends a resting printer: what a calibrated printer's bed levelling takes out."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit

from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import DeltaKinematics, Machine
from models.printer.kernels.record import Q
from models.printer.parameters import printer_numbers
from models.printer.printer import rest_values

ORDER = 8
_RINGS, _ANGLES = 9, 18


def sag(plant: Machine, nozzle: FloatArray) -> FloatArray:
    """How far weight alone bends the resting printer at places (m, 3) mm → (m, 3) mm."""
    if not isinstance(plant.kinematics, DeltaKinematics):  # weight stands on the frame, not on what vibrates
        return np.zeros((len(nozzle), 3))
    reach = plant.kinematics.bed_radius_mm
    return np.asarray(_powers(np.ascontiguousarray(nozzle[:, :2] / reach)) @ _coefficients(plant))


@njit(cache=True, nogil=True)
def _powers(xy: FloatArray) -> FloatArray:
    """x^i y^j for all i + j up to ORDER : (m, 45) of (m, 2)."""
    out = np.empty((len(xy), (ORDER + 1) * (ORDER + 2) // 2))
    for m in range(len(xy)):
        k, of_x = 0, 1.0
        for i in range(ORDER + 1):
            both = of_x
            for _ in range(ORDER + 1 - i):
                out[m, k] = both
                both *= xy[m, 1]
                k += 1
            of_x *= xy[m, 0]
    return out


@lru_cache(maxsize=64)
def _coefficients(plant: Machine) -> FloatArray:
    """Of a polynomial of the eighth order over the bed, (45, 3) mm; 10 nm off at the most."""
    reach = plant.kinematics.bed_radius_mm
    radius, angle = np.meshgrid(
        reach * np.sqrt(np.linspace(0.0, 1.0, _RINGS)), 2 * np.pi / _ANGLES * np.arange(_ANGLES)
    )
    places = np.column_stack([(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel(), 0 * radius.ravel()])
    commands = plant.kinematics.compiled().inverse(places)
    heavy, weightless = (printer_numbers(plant, gravity=g) for g in (True, False))
    kinematics = effective_machine(plant).kinematics
    bent, straight = (
        kinematics.forward(1e3 * np.array([rest_values(plant, c, p)[Q : Q + 3] for c in commands]))
        for p in (heavy, weightless)
    )
    powers = _powers(places[:, :2] / reach)
    return np.asarray(np.linalg.lstsq(powers, bent - straight, rcond=None)[0])
