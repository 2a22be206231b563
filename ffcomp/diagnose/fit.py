"""Gauss-Newton on the whitened output error, with priors; the evidence of what was fitted, and its intervals.

Numbers are in units of their prior's standard deviation, z = (x − start)/sd, so the prior is |z|². The evidence is
Laplace's approximation, with J the derivative of the residual by z (MacKay, Neural Computation 4, 1992):

    −2 ln Z = |r|² + |z|² + ln det(I + JᵀJ)
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ffcomp.diagnose.noise import Whitener
from ffcomp.diagnose.plant import Impossible, Number, Plant
from ffcomp.measured.frf import FloatArray

STEP = 0.01  # of a prior's standard deviation, for derivatives: the simulation has no noise of its own
NEAR_COST = 0.5  # of −2 ln: less than this gained, and the fit is done
SMALL_GAIN = 1e-6  # or less than this share
TRUSTED = 0.7  # of the promised gain, or the derivatives are taken anew
HUGE = 1e6  # standard deviations
BLOCK_HZ = 5.0  # of the sandwich: what a wrong shape leaves keeps its sign over a few Hz
WORKERS = min(8, os.cpu_count() or 1)


@dataclass(frozen=True, eq=False)
class Bench:
    """A plant with its whitener: values in, residual out."""

    plant: Plant
    whiten: Whitener
    measured: FloatArray  # (rows,) whitened

    def residual(self, values: Mapping[str, float]) -> FloatArray:
        """(rows,) measured − simulated, whitened; huge where the plant is impossible."""
        try:
            return self.measured - self.whiten(self.plant.simulate(values))
        except Impossible:
            return np.full(len(self.measured), HUGE)

    def residuals(self, many: Sequence[Mapping[str, float]]) -> list[FloatArray]:
        """The same for many, on every core."""
        with ThreadPoolExecutor(WORKERS) as pool:
            return list(pool.map(self.residual, many))

    def rows_at(self, recordings: Sequence[int]) -> FloatArray:
        """Indices of the rows of some recordings."""
        return np.concatenate([np.arange(len(self.measured))[self.whiten.rows[i]] for i in recordings])


def bench(plant: Plant, whiten: Whitener) -> Bench:
    return Bench(plant, whiten, whiten([r.measured for r in plant.recordings]))


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

    @property
    def information(self) -> FloatArray:
        return np.eye(len(self.z)) + self.jacobian.T @ self.jacobian

    @property
    def evidence(self) -> float:
        """−2 ln Z, but for what every hypothesis shares: the smaller the likelier."""
        return self.cost + float(np.linalg.slogdet(self.information)[1])

    def covariance(self, frequency_hz: FloatArray, rows: Sequence[slice]) -> FloatArray:
        """(p, p) of z: the sandwich over blocks of 5 Hz of each recording, never below the inverse information."""
        bread = np.linalg.inv(self.information)
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
) -> FloatArray:
    """(rows, len(which)) of the simulation by z: one-sided, away from the nearer bound, or central where there is room.

    Central differences cost twice as much, and are worth it at the end of a fit: numbers that do the same (a heavier
    machine on stiffer belts) cancel only in exact derivatives.
    """
    behind = [_shifted(numbers, z, i, -STEP) for i in which]
    ahead = [_shifted(numbers, z, i, STEP) for i in which]
    pairs = [
        (b if (central or a[i] == z[i]) and b[i] != z[i] else z, a)
        for i, b, a in zip(which, behind, ahead, strict=True)
    ]
    residuals = iter(bench.residuals([values_at(numbers, x) for pair in pairs for x in pair if x is not z]))
    columns = []
    for i, (low, high) in zip(which, pairs, strict=True):
        below = residual if low is z else next(residuals)
        columns.append((below - next(residuals)) / (high[i] - low[i]))
    return np.stack(columns, axis=1)


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
) -> Fit:
    """Minimise |r|² + |z|² from `start`.

    Parameters
    ----------
    start : (p,) z.
    jacobian : (rows, p) to begin with; None to find all of it, by central differences.
    renew : columns to find anew at every step: those of numbers that act nonlinearly.
    """
    numbers = tuple(numbers)
    z = clipped(numbers, start)
    residual = bench.residual(values_at(numbers, z))
    everything: Sequence[int] = range(len(z))
    fresh = jacobian is None
    if jacobian is None:
        jacobian = derivatives(bench, numbers, z, residual, everything, central=True)
    cost, damping = float(residual @ residual + z @ z), 0.0
    for _ in range(iterations):
        better = _stepped(bench, numbers, z, residual, jacobian, cost, damping)
        if better is None and fresh:
            break
        if better is not None:
            gained, promised = cost - better[2], cost - _linear_cost(z, residual, jacobian, better[0])
            jacobian = _secant(jacobian, better[0] - z, residual - better[1])
            z, residual, cost, damping = better
            if gained < max(NEAR_COST, SMALL_GAIN * cost) and (fresh or gained > TRUSTED * promised):
                break
        # where no step helped any more, the columns that were kept are too old
        fresh = better is None
        which = everything if fresh else renew
        if len(which):
            jacobian = jacobian.copy()
            jacobian[:, list(which)] = derivatives(bench, numbers, z, residual, which)
    return Fit(numbers, z, residual, jacobian)


def _secant(jacobian: FloatArray, step: FloatArray, change: FloatArray) -> FloatArray:
    """The Jacobian corrected by what the step really did (Broyden, Math. Comp. 19, 1965)."""
    return np.asarray(jacobian + np.outer(change - jacobian @ step, step) / (step @ step))


def _linear_cost(z: FloatArray, residual: FloatArray, jacobian: FloatArray, to: FloatArray) -> float:
    """What the linear model promised at `to`."""
    r = residual - jacobian @ (to - z)
    return float(r @ r + to @ to)


def _stepped(
    bench: Bench,
    numbers: Sequence[Number],
    z: FloatArray,
    residual: FloatArray,
    jacobian: FloatArray,
    cost: float,
    damping: float,
) -> tuple[FloatArray, FloatArray, float, float] | None:
    """One step, damped more and more until it helps (Levenberg 1944, Marquardt 1963); None if nothing does."""
    gradient = jacobian.T @ residual - z
    normal = np.eye(len(z)) + jacobian.T @ jacobian
    for grown in (damping, max(10 * damping, 1e-2), max(100 * damping, 1e-1), max(1e3 * damping, 1.0)):
        step = np.linalg.solve(normal + grown * np.diag(np.diag(normal)), gradient)
        trial = clipped(numbers, z + step)
        r = bench.residual(values_at(numbers, trial))
        trial_cost = float(r @ r + trial @ trial)
        if trial_cost < cost:
            return trial, r, trial_cost, grown / 10 if grown > 1e-3 else 0.0
    return None
