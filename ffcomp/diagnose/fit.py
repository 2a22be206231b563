"""Gauss-Newton on the whitened output error, with priors; the evidence of what was fitted, and its intervals.

Numbers are in units of their prior's standard deviation, z = (x − start)/sd, so the prior is |z|². The evidence is
Laplace's approximation, with J the derivative of the residual by z (MacKay, Neural Computation 4, 1992):

    −2 ln Z = |r|² + |z|² + ln det(I + JᵀJ)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ffcomp.diagnose.noise import Whitener
from ffcomp.diagnose.problem import Impossible, Number, Plant
from models.arrays import FloatArray

STEP = 0.01  # of a prior's standard deviation, for derivatives: the simulation has no noise of its own; or so much
ALIKE = 1e-12  # of the diagonal: what keeps the normal matrix of numbers that cannot be told apart regular
STIR, LEAST_STEP = 30.0, 1e-5  # less that the answer changes by 30 standard deviations of the noise: resonances bend
NEAR_COST = 0.3  # of −2 ln, times the misfit: less than this to be gained, and the fit is done
SMALL_GAIN = 1e-7  # or less than this share
TRUST = 0.3  # of what a step promised
SLIP = 1e-4  # relative error of a derivative: what cancels to less says nothing
WELL_KNOWN, GUESSED = 0.1, 3.0  # share of the noise to which its floor is known: from repeats, or without any
HUGE = 1e6  # standard deviations
MOST_PASSES = 1000  # of the search for the bounds that hold a step
BLOCK_HZ = 5.0  # of the sandwich: what a wrong shape leaves keeps its sign over a few Hz


@dataclass(frozen=True, eq=False)
class Bench:
    """A plant with its whitener: values in, residual out."""

    plant: Plant
    whiten: Whitener
    measured: FloatArray  # (rows,) whitened
    coarse: bool = False  # quicker simulations
    given: Mapping[str, float] = field(default_factory=dict)  # values of numbers that are not fitted
    slack: float = WELL_KNOWN  # of the noise: what is left is called nothing; as well as the noise is known

    def residual(self, values: Mapping[str, float]) -> FloatArray:
        """(rows,) measured − simulated, whitened; huge where the plant is impossible."""
        return next(self.residuals([values]))

    def residuals(self, many: Sequence[Mapping[str, float]]) -> Iterator[FloatArray]:
        """The same for many, one after the other."""
        for simulated in self.plant.simulate_many([{**self.given, **v} for v in many], coarse=self.coarse):
            if isinstance(simulated, Impossible):
                yield np.full(len(self.measured), HUGE)
            else:
                residual = self.measured - self.whiten(simulated)
                yield residual if np.isfinite(residual @ residual) else np.full(len(self.measured), HUGE)

    def rows_at(self, observations: Sequence[int]) -> FloatArray:
        """Indices of the rows of some recordings."""
        return np.concatenate([np.arange(len(self.measured))[self.whiten.rows[i]] for i in observations])


def bench(plant: Plant, whiten: Whitener) -> Bench:
    slack = WELL_KNOWN if whiten.floor.from_repeats else GUESSED
    return Bench(plant, whiten, whiten([r.measured for r in plant.observations]), slack=slack)


@dataclass(frozen=True, eq=False)
class Fit:
    """Numbers at their best values."""

    numbers: tuple[Number, ...]
    z: FloatArray  # (p,)
    residual: FloatArray  # (rows,)
    jacobian: FloatArray  # (rows, p), of the *simulation* by z

    @property
    def values(self) -> dict[str, float]:
        return {n.name: n.start + n.sd * float(z) for n, z in zip(self.numbers, self.z, strict=True)}

    @property
    def chi_squared(self) -> float:
        return float(self.residual @ self.residual)

    @property
    def cost(self) -> float:
        return self.chi_squared + float(self.z @ self.z)

    @cached_property
    def information(self) -> FloatArray:
        return np.eye(len(self.z)) + self.jacobian.T @ self.jacobian

    @property
    def evidence(self) -> float:
        """−2 ln Z, but for what every hypothesis shares: the smaller the likelier."""
        return self.cost + float(np.linalg.slogdet(self.information)[1])

    @property
    def _sure_information(self) -> FloatArray:
        """The information less what errors of the derivatives alone may seem to know."""
        length = np.maximum(np.linalg.norm(self.jacobian, axis=0), 1e-300)
        unit = self.jacobian / length
        known, along = np.linalg.eigh(unit.T @ unit)
        sure = (along * np.maximum(known - len(known) * SLIP**2, 0.0)) @ along.T
        return np.asarray(np.eye(len(self.z)) + sure * np.outer(length, length))

    def covariance(self, frequency_hz: FloatArray, rows: Sequence[slice]) -> FloatArray:
        """(p, p) of z: the sandwich over blocks of 5 Hz of each recording, never below the inverse information."""
        bread = np.linalg.inv(self._sure_information)
        meat = np.eye(len(self.z))
        for part in rows:
            block = (frequency_hz[part] // BLOCK_HZ).astype(np.int64)
            weighted = self.jacobian[part] * self.residual[part][:, None]
            sums = np.zeros((block.max() + 1, len(self.z)))
            np.add.at(sums, block, weighted)
            meat += sums.T @ sums
        wide = np.diag(bread @ meat @ bread) / np.diag(bread)
        wider = np.sqrt(np.maximum(1.0, wide))
        return bread * np.outer(wider, wider)


def values_at(numbers: Sequence[Number], z: FloatArray) -> dict[str, float]:
    return {n.name: n.start + n.sd * float(x) for n, x in zip(numbers, z, strict=True)}


def clipped(numbers: Sequence[Number], z: FloatArray) -> FloatArray:
    """Inside every number's bounds."""
    low = np.array([(n.low - n.start) / n.sd for n in numbers])
    high = np.array([(n.high - n.start) / n.sd for n in numbers])
    return np.clip(z, low, high)


