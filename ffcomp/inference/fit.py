"""Damped least squares for every problem: Levenberg-Marquardt in batches that also estimates the model's own error.

    minimise  Σ r²/(noise + ε² size) + Σ ((θ − mean)/sd)²   inside bounds

A step solves the quadratic model inside the bounds; one that does not lower the cost is tried again with several
dampings at once (Levenberg 1944, Marquardt 1963). Derivatives are exact, or differences, which may be kept from step to
step and corrected by secants (Broyden, Math. Comp. 19, 1965). A fit has converged where the best step would gain less
than `FitSettings.gain` of χ²: no combination of values is then farther than √gain standard deviations from the optimum.
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
from ffcomp.numerics.least_squares import bounded_step
from models.arrays import FloatArray

DAMPINGS = (1e1, 1e2, 1e3, 1e4, 1e5)  # tried at once, times the last one, where a step does not help
SMALLEST_DAMPING = 1e-3
RIDGE = 1e-12  # of the diagonal: keeps the normal matrix of confounded unknowns regular
TRUSTED_GAIN = 0.3  # of its predicted gain a step must reach, or derivatives that were kept are too old
MOST_CHANGE, FINEST = 30.0, 1e-3  # a difference's step shrinks, at most to this share, where it changes more than that
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
    exact_end: bool = False  # central differences at the end make the covariance exact


@dataclass(frozen=True, eq=False)
class FitResult(Generic[P]):
    """The optimum, with its residual and derivatives."""

    problem: P
    values: FloatArray  # (p,)
    residual: FloatArray  # (rows,) measured − simulated, in standard deviations
    jacobian: FloatArray  # (rows, p) of the simulation, in the same units
    sd: FloatArray  # (rows,)
    errors: FloatArray  # (o,) the model's own relative error in each observation
    status: Status = Status.RAN_OUT
    n_evaluations: int = 0
    history: tuple[float, ...] = ()  # the cost after each step

    def __getitem__(self, name: str) -> float:
        return float(self.values[[u.name for u in self.problem.unknowns].index(name)])

    @cached_property
    def cost(self) -> float:
        """χ² and the prior's part."""
        mean, precision = self.problem.prior
        cost = float(self.residual @ self.residual + precision @ (self.values - mean) ** 2)
        return cost if np.isfinite(cost) else np.inf

    @cached_property
    def deviance(self) -> float:
        """−2 ln of likelihood and prior, up to a constant."""
        return self.cost + 2.0 * float(np.sum(np.log(self.sd)))

    @cached_property
    def information(self) -> FloatArray:
        """(p, p) JᵀJ and the prior's precision."""
        return self.jacobian.T @ self.jacobian + np.diag(self.problem.prior[1])

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
        mean, precision = self.problem.prior
        return self.jacobian.T @ self.residual - precision * (self.values - mean)

    def step(self, damping: float = 0.0) -> FloatArray:
        """Return a step (p,) to the least of the quadratic model, with values at their bounds where it lies beyond."""
        low, high = (limit - self.values for limit in self.problem.limits)
        size = np.diag(self.information)
        scale = 1 / np.sqrt(np.where(size > 0, size, 1.0))
        normal = self.information * np.outer(scale, scale) + (damping + RIDGE) * np.eye(len(scale))
        gradient, step, free = scale * self.gradient, np.zeros(len(scale)), (high > low) & (size > 0)
        while free.any():
            rest = gradient[free] - normal[np.ix_(free, ~free)] @ (step[~free] / scale[~free])
            step[free] = scale[free] * np.linalg.solve(normal[np.ix_(free, free)], rest)
            beyond = free & ((step < low) | (step > high))
            if not beyond.any():
                break
            step, free = np.clip(step, low, high), free & ~beyond
        return step

    @cached_property
    def predicted_gain(self) -> float:
        """The decrease of the cost by the best step, were the simulation linear."""
        low, high = (limit - self.values for limit in self.problem.limits)
        idle = np.diag(self.information) == 0  # values that move nothing, as those of a mode without a share
        return self.gain(bounded_step(self.information + np.diag(idle * 1.0), self.gradient, low, high))

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
    sd: FloatArray | None = None,
    jacobian: FloatArray | None = None,
    progress: Callable[[FitResult[P]], None] = lambda _: None,
) -> FitResult[P]:
    """Fit the unknowns from `start`, (p,), in several rounds if the model's errors are estimated too.

    Parameters
    ----------
    errors : (o,) the model's errors to begin with; None: one for all, as the start leaves.
    sd : (rows,) standard deviations in place of those that follow from the errors.
    jacobian : (rows, p) of the simulation, in standard deviations, to begin with.
    progress : called with the result of each round.
    """
    run = _Run(problem, settings)
    here = run.begin(start, errors, sd, jacobian)
    here, status = run.descend(here, fresh=jacobian is None)
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
        here, status = run.descend(here, fresh=problem.slopes is not EstimationProblem.slopes)
        progress(here)
    if settings.exact_end:
        here = run.renewed(here, central=True)
    return replace(here, status=status, n_evaluations=run.count, history=tuple(run.history))


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
    jacobian = here.jacobian * share[:, None]
    return replace(here, residual=here.residual * share, jacobian=jacobian, sd=sd, errors=errors)


