"""Damped least squares for every problem: Levenberg-Marquardt in batches that also estimates the model's own error.

    minimise  Σ r²/(noise + ε² size) + Σ ((θ − mean)/sd)²   inside bounds

A step solves the quadratic model inside the bounds; one that does not lower the cost is tried again with several
dampings at once (Levenberg 1944, Marquardt 1963), and bent by what it missed, along the valley of confounded unknowns
(geodesic acceleration: Transtrum & Sethna, arXiv:1201.5885). Derivatives are differences, which may be kept from step
to step and corrected by secants (Broyden, Math. Comp. 19, 1965). A fit has converged where the best step would gain
less than `FitSettings.gain` of χ²: the optimum is then within √gain standard deviations in every direction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np

from ffcomp.inference.covariance import clustered_covariance
from ffcomp.inference.problem import SMALLEST_ERROR, EstimationProblem
from models.arrays import FloatArray

DAMPINGS = (1e1, 1e2, 1e3, 1e4, 1e5)  # tried at once, times the last one, where a step does not help,
BENT = (1.0, 0.3)  # with shares of that step, bent
SMALLEST_DAMPING = 1e-3
RIDGE = 1e-12  # of the diagonal: keeps the normal matrix of confounded unknowns regular
TRUSTED_GAIN = 0.3  # of its predicted gain a step must reach, or derivatives that were kept are too old
MOST_CHANGE, FINEST = 30.0, 1e-3  # a difference's step shrinks, at most to this share, where it changes more than that
MOST_PASSES = 1000  # of the search for the bounds that a step meets
SETTLED = 0.05  # of a model error: less change ends the rounds

P = TypeVar("P", bound=EstimationProblem)


class Status(Enum):
    """How a fit ended."""

    CONVERGED = "converged"
    STALLED = "no step lowers the cost, though one should: derivatives or simulation are not exact enough"
    RAN_OUT = "ran out of steps"


@dataclass(frozen=True)
class FitSettings:
    """How hard a fit tries."""

    steps: int = 60  # in each round
    rounds: int = 0  # of fitting and estimating the model's errors; 0: the given errors are kept
    gain: float = 1e-3  # of χ²: a fit converges where less can be gained,
    share: float = 1e-12  # or less than this share of the cost
    keep: bool = False  # derivatives from step to step: for simulations that cost much
    exact: bool = False  # central differences wherever all derivatives are taken
    renew: Sequence[int] = ()  # unknowns whose derivatives are taken at every step although the others are kept
    renew_all: bool = True  # all derivatives that were kept where no step helps


@dataclass(frozen=True, eq=False)
class FitResult(Generic[P]):
    """The optimum, with its residual and derivatives."""

    problem: P
    values: FloatArray  # (p,)
    residual: FloatArray  # (rows,) measured − simulated, in standard deviations
    jacobian: FloatArray  # (rows, p) of the simulation, in the same units
    sd: FloatArray  # (rows,)
    errors: FloatArray  # (o,) the model's own relative error in each observation
    precision: FloatArray  # (p,) of the prior
    status: Status = Status.RAN_OUT
    n_evaluations: int = 0
    history: tuple[float, ...] = ()  # the cost after each step

    def __getitem__(self, name: str) -> float:
        return float(self.values[[u.name for u in self.problem.unknowns].index(name)])

    @cached_property
    def cost(self) -> float:
        """χ² and the prior's part."""
        cost = float(self.residual @ self.residual + self.precision @ (self.values - self.problem.prior[0]) ** 2)
        return cost if np.isfinite(cost) else np.inf

    @cached_property
    def deviance(self) -> float:
        """−2 ln of likelihood and prior, up to a constant."""
        return self.cost + 2.0 * float(np.sum(np.log(self.sd)))

    @cached_property
    def information(self) -> FloatArray:
        """(p, p) JᵀJ and the prior's precision."""
        return self.jacobian.T @ self.jacobian + np.diag(self.precision)

    @property
    def evidence(self) -> float:
        """−2 ln of the evidence by Laplace's approximation: the smaller the likelier (MacKay, Neural Comp. 4, 1992)."""
        precision = self.problem.prior[1]
        known = float(np.sum(np.log(precision[precision > 0])))
        return self.deviance - known + float(np.linalg.slogdet(self.information)[1])

    @cached_property
    def covariance(self) -> FloatArray:
        """(p, p) of the values; rows err alike within clusters unless noise alone explains their observation."""
        clusters = self.problem.clusters_with(self.errors)
        return clustered_covariance(self.jacobian, self.residual, clusters, self.problem.prior[1])

    @property
    def gradient(self) -> FloatArray:
        """(p,) half of what the cost falls by with each value, at first."""
        return self.jacobian.T @ self.residual - self.precision * (self.values - self.problem.prior[0])

    def step(self, damping: float = 0.0) -> FloatArray:
        """Return a step (p,) to the least of the quadratic model inside the bounds."""
        low, high = (limit - self.values for limit in self.problem.limits)
        size = np.diag(self.information)
        more = np.where(size > 0, damping * size, 1.0)  # values that move nothing, as of a mode without a share, stay
        return bounded_step(self.information + np.diag(more), self.gradient, low, high)

    def gain(self, step: FloatArray) -> float:
        """Return the decrease of the cost by a step (p,), were the simulation linear."""
        return float(2 * self.gradient @ step - step @ self.information @ step)

    def doubt(self, what: str) -> list[str]:
        """Say that the fit has not converged; nothing if it has."""
        if self.status is not Status.RAN_OUT:
            return []
        return [
            f"The fit of {what} ran out of steps ({self.n_evaluations} simulations) before it converged: its numbers "
            "and intervals are uncertain. Start from a nearer machine file, or measure again."
        ]


