"""90 % intervals of fitted parameters, and effects that they show to be nothing."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit
from ffcomp.diagnose.problem import Candidate, Parameter
from ffcomp.identify.uncertainty import NINETY_PERCENT, Estimate


def intervals_of(estimation: EstimationProblem, fitted: Fit, values: Mapping[str, float]) -> dict[str, Estimate]:
    """Put intervals about the values that are reported, as wide as all parameters together leave them."""
    whiten = estimation.whiten
    same = [o.repeat_of for o in whiten.observations]
    covariance = fitted.covariance(whiten.frequencies(), whiten.rows, same)
    sd = np.sqrt(np.diag(covariance))
    return {
        n.name: _interval(n, values.get(n.name, n.start), n.sd * float(s))
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
