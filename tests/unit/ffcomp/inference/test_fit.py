"""The engine: known minima, bounds, priors, how a fit ended, model errors, clusters, and evidence in closed form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from ffcomp.inference.covariance import overdispersion
from ffcomp.inference.fit import FitResult, FitSettings, Status, best_of, bounded_step, fit
from ffcomp.inference.problem import EstimationProblem, Observation, Unknown
from models.arrays import FloatArray

T = np.linspace(0.0, 1.0, 40)
NOISE = np.full(len(T), 1e-4)


class Decay(EstimationProblem):
    """a e^(−b t), measured once or several times."""

    def __init__(self, observations: Sequence[Observation], unknowns: Sequence[Unknown]) -> None:
        self.observations, self.unknowns, self.count = observations, unknowns, 0

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        for a, b in lanes:
            self.count += 1
            yield np.tile(a * np.exp(-b * T), len(self.observations))


def decay(truth: tuple[float, float] = (2.0, 3.0), **b: float) -> Decay:
    seen = Observation(truth[0] * np.exp(-truth[1] * T), NOISE)
    return Decay([seen], [Unknown("a"), Unknown("b", **b)])


class Line(EstimationProblem):
    """Measurements that are linear in the unknowns: everything is known in closed form."""

    def __init__(self, matrix: FloatArray, observations: Sequence[Observation], unknowns: Sequence[Unknown]) -> None:
        self.matrix, self.observations, self.unknowns = matrix, observations, unknowns

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        return (self.matrix @ x for x in lanes)


@pytest.mark.parametrize("keep", [False, True])
def test_a_known_minimum_is_found(keep: bool) -> None:
    problem = decay()
    found = fit(problem, np.ones(2), FitSettings(keep=keep, exact=True, gain=1e-6))
    assert found.status is Status.CONVERGED and found.doubt("it") == []
    np.testing.assert_allclose(found.values, [2.0, 3.0], rtol=1e-4)
    a, decayed = found["a"], np.exp(-found.values[1] * T)
    np.testing.assert_allclose(found.jacobian, 100 * np.column_stack([decayed, -a * T * decayed]), rtol=1e-5, atol=1e-5)
    assert found.n_evaluations == problem.count
    assert list(found.history) == sorted(found.history, reverse=True)


class Valley(Line):
    """Rosenbrock's: Gauss-Newton's step leaves its bottom far behind, and damped ones creep."""

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        return (np.array([x, 1e3 * (y - x**2)]) for x, y in lanes)


def test_a_narrow_valley_is_followed_round_its_bend() -> None:
    seen = Observation(np.array([1.0, 0.0]), np.ones(2))
    found = fit(Valley(np.eye(2), [seen], [Unknown("x"), Unknown("y")]), np.array([-1.2, 1.0]))
    assert found.status is Status.CONVERGED and found.n_evaluations < 30 and found.values == pytest.approx([1.0, 1.0])


def test_running_out_of_steps_is_not_converging() -> None:
    found = fit(decay(), np.array([1.0, 20.0]), FitSettings(steps=2))
    assert found.status is Status.RAN_OUT and len(found.history) == 2
    (sentence,) = found.doubt("the decay")
    assert "the decay ran out of steps" in sentence


def test_a_bound_holds_and_the_rest_fits_as_well_as_it_can() -> None:
    found = fit(decay(high=2.0), np.ones(2))
    assert found.status is Status.CONVERGED and found["b"] == 2.0
    column = np.exp(-2.0 * T)
    assert found["a"] == pytest.approx(float(column @ (2 * np.exp(-3 * T)) / (column @ column)), rel=1e-4)


def test_a_prior_pulls_as_much_as_it_is_sure() -> None:
    y, sd, prior = 3.0, 0.5, Unknown("x", mean=1.0, sd=2.0)
    found = fit(Line(np.eye(1), [Observation(np.array([y]), np.array([sd**2]))], [prior]), np.zeros(1))
    precision = sd**-2 + prior.sd**-2
    assert found.values[0] == pytest.approx((y / sd**2 + 1.0 / prior.sd**2) / precision)
    assert found.covariance[0, 0] == pytest.approx(1 / precision)


def test_evidence_is_that_of_the_marginal_distribution() -> None:
    """Linear and normal: y ~ N(A mean, A P Aᵀ + R), and Laplace's approximation is exact."""
    rng = np.random.default_rng(0)
    matrix, y, noise = rng.normal(size=(6, 2)), rng.normal(size=6), rng.uniform(0.5, 2.0, 6)
    unknowns = [Unknown("a", 0.5, 2.0), Unknown("b", -1.0, 0.3)]
    found = fit(Line(matrix, [Observation(y, noise)], unknowns), np.zeros(2), FitSettings(exact=True))
    spread = matrix @ np.diag([4.0, 0.09]) @ matrix.T + np.diag(noise)
    off = y - matrix @ [0.5, -1.0]
    assert found.evidence == pytest.approx(off @ np.linalg.solve(spread, off) + np.linalg.slogdet(spread)[1])