def fit(
    problem: P,
    start: FloatArray,
    settings: FitSettings = FitSettings(),
    *,
    errors: FloatArray | None = None,
    jacobian: FloatArray | None = None,
    progress: Callable[[FitResult[P]], None] = lambda _: None,
) -> FitResult[P]:
    """Fit the unknowns from `start`, (p,), in several rounds if the model's errors are estimated too.

    Parameters
    ----------
    errors : (o,) the model's errors to begin with; None: one for all, as the start leaves.
    jacobian : (rows, p) of the simulation, in standard deviations, to begin with.
    progress : called with the result of each round.
    """
    run = _Run(problem, settings)
    here = run.begin(start, errors, jacobian)
    here, status = run.descend(here, fresh=jacobian is None or settings.exact)
    progress(here)
    for number in range(settings.rounds):
        now = problem.errors_of(here.residual * here.sd)
        settled = bool(np.all(np.abs(now - here.errors) <= SETTLED * now + SMALLEST_ERROR))
        here = _weighed(here, now)
        if settled:
            break
        if number + 1 == settings.rounds:
            status = Status.RAN_OUT
            break
        here, status = run.descend(here, fresh=True)
        progress(here)
    return replace(here, status=status, n_evaluations=run.count, history=tuple(run.history))


def derivatives(
    problem: EstimationProblem,
    values: FloatArray,
    residual: FloatArray,
    sd: FloatArray,
    columns: Sequence[int],
    central: bool = False,
    sizes: FloatArray | None = None,
) -> FloatArray:
    """Differentiate the simulation by some unknowns, (rows, len(columns)) in standard deviations, by differences.

    One-sided ones turn inward at a bound. Central ones cost twice as much, and are worth it at the end of a fit: the
    effects of confounded unknowns (a heavier machine on stiffer belts) cancel in exact derivatives only.

    Parameters
    ----------
    sizes : (p,) about how much the residual changes with each unknown, which sets the steps.
    """
    sizes = np.zeros(len(values)) if sizes is None else sizes
    return _Run(problem, FitSettings()).differences(values, residual, sd, columns, central, sizes)


def best_of(results: Iterable[FitResult[P]], enough: Callable[[FitResult[P]], bool] = lambda _: False) -> FitResult[P]:
    """Return the fit of least cost; the first best one that is good enough ends the search."""
    best: FitResult[P] | None = None
    for result in results:
        best = result if best is None or result.cost < best.cost else best
        if enough(best):
            break
    if best is None:
        raise ValueError("There is no start.")
    return best


def _weighed(here: FitResult[P], errors: FloatArray) -> FitResult[P]:
    """Weigh the rows by other model errors."""
    sd = here.problem.deviations(errors)
    share = here.sd / sd
    return replace(here, residual=here.residual * share, jacobian=here.jacobian * share[:, None], sd=sd, errors=errors)


