"""Parsimony: fewer effects, fewer parameters, fewer retuned ones, where more are not significant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit, fit
from ffcomp.diagnose.hypotheses import NEAR, SIGNIFICANT, Hypothesis, likeliest, misfit, significant
from ffcomp.diagnose.initial_fits import FEW
from ffcomp.diagnose.problem import Candidate
from ffcomp.diagnose.progress import Progress
from ffcomp.diagnose.refinement import refine
from models.arrays import FloatArray


def simplest(best: Hypothesis, tried: Sequence[Hypothesis], candidates: Sequence[Candidate]) -> Hypothesis:
    """Prefer fewer effects, or fewer parameters, where more are not significant."""
    fewer = [h for h in tried if _smaller(h, best, candidates)]
    return next((h for h in likeliest(fewer) if not significant(best.fit, h.fit)), best)


def _smaller(h: Hypothesis, best: Hypothesis, candidates: Sequence[Candidate]) -> bool:
    if h.names == best.names:
        return len(h.fit.parameters) < len(best.fit.parameters)
    if len(h.effects) == len(best.effects):
        return _needed(h, candidates) < _needed(best, candidates)
    return set(h.names) < set(best.names)


def _needed(h: Hypothesis, candidates: Sequence[Candidate]) -> int:
    """Count the parameters without which there are no such effects.

    Of two effects that need as many, the likelier one is better: how far the shape of either was set free is no
    reason to prefer the other.
    """
    return sum(len(c.parameters) for c in candidates if c.name in h.names)


def most_parsimonious(
    estimation: EstimationProblem, best: Hypothesis, tried: Sequence[Hypothesis], progress: Progress
) -> Hypothesis:
    """Prefer another hypothesis with as many effects and fewer parameters, if it is as good once it is refined."""
    for h in smaller_rivals(best, tried, estimation.problem.candidates)[:1]:
        found = refine(estimation, h, progress)
        if not significant(best.fit, found.fit):
            return found
    return best


def smaller_rivals(best: Hypothesis, tried: Sequence[Hypothesis], candidates: Sequence[Candidate]) -> list[Hypothesis]:
    """List hypotheses of other effects, as many, with fewer parameters, that leave as little; the likeliest first."""
    competing = [h for h in tried if h.names != best.names and len(h.effects) == len(best.effects)]
    fewer = [h for h in competing if _smaller(h, best, candidates)]
    return likeliest([h for h in fewer if h.discrepancy < best.discrepancy + NEAR])


def predicted_without(h: Hypothesis, effect: Candidate) -> Fit:
    """Predict the fit of a hypothesis without one of its effects, to first order."""
    keep = [i for i, n in enumerate(h.fit.parameters) if n not in effect.parameters]
    columns, target = h.fit.jacobian[:, keep], h.fit.residual + h.fit.jacobian @ h.fit.z
    z = np.asarray(np.linalg.solve(np.eye(len(keep)) + columns.T @ columns, columns.T @ target), dtype=np.float64)
    parameters = tuple(h.fit.parameters[i] for i in keep)
    return Fit(parameters, z, target - columns @ z, columns)


def parsimonious_fit(estimation: EstimationProblem, h: Hypothesis) -> Fit:
    """Retune only those of the machine's parameters that the data ask for, one after the other.

    Parameters and effects that are nearly confounded share an error of the data among them. If the file is right,
    this gives it all to the effect.
    """
    own = h.own
    chosen, scale = list(range(own, len(h.fit.parameters))), misfit(h.fit)
    target = h.fit.residual + h.fit.jacobian @ h.fit.z
    normal, slope = h.fit.jacobian.T @ h.fit.jacobian, h.fit.jacobian.T @ target
    for _ in range(own):
        before = _evidence(normal, slope, chosen, scale)
        trials = [(_evidence(normal, slope, [*chosen, i], scale), i) for i in range(own) if i not in chosen]
        if min(trials)[0] > before - SIGNIFICANT:
            break
        chosen.append(min(trials)[1])
    keep = sorted(chosen)
    z = np.asarray(np.linalg.solve(np.eye(len(keep)) + normal[np.ix_(keep, keep)], slope[keep]))
    parameters, renew = [h.fit.parameters[i] for i in keep], range(len(keep)) if len(keep) <= FEW else ()
    found = fit(estimation, parameters, z, h.fit.jacobian[:, keep], renew, iterations=4)
    # where the file is far off, the way there is not linear: then all parameters stay as they were fitted
    return found if found.cost - h.fit.cost < SIGNIFICANT * scale * (own + 1) else h.fit


def _evidence(normal: FloatArray, slope: FloatArray, chosen: Sequence[int], scale: float) -> float:
    information = np.eye(len(chosen)) + normal[np.ix_(chosen, chosen)]
    gained = slope[chosen] @ np.linalg.solve(information, slope[chosen])
    return float(-gained / scale + np.linalg.slogdet(information)[1])
