"""Damped nonlinear least squares, for cheap residuals and for residuals that are simulations.

`minimise` serves residuals that cost little and are smooth: Levenberg-Marquardt as in MINPACK (Moré, 1978).

`minimise_batched` serves residuals that cost a simulation each. It is Levenberg-Marquardt (Levenberg 1944, Marquardt
1963) with bounds and a unit prior on every unknown; its Jacobian is kept from step to step and corrected by secants
(Broyden, Math. Comp. 19, 1965), and its differences and damped trials are evaluated in batches.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]  # as models.arrays, which numerics lies below
Residual = Callable[[FloatArray], FloatArray]  # (p,) -> (rows,)

STEP = 0.01  # of a prior's standard deviation, for differences
MOST_CHANGE, SMALLEST_STEP = 30.0, 1e-5  # a step is smaller where it would change the residual by more than this
RIDGE = 1e-12  # of the diagonal: keeps the normal matrix of confounded unknowns regular
COST_TOLERANCE = 0.3  # of the cost, times the overdispersion: a fit ends when less than this can be gained
SMALL_GAIN = 1e-7  # or less than this share of what stands above the noise
TRUSTED_GAIN = 0.3  # of its predicted gain must a step reach, or the kept columns of the Jacobian are too old
DAMPINGS = (10.0, 100.0, 1e3, 1e4, 1e5)  # tried at once, times the last one, where a step does not help
SMALLEST_DAMPING = 1e-3
MOST_PASSES = 1000  # of the search for the bounds that are active in a step


@dataclass(frozen=True, eq=False)
class Solution:
    """The least found by `minimise`."""

    x: FloatArray  # (p,)
    residual: FloatArray  # (rows,)
    jacobian: FloatArray  # (rows, p), ∂residual/∂x
    cost: float  # |residual|²
    converged: bool  # False where the evaluations ran out


def minimise(residual: Residual, start: FloatArray, *, evaluations: int, tolerance: float = 1e-8) -> Solution:
    """Minimise |residual(x)|² from `start`, (p,).

    Parameters
    ----------
    evaluations : of the residual, at most.
    tolerance : end when a step gains less than this share of the minimised function.
    """
    from scipy.optimize import least_squares

    result = least_squares(residual, start, method="lm", x_scale="jac", ftol=tolerance, max_nfev=evaluations)
    return Solution(np.asarray(result.x), result.fun, result.jac, 2.0 * float(result.cost), bool(result.success))


def central_differences(function: Residual, x: FloatArray, steps: FloatArray) -> FloatArray:
    """Return ∂function/∂x, (rows, p); a column is zero where its step, of (p,), is zero."""
    columns: dict[int, FloatArray] = {}
    for i in np.flatnonzero(steps).tolist():
        shift = np.zeros(len(x))
        shift[i] = steps[i]
        columns[i] = (function(x + shift) - function(x - shift)) / (2 * steps[i])
    unmoved = np.zeros_like(next(iter(columns.values())) if columns else function(x))
    return np.stack([columns.get(i, unmoved) for i in range(len(x))], axis=1)


# ---- residuals that are simulations --------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class BatchedProblem:
    """Minimise |r(z)|² + φ|z|² inside bounds, r(z) = y − f(z), where many points are evaluated together.

    The unknowns z are in units of their priors' standard deviations.
    """

    residuals: Callable[[Sequence[FloatArray]], Iterator[FloatArray]]  # points (p,) -> (rows,) each, in order
    low: FloatArray  # (p,)
    high: FloatArray  # (p,)
    # coarser, quicker residuals, which serve for one-sided derivatives by the first `rough` unknowns: unknowns whose
    # effects cancel need all derivatives of one kind
    quick: Callable[[Sequence[FloatArray]], Iterator[FloatArray]] | None = None
    rough: int = 0

    def clip(self, z: FloatArray) -> FloatArray:
        """Move a point (p,) inside the bounds."""
        return np.clip(z, self.low, self.high)

    def at(self, z: FloatArray) -> FloatArray:
        """Evaluate one point: (rows,)."""
        return next(self.residuals([z]))

    def step(self, z: FloatArray, normal: FloatArray, gradient: FloatArray) -> FloatArray:
        """Return the best step (p,) from z of the quadratic model ½ sᵀ normal s − gradientᵀ s."""
        return bounded_step(normal, gradient, self.low - z, self.high - z)


@dataclass(frozen=True, eq=False)
class Iterate:
    """A point of a batched fit, with its residual and derivatives."""

    z: FloatArray  # (p,)
    residual: FloatArray  # (rows,)
    jacobian: FloatArray  # (rows, p), ∂f/∂z = −∂r/∂z
    prior: FloatArray | float = 1.0  # (p,) weight of each z²: φ, or 1

    @property
    def cost(self) -> float:
        """|r|² + φ|z|²."""
        return float(self.residual @ self.residual + self.z @ (self.prior * self.z))

    @cached_property
    def quadratic(self) -> tuple[FloatArray, FloatArray]:
        """The normal matrix (p, p) and the gradient (p,) of the Gauss-Newton model."""
        normal = np.diag(self.prior * np.ones(len(self.z))) + self.jacobian.T @ self.jacobian
        return normal, self.jacobian.T @ self.residual - self.prior * self.z


def overdispersion(misfit: float, block_rows: float) -> float:
    """Return the ratio of the scatter of |r|² from noise and model error to that from noise alone.

    The shapes of a model are never exactly those of a machine. Of a misfit v, 1/v is noise, which is white, and the
    rest is model error, which keeps its sign over a block of rows: quasi-likelihood with correlated errors (McCullagh &
    Nelder, Generalized Linear Models, 1989, chapter 9).

    Parameters
    ----------
    misfit : the mean square of the whitened residual; below one it counts as one.
    block_rows : rows over which the model's error keeps its sign.
    """
    v = max(misfit, 1.0)
    return v * (1 + (block_rows - 1) * (1 - 1 / v))


def minimise_batched(
    problem: BatchedProblem,
    start: FloatArray,
    jacobian: FloatArray | None = None,
    *,
    renew: Sequence[int] = (),
    iterations: int = 6,
    small_gain: float = SMALL_GAIN,
    renew_all: bool = True,
    exact: bool = False,
    block_rows: float = 1.0,
    tempered: NDArray[np.bool_] | None = None,
) -> Iterate:
    """Minimise |r|² + φ|z|² from `start`.

    For unknowns that are tempered φ is the overdispersion of the residual, and falls with it (Grünwald & van Ommen,
    Bayesian Analysis 12, 2017). With φ = 1, as for the others, a residual far above the noise outvotes any prior, and
    unknowns that hardly matter follow the model's error.

    Parameters
    ----------
    start : (p,).
    jacobian : (rows, p) to begin with; None: take all of it, by central differences.
    renew : columns to recompute at every step: those of nonlinear unknowns.
    small_gain : the share of the cost beyond noise, of one a row, that must still be gained for another step.
    renew_all : if no step helps, recompute all columns and continue.
    exact : take all of the Jacobian by central differences, with steps as fine as the given one needs.
    block_rows : see `overdispersion`; no decision depends on a gain far below it.
    tempered : (p,) which unknowns have a prior that counts; None: none of them.
    """
    here, fresh = _begin(problem, start, jacobian, exact)
    everything: Sequence[int] = range(len(here.z))
    damping = 0.0
    for _ in range(iterations):
        excess = max(here.cost - len(here.residual), 0.0)  # beyond noise, which no step can take off
        scatter = overdispersion(float(here.residual @ here.residual) / len(here.residual), block_rows)
        if tempered is not None:
            here = replace(here, prior=np.where(tempered, scatter, 1.0))
        least = max(COST_TOLERANCE * scatter, small_gain * excess)
        predicted = predicted_gain(problem, here)
        better = None if predicted < least else _damped_step(problem, here, damping)
        if better is None and (fresh or not renew_all):
            break
        # where no step helps any more, or one gains far less than predicted, the columns that were kept are too old
        fresh = better is None or here.cost - better[0].cost < TRUSTED_GAIN * predicted
        if better is not None:
            here, damping = better
        columns = everything if fresh else renew
        if len(columns):
            here = _renewed(problem, here, columns, central=fresh and exact)
    return here


def _begin(
    problem: BatchedProblem, start: FloatArray, jacobian: FloatArray | None, exact: bool
) -> tuple[Iterate, bool]:
    """Evaluate the start, and return whether its Jacobian is fresh."""
    z = problem.clip(start)
    residual = problem.at(z)
    if jacobian is not None and not exact:
        return Iterate(z, residual, jacobian), False
    sizes = None if jacobian is None else np.linalg.norm(jacobian, axis=0)
    return Iterate(z, residual, differences(problem, z, residual, range(len(z)), central=True, sizes=sizes)), True


def _renewed(problem: BatchedProblem, here: Iterate, columns: Sequence[int], central: bool) -> Iterate:
    jacobian = here.jacobian.copy()
    sizes = np.linalg.norm(jacobian, axis=0)
    jacobian[:, list(columns)] = differences(problem, here.z, here.residual, columns, central, sizes)
    return replace(here, jacobian=jacobian)


def differences(
    problem: BatchedProblem,
    z: FloatArray,
    residual: FloatArray,
    columns: Sequence[int],
    central: bool = False,
    sizes: FloatArray | None = None,
) -> FloatArray:
    """Return ∂f/∂z, (rows, len(columns)): one-sided, away from the nearer bound, or central where there is room.

    Central differences cost twice as much, and are worth it at the end of a fit: the effects of confounded unknowns (a
    heavier machine on stiffer belts) cancel in exact derivatives only.

    Parameters
    ----------
    sizes : (p,) about how much the residual changes with each unknown, which sets the steps.
    """
    steps = np.full(len(z), STEP)
    if sizes is not None:
        steps = np.clip(MOST_CHANGE / np.maximum(sizes, 1e-300), SMALLEST_STEP, STEP)
    pairs = {i: _either_side(problem, z, i, steps[i], central) for i in columns}
    rough = [i for i in columns if i < problem.rough] if problem.quick is not None and not central else []
    quotients = _quotients(problem.residuals, z, residual, {i: pair for i, pair in pairs.items() if i not in rough})
    if rough and problem.quick is not None:
        here = next(problem.quick([z]))
        quotients |= _quotients(problem.quick, z, here, {i: pairs[i] for i in rough})
    return np.stack([quotients[i] for i in columns], axis=1)


def _quotients(
    evaluate: Callable[[Sequence[FloatArray]], Iterator[FloatArray]],
    z: FloatArray,
    residual: FloatArray,
    pairs: Mapping[int, tuple[FloatArray, FloatArray]],
) -> dict[int, FloatArray]:
    """Return −∂r/∂z_i, (rows,) each, from r at z and at each pair of points around it; one of them may be z itself."""
    residuals = evaluate([x for pair in pairs.values() for x in pair if x is not z])
    quotients = {}
    for i, (low, high) in pairs.items():
        below = residual if low is z else next(residuals)
        above = residual if high is z else next(residuals)
        quotients[i] = (below - above) / max(high[i] - low[i], SMALLEST_STEP)
    return quotients


def _either_side(
    problem: BatchedProblem, z: FloatArray, i: int, step: float, central: bool
) -> tuple[FloatArray, FloatArray]:
    """Return z with unknown i a step lower and higher; z itself at a bound, or where one side is enough."""
    behind, ahead = _shifted(problem, z, i, -step), _shifted(problem, z, i, step)
    high = ahead if ahead[i] > z[i] else z
    low = behind if behind[i] < z[i] and (central or high is z) else z
    return low, high


def _shifted(problem: BatchedProblem, z: FloatArray, i: int, step: float) -> FloatArray:
    shifted = z.copy()
    shifted[i] += step
    return problem.clip(shifted)


def predicted_gain(problem: BatchedProblem, here: Iterate) -> float:
    """Return what the best step would take off the cost if f were linear."""
    normal, gradient = here.quadratic
    step = problem.step(here.z, normal, gradient)
    return float(2 * gradient @ step - step @ normal @ step)


def bounded_step(normal: FloatArray, gradient: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Minimise ½ sᵀNs − gᵀs with low ≤ s ≤ high, N positive definite.

    As least squares, |Lᵀs − L⁻¹g|² with N = L Lᵀ scaled to a diagonal of ones, so that confounded unknowns share a
    step (bounded-variable least squares: Stark & Parker, Comp. Stat. 10, 1995).

    Parameters
    ----------
    normal : (p, p).
    gradient, low, high : (p,).
    """
    from scipy.linalg import solve_triangular
    from scipy.optimize import lsq_linear

    free = high > low
    step = np.zeros(len(gradient))
    if not free.any():
        return step
    scale = 1 / np.sqrt(np.diag(normal)[free])
    regular = normal[np.ix_(free, free)] * np.outer(scale, scale) + RIDGE * np.eye(len(scale))
    lower = np.linalg.cholesky(regular)
    right = solve_triangular(lower, scale * gradient[free], lower=True)
    bounds = (np.minimum(low[free], 0.0) / scale, np.maximum(high[free], 0.0) / scale)
    inside = solve_triangular(lower, right, lower=True, trans="T")
    if not np.all((bounds[0] <= inside) & (inside <= bounds[1])):
        inside = lsq_linear(lower.T, right, bounds, "bvls", tol=1e-14, max_iter=MOST_PASSES).x
    step[free] = scale * inside
    return step