def test_the_best_start_wins_and_a_good_one_ends_the_search() -> None:
    tried = []

    def fits() -> Iterator[object]:
        for b in (300.0, 1.0, 2.0):
            tried.append(b)
            yield fit(decay(low=-1.0), np.array([1.0, b]), FitSettings(steps=8))

    best = best_of(fits(), lambda found: found.cost < 1e-3)  # type: ignore[arg-type]
    assert best["b"] == pytest.approx(3.0, abs=1e-3) and tried == [300.0, 1.0]


# ---- what the model gets wrong -------------------------------------------------------------------


def recordings(seed: int, wrong: float) -> list[Observation]:
    """Four recordings of a constant, off by a share that keeps its sign in each of 30 blocks of ten rows."""
    rng, seen, blocks = np.random.default_rng(seed), [], np.repeat(np.arange(30), 10)
    for _ in range(4):
        y = 5.0 * (1 + wrong * rng.normal(size=30)[blocks]) + 0.01 * rng.normal(size=300)
        seen.append(Observation(y, np.full(300, 1e-4), np.full(300, 25.0), blocks))
    return seen


def constant(seen: Sequence[Observation]) -> FitResult[Line]:
    return fit(Line(np.ones((1200, 1)), seen, [Unknown("x")]), np.zeros(1), FitSettings(rounds=10))


def test_the_models_own_error_is_estimated_and_noise_alone_has_none() -> None:
    off, exact = constant(recordings(0, 0.03)), constant(recordings(0, 0.0))
    assert off.status is exact.status is Status.CONVERGED
    assert 0.02 < off.errors.min() < off.errors.max() < 0.04
    assert not exact.errors.any()
    assert exact.covariance[0, 0] == pytest.approx(1e-4 / 1200)


def test_intervals_hold_the_truth_where_rows_err_alike() -> None:
    """90 % of 200 are 180, with a standard deviation of 4; as if rows were independent, 40 % would."""
    held = 0
    for seed in range(200):
        found = constant(recordings(seed, 0.03))
        held += abs(found.values[0] - 5.0) < 1.645 * np.sqrt(found.covariance[0, 0])
    assert 166 <= held <= 194


def test_recordings_of_one_motion_err_alike() -> None:
    """The same recording four times: no more is known than by one of them."""
    once = recordings(3, 0.03)[:1]
    apart, together = (constant([replace(each, motion=motion) for each in once * 4]) for motion in (None, "same"))
    assert together.covariance[0, 0] == pytest.approx(4 * apart.covariance[0, 0], rel=0.1)


# ---- a likelihood that is tempered ---------------------------------------------------------------


class Tempered(Line):
    """A line whose prior counts as much as model error scatters χ²."""

    def precision(self, residual: FloatArray) -> FloatArray:
        return np.full(2, overdispersion(float(residual @ residual) / len(residual), 20.0))


def test_model_error_leaves_an_unknown_that_hardly_matters_at_its_prior() -> None:
    """A slow wave that no unknown makes, and a second unknown that takes off a thousandth of it for three deviations.

    The minimum of |r|² + φ|z|² is where the normal equations with the φ of its own residual say.
    """
    t = np.linspace(0.0, 1.0, 1000)
    columns = np.stack([1e3 * np.cos(40 * t), 3.0 * np.sin(9 * t)], axis=1)
    y = columns @ [2.0, 3.0] + 300 * np.sin(7 * t)
    seen, unknowns = [Observation(y, np.ones(1000))], [Unknown(n, 0.0, 1.0, -5.0, 5.0, 0.01) for n in "ab"]
    assert fit(Line(columns, seen, unknowns), np.zeros(2)).values[1] == pytest.approx(5.0)
    found = fit(Tempered(columns, seen, unknowns), np.zeros(2), FitSettings(keep=True))
    phi = overdispersion(float(found.residual @ found.residual) / len(t), 20.0)
    best = np.linalg.solve(phi * np.eye(2) + columns.T @ columns, columns.T @ y)
    np.testing.assert_allclose(found.values, best, atol=1e-3)


# ---- a step inside bounds ------------------------------------------------------------------------


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
