"""State spaces and frequency responses as objects of python-control, which takes seconds to import: only when asked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.vibration.state_space import StateSpace

if TYPE_CHECKING:
    from control import FrequencyResponseData
    from control import StateSpace as ControlStateSpace

AXES = ("x", "y", "z")
KINDS = {"carriage": "pos", "nozzle": "pos", "acceleration": "acc"}


def to_control(
    plant: StateSpace, jacobian: FloatArray, channels: Sequence[str], output: str, input: str
) -> ControlStateSpace:
    """Return the first position of a plant as a state space of python-control.

    Inputs cmd_A … or cmd_x …, outputs pos_A …, pos_x … or acc_x …; states in mm and mm/s. An ideal drive's states are
    left out. It hands the belt's damper the command's slope, ẋ = A x + B u + Bₛ u̇. The states z = x − Bₛ u need no
    slope: ż = A z + (B + A Bₛ) u, and only velocities differ between z and x, so positions read the same.

    Parameters
    ----------
    jacobian : (3, 3) mm/mm, of the nozzle's motion from the actuators' at that position.

    Raises
    ------
    ValueError
        For the acceleration with an ideal drive and a damped belt: it follows the command's slope, so no state space
        of the command has it.
    """
    import control

    a, slope, c = plant.a[0], plant.b_slope[0], plant.carriage
    b = plant.b_command[0] + a @ slope
    rows = c if output == "carriage" else jacobian @ c
    direct = np.zeros((3, 3))
    if output == "acceleration":
        if np.any(slope):
            raise ValueError(
                "The acceleration is no state space of the command: a drive is ideal and its belt is damped, so the "
                "acceleration follows the command's slope at once; give the machine a drive, or ask for 'nozzle' and "
                "differentiate."
            )
        rate = jacobian @ (c @ a)
        rows, direct = rate @ a, rate @ b
    turn = np.eye(3) if input == "carriage" else np.linalg.inv(jacobian)
    drives = plant.drive_states
    keep = np.arange(drives if not np.any(a[drives:, :drives]) else 0, len(a))
    return control.StateSpace(
        a[np.ix_(keep, keep)],
        b[keep] @ turn,
        rows[:, keep],
        direct @ turn,
        inputs=[f"cmd_{name}" for name in (channels if input == "carriage" else AXES)],
        outputs=[f"{KINDS[output]}_{name}" for name in (channels if output == "carriage" else AXES)],
        states=[plant.names[i] for i in keep],
        name=f"{output}_per_{input}",
    )


def frf_to_control(
    frequency_hz: FloatArray, value: ComplexArray, inputs: Sequence[str], outputs: Sequence[str]
) -> FrequencyResponseData:
    """Return a frequency response as data of python-control.

    Parameters
    ----------
    frequency_hz : (k,) Hz.
    value : (k, outputs, inputs).
    """
    import control

    omega = 2 * np.pi * np.asarray(frequency_hz)
    return control.FrequencyResponseData(
        np.moveaxis(np.asarray(value), 0, -1), omega, inputs=list(inputs), outputs=list(outputs)
    )
