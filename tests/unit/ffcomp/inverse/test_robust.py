"""Robust inversion: what is wanted of a machine that is not exactly known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from ffcomp.comparison.evaluation import Execution, contour
from ffcomp.comparison.methods import COMPENSATED, ROBUST, inversion
from ffcomp.comparison.monte_carlo import draw_plants
from ffcomp.comparison.sampling import Print, Sampling
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.robust import (
    TANGENT_WEIGHT,
    RobustReference,
    across,
    conjugate_gradients,
    normal_errors,
    preconditioned,
)
from ffcomp.inverse.sensitivity import FULL, SPANS, Response, sampled_machines
from ffcomp.inverse.settings import settings_for
from ffcomp.metrics import contour_error
from ffcomp.simulation.playback import simulate_nozzles
from models.file import load_machine
from models.machine import Machine, value_of
from tests.support.prints import squares
from tests.support.settings import finely_joined

MARGIN = FULL.margin

FloatArray = NDArray[np.float64]
PLACE = np.array([40.0, -30.0, 5.0])


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("mp-delta-pro")


def unsure(machine: Machine, sd: float) -> Machine:
    return replace(machine, uncertainty={"default": sd})


@pytest.fixture(scope="module")
def softening(machine: Machine) -> RobustReference:
    return InverseModel(unsure(machine, 0.1), settings_for(machine))._robust


def zigzag(rows: int, side_rows: int = 50) -> FloatArray:
    """(rows, 3) mm: sides of 20 mm along x and y in turn, from rest to rest each, with constant acceleration."""
    u = (np.arange(rows) % side_rows) / side_rows
    eased = np.where(u < 0.5, 2 * u**2, 1 - 2 * (1 - u) ** 2)
    side = np.arange(rows) // side_rows
    x = 20.0 * (side // 2 % 2 + np.where(side % 2 == 0, eased * (1 - 2 * (side // 2 % 2)), 1 - 2 * (side // 2 % 2)))
    y = 20.0 * (side // 2 % 2 + np.where(side % 2 == 1, eased * (1 - 2 * (side // 2 % 2)), 0.0))
    return PLACE + np.stack([x, y, np.zeros(rows)], axis=1)


def wish(softening: RobustReference, path: FloatArray) -> FloatArray:
    """d (n, 3) mm of a path (n, 3) mm that moves all the time, with rests on both sides."""
    rested = np.concatenate([np.repeat(path[:1], MARGIN, axis=0), path, np.repeat(path[-1:], MARGIN, axis=0)])
    moving = np.zeros(len(rested), dtype=np.bool_)
    moving[MARGIN:-MARGIN] = True
    return softening.offset(rested, moving)


def response(softening: RobustReference) -> Response:
    place = np.linspace([-70.0, 20.0], [50.0, -40.0], 700)  # its middle is between the nodes
    return softening.sensitivity.along(place, SPANS[2])


# ---- what counts ---------------------------------------------------------------------------------


LINE = PLACE + np.outer(np.arange(40.0), [0.3, 0.4, 0.0])
TANGENT_WEIGHT_IT, BESIDE_IT = np.array([0.6, 0.8, 0.0]), np.array([-0.8, 0.6, 0.0])


def test_an_error_along_a_line_counts_little() -> None:
    missed = np.tile(0.8 * TANGENT_WEIGHT_IT + 0.02 * BESIDE_IT, (40, 1)).astype(np.float32)  # more than a step late
    left, along = normal_errors(LINE, missed)
    inside = slice(2, -2)
    np.testing.assert_allclose(along[inside], np.tile(TANGENT_WEIGHT_IT, (36, 1)), atol=1e-6)
    np.testing.assert_allclose(
        left[inside], np.tile(0.02 * BESIDE_IT + 0.8 * TANGENT_WEIGHT * TANGENT_WEIGHT_IT, (36, 1)), atol=1e-6
    )
    np.testing.assert_allclose(across(missed[None], along)[0, inside], left[inside], atol=1e-6)


def test_beyond_a_corner_and_at_rest_all_of_an_error_counts() -> None:
    corner = PLACE + np.array([[-1.0, 0, 0], [0, 0, 0], [0, 1, 0], [0, 2, 0], [0, 2, 0], [0, 2, 0]])
    missed = np.zeros((6, 3), np.float32)
    missed[1] = [0.3, -0.2, 0.0]  # outside the corner
    missed[4] = [0.1, 0.2, 0.3]  # beyond the end
    left, along = normal_errors(corner, missed)
    for i in (1, 4):
        np.testing.assert_allclose(left[i], missed[i], atol=1e-6)
        assert not along[i].any()


def test_what_conjugate_gradients_begin_with_undoes_the_weights() -> None:
    along = np.tile(TANGENT_WEIGHT_IT, (5, 1)).astype(np.float32)
    rows = np.random.default_rng(6).normal(size=(5, 3)).astype(np.float32)
    weighed = rows - (1.0 - 0.3) * np.sum(rows * along, axis=1, keepdims=True) * along
    np.testing.assert_allclose(preconditioned(weighed, along, 0.3), rows, atol=1e-5)
    np.testing.assert_array_equal(preconditioned(rows, np.zeros_like(along), 0.3), rows)


def test_conjugate_gradients_solve_in_as_many_steps_as_unknowns() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6))
    a, b = (root @ root.T + np.eye(6)), rng.normal(size=6).astype(np.float32)
    for eased in (np.ones(6), 1.0 / np.diag(a)):
        found = conjugate_gradients(
            lambda x: (a @ x).astype(np.float32), b, 12, lambda x, eased=eased: (eased * x).astype(np.float32)
        )
        np.testing.assert_allclose(found, np.linalg.solve(a, b), rtol=2e-2, atol=2e-3)


# ---- what the machine may make of it -------------------------------------------------------------


def test_the_adjoint_is_one(softening: RobustReference) -> None:
    rng, known = np.random.default_rng(5), response(softening)
    d = rng.normal(size=(700, 3)).astype(np.float32)
    answers = known.to_offset(d)
    errors = rng.normal(size=answers.shape).astype(np.float32)
    assert np.vdot(answers, errors) == pytest.approx(np.vdot(d, known.adjoint(errors)), rel=1e-4)


def test_a_path_is_a_wish_that_need_not_end_where_it_begins(softening: RobustReference) -> None:
    known, t = response(softening), np.arange(700)[:, None]
    bump = np.exp(-0.5 * ((t - 350) / 8.0) ** 2) * np.array([1.0, -0.7, 0.1])  # there and back, up to 20 Hz
    expected = known.to_offset(bump.astype(np.float32))
    expected[0] -= bump
    found = known.to_path(np.diff(bump, axis=0, append=bump[-1:]).astype(np.float32))
    assert np.abs(expected).max() > 5e-3
    np.testing.assert_allclose(found, expected, atol=2e-4)


def test_directions_hold_the_spread_of_the_draws(softening: RobustReference) -> None:
    """Σ |M_k|² over the directions, against the variance of printers that were not among the draws."""
    sensitivity, xy = softening.sensitivity, np.zeros(2)
    known = sensitivity._node((0, 0)).astype(np.complex128)
    f = sensitivity.frequency[30:140:10]  # 15 to 65 Hz
    plain = np.linalg.inv(sensitivity.machine.vibration.frequency_response(xy, f, "nozzle", "nozzle"))
    plants = draw_plants(sensitivity.machine, 0.1, 100)
    plants = np.array([each.vibration.frequency_response(xy, f, "nozzle", "nozzle") for each in plants]) @ plain
    held = np.sum(np.abs(known[1:, 0, 0, 30:140:10]) ** 2, axis=0)
    assert 0.5 < np.sum(held) / np.sum(plants.var(axis=0)[:, 0, 0]) < 1.4


# ---- what is wanted ------------------------------------------------------------------------------


def test_rest_is_left_alone(softening: RobustReference) -> None:
    assert np.array_equal(wish(softening, np.repeat(PLACE[None], 50, axis=0)), np.zeros((50, 3)))


def test_steady_motion_is_left_alone(softening: RobustReference) -> None:
    path = PLACE + np.arange(MARGIN * 2 + 300.0)[:, None] * np.array([0.05, 0.02, 0.0])
    assert np.abs(softening.offset(path, np.ones(len(path), dtype=np.bool_))[100:200]).max() < 1e-3


def test_nothing_is_wanted_beyond_the_path_where_the_command_rests(softening: RobustReference) -> None:
    path = zigzag(600 + 2 * MARGIN)
    moving = np.ones(len(path), dtype=np.bool_)
    moving[: MARGIN + 40] = False
    d = softening.offset(path, moving)
    assert np.array_equal(d[:40], np.zeros((40, 3)))
    assert np.abs(d).max() > 5e-3


def test_the_expected_contour_error_is_lower(softening: RobustReference, machine: Machine) -> None:
    """Over machines that were not among the draws: the mean square distance of D (r + d) to the path."""
    path, known = zigzag(800), softening.sensitivity  # ends where it begins
    wanted, length = path + wish(softening, path), 4096
    f = np.asarray(np.fft.rfftfreq(length, known.row_s), dtype=np.float64)
    g = machine.vibration.frequency_response(PLACE[:2], f, "nozzle", "nozzle")
    weight = known.control_weight / 2 * (2 * np.sin(np.pi * f * 2 * known.row_s)) ** 4
    adjoint = np.conj(np.swapaxes(g, 1, 2))
    plain = np.linalg.solve(adjoint @ g + weight[:, None, None] * np.eye(3), adjoint)
    t = np.arange(len(path), dtype=np.float64) * known.row_s

    def error(plant: Machine, wanted: FloatArray) -> float:
        lines = (
            plant.vibration.frequency_response(PLACE[:2], f, "nozzle", "nozzle")
            @ plain
            @ np.fft.rfft(wanted - path[0], length, axis=0)[:, :, None]
        )
        nozzle = path[0] + np.fft.irfft(lines[..., 0], length, axis=0)[: len(path)]
        return float(np.mean(contour_error(t, path, t, nozzle) ** 2))

    plants = draw_plants(machine, 0.1, 20)
    plainly, robustly = (np.mean([error(plant, r) for plant in plants]) for r in (path, wanted))
    assert robustly < 0.4 * plainly


def test_where_a_span_ends_does_not_show(softening: RobustReference) -> None:
    path = zigzag(2600 + 2 * MARGIN)
    moving = np.ones(len(path), dtype=np.bool_)
    later = 700
    whole, part = softening.offset(path, moving), softening.offset(path[later:], moving[later:])
    apart = np.abs(whole[later + 200 : -200] - part[200:-200])
    assert apart.max() < 0.1 * np.abs(whole).max()


def test_named_uncertainties_count_for_their_numbers_alone(machine: Machine) -> None:
    sure = replace(machine, uncertainty={"default": 0.0, "carriage.belt_stiffness_n_per_m": 0.1})
    draws = sampled_machines(sure)
    for name in machine.vibration.parameters().names:
        values = np.array([value_of(each, name) for each in draws])
        moved = name == "carriage.belt_stiffness_n_per_m"
        assert (np.ptp(values) > 0) == moved
    relative = np.array([value_of(each, "carriage.belt_stiffness_n_per_m") for each in draws])
    relative /= value_of(machine, "carriage.belt_stiffness_n_per_m")
    assert relative.mean() == pytest.approx(1.0, abs=1e-9) and 0.06 < relative.std() < 0.14


def test_printers_that_are_off_print_better_on_average(machine: Machine) -> None:
    believed = unsure(machine, 0.1)
    (stretch,), _ = Print(squares(1), "squares.gcode", machine).slices(Sampling())
    plants = draw_plants(machine, 0.1, 6)
    means = []
    for name in (COMPENSATED, ROBUST):
        motion, _ = inversion(believed, finely_joined(believed), name).motion(stretch)
        t, nozzles = simulate_nozzles(plants, motion, believed)
        squared = [np.mean(contour([Execution(stretch, motion, t, nozzle)]) ** 2) for nozzle in nozzles]
        means.append(float(np.mean(squared)))
        np.testing.assert_allclose(motion.position(np.array([motion.end_t]))[0], stretch.corners[1][-1], atol=2e-4)
    assert means[1] < 0.55 * means[0]
