"""90 % intervals of fitted parameters, and effects that they show to be nothing."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit
from ffcomp.diagnose.problem import Candidate, Parameter
from ffcomp.identify.uncertainty import NINETY_PERCENT, Estimate


def intervals_of(
    estimation: EstimationProblem, fitted: Fit, values: Mapping[str, float], scatter: bool = False, wider: float = 1.0
) -> dict[str, Estimate]:
    """Put intervals about the values that are reported, as wide as all parameters together leave them.

    Parameters
    ----------
    scatter : at least as wide as the values scatter as one motion after the other is left out. What one motion alone
        shows is not known from the others, and yet it is there: that is no reason to refuse an effect.
    wider : times as wide.
    """
    whiten, same = estimation.whiten, estimation.problem.motions
    sd = np.sqrt(np.diag(fitted.covariance(whiten.frequencies(), whiten.rows, same)))
    if scatter:
        sd = np.maximum(sd, fitted.scatter(whiten.rows, same))
    return {
        n.name: _interval(n, values.get(n.name, n.start), wider * n.sd * float(s))
        for n, s in zip(fitted.parameters, sd, strict=True)
    }


def _interval(n: Parameter, value: float, spread: float) -> Estimate:
    low, high = max(n.low, value - NINETY_PERCENT * spread), min(n.high, value + NINETY_PERCENT * spread)
    return Estimate(value, spread, low, high)


def superfluous(candidate: Candidate, intervals: Mapping[str, Estimate]) -> bool:
    """Tell whether the intervals of an effect include no effect at all."""
    return not candidate.switch and all(_includes(intervals[a.name], a.start) for a in candidate.amplitudes)


def _includes(interval: Estimate, value: float) -> bool:
    return interval.low <= value <= interval.high