def _damped_step(problem: BatchedProblem, here: Iterate, damping: float) -> tuple[Iterate, float] | None:
    """Take one step; if it does not help, the best of several that are damped more and more; None if none helps.

    Returns the new point, its Jacobian corrected by the secant, and the damping to begin the next step with.
    """
    normal, gradient = here.quadratic
    for dampings in ((damping,), tuple(max(damping, SMALLEST_DAMPING) * grown for grown in DAMPINGS)):
        damped = [normal + d * np.diag(np.diag(normal)) for d in dampings]
        trials = [problem.clip(here.z + problem.step(here.z, matrix, gradient)) for matrix in damped]
        iterates = [replace(here, z=z, residual=r) for z, r in zip(trials, problem.residuals(trials), strict=True)]
        best = int(np.argmin([trial.cost for trial in iterates]))
        if iterates[best].cost < here.cost:
            used = dampings[best]
            return _secant(here, iterates[best]), used / 10 if used > SMALLEST_DAMPING else 0.0
    return None


def _secant(here: Iterate, there: Iterate) -> Iterate:
    """Correct the Jacobian by what the step really did."""
    step, change = there.z - here.z, here.residual - there.residual
    jacobian = here.jacobian + np.outer(change - here.jacobian @ step, step) / (step @ step)
    return replace(there, jacobian=jacobian)
