"""Our virtual printer against MuJoCo with the arms as bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.printer.printer import simulate_printer
from validation import judge

pytest.importorskip("mujoco")

from validation.plants import multibody
from validation.plants.multibody import Choice

FloatArray = NDArray[np.float64]

PLACE_MM = np.array([95.0, 55.0, 30.0])
ROW_S = 1 / 3200


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine(judge.MACHINE_FILE)


def with_share(machine: Machine, share: float) -> Machine:
    carriage = replace(delta_vibration(machine).carriage, arm_mass_share_at_ends=share)
    return with_parts(machine, carriage=carriage)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))


@pytest.mark.parametrize(
    "choice",
    [Choice("lumped"), Choice("lumped", "parallelograms", gravity=True), Choice("uniform", gravity=True)],
)
def test_it_answers_a_jerk_as_bodies_do(machine: Machine, choice: Choice) -> None:
    """20 mm in a tenth of a second along x and y, and half as long to ring; with weight it sags before.

    With parallelograms the effector may turn and its centre of mass is off: neither may be seen.
    """
    t = ROW_S * np.arange(round(0.15 / ROW_S) + 1)
    way = np.minimum(t / 0.1, 1.0)
    path = PLACE_MM - np.outer(10.0 * (1 - np.cos(np.pi * way)), [1.0, 0.5, 0.1])
    command = machine.kinematics.inverse(path)
    model = with_share(machine, multibody.AT_ENDS[choice.arms])
    ours = simulate_printer(model, command, ROW_S, gravity=choice.gravity)
    theirs = multibody.play(machine, path[0], command, ROW_S, choice)
    every = round(ROW_S / multibody.STEP_S)
    vibration = rms(ours.nozzle_mm - ours.nozzle_mm[0] - (path - path[0]))
    assert vibration > 0.1
    assert (np.abs(ours.nozzle_mm[0] - path[0]).max() > 0.05) == choice.gravity
    assert np.abs(ours.nozzle_mm[0] - theirs.nozzle_mm[0]).max() < 1e-6
    assert rms(ours.nozzle_mm - theirs.nozzle_mm[::every]) < 2e-4 * vibration
    assert rms(ours.carriage_mm - theirs.carriage_mm[::every]) < 2e-4 * vibration
