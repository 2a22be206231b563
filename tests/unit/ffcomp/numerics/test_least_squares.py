"""Least squares: known minima, bounds, outliers, and the bounded step and fit of a batched problem."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from ffcomp.numerics.least_squares import (
    BatchedProblem,
    bounded_step,
    central_differences,
    minimise,
    minimise_batched,
    overdispersion,
)
from models.arrays import FloatArray

T = np.linspace(0.0, 1.0, 40)


def decay(x: FloatArray) -> FloatArray:
    return x[0] * np.exp(-x[1] * T)


def test_minimise_finds_a_known_minimum_and_says_when_evaluations_run_out() -> None:
    def residual(x: FloatArray) -> FloatArray:
        return decay(x) - decay(np.array([2.0, 3.0]))

    found = minimise(residual, np.array([1.0, 1.0]), evaluations=100)
    np.testing.assert_allclose(found.x, [2.0, 3.0], rtol=1e-6)
    assert found.converged and found.cost < 1e-12
    jacobian = np.stack([np.exp(-found.x[1] * T), -T * decay(found.x)], axis=1)
    np.testing.assert_allclose(found.jacobian, jacobian, atol=1e-5)
    assert not minimise(residual, np.array([1.0, 1.0]), evaluations=3).converged


def test_central_differences_are_of_second_order_and_skip_what_does_not_move() -> None:
    x, exact = np.array([2.0, 3.0]), np.stack([np.exp(-3 * T), np.zeros_like(T)], axis=1)
    found = central_differences(decay, x, np.array([1e-4, 0.0]))
    np.testing.assert_allclose(found, exact, atol=1e-9)
    errors = [np.abs(central_differences(decay, x, np.array([0.0, h]))[:, 1] + T * decay(x)).max() for h in (0.1, 0.05)]
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


# ---- batched problems ----------------------------------------------------------------------------


def batched(y: FloatArray) -> BatchedProblem:
    """y = a (t + t²) + a³ t², a toy simulation whose second unknown moves nothing beyond its bounds."""

    def residuals(points: Sequence[FloatArray]) -> Iterator[FloatArray]:
        return (y - model(z) for z in points)

    return BatchedProblem(residuals, np.array([-5.0, 0.0]), np.array([5.0, 0.5]))


def model(z: FloatArray) -> FloatArray:
    return 1e3 * (z[0] * T + z[0] ** 3 * T**2 + z[1] * np.cos(5 * T))


def test_a_batched_fit_finds_the_minimum_inside_the_bounds() -> None:
    found = minimise_batched(batched(model(np.array([1.5, 0.25]))), np.zeros(2), iterations=20)
    np.testing.assert_allclose(found.z, [1.5, 0.25], atol=1e-3)
    at_bound = minimise_batched(batched(model(np.array([1.5, 2.0]))), np.zeros(2), iterations=20)
    assert at_bound.z[1] == pytest.approx(0.5)


def test_model_error_leaves_an_unknown_that_hardly_matters_at_its_prior() -> None:
    """A slow wave that no unknown makes, and a second unknown that takes off a thousandth of it for three deviations.

    The minimum of |r|² + φ|z|² is where the normal equations with the φ of its own residual say.
    """
    t = np.linspace(0.0, 1.0, 1000)
    columns = np.stack([1e3 * np.cos(40 * t), 3.0 * np.sin(9 * t)], axis=1)
    y = columns @ [2.0, 3.0] + 300 * np.sin(7 * t)

    def residuals(points: Sequence[FloatArray]) -> Iterator[FloatArray]:
        return (y - columns @ z for z in points)

    problem = BatchedProblem(residuals, np.full(2, -5.0), np.full(2, 5.0))
    assert minimise_batched(problem, np.zeros(2), iterations=30).z[1] == pytest.approx(5.0)
    found = minimise_batched(problem, np.zeros(2), iterations=30, block_rows=20.0, tempered=np.ones(2, dtype=bool))
    phi = overdispersion(float(found.residual @ found.residual) / len(t), 20.0)
    best = np.linalg.solve(phi * np.eye(2) + columns.T @ columns, columns.T @ y)
    np.testing.assert_allclose(found.z, best, atol=0.1)  # a fit ends when less than 0.3 φ can be gained


def test_confounded_unknowns_share_a_step() -> None:
    """A normal matrix that is singular to rounding: the step still goes down, and no farther than needed."""
    column = 1e9 * np.ones((50, 1)) + np.arange(50)[:, None]
    jacobian = np.hstack([column, column, np.arange(50.0)[:, None]])
    normal = np.eye(3) + jacobian.T @ jacobian
    step = bounded_step(normal, jacobian.T @ np.arange(50.0), np.full(3, -np.inf), np.full(3, np.inf))
    assert np.all(np.isfinite(step))
    assert step[0] == pytest.approx(step[1], rel=1e-3, abs=1e-6)
    assert step[2] == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_a_bounded_step_is_the_best_inside_the_bounds(seed: int) -> None:
    """At the least of a convex parabola in a box, the slope points outward at every wall and is zero elsewhere."""
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(60, 12)) @ rng.normal(size=(12, 12))
    normal, gradient = np.eye(12) + jacobian.T @ jacobian, jacobian.T @ rng.normal(size=60) * 300
    z = rng.uniform(-1, 1, 12)
    step = bounded_step(normal, gradient, -1 - z, 1 - z)
    slope, at = gradient - normal @ step, z + step
    assert np.all(np.abs(at) <= 1 + 1e-12)
    inside = np.abs(at) < 1 - 1e-9
    assert np.abs(slope[inside]).max(initial=0.0) < 1e-6 * np.abs(gradient).max()
    assert np.all(slope[~inside] * at[~inside] > -1e-6 * np.abs(gradient).max())
    assert (~inside).any()  # the parabola is long enough to reach them
