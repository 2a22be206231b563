"""Robust inversion: what is wanted of a machine that is not exactly known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ffcomp.compare.judge import Played, contour
from ffcomp.compare.plants import drawn
from ffcomp.compare.play import play
from ffcomp.compare.stretch import Print, Sampling
from ffcomp.compare.ways import OURS, ROBUST, inversion
from ffcomp.invert.inverter import Inverter
from ffcomp.invert.robust import HALF, Softening, _draws
from ffcomp.pipeline import settings_for
from models.machine import Machine
from models.machine_file import load_machine
from models.parameters import dynamic_numbers, value_of
from models.receptance import nozzle_frf
from tests.ffcomp.compare.prints import squares

FloatArray = NDArray[np.float64]
PLACE = np.array([40.0, -30.0])


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("mp-delta-pro")


def unsure(machine: Machine, sd: float) -> Machine:
    return replace(machine, uncertainty={"default": sd})


def softening(machine: Machine) -> Softening:
    return Inverter(machine, settings_for(machine)).softening


def frequency_response(kernel: FloatArray, f: FloatArray, row_s: float) -> NDArray[np.complex128]:
    m = np.arange(-HALF, HALF + 1)
    return np.einsum("tij,tf->fij", kernel, np.exp(2j * np.pi * f * row_s * m[:, None])).astype(np.complex128)


def test_a_known_machine_is_asked_for_the_path(machine: Machine) -> None:
    path = np.cumsum(np.random.default_rng(1).normal(size=(40 + 2 * HALF, 3)), axis=0)
    assert np.abs(softening(unsure(machine, 0.0)).of(path)).max() < 1e-9
    assert np.abs(softening(unsure(machine, 0.1)).of(path)).max() > 1e-2


def test_rest_and_steady_motion_are_left_alone(machine: Machine) -> None:
    t = np.arange(30 + 2 * HALF, dtype=np.float64)[:, None]
    path = np.array([10.0, -20.0, 5.0]) + t * np.array([0.2, 0.1, -0.05])  # 100 mm/s
    assert np.abs(softening(unsure(machine, 0.1)).of(path)).max() < 1e-9


def test_less_is_asked_for_where_the_draws_disagree(machine: Machine) -> None:
    """Below the mode nothing is lost; at the mode, which a tenth moves by more than its width, a good part."""
    soft = softening(unsure(machine, 0.1))
    f = np.array([8.0, 50.0])
    below, at_mode = (np.eye(3) + frequency_response(soft._kernel(PLACE), f, soft.row_s)).astype(np.complex128)
    assert np.abs(below - np.eye(3)).max() < 0.02
    assert 0.4 < np.linalg.norm(at_mode, 2) < 1.0 and np.abs(np.diag(at_mode)[:2]).max() < 0.9


def test_the_expected_error_is_lower(machine: Machine) -> None:
    """Over machines that were not among the draws: E ‖r − G K r‖² for white r below the bandwidth."""
    believed = unsure(machine, 0.1)
    inverter = Inverter(believed, settings_for(believed))
    soft, f = inverter.softening, np.linspace(20.0, 80.0, 41)
    known = nozzle_frf(machine, PLACE, f)
    bend = (2 * np.sin(np.pi * f * 2 * soft.row_s)) ** 4
    weight = (soft.effort / 2 * bend)[:, None, None] * np.eye(3)
    adjoint = np.conj(np.swapaxes(known, 1, 2))
    plain = np.linalg.solve(adjoint @ known + weight, adjoint)
    robust = plain @ (np.eye(3) + frequency_response(soft._kernel(PLACE), f, soft.row_s))
    plants = [nozzle_frf(plant, PLACE, f) for plant in drawn(machine, 0.1, 60)]
    errors = [np.mean([np.sum(np.abs(np.eye(3) - g @ k) ** 2) for g in plants]) for k in (plain, robust)]
    assert errors[1] < 0.9 * errors[0]


def test_named_uncertainties_count_for_their_numbers_alone(machine: Machine) -> None:
    sure = replace(machine, uncertainty={"default": 0.0, "carriage.belt_stiffness_n_per_m": 0.1})
    draws = _draws(sure)
    for name in dynamic_numbers(machine):
        values = np.array([value_of(each, name) for each in draws])
        moved = name == "carriage.belt_stiffness_n_per_m"
        assert (np.ptp(values) > 0) == moved
    relative = np.array([value_of(each, "carriage.belt_stiffness_n_per_m") for each in draws])
    relative /= value_of(machine, "carriage.belt_stiffness_n_per_m")
    assert relative.mean() == pytest.approx(1.0, abs=1e-9) and 0.06 < relative.std() < 0.14


def test_printers_that_are_off_print_better_on_average(machine: Machine) -> None:
    believed = unsure(machine, 0.1)
    (stretch,), _ = Print(squares(1), "squares.gcode", machine).stretches(Sampling())
    plants = drawn(machine, 0.1, 6)
    means = []
    for name in (OURS, ROBUST):
        motion, _ = inversion(believed, settings_for(believed), name).motion(stretch)
        t, nozzles = play(plants, motion, believed)
        squared = [np.mean(contour([Played(stretch, motion, t, nozzle)]) ** 2) for nozzle in nozzles]
        means.append(float(np.mean(squared)))
        np.testing.assert_allclose(motion.position(np.array([motion.end_t]))[0], stretch.corners[1][-1], atol=2e-4)
    assert means[1] < means[0]
