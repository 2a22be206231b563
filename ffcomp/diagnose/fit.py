"""Fit parameters with priors to the whitened residual; evidence of a fit, and its intervals.

Parameters are in units of their prior's standard deviation, z = (x − start)/sd, so the prior is |z|². The evidence is
Laplace's approximation, with J the derivative of the simulation by z (MacKay, Neural Computation 4, 1992):

    −2 ln Z = |r|² + |z|² + ln det(I + JᵀJ)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.problem import Parameter
from ffcomp.identify.uncertainty import NINETY_PERCENT
from ffcomp.numerics.least_squares import (
    SMALL_GAIN,
    BatchedProblem,
    bounded_step,
    differences,
    minimise_batched,
)
from models.arrays import FloatArray

DERIVATIVE_ERROR = 1e-4  # relative: combinations that cancel to less are not determined
BLOCK_HZ = 5.0  # of the sandwich: the residual of a wrong shape keeps its sign over a few Hz


@dataclass(frozen=True, eq=False)
class Fit:
    """Parameters at their best values."""

    parameters: tuple[Parameter, ...]
    z: FloatArray  # (p,)
    residual: FloatArray  # (rows,)
    jacobian: FloatArray  # (rows, p), of the *simulation* by z

    @property
    def values(self) -> dict[str, float]:
        """Parameter values by name."""
        return values_at(self.parameters, self.z)

    @property
    def chi_squared(self) -> float:
        """|r|²."""
        return float(self.residual @ self.residual)

    @property
    def cost(self) -> float:
        """|r|² + |z|²."""
        return self.chi_squared + float(self.z @ self.z)

    @cached_property
    def information(self) -> FloatArray:
        """(p, p) I + JᵀJ."""
        return np.eye(len(self.z)) + self.jacobian.T @ self.jacobian

    @property
    def evidence(self) -> float:
        """−2 ln Z without what all hypotheses share: the smaller the likelier."""
        return self.cost + float(np.linalg.slogdet(self.information)[1])

    @cached_property
    def slope(self) -> FloatArray:
        """(p,) Jᵀr: half of what |r|² falls by with each z, at first."""
        return np.asarray(self.jacobian.T @ self.residual)

    @cached_property
    def best_step(self) -> FloatArray:
        """(p,) the step to the optimum inside the bounds if the simulation were linear."""
        gradient = self.slope - self.z
        return step_within(self.parameters, self.z, self.information, gradient)

    @cached_property
    def predicted_gain(self) -> float:
        """The decrease of the cost by the best step."""
        gradient, step = self.slope - self.z, self.best_step
        return float(2 * gradient @ step - step @ self.information @ step)

    @property
    def _certain_information(self) -> FloatArray:
        """The information without the part that errors of the derivatives alone may cause."""
        length = np.maximum(np.linalg.norm(self.jacobian, axis=0), 1e-300)
        unit = self.jacobian / length
        known, along = np.linalg.eigh(unit.T @ unit)
        certain = (along * np.maximum(known - len(known) * DERIVATIVE_ERROR**2, 0.0)) @ along.T
        return np.asarray(np.eye(len(self.z)) + certain * np.outer(length, length))

    def covariance(self, frequency_hz: FloatArray, rows: Sequence[slice], same: Sequence[int]) -> FloatArray:
        """Estimate the covariance (p, p) of z: the sandwich over blocks of 5 Hz, never below the inverse information.

        Parameters
        ----------
        frequency_hz : (rows,) of the residual's entries.
        rows : of each observation.
        same : of each observation the one whose motion it repeats: repeats share the model's error.
        """
        bread = np.linalg.inv(self._certain_information)
        meat = np.eye(len(self.z)) + sum(sums.T @ sums for sums in self._slopes(frequency_hz, rows, same))
        wide = np.diag(bread @ meat @ bread) / np.diag(bread)
        wider = np.sqrt(np.maximum(1.0, wide))
        return bread * np.outer(wider, wider)

    def scatter(self, rows: Sequence[slice], same: Sequence[int]) -> FloatArray:
        """Return how far z, (p,), moves as one motion after the other is left out: the jackknife's standard deviation.

        Where an effect's shape is not ours, it is wrong all through a motion, and what fits all of them best is off for
        each. To first order; how far few motions scatter is itself known to Student's t only, which is allowed for
        (Bell & McCaffrey, Survey Methodology 28, 2002). Zero where there is one motion.
        """
        motions = [[part for part, own in zip(rows, same, strict=True) if own == one] for one in sorted(set(same))]
        if len(motions) < 2:
            return np.zeros(len(self.z))
        moved = np.stack([self._without(motion) for motion in motions])
        square = np.sum((moved - moved.mean(axis=0)) ** 2, axis=0) * (len(moved) - 1) / len(moved)
        return np.asarray(student_share(len(moved) - 1) * np.sqrt(square))

    def _without(self, left_out: Sequence[slice]) -> FloatArray:
        """Return the step (p,) from the optimum to the one without some rows, to first order."""
        parts = [self.jacobian[part] for part in left_out]
        slope = sum(j.T @ self.residual[part] for j, part in zip(parts, left_out, strict=True))
        return np.asarray(-np.linalg.solve(self.information - sum(j.T @ j for j in parts), slope))

    def _slopes(self, frequency_hz: FloatArray, rows: Sequence[slice], same: Sequence[int]) -> list[FloatArray]:
        """Return Jᵀr of each motion by blocks of 5 Hz, (blocks, p) each."""
        found: dict[int, FloatArray] = {}
        blocks = int(frequency_hz.max() // BLOCK_HZ) + 1
        for part, motion in zip(rows, same, strict=True):
            block = (frequency_hz[part] // BLOCK_HZ).astype(np.int64)
            sums = found.setdefault(motion, np.zeros((blocks, len(self.z))))
            np.add.at(sums, block, self.jacobian[part] * self.residual[part][:, None])
        return list(found.values())


def student_share(freedom: int) -> float:
    """Return by how much Student's 90 % interval of so many degrees of freedom is wider than the normal one."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.95)) / NINETY_PERCENT


