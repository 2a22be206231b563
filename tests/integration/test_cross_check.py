"""Our virtual printer against MuJoCo with the arms as bodies, and the straight plant against slides and belts."""

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
from validation.plants.straight_plant import COREXY, Plant, simulate

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


@pytest.mark.parametrize("arms", multibody.AT_ENDS)
def test_it_answers_a_jerk_as_bodies_do(machine: Machine, arms: multibody.Arms) -> None:
    """20 mm in a tenth of a second along x and y, and half as long to ring; by its weight it sags before.

    The effector may turn and its centre of mass is off: neither may be seen.
    """
    t = ROW_S * np.arange(round(0.15 / ROW_S) + 1)
    way = np.minimum(t / 0.1, 1.0)
    path = PLACE_MM - np.outer(10.0 * (1 - np.cos(np.pi * way)), [1.0, 0.5, 0.1])
    command = machine.kinematics.inverse(path)
    model = with_share(machine, multibody.AT_ENDS[arms])
    ours = simulate_printer(model, command, ROW_S, gravity=True)
    nozzle, carriages = multibody.play(machine, path[0], command, ROW_S, arms)
    every = round(ROW_S / multibody.STEP_S)
    vibration = rms(ours.nozzle_mm - ours.nozzle_mm[0] - (path - path[0]))
    assert vibration > 0.1
    assert np.abs(ours.nozzle_mm[0] - path[0]).max() > 0.05
    assert np.abs(ours.nozzle_mm[0] - nozzle[0]).max() < 1e-6
    assert rms(ours.nozzle_mm - nozzle[::every]) < 2e-4 * vibration
    assert rms(ours.carriage_mm - carriages[::every]) < 2e-4 * vibration


@pytest.mark.parametrize("motors", [np.eye(2), COREXY], ids=["cartesian", "corexy"])
def test_straight_axes_answer_as_slides_and_belts_do(motors: FloatArray) -> None:
    """Unequal belts, dampers and tools: of a vibration of 0.3 to 1 mm to two ten-thousandths."""
    (a, b), (c, d) = motors.tolist()
    plant = Plant(((a, b), (c, d)), tool_kg=(0.08, 0.1), belt_n_s_per_m=(3.0, 5.0))
    t = np.arange(1600) / 3200.0
    waves = [3.0 * np.sin(2 * np.pi * 11 * t), 2.0 * np.sin(2 * np.pi * 27 * t)]
    command = np.column_stack(waves) * np.minimum(t / 0.1, 1.0)[:, None] ** 2
    ours = simulate(plant, command, 3200.0)["position_mm"]
    vibration = rms(ours - command)
    assert vibration > 0.1
    assert rms(ours - multibody.play_straight(plant, command, 3200.0)) < 2e-4 * vibration
