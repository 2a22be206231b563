"""Fits that move between all recordings and an excerpt, which knows no delays of those that it leaves out."""

from __future__ import annotations

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit, derivatives
from ffcomp.diagnose.hypotheses import Hypothesis
from ffcomp.diagnose.problem import Problem


def in_excerpt(part: EstimationProblem, fitted: Fit) -> Fit:
    """Take a fit of the machine's own parameters over to an excerpt, with the derivatives there."""
    known = {n.name for n in part.problem.parameters}
    keep = [i for i, n in enumerate(fitted.parameters) if n.name in known]
    parameters, z = tuple(fitted.parameters[i] for i in keep), fitted.z[keep]
    residual = part.residual({n.name: fitted.values[n.name] for n in parameters})
    return Fit(parameters, z, residual, derivatives(part, parameters, z, residual, range(len(z))))


def in_whole(problem: Problem, h: Hypothesis) -> Hypothesis:
    """Give a hypothesis all of a problem's own parameters, those that it had none of as they are in the file.

    What is left and the derivatives have to be computed anew.
    """
    fitted = {n.name: (n, float(z)) for n, z in zip(h.own_parameters, h.fit.z, strict=False)}
    own = [fitted.get(n.name, (n, 0.0)) for n in problem.parameters]
    parameters = (*(n for n, _ in own), *h.effect_parameters)
    z = np.array([*(x for _, x in own), *h.effect_z])
    return Hypothesis(h.effects, Fit(parameters, z, h.fit.residual, np.zeros((len(h.fit.residual), len(z)))))
