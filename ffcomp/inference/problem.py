"""An estimation problem: unknowns with priors and bounds, observations with their noise, and a simulation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.arrays import FloatArray, IntArray

SMALLEST_ERROR, LARGEST_ERROR = 1e-4, 10.0  # of a model, relative
CHANCE = 4.0  # standard deviations of χ²: less is no error of the model


@dataclass(frozen=True)
class Unknown:
    """One number as a fit moves it: of a positive quantity usually its logarithm."""

    name: str
    mean: float = 0.0  # of its normal prior
    sd: float = np.inf  # of its prior; infinite: nothing is known
    low: float = -np.inf
    high: float = np.inf
    step: float = 1e-6  # of differences


@dataclass(frozen=True, eq=False)
class Observation:
    """The measurements of one recording, as rows that a simulation predicts.

    The variance of a row is noise + ε² size: ε is the model's own relative error in this recording. It is estimated
    with the fit, so that the model's accuracy limits the weight of a loud recording.
    """

    measured: FloatArray  # (n,)
    noise: FloatArray  # (n,) variance
    size: FloatArray | None = None  # (n,) the variance that ε = 1 adds; None: noise is all there is
    blocks: IntArray | None = None  # (n,) errors are correlated within a block; None: all rows are independent
    motion: Hashable = None  # recordings of one motion share its errors; None: no other one has this motion

    def variance(self, error: float) -> FloatArray:
        """Return the variance of each row, (n,)."""
        return self.noise if self.size is None else self.noise + error**2 * self.size


def model_error(square: FloatArray, noise: FloatArray, size: FloatArray, unknowns: float) -> float:
    """Find the ε that gives Σ r²/(noise + ε² size) its expected value; 0 where noise explains the residual.

    Parameters
    ----------
    square, noise, size : (n,) r² and the two parts of its variance.
    unknowns : that were fitted to these rows; a share of those that were fitted to more.
    """
    expected = len(square) - unknowns

    def excess(error: float) -> float:
        return float(np.sum(square / (noise + error**2 * size))) - expected

    low, high = SMALLEST_ERROR, LARGEST_ERROR
    if excess(0.0) < CHANCE * np.sqrt(2 * max(expected, 1.0)):
        return 0.0
    for _ in range(40):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return low


class EstimationProblem(ABC):
    """Unknowns, observations, and a simulation of the observations with other values of the unknowns."""

    unknowns: Sequence[Unknown]
    observations: Sequence[Observation]
    expected_cost: float = 0.0  # of noise, which no step takes off

    @abstractmethod
    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        """Simulate all observations with each of several sets of values (p,), in order: (rows,) each.

        Rows that are not finite mark values that cannot be simulated.
        """

    def scatter(self, residual: FloatArray) -> float:
        """Return the scatter of χ² with a residual (rows,), in times that of noise: a gain counts against it."""
        return max(1.0, float(residual @ residual) / len(residual))

    def precision(self, residual: FloatArray) -> FloatArray:
        """Return the prior's precision (p,) next to a residual (rows,); override it to temper the likelihood.

        Times φ, the overdispersion, a prior holds unknowns that hardly matter against the model's error, and falls with
        it (Grünwald & van Ommen, Bayesian Analysis 12, 2017).
        """
        return self.prior[1]

    def by_fidelity(self, columns: Sequence[int]) -> list[tuple[EstimationProblem, Sequence[int]]]:
        """Return problems that take one-sided differences, each with its unknowns; quick ones serve too."""
        return [(self, columns)]

    def whitened(self, simulated: FloatArray, sd: FloatArray) -> FloatArray:
        """Return the residual (rows,) in standard deviations; override it to take out linear nuisance parameters."""
        return (self.measured - simulated) / sd

    def deviations(self, errors: FloatArray) -> FloatArray:
        """Return the standard deviation of each row, (rows,), by the model's error in each observation."""
        each = [o.variance(e) for o, e in zip(self.observations, errors.tolist(), strict=True)]
        return np.sqrt(np.concatenate(each))

    def errors_of(self, residual: FloatArray, together: bool = False) -> FloatArray:
        """Estimate the model's error in each observation, (o,), from the residual (rows,) in its own units.

        Parameters
        ----------
        together : estimate one error for all, as the first round does.
        """
        shown = [o for o in self.observations if o.size is not None]
        used = len(self.unknowns) / max(sum(len(o.measured) for o in shown), 1)
        parts = np.split(residual**2, self.ends[:-1])
        pairs = [(o, part) for o, part in zip(self.observations, parts, strict=True) if o.size is not None]
        if together and pairs:
            noise = np.concatenate([o.noise for o, _ in pairs])
            size = np.concatenate([o.size for o, _ in pairs if o.size is not None])
            square = np.concatenate([part for _, part in pairs])
            return np.full(len(parts), model_error(square, noise, size, used * len(square)))
        return np.array(
            [
                0.0 if o.size is None else model_error(part, o.noise, o.size, used * len(part))
                for o, part in zip(self.observations, parts, strict=True)
            ]
        )

    @cached_property
    def measured(self) -> FloatArray:
        """(rows,) of all observations."""
        return np.concatenate([o.measured for o in self.observations])

    @cached_property
    def ends(self) -> IntArray:
        """(o,) where each observation's rows end."""
        return np.cumsum([len(o.measured) for o in self.observations])

    @cached_property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """The lowest and the highest values, (p,) each."""
        return np.array([u.low for u in self.unknowns]), np.array([u.high for u in self.unknowns])

    @cached_property
    def prior(self) -> tuple[FloatArray, FloatArray]:
        """Mean and precision of each unknown's prior, (p,) each; a precision of zero knows nothing."""
        return np.array([u.mean for u in self.unknowns]), np.array([u.sd**-2.0 for u in self.unknowns])

    def clusters_with(self, errors: FloatArray) -> IntArray:
        """Return the number of each row's cluster, (rows,); −1: it errs by itself, as where noise is all there is."""
        numbers: dict[tuple[Hashable, int], int] = {}
        parts = []
        for i, (o, error) in enumerate(zip(self.observations, errors.tolist(), strict=True)):
            motion = ("own", i) if o.motion is None else ("shared", o.motion)
            alike = o.blocks is not None and (o.size is None or error > 0)
            blocks = o.blocks.tolist() if alike and o.blocks is not None else []
            own = [numbers.setdefault((motion, block), len(numbers)) for block in blocks]
            parts.append(np.array(own or [-1] * len(o.measured), dtype=np.int64))
        return np.concatenate(parts)
