"""Fits of a hypothesis: full ones, exact ones, and the step from an excerpt to all recordings.

full      until a step promises little, kinks at full sharpness
exact     with central differences: confounded parameters cancel only in those
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ffcomp.diagnosis.fit import MOST_STEPS, SMALL_GAIN, EstimationProblem, Fit, clipped, derivatives, fit, values_at
from ffcomp.diagnosis.hypotheses import Hypothesis, log_fit, log_try
from ffcomp.diagnosis.problem import Parameter
from ffcomp.numerics.stages import Progress
from models.arrays import FloatArray

QUICK_GAIN = 1e-2  # of the excess over noise, that another step must promise while hypotheses are ranked
RENEWED = 4  # parameters, up to which their derivatives are renewed at every step
LARGE = 1.0  # noise power: from this discrepancy effects may be too strong to be linear

# ---- full fits -----------------------------------------------------------------------------------


def continue_fit(
    estimation: EstimationProblem, h: Hypothesis, progress: Progress, note: str = "", known: FloatArray | None = None
) -> Hypothesis:
    """Continue a fit with new derivatives and every kink at full sharpness.

    Parameters
    ----------
    known : (rows, machine_count) derivatives by the machine's parameters, where they are known well enough.
    """
    log_try(h.effects, progress, note)
    every, machine = range(len(h.fit.parameters)), h.machine_count
    ranked, residual = quickest(estimation, h.fit.values)
    which = every if known is None else every[-h.effect_count :]
    columns = derivatives(ranked, h.fit.parameters, h.fit.z, residual, which, rough=machine)
    if known is not None:
        columns = np.hstack([known, columns])
    renew = every[-h.effect_count :] if h.effect_count <= RENEWED else ()
    fitted = _fit_quickly(estimation, h.fit.parameters, h.fit.z, columns, renew, MOST_STEPS, QUICK_GAIN, rough=machine)
    return log_fit(estimation, Hypothesis(h.effects, fitted), progress, note)


def _fit_quickly(
    estimation: EstimationProblem,
    parameters: Sequence[Parameter],
    start: FloatArray,
    jacobian: FloatArray,
    renew: Sequence[int],
    iterations: int,
    small_gain: float = SMALL_GAIN,
    rough: int = 0,
    exact: bool = False,
    little: float = -1.0,
) -> Fit:
    """Fit coarsely where the error of coarse steps is negligible and the discrepancy exceeds `little`; see `fit`."""
    ranked, _ = quickest(estimation, values_at(parameters, clipped(parameters, start)), little)
    fitted = fit(ranked, parameters, start, jacobian, renew, iterations, small_gain, exact=exact, rough=rough)
    if ranked is estimation:
        return fitted
    z, jacobian = fitted.z, fitted.jacobian
    if quickest(estimation, fitted.values, little)[0] is estimation:
        return fit(estimation, parameters, z, jacobian, renew, iterations, small_gain, exact=exact, rough=rough)
    return replace(fitted, residual=estimation.residual(fitted.values))


def quickest(
    estimation: EstimationProblem, values: Mapping[str, float], little: float = -1.0
) -> tuple[EstimationProblem, FloatArray]:
    """Return the problem, coarse where the error of coarse steps is negligible against the residual, and its residual.

    Parameters
    ----------
    little : discrepancy up to which it is not coarse.
    """
    residual = estimation.residual(values)
    if estimation.coarse or float(residual @ residual) < (1 + little) * len(residual):
        return estimation, residual
    quick = replace(estimation, coarse=True)
    roughly = quick.residual(values)
    error = roughly - residual
    negligible = float(error @ error) < estimation.settings.coarse_error * float(residual @ residual)
    return (quick, roughly) if negligible else (estimation, residual)


def fit_exactly(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit with exact derivatives: confounded parameters cancel only in those."""
    if h.exact:
        return h
    log_try(h.effects, progress, " with exact derivatives")
    fitted = _fit_quickly(estimation, h.fit.parameters, h.fit.z, h.fit.jacobian, (), 5, exact=True, little=LARGE)
    return log_fit(estimation, Hypothesis(h.effects, fitted, exact=True), progress, " at the end")


# ---- excerpts ------------------------------------------------------------------------------------


def excerpt_of(estimation: EstimationProblem, discrepancy: float) -> EstimationProblem | None:
    """Return the problem on an excerpt of its data that shows such a discrepancy, of the noise, as surely.

    None where the discrepancy is too small for that, or there is no excerpt.
    """
    information = discrepancy * len(estimation.measured)
    if discrepancy < 2 * estimation.tolerance or information < estimation.settings.excerpt_information:
        return None
    problem = estimation.problem.excerpt()
    if problem is None:
        return None
    part = estimation.on_part(problem)
    return None if part.share * information < estimation.settings.excerpt_information else part


def fit_in_excerpt(part: EstimationProblem, fitted: Fit) -> Fit:
    """Fit the machine's parameters to an excerpt, which knows no delays of recordings that it omits."""
    known = {n.name for n in part.problem.parameters}
    keep = [i for i, n in enumerate(fitted.parameters) if n.name in known]
    begun = linearised(part, tuple(fitted.parameters[i] for i in keep), fitted.z[keep])
    return fit(part, begun.parameters, begun.z, begun.jacobian)


def linearised(estimation: EstimationProblem, parameters: Sequence[Parameter], z: FloatArray) -> Fit:
    """Return the fit at z, (p,), with the derivatives there."""
    residual = estimation.residual(values_at(parameters, z))
    jacobian = derivatives(estimation, parameters, z, residual, range(len(z)))
    return Fit(tuple(parameters), z, residual, jacobian, estimation.block_rows)


def fit_in_whole(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit to all data what was fitted to an excerpt; parameters that the excerpt lacked begin at the file's values."""
    note = ", on all data"
    log_try(h.effects, progress, note)
    fitted = {n.name: (n, float(z)) for n, z in zip(h.machine_parameters, h.fit.z, strict=False)}
    machine = [fitted.get(n.name, (n, 0.0)) for n in estimation.problem.parameters]
    parameters = (*(n for n, _ in machine), *h.effect_parameters)
    z = np.array([*(x for _, x in machine), *h.fit.z[h.machine_count :]])
    whole = fit(estimation, parameters, z, iterations=5, renew_all=False, exact=True)
    return log_fit(estimation, Hypothesis(h.effects, whole, exact=True), progress, note)
