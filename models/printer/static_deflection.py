"""Compute the nozzle's displacement by weight at rest, which bed levelling takes out of a printer."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit

from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import Machine
from models.printer.kernels.record import Q
from models.printer.parameters import printer_parameters
from models.printer.rest import equilibrium_state

ORDER = 8
_RINGS, _ANGLES = 9, 18


def static_deflection(plant: Machine, nozzle: FloatArray) -> FloatArray:
    """Compute the static deflection at positions (m, 3) mm → (m, 3) mm.

    Zero for cartesian and CoreXY axes, whose weight rests on the frame and not on what vibrates.
    """
    if not plant.vibration.gravity_loaded:
        return np.zeros((len(nozzle), 3))
    reach = plant.kinematics.bed_radius_mm
    return np.asarray(_powers(np.ascontiguousarray(nozzle[:, :2] / reach)) @ _coefficients(plant))


@njit(cache=True, nogil=True)
def _powers(xy: FloatArray) -> FloatArray:
    """Compute x^i y^j for all i + j up to ORDER : (m, 45) of (m, 2)."""
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
    """Fit a polynomial of the eighth order over the bed, (45, 3) mm; its error is at most 10 nm."""
    reach = plant.kinematics.bed_radius_mm
    radius, angle = np.meshgrid(
        reach * np.sqrt(np.linspace(0.0, 1.0, _RINGS)), 2 * np.pi / _ANGLES * np.arange(_ANGLES)
    )
    positions = np.column_stack(
        [(radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel(), 0 * radius.ravel()]
    )
    commands = plant.kinematics.compiled().inverse(positions)
    heavy, weightless = (printer_parameters(plant, gravity=g) for g in (True, False))
    kinematics = effective_machine(plant).kinematics
    bent, straight = (
        kinematics.forward(1e3 * np.array([equilibrium_state(plant, c, p)[Q : Q + 3] for c in commands]))
        for p in (heavy, weightless)
    )
    powers = _powers(positions[:, :2] / reach)
    return np.asarray(np.linalg.lstsq(powers, bent - straight, rcond=None)[0])