def derivatives(
    bench: Bench,
    numbers: Sequence[Number],
    z: FloatArray,
    residual: FloatArray,
    which: Sequence[int],
    central: bool = False,
    sizes: FloatArray | None = None,
) -> FloatArray:
    """(rows, len(which)) of the simulation by z: one-sided, away from the nearer bound, or central where there is room.

    Central differences cost twice as much, and are worth it at the end of a fit: numbers that do the same (a heavier
    machine on stiffer belts) cancel only in exact derivatives.

    sizes : (p,) about how much the residual changes with each z, which sets the steps.
    """
    steps = np.full(len(z), STEP) if sizes is None else np.clip(STIR / np.maximum(sizes, 1e-300), LEAST_STEP, STEP)
    pairs = [_either_side(numbers, z, i, steps[i], central) for i in which]
    residuals = bench.residuals([values_at(numbers, x) for pair in pairs for x in pair if x is not z])
    columns = []
    for i, (low, high) in zip(which, pairs, strict=True):
        below = residual if low is z else next(residuals)
        above = residual if high is z else next(residuals)
        columns.append((below - above) / max(high[i] - low[i], LEAST_STEP))
    return np.stack(columns, axis=1)


def _either_side(
    numbers: Sequence[Number], z: FloatArray, i: int, step: float, central: bool
) -> tuple[FloatArray, FloatArray]:
    """z with number i a step lower and higher; z itself where a bound is in the way, or one side is enough."""
    behind, ahead = _shifted(numbers, z, i, -step), _shifted(numbers, z, i, step)
    high = ahead if ahead[i] > z[i] else z
    low = behind if behind[i] < z[i] and (central or high is z) else z
    return low, high


def _shifted(numbers: Sequence[Number], z: FloatArray, i: int, step: float) -> FloatArray:
    shifted = z.copy()
    shifted[i] += step
    return clipped(numbers, shifted)


