"""The linear least squares of a check: what differs, by its noise, with a delay of each experiment left free."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.check.felt import DEPENDENT, RATE_HZ, Felt
from models.arrays import FloatArray

FROM_DAY_TO_DAY = 0.01  # of the signal: no printer repeats better after it was homed anew

ByExperiment = Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Solution:
    """Columns fitted to a difference."""

    values: FloatArray  # (k,)
    sd: FloatArray  # (k,)
    left: float  # sum of squares


@dataclass(frozen=True, eq=False)
class Weighed:
    """Differences (N + e,), each by its noise, with the priors of the delays below; independent rows count once."""

    difference: FloatArray
    delays: FloatArray  # (N + e, e)
    sigma: Mapping[str, FloatArray]  # (3,) m/s² by experiment

    @property
    def rows(self) -> float:
        """Count the independent rows."""
        return (len(self.difference) - len(self.sigma)) / DEPENDENT

    def column(self, of: ByExperiment) -> FloatArray:
        """Return a signature (N + e,) in the same weights."""
        parts = [(of[name] / sigma).ravel() for name, sigma in self.sigma.items()]
        return np.concatenate([*parts, np.zeros(len(self.sigma))]) / np.sqrt(DEPENDENT)

    def fit(
        self, columns: Sequence[FloatArray], usual: Sequence[float] = (), without: FloatArray | None = None
    ) -> Solution:
        """Fit columns (N + e,) each.

        Parameters
        ----------
        usual : standard deviations of their priors around zero; none: no priors
        without : (N + e,) is taken from the difference before
        """
        k, wanted = len(columns), self.difference if without is None else self.difference - without
        matrix = np.column_stack([*columns, self.delays])
        if usual:
            below = np.hstack([np.diag(1.0 / np.asarray(usual)), np.zeros((k, self.delays.shape[1]))])
            matrix, wanted = np.vstack([matrix, below]), np.concatenate([wanted, np.zeros(k)])
        normal = matrix.T @ matrix
        covariance = np.linalg.pinv(normal, hermitian=True)
        values = np.asarray(np.linalg.lstsq(matrix, wanted, rcond=None)[0], dtype=np.float64)
        left = float(np.sum((wanted - matrix @ values) ** 2))
        return Solution(values[:k], np.asarray(np.sqrt(np.diag(covariance)[:k]), dtype=np.float64), left)


def weighed(pairs: Sequence[tuple[Felt, Felt]]) -> Weighed:
    """Weigh what differs between today and then, in pairs of one experiment."""
    sigma: dict[str, FloatArray] = {}
    differences, slopes, priors = [], [], []
    for today, then in pairs:
        floor = FROM_DAY_TO_DAY * today.size
        own = sigma[today.name] = np.sqrt(today.noise**2 + then.noise**2 + floor**2)
        differences.append(((today.acceleration - then.acceleration) / own).ravel())
        slopes.append((np.gradient(then.acceleration, 1.0 / RATE_HZ, axis=0) / own).ravel())
        priors.append(float(np.hypot(today.clock_sd_s, then.clock_sd_s)))
    count, total = len(pairs), sum(map(len, differences))
    delays, first = np.zeros((total + count, count)), 0
    for k, slope in enumerate(slopes):
        delays[first : first + len(slope), k] = slope / np.sqrt(DEPENDENT)
        delays[total + k, k] = 1.0 / priors[k]
        first += len(slope)
    difference = np.concatenate([*differences, np.zeros(count)]) / np.sqrt(DEPENDENT)
    return Weighed(difference, delays, sigma)