def values_at(parameters: Sequence[Parameter], z: FloatArray) -> dict[str, float]:
    """Return the parameter values by name at z, (p,)."""
    return {n.name: n.start + n.sd * float(x) for n, x in zip(parameters, z, strict=True)}


def limits_of(parameters: Sequence[Parameter]) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest z of the parameters, (p,) each."""
    low = np.array([(n.low - n.start) / n.sd for n in parameters])
    return low, np.array([(n.high - n.start) / n.sd for n in parameters])


def clipped(parameters: Sequence[Parameter], z: FloatArray) -> FloatArray:
    """Move z (p,) inside every parameter's bounds."""
    return np.clip(z, *limits_of(parameters))


def step_within(parameters: Sequence[Parameter], z: FloatArray, normal: FloatArray, gradient: FloatArray) -> FloatArray:
    """Minimise ½ sᵀNs − gᵀs over steps s (p,) from z that stay inside the bounds."""
    low, high = limits_of(parameters)
    return bounded_step(normal, gradient, low - z, high - z)


def derivatives(
    estimation: EstimationProblem,
    parameters: Sequence[Parameter],
    z: FloatArray,
    residual: FloatArray,
    which: Sequence[int],
    central: bool = False,
    sizes: FloatArray | None = None,
    rough: int = 0,
) -> FloatArray:
    """Differentiate the simulation by some of z: (rows, len(which)); see `least_squares.differences`.

    Parameters
    ----------
    rough : the first so many parameters are differentiated in coarse simulations.
    """
    return differences(_batched(estimation, parameters, rough), z, residual, which, central, sizes)


def fit(
    estimation: EstimationProblem,
    parameters: Sequence[Parameter],
    start: FloatArray,
    jacobian: FloatArray | None = None,
    renew: Sequence[int] = (),
    iterations: int = 6,
    small_gain: float = SMALL_GAIN,
    renew_all: bool = True,
    exact: bool = False,
    rough: int = 0,
) -> Fit:
    """Minimise |r|² + |z|² from `start`, (p,); see `derivatives` and `least_squares.minimise_batched`."""
    found = minimise_batched(
        _batched(estimation, parameters, rough),
        start,
        jacobian,
        renew=renew,
        iterations=iterations,
        small_gain=small_gain,
        renew_all=renew_all,
        exact=exact,
    )
    return Fit(tuple(parameters), found.z, found.residual, found.jacobian)


def _batched(estimation: EstimationProblem, parameters: Sequence[Parameter], rough: int = 0) -> BatchedProblem:
    def evaluated(problem: EstimationProblem) -> Callable[[Sequence[FloatArray]], Iterator[FloatArray]]:
        return lambda points: problem.residuals([values_at(parameters, z) for z in points])

    quick = evaluated(replace(estimation, coarse=True)) if rough and not estimation.coarse else None
    return BatchedProblem(evaluated(estimation), *limits_of(parameters), quick, rough)
