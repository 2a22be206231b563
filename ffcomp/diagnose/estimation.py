"""The estimation problem: parameter values in, whitened residual out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ffcomp.diagnose.noise import Whitener
from ffcomp.diagnose.problem import InfeasibleParameters, Problem
from models.arrays import FloatArray

WELL_KNOWN, GUESSED = 0.1, 3.0  # share of the noise to which its floor is known: from repeats, or without any
INFEASIBLE = 1e6  # standard deviations, each entry of the residual of infeasible parameters


@dataclass(frozen=True, eq=False)
class EstimationProblem:
    """A problem with its whitener."""

    problem: Problem
    whiten: Whitener
    measured: FloatArray  # (rows,) whitened
    coarse: bool = False  # quicker simulations
    given: Mapping[str, float] = field(default_factory=dict)  # values of parameters that are not fitted
    tolerance: float = WELL_KNOWN  # of the noise: a smaller discrepancy counts as none

    def residual(self, values: Mapping[str, float]) -> FloatArray:
        """Return measured − simulated, whitened: (rows,)."""
        return next(self.residuals([values]))

    def residuals(self, many: Sequence[Mapping[str, float]]) -> Iterator[FloatArray]:
        """Evaluate several sets of values, in order."""
        for simulated in self.problem.simulate_many([{**self.given, **v} for v in many], coarse=self.coarse):
            if isinstance(simulated, InfeasibleParameters):
                yield np.full(len(self.measured), INFEASIBLE)
            else:
                residual = self.measured - self.whiten(simulated)
                yield residual if np.isfinite(residual @ residual) else np.full(len(self.measured), INFEASIBLE)

    def rows_of(self, observations: Sequence[int]) -> FloatArray:
        """Return the indices of the rows of some observations."""
        return np.concatenate([np.arange(len(self.measured))[self.whiten.rows[i]] for i in observations])


def estimation_problem(problem: Problem, whiten: Whitener) -> EstimationProblem:
    """Whiten the measurements; the tolerance follows from how well the noise is known."""
    tolerance = WELL_KNOWN if whiten.floor.from_repeats else GUESSED
    return EstimationProblem(problem, whiten, whiten([o.measured for o in problem.observations]), tolerance=tolerance)
