"""Check that a plant is the printer that a machine file describes."""

from __future__ import annotations

import numpy as np

from models.errors import MachineFileError
from models.machine import Machine


def check_same_kinematics(machine: Machine, plant: Machine) -> None:
    """Check that a plant has the machine's kinematics; else its error would be that of the geometry.

    Parameters
    ----------
    machine, plant : Machine

    Raises
    ------
    MachineFileError
        If the plant's kinematics differ by more than ALLOWED.
    """
    if type(machine.kinematics) is not type(plant.kinematics):
        rule = f"A plant must have the machine's kind of kinematics, that of {machine.path or machine.name}."
        raise MachineFileError(plant.path or plant.name, [rule])
    problems = []
    for key, allowed in machine.kinematics.calibration_tolerances.items():
        own, other = (np.atleast_1d(getattr(m.kinematics, key)) for m in (machine, plant))
        if np.abs(own - other).max() > allowed:
            given = f"kinematics.{key} is {_shown(other)}, but {_shown(own)} in {machine.path or machine.name}"
            rule = f"a plant must have the machine's kinematics, within {allowed:g}"
            problems.append(f"{given}: {rule}. For another calibration there is the effect arm_geometry.")
    if problems:
        raise MachineFileError(plant.path or plant.name, problems)


def _shown(values: np.ndarray) -> str:
    return ", ".join(f"{v:g}" for v in values.ravel())
