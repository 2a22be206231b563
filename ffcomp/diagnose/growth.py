"""Growth of a hypothesis by one effect, fitted quickly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit, derivatives, fit, values_at
from ffcomp.diagnose.hypotheses import NEAR, Hypothesis, log_fit
from ffcomp.diagnose.initial_fits import FEW, QUICK, Start, predicted_left
from ffcomp.diagnose.progress import Progress

BEHIND = 10.0  # times the best discrepancy: a hypothesis that leaves more in its quick fit is not fitted well


def with_one_more(
    estimation: EstimationProblem, h: Hypothesis, start: Start, progress: Progress, bar: float = np.inf
) -> Hypothesis:
    """Add one effect: fit first the effects together, then all parameters.

    Parameters
    ----------
    bar : smallest discrepancy so far; where even the linear prediction of the second fit stays far above it, that
        fit is left out.
    """
    own = h.own
    parameters = (*h.effect_parameters, *start.parameters)
    given = dict(list(h.fit.values.items())[:own])
    fixed, everything = replace(estimation, given={**estimation.given, **given}), range(len(parameters))
    z = np.concatenate([h.effect_z, start.z])
    columns = derivatives(fixed, parameters, z, fixed.residual(values_at(parameters, z)), everything)
    renew = everything if len(parameters) <= 2 * FEW else ()
    effects = fit(fixed, parameters, z, columns, renew, iterations=5, small_gain=QUICK, renew_all=False)
    both = np.hstack([h.fit.jacobian[:, :own], effects.jacobian])
    z = np.concatenate([h.fit.z[:own], effects.z])
    found = Fit((*h.own_parameters, *parameters), z, effects.residual, both)
    if predicted_left(found) + NEAR < BEHIND * (bar + NEAR):
        found = fit(estimation, found.parameters, z, both, iterations=4, small_gain=QUICK, renew_all=False)
    return log_fit(Hypothesis((*h.effects, *(s.candidate for s in start.chosen)), found), progress)
