"""Compute what an accelerometer on the nozzle is expected to feel in an experiment, and what unknown effects would add.

A machine file is never complete, and what it lacks must not be taken for a delay: 3 N of dry friction unaccounted for
look like 0.3 to 1 ms. So the responses to friction of several sizes and to an added mass are simulated too, and their
sizes are fitted along with the delay, and forgotten.

To first order a force F on a carriage with a belt of stiffness k acts as if its motor stood F/k elsewhere: an added
mass like a command of −q̈, and dry friction, where the machine's model has none, like one of −sgn(q̇).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ffcomp.record.motion import Commanded
from models.arrays import FloatArray
from models.machine import Machine
from models.printer.printer import simulate_printers

RATE_HZ = 1600.0
TAIL_S = 0.4  # simulated after the motion: the printer rings for 0.2 s
FRICTION_N = (1.0, 3.0, 8.0)  # of each guide: more holds the carriage fast for longer
FRICTION_MM, MASS_S2 = 1e-3, 1e-6  # small against every motion; (m/k) of an added mass
CREEP_MM_PER_S = 5.0  # below which dry friction turns over
UNFELT_M_PER_S2 = 1e-3


@dataclass(frozen=True, eq=False)
class Expectation:
    """The nozzle's acceleration in an experiment whose motion begins at 0. N times."""

    time_s: FloatArray  # (N,) s, uniform
    acceleration: FloatArray  # (N, 3) m/s², columns x y z
    signatures: FloatArray  # (s, N, 3) m/s² of effects of unknown size
    duration_s: float  # of the motion


def expectation(motion: Commanded, machine: Machine, lead_s: float, with_signatures: bool = True) -> Expectation:
    """Simulate an experiment's motion on the machine file's printer, at rest for `lead_s` before it.

    Without signatures, for a clock whose delay stays free in what is fitted next, only the plain motion is simulated.

    Raises
    ------
    UnreachableError
        If the machine cannot execute the motion.
    """
    t = np.arange(-lead_s, motion.duration_s + TAIL_S, 1 / RATE_HZ)
    carriages = machine.kinematics.inverse(motion.nozzle(t))
    if not with_signatures:
        (plain,) = _felt([machine], [carriages])
        return Expectation(t, plain, np.empty((0, *plain.shape)), motion.duration_s)
    velocity = np.gradient(carriages, 1 / RATE_HZ, axis=0)
    massive = carriages - MASS_S2 * np.gradient(velocity, 1 / RATE_HZ, axis=0)
    rubbing = [replace(machine, effects=_with_friction(machine, force)) for force in FRICTION_N]
    plain, heavy, *rubbed = _felt([machine, machine, *rubbing], [carriages, massive, *[carriages] * len(rubbing)])
    signatures = [heavy - plain, *(each - plain for each in rubbed)]
    if np.abs(signatures[-1]).max() < UNFELT_M_PER_S2:  # a model without guides
        (dragged,) = _felt([machine], [carriages - FRICTION_MM * np.tanh(velocity / CREEP_MM_PER_S)])
        signatures = [heavy - plain, dragged - plain]
    return Expectation(t, plain, np.array(signatures), motion.duration_s)


def _with_friction(machine: Machine, force_n: float) -> dict[str, Any]:
    """Return the effects of a machine with so much more dry friction."""
    known = machine.effects.get("coulomb_friction", {})
    already = float(np.mean(known.get("force_n", 0.0)))
    return {**machine.effects, "coulomb_friction": {**known, "force_n": already + force_n}}


def _felt(machines: Sequence[Machine], commands: Sequence[FloatArray]) -> list[FloatArray]:
    """Simulate the nozzle's acceleration, (N, 3) m/s² each."""
    accelerations = []
    for motion in simulate_printers(machines, commands, 1 / RATE_HZ):
        if isinstance(motion, ValueError):
            raise motion
        accelerations.append(motion.nozzle_acceleration)
    return accelerations
