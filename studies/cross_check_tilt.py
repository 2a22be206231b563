"""Whether the effector's tilt matters: rods that give, in MuJoCo; a part of studies/reports/cross_check.md.

`studies.cross_check` calls `tilt`. The rods of `validation/plants/multibody.py` give along their length. One rod a
tower and an effector that slides can give but not tilt; two rods a tower let it tilt as well.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, linear_sum_assignment

from models.arrays import constant
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.printer.printer import simulate_printer
from validation.plants.multibody import Choice, build, modes, play

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

RODS_N_PER_M = (1e7, 3e6, 1e6)
SLOWEST = 5  # modes; the tilt's own come in above them
FREE = 6  # belts, the carriage's mass, nozzle holder's, extruder's; its mount along x, y (z is above the slowest modes)
WEIGHED = Choice("lumped", "parallelograms", gravity=True)


def tilt(machine: Machine, path: FloatArray, places: FloatArray, row_s: float) -> dict[str, Any]:
    """Compare our model with rods that give, without and with tilt, over the bed and on a path (n, 3) mm."""
    rows = []
    for k in RODS_N_PER_M:
        straight = Choice("lumped", "sliding", gravity=True, rod_n_per_m=2 * k)
        tilting = replace(WEIGHED, rod_n_per_m=k)
        theirs = {name: _poles(machine, places, each) for name, each in (("gives", straight), ("tilts", tilting))}
        again = refitted(machine, places, theirs["tilts"])
        played = _played(machine, path, tilting, row_s)
        rows.append(
            {
                "rod_n_per_m": k,
                "gives": _apart(theirs["gives"], machine, places),
                "tilts": _apart(theirs["tilts"], machine, places),
                "tilts_refitted": _apart(theirs["tilts"], again, places),
                "response": _response(machine, path, played, row_s),
                "response_refitted": _response(again, path, played, row_s),
            }
        )
    return {"tilt": rows}


def refitted(machine: Machine, places: FloatArray, theirs: ComplexArray) -> Machine:
    """Return the machine whose numbers fit these poles best: what identification would do."""

    def apart(factors: FloatArray) -> FloatArray:
        difference = _matched(theirs, _ours(scaled(machine, factors), places)) / theirs - 1
        return np.concatenate([difference.real.ravel(), difference.imag.ravel()])

    return scaled(machine, np.asarray(least_squares(apart, np.ones(FREE), bounds=(0.3, 3.0)).x))


def scaled(machine: Machine, factors: FloatArray) -> Machine:
    """Return the machine with what identification finds multiplied by the factors."""
    carriage, effector = delta_vibration(machine).carriage, delta_vibration(machine).effector
    belts, own, nozzle, extruder = factors[:4].tolist()
    mount = np.append(factors[4:], 1.0)
    carriage = replace(
        carriage, belt_stiffness_n_per_m=belts * carriage.belt_stiffness_n_per_m, mass_kg=own * carriage.mass_kg
    )
    effector = replace(
        effector,
        nozzle_mass_kg=nozzle * effector.nozzle_mass_kg,
        extruder_mass_kg=extruder * effector.extruder_mass_kg,
        extruder_stiffness_n_per_m=constant(mount * effector.extruder_stiffness_n_per_m),
    )
    return with_parts(machine, carriage=carriage, effector=effector)


def _poles(machine: Machine, places: FloatArray, choice: Choice) -> ComplexArray:
    """Find MuJoCo's slowest : (places, SLOWEST) 1/s; places (n, 3) mm."""
    return np.array([modes(build(machine, place, choice))[:SLOWEST] for place in places])


def _ours(machine: Machine, places: FloatArray) -> ComplexArray:
    swings = [found[found.imag > 1.0] for found in machine.vibration.poles(places[:, :2])]
    return np.array([found[np.argsort(np.abs(found))][:SLOWEST] for found in swings])


def _matched(theirs: ComplexArray, ours: ComplexArray) -> ComplexArray:
    """Our poles in the order of theirs, the nearest together."""
    order = [linear_sum_assignment(np.abs(a[:, None] - b[None]))[1] for a, b in zip(theirs, ours, strict=True)]
    return np.take_along_axis(ours, np.array(order), axis=1)


def _apart(theirs: ComplexArray, machine: Machine, places: FloatArray) -> float:
    """Worst difference of a natural frequency, relative."""
    ours = _matched(theirs, _ours(machine, places))
    return float(np.abs(np.abs(ours) / np.abs(theirs) - 1).max())


def _played(machine: Machine, path: FloatArray, choice: Choice, row_s: float) -> FloatArray:
    """MuJoCo's nozzle at the command's rows, (n, 3) mm."""
    found = play(machine, path[0], machine.kinematics.inverse(path), row_s, choice)
    return found.nozzle_mm[:: round(row_s / choice.step_s)]


def _response(machine: Machine, path: FloatArray, theirs: FloatArray, row_s: float) -> float:
    """Difference of the nozzle's motion from where it rests, rms, relative to ours beyond the motors'."""
    ours = simulate_printer(machine, machine.kinematics.inverse(path), row_s)
    apart = _moved(ours.nozzle_mm) - _moved(theirs)
    vibration = _moved(ours.nozzle_mm - machine.kinematics.forward(ours.motor_mm))
    return float(np.linalg.norm(apart) / np.linalg.norm(vibration))


def _moved(values: FloatArray) -> FloatArray:
    return values - values[0]
