"""The objects of python-control against the arrays: two ways from the same machine, one frequency response."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from models.effects.catalogue import design_machine
from models.file import load_machine
from models.kinds import delta_vibration, with_parts
from models.vibration.scheduled import table_positions
from models.vibration.state_space import discretise

pytest.importorskip("control", reason="python-control is not installed: pip install 'ffcomp[control]'.")

from models.machine import Machine

FREQUENCIES = np.geomspace(0.5, 400, 25)
S = 2j * np.pi * FREQUENCIES
PLACES = [(0.0, 0.0), (-80.0, 0.0), (40.0, -69.0), (-30.0, 110.0)]


def variant(machine: Machine, force_map: str, with_drive: bool) -> Machine:
    carriage = (
        delta_vibration(machine).carriage if with_drive else replace(delta_vibration(machine).carriage, drive=None)
    )
    return with_parts(
        machine, carriage=carriage, effector=replace(delta_vibration(machine).effector, force_map=force_map)
    )


def response(system) -> np.ndarray:
    """(k, rows, columns)"""
    return np.moveaxis(system(S, squeeze=False), 2, 0)


def close(actual: np.ndarray, wanted: np.ndarray) -> None:
    """To 1e-9 of the largest entry at each frequency."""
    scale = np.abs(wanted).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(actual / scale, wanted / scale, rtol=0, atol=1e-9)


@pytest.mark.parametrize("force_map", ["virtual_work", "paper"])
@pytest.mark.parametrize("with_drive", [True, False])
@pytest.mark.parametrize("of", ["carriage", "nozzle"])
@pytest.mark.parametrize("per", ["carriage", "nozzle"])
def test_the_assembly_is_its_frequency_response(printer: Machine, force_map, with_drive, of, per) -> None:
    machine = variant(printer, force_map, with_drive)
    for place in PLACES:
        close(
            response(machine.vibration.to_control(place, of, per)),
            machine.vibration.frequency_response(np.array(place), FREQUENCIES, of, per),
        )


def test_an_ideal_drive_on_a_damped_belt_has_no_acceleration(printer: Machine) -> None:
    with pytest.raises(ValueError, match="a drive is ideal and its belt is damped"):
        variant(printer, "virtual_work", False).vibration.to_control((0.0, 0.0), "acceleration")
    undamped = replace(delta_vibration(printer).carriage, drive=None, belt_damping_n_s_per_m=0.0)
    machine = with_parts(printer, carriage=undamped)
    wanted = machine.vibration.frequency_response(np.zeros(2), FREQUENCIES, "acceleration")
    close(response(machine.vibration.to_control((0.0, 0.0), "acceleration")), wanted)


@pytest.mark.parametrize("name", ["mp-delta-pro", "flsun-v400", "voron-250"])
@pytest.mark.parametrize("step_s", [5e-4, 4e-3])
def test_machines_agree_with_one_matrix_exponential_a_position(name: str, step_s: float) -> None:
    machine = design_machine(load_machine(name))[0]
    plant = machine.vibration.state_space(table_positions(machine.kinematics)[1][::29])
    g, n = plant.a.shape[:2]
    block = np.zeros((g, n + 9, n + 9))
    block[:, :n] = np.concatenate([plant.a, plant.b_command, plant.b_slope / step_s, plant.b_centripetal], axis=2)
    block[:, n : n + 3, n + 3 : n + 6] = np.eye(3) / step_s
    whole = expm(block * step_s)[:, :n]
    held, ramp = whole[..., n : n + 3], whole[..., n + 3 : n + 6]
    found = discretise(plant, step_s)
    for each, expected in (
        (found.a, whole[..., :n]),
        (found.b0, held - ramp),
        (found.b1, ramp),
        (found.b_centripetal, whole[..., n + 6 :]),
    ):
        np.testing.assert_allclose(each, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max(initial=1e-9))