def fit(
    bench: Bench,
    numbers: Sequence[Number],
    start: FloatArray,
    jacobian: FloatArray | None = None,
    renew: Sequence[int] = (),
    iterations: int = 6,
    small: float = SMALL_GAIN,
    again: bool = True,
    exact: bool = False,
) -> Fit:
    """Minimise |r|² + |z|² from `start`.

    Parameters
    ----------
    start : (p,) z.
    jacobian : (rows, p) to begin with; None to find all of it, by central differences.
    renew : columns to find anew at every step: those of numbers that act nonlinearly.
    small : the share of the cost that must still be gained for another step.
    again : where no step helps, find all columns anew and go on.
    exact : find all of the jacobian anew by central differences, with steps as fine as the given one asks for.
    """
    numbers = tuple(numbers)
    z = clipped(numbers, start)
    residual = bench.residual(values_at(numbers, z))
    everything: Sequence[int] = range(len(z))
    fresh = jacobian is None
    if jacobian is None or exact:
        sizes = None if jacobian is None else np.linalg.norm(jacobian, axis=0)
        jacobian = derivatives(bench, numbers, z, residual, everything, central=True, sizes=sizes)
        fresh = True
    cost, damping = float(residual @ residual + z @ z), 0.0
    for _ in range(iterations):
        least = max(NEAR_COST * max(1.0, cost / len(residual)), small * cost)
        promised = promise(Fit(numbers, z, residual, jacobian))
        better = None if promised < least else _stepped(bench, numbers, z, residual, jacobian, cost, damping)
        if better is None and (fresh or not again):
            break
        # where no step helps any more, or one gains far less than it promised, the columns that were kept are too old
        fresh = better is None or cost - better[2] < TRUST * promised
        if better is not None:
            jacobian = _secant(jacobian, better[0] - z, residual - better[1])
            z, residual, cost, damping = better
        which = everything if fresh else renew
        if len(which):
            jacobian = jacobian.copy()
            sizes = np.linalg.norm(jacobian, axis=0)
            jacobian[:, list(which)] = derivatives(bench, numbers, z, residual, which, fresh and exact, sizes)
    return Fit(numbers, z, residual, jacobian)


def promise(fitted: Fit) -> float:
    """What the best step would gain if all were linear."""
    gradient = fitted.jacobian.T @ fitted.residual - fitted.z
    step = bounded_step(fitted.numbers, fitted.z, fitted.information, gradient)
    return float(2 * gradient @ step - step @ fitted.information @ step)


def _secant(jacobian: FloatArray, step: FloatArray, change: FloatArray) -> FloatArray:
    """The Jacobian corrected by what the step really did (Broyden, Math. Comp. 19, 1965)."""
    return np.asarray(jacobian + np.outer(change - jacobian @ step, step) / (step @ step))


def bounded_step(numbers: Sequence[Number], z: FloatArray, normal: FloatArray, gradient: FloatArray) -> FloatArray:
    """(p,) least of ½ sᵀNs − gᵀs with z + s inside the bounds, N positive definite.

    As least squares, |Lᵀs − L⁻¹g|² with N = L Lᵀ scaled to a diagonal of ones, so that numbers that do quite the same
    share a step (bounded-variable least squares: Stark & Parker, Comp. Stat. 10, 1995).
    """
    from scipy.linalg import solve_triangular
    from scipy.optimize import lsq_linear

    low, high = (clipped(numbers, np.full(len(z), end)) - z for end in (-np.inf, np.inf))
    free = high > low
    step = np.zeros(len(z))
    if not free.any():
        return step
    scale = 1 / np.sqrt(np.diag(normal)[free])
    alike = normal[np.ix_(free, free)] * np.outer(scale, scale) + ALIKE * np.eye(len(scale))
    lower = np.linalg.cholesky(alike)
    right = solve_triangular(lower, scale * gradient[free], lower=True)
    bounds = (np.minimum(low[free], 0.0) / scale, np.maximum(high[free], 0.0) / scale)
    step[free] = scale * lsq_linear(lower.T, right, bounds, "bvls", tol=1e-14, max_iter=MOST_PASSES).x
    return step


def _stepped(
    bench: Bench,
    numbers: Sequence[Number],
    z: FloatArray,
    residual: FloatArray,
    jacobian: FloatArray,
    cost: float,
    damping: float,
) -> tuple[FloatArray, FloatArray, float, float] | None:
    """One step; if it does not help, the best of some that are damped more and more (Levenberg 1944, Marquardt 1963);
    None if nothing helps."""
    gradient = jacobian.T @ residual - z
    normal = np.eye(len(z)) + jacobian.T @ jacobian
    for dampings in ((damping,), tuple(max(damping, 1e-3) * grown for grown in (10.0, 100.0, 1e3, 1e4, 1e5))):
        steps = [bounded_step(numbers, z, normal + d * np.diag(np.diag(normal)), gradient) for d in dampings]
        trials = [clipped(numbers, z + step) for step in steps]
        residuals = list(bench.residuals([values_at(numbers, trial) for trial in trials]))
        costs = [float(r @ r + trial @ trial) for r, trial in zip(residuals, trials, strict=True)]
        best = int(np.argmin(costs))
        if costs[best] < cost:
            return trials[best], residuals[best], costs[best], dampings[best] / 10 if dampings[best] > 1e-3 else 0.0
    return None