class _Run(Generic[P]):
    """One fit with what it counts."""

    def __init__(self, problem: P, settings: FitSettings) -> None:
        self.problem, self.settings = problem, settings
        self.count, self.history = 0, list[float]()

    def evaluated(self, lanes: Sequence[FloatArray], sd: FloatArray) -> list[FloatArray]:
        self.count += len(lanes)
        return [self.problem.whitened(simulated, sd) for simulated in self.problem.simulate(lanes)]

    def begin(
        self, start: FloatArray, errors: FloatArray | None, sd: FloatArray | None, jacobian: FloatArray | None
    ) -> FitResult[P]:
        values = np.clip(start, *self.problem.limits)
        nothing = np.zeros(len(self.problem.observations))
        if errors is None and sd is None and self.settings.rounds:
            ones = np.ones(len(self.problem.measured))
            errors = self.problem.errors_of(self.evaluated([values], ones)[0], together=True)
        errors = nothing if errors is None else errors
        sd = self.problem.deviations(errors) if sd is None else sd
        (residual,) = self.evaluated([values], sd)
        empty = np.zeros((len(residual), len(values)))
        here = FitResult(self.problem, values, residual, empty if jacobian is None else jacobian, sd, errors)
        return self.renewed(here, central=self.settings.keep) if jacobian is None else here

    def descend(self, here: FitResult[P], fresh: bool) -> tuple[FitResult[P], Status]:
        """Take steps until the best one gains too little."""
        damping = 0.0
        for _ in range(self.settings.steps):
            misfit = max(1.0, here.cost / len(here.residual))
            least = max(self.settings.gain * misfit, self.settings.share * here.cost)
            predicted = here.gain(here.step())
            if predicted < least:  # of a step that may have kept too many bounds
                predicted = here.predicted_gain
            better = None if predicted < least else self.stepped(here, damping)
            if better is None and fresh:
                return here, Status.CONVERGED if predicted < least else Status.STALLED
            gained = 0.0
            if better is not None:
                gained = here.cost - better[0].cost
                here, damping = better
                self.history.append(here.cost)
            fresh = not self.settings.keep or gained < TRUSTED_GAIN * predicted
            if fresh:
                here = self.renewed(here)
        return here, Status.RAN_OUT

    def stepped(self, here: FitResult[P], damping: float) -> tuple[FitResult[P], float] | None:
        """Take one step; if it does not help, the best of several that are damped more and more; None if none helps.

        Returns the new point, its derivatives corrected by the secant, and the damping to begin the next step with.
        """
        for dampings in ((damping,), tuple(max(damping, SMALLEST_DAMPING) * grown for grown in DAMPINGS)):
            trials = [np.clip(here.values + here.step(each), *self.problem.limits) for each in dampings]
            residuals = self.evaluated(trials, here.sd)
            points = [replace(here, values=x, residual=r) for x, r in zip(trials, residuals, strict=True)]
            best = int(np.argmin([point.cost for point in points]))
            if points[best].cost < here.cost:
                used = dampings[best]
                there = _secant(here, points[best]) if self.settings.keep else points[best]
                return there, used / 10 if used > SMALLEST_DAMPING else 0.0
        return None

    def renewed(self, here: FitResult[P], central: bool = False) -> FitResult[P]:
        """Take all derivatives again: in closed form, or by differences, which turn inward at a bound."""
        exact = self.problem.slopes(here.values)
        if exact is not None:
            return replace(here, jacobian=np.nan_to_num(exact / here.sd[:, None]))
        size = np.linalg.norm(here.jacobian, axis=0)
        steps = np.array([u.step for u in self.problem.unknowns])
        fine = MOST_CHANGE / np.maximum(size * steps, 1e-300)
        steps = steps * np.clip(np.where(size > 0, fine, 1.0), FINEST, 1.0)
        low, high = self.problem.limits
        pairs = []
        for i, step in enumerate(steps):
            ahead, behind = here.values.copy(), here.values.copy()
            ahead[i], behind[i] = min(ahead[i] + step, high[i]), max(behind[i] - step, low[i])
            pairs.append((here.values if ahead[i] > here.values[i] and not central else behind, ahead))
        lanes = [lane for pair in pairs for lane in pair if lane is not here.values]
        found = iter(self.evaluated(lanes, here.sd))
        jacobian = np.zeros_like(here.jacobian)
        for i, pair in enumerate(pairs):
            below, above = (here.residual if lane is here.values else next(found) for lane in pair)
            jacobian[:, i] = (below - above) / max(pair[1][i] - pair[0][i], 1e-300)
        return replace(here, jacobian=jacobian)


def _secant(here: FitResult[P], there: FitResult[P]) -> FitResult[P]:
    """Correct the derivatives by what the step really did."""
    step, change = there.values - here.values, here.residual - there.residual
    # in the prior's units where there is a prior, so that unknowns of different sizes are corrected alike
    precision = here.problem.prior[1]
    scaled = step * np.where(precision > 0, precision, np.diag(here.information))
    jacobian = here.jacobian + np.outer(change - here.jacobian @ step, scaled) / (scaled @ step)
    return replace(there, jacobian=jacobian)
