"""Find the equilibrium of printers under a command at rest."""

from __future__ import annotations

import numpy as np

from models.arrays import FloatArray
from models.printer.kernels.integrate import active_effects, fill_lanes, rate, store_state
from models.printer.kernels.jit import compiled
from models.printer.kernels.motors import cogging, stiffness_by_length
from models.printer.kernels.record import COMMAND, ETA, LANES, NOW, PULL, STRETCH, Q, V, parameter_rows
from models.printer.kernels.vectors import at

BELT_K, HARDENING, QUINTIC = parameter_rows("belt_k", "cubic", "quintic")
EXTRUDER_MASS, MOUNT_K, GRAVITY = parameter_rows("extruder_mass", "mount_k", "gravity")

PASSES = 2000
TOLERANCE_M = 1e-13


@compiled
def _relax(m: FloatArray, l: int) -> float:
    """Move every carriage by its unbalanced force over its belt's stiffness; return the largest displacement, m."""
    moved = 0.0
    for i in range(3):
        shorter = stiffness_by_length(m, i * LANES + l, at(m, NOW + Q + i, l))
        squared = at(m, STRETCH + i, l) ** 2
        harder = (3.0 * at(m, HARDENING + i, l) + 5.0 * at(m, QUINTIC + i, l) * squared) * squared
        move = at(m, PULL + i, l) / (at(m, BELT_K + i, l) * max(shorter, 1.0) + max(harder, 0.0))
        m[(NOW + Q + i) * LANES + l] += move
        if not abs(move) <= moved:  # NaN too
            moved = abs(move)
    return moved


@compiled
def find_equilibrium(states: FloatArray, parameters: FloatArray) -> FloatArray:
    """Relax belts and extruder, from states : (k, STATES) with the drives at their command, until the forces balance.

    Returns
    -------
    (k,) m, the largest displacement of a carriage in the last pass; `states` is overwritten by the equilibria.
    """
    m, moved = fill_lanes(states, parameters), np.full(len(states), np.inf)
    has = active_effects(m)
    for n in range(3 * LANES):
        m[COMMAND * LANES + n] = m[(NOW + V) * LANES + n]
    cogging(m)
    for l in range(len(states)):
        m[(NOW + ETA + 2) * LANES + l] = -at(m, EXTRUDER_MASS, l) * at(m, GRAVITY, l) / at(m, MOUNT_K + 2, l)
    for _ in range(PASSES):
        rate(m, has)
        for l in range(len(states)):
            if not moved[l] < TOLERANCE_M:
                moved[l] = _relax(m, l)
        if moved.max() < TOLERANCE_M:
            break
    for l in range(len(states)):
        store_state(m, l, states)
    return moved