class _Run(Generic[P]):
    """One fit with what it counts."""

    def __init__(self, problem: P, settings: FitSettings) -> None:
        self.problem, self.settings = problem, settings
        self.count, self.history = 0, list[float]()

    def evaluated(
        self, lanes: Sequence[FloatArray], sd: FloatArray, problem: EstimationProblem | None = None
    ) -> list[FloatArray]:
        self.count, problem = self.count + len(lanes), problem or self.problem
        return [problem.whitened(simulated, sd) for simulated in problem.simulate(lanes)]

    def begin(self, start: FloatArray, errors: FloatArray | None, jacobian: FloatArray | None) -> FitResult[P]:
        problem, settings = self.problem, self.settings
        values = np.clip(start, *problem.limits)
        if errors is None and settings.rounds:
            errors = problem.errors_of(self.evaluated([values], np.ones(len(problem.measured)))[0], together=True)
        errors = np.zeros(len(problem.observations)) if errors is None else errors
        sd = problem.deviations(errors)
        (residual,) = self.evaluated([values], sd)
        known = np.zeros((len(residual), len(values))) if jacobian is None else jacobian
        here = FitResult(problem, values, residual, known, sd, errors, problem.prior[1])
        if jacobian is None or settings.exact:
            here = self.renewed(here, central=settings.keep or settings.exact)
        return here

    def descend(self, here: FitResult[P], fresh: bool) -> tuple[FitResult[P], Status]:
        """Take steps until the best one gains too little."""
        damping, settings, problem = 0.0, self.settings, self.problem
        for _ in range(settings.steps):
            beyond = max(here.cost - problem.expected_cost, 0.0)
            least = max(settings.gain * problem.scatter(here.residual), settings.share * beyond)
            here = replace(here, precision=problem.precision(here.residual))
            predicted = here.gain(here.step())
            better = None if predicted < least else self.stepped(here, damping)
            if better is None and (fresh or not settings.renew_all):
                return here, Status.CONVERGED if predicted < least else Status.STALLED
            gained = 0.0
            if better is not None:
                gained = here.cost - better[0].cost
                here, damping = better
                self.history.append(here.cost)
            fresh = not settings.keep or gained < TRUSTED_GAIN * predicted
            here = self.renewed(here, central=settings.exact) if fresh else self.renewed(here, settings.renew)
        return here, Status.RAN_OUT

    def stepped(self, here: FitResult[P], damping: float) -> tuple[FitResult[P], float] | None:
        """Take one step; if it does not help, the best of several that are damped more and more; None if none helps.

        Returns the new point, its derivatives corrected by the secant, and the damping to begin the next step with.
        """
        whole, grown = here.step(damping), [max(damping, SMALLEST_DAMPING) * each for each in DAMPINGS]
        steps = [(whole, damping)]
        for more in (True, False):
            points = self.points(here, [step for step, _ in steps])
            best = int(np.argmin([point.cost for point in points]))
            if points[best].cost < here.cost:
                used = steps[best][1]
                there = _secant(here, points[best]) if self.settings.keep else points[best]
                return there, used / 10 if used > SMALLEST_DAMPING else 0.0
            steps = [(here.step(each), each) for each in grown] if more else []
            if more and np.isfinite(points[0].cost) and not self.settings.keep:
                bend = points[0].step(damping)  # by the derivatives from before that step: by what they missed
                steps += [(share * whole + share**2 * bend, damping) for share in BENT]
        return None

    def points(self, here: FitResult[P], steps: Sequence[FloatArray]) -> list[FitResult[P]]:
        """Return the fit as it is after each of several steps, with the derivatives from here."""
        trials = [np.clip(here.values + step, *self.problem.limits) for step in steps]
        residuals = self.evaluated(trials, here.sd)
        return [replace(here, values=x, residual=r) for x, r in zip(trials, residuals, strict=True)]

    def renewed(self, here: FitResult[P], columns: Sequence[int] | None = None, central: bool = False) -> FitResult[P]:
        """Take derivatives again, by some unknowns or all."""
        columns = range(len(here.values)) if columns is None else columns
        if not len(columns):
            return here
        jacobian, sizes = here.jacobian.copy(), np.linalg.norm(here.jacobian, axis=0)
        jacobian[:, list(columns)] = self.differences(here.values, here.residual, here.sd, columns, central, sizes)
        return replace(here, jacobian=jacobian)

    def differences(
        self,
        values: FloatArray,
        residual: FloatArray,
        sd: FloatArray,
        columns: Sequence[int],
        central: bool,
        sizes: FloatArray,
    ) -> FloatArray:
        """Differentiate, see `derivatives`."""
        pairs, found = {i: self.pair(values, i, float(sizes[i]), central) for i in columns}, dict[int, FloatArray]()
        for problem, own in [(self.problem, columns)] if central else self.problem.by_fidelity(columns):
            if not own:
                continue
            here = residual if problem is self.problem else self.evaluated([values], sd, problem)[0]
            lanes = [lane for i in own for lane in pairs[i] if lane is not values]
            moved = iter(self.evaluated(lanes, sd, problem))
            for i in own:
                below, above = (here if lane is values else next(moved) for lane in pairs[i])
                slope = (below - above) / max(pairs[i][1][i] - pairs[i][0][i], 1e-300)
                found[i] = np.where(np.isfinite(slope), slope, 0.0)
        return np.stack([found[i] for i in columns], axis=1)

    def pair(self, values: FloatArray, i: int, size: float, central: bool) -> tuple[FloatArray, FloatArray]:
        """Return the values with unknown i a step lower and higher; unmoved at a bound, or where one side is enough."""
        step, (low, high) = self.problem.unknowns[i].step, self.problem.limits
        if size > 0:
            step *= float(np.clip(MOST_CHANGE / (size * step), FINEST, 1.0))
        behind, ahead = values.copy(), values.copy()
        behind[i], ahead[i] = max(values[i] - step, low[i]), min(values[i] + step, high[i])
        above = ahead if ahead[i] > values[i] else values
        return (behind if behind[i] < values[i] and (central or above is values) else values), above


def _secant(here: FitResult[P], there: FitResult[P]) -> FitResult[P]:
    """Correct the derivatives by what the step really did."""
    step, change = there.values - here.values, here.residual - there.residual
    # in the prior's units where there is a prior, so that unknowns of different sizes are corrected alike
    precision = here.problem.prior[1]
    scaled = step * np.where(precision > 0, precision, np.diag(here.information))
    jacobian = here.jacobian + np.outer(change - here.jacobian @ step, scaled) / (scaled @ step)
    return replace(there, jacobian=jacobian)


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
