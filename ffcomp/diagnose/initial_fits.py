"""Initial fits: from each promising candidate, at its most helpful start, to a hypothesis fitted quickly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit, clipped, derivatives, fit, values_at
from ffcomp.diagnose.glimpse import glimpse_of
from ffcomp.diagnose.hypotheses import (
    LARGE,
    NEAR,
    Hypothesis,
    comparable,
    discrepancy_of,
    distinct,
    likeliest,
    log_fit,
    log_try,
    within_file,
)
from ffcomp.diagnose.problem import Parameter
from ffcomp.diagnose.progress import Progress
from ffcomp.diagnose.score_test import Screened
from models.arrays import FloatArray

SCALES = (1.0, 0.5, 0.25, 0.1, 0.03, -0.1, -0.5)  # of a linear estimate, and, where that may lead astray,
USUAL = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01, -0.03, -0.1, -0.25, -0.5, -1.0)  # of a usual size
BY_PREDICTION, BY_SIMULATION = 6, 3  # candidates that are fitted: by their linear gain, and by what they really do
QUICK = 1e-2  # share of the cost that must still be gained for another step while hypotheses are ranked
CONTENDER = 30.0  # times the best discrepancy: a hypothesis that leaves more is not pursued
PURSUED = 6  # hypotheses that are fitted a little further, before the likeliest of them are fitted well
FEW = 4  # parameters whose derivatives are renewed at every step


@dataclass(frozen=True, eq=False)
class Start:
    """One or several screened effects, with the amplitudes and shapes to begin at."""

    chosen: tuple[Screened, ...]
    z: FloatArray
    cost: float  # |r|² with everything else as it was

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Of all chosen effects."""
        return tuple(n for s in self.chosen for n in s.candidate.parameters)


def initial_fits(
    estimation: EstimationProblem, bases: Sequence[tuple[Fit, Sequence[Screened]]], progress: Progress
) -> list[Hypothesis]:
    """Fit the promising candidates quickly, from every base; one hypothesis a candidate, the likeliest first.

    Parameters
    ----------
    bases : fits of the machine's parameters to begin at, each with its screened candidates.
    """
    quick = replace(estimation, coarse=True)
    found: list[Hypothesis] = []
    for base, screened in bases:
        for start in select_starts(quick, base, screened, discrepancy_of(base) > LARGE):
            if found and not estimation.problem.work.allows():
                break
            bar = min((h.discrepancy for h in found), default=np.inf)
            found.append(fit_start(quick, base, start, progress, bar))
    ranked = distinct(likeliest(found))
    held = [h for h in ranked if within_file(h)]  # what bends the file's numbers is no measure for what does not
    near = [*ranked[:PURSUED], *held[:1]]
    return likeliest([_pursued(quick, h, held[0] if h in held else ranked[0]) if h in near else h for h in ranked])


def _pursued(estimation: EstimationProblem, h: Hypothesis, best: Hypothesis) -> Hypothesis:
    """Take a few steps more with a contender."""
    if not comparable(h, best, CONTENDER):
        return h
    fitted = fit(estimation, h.fit.parameters, h.fit.z, h.fit.jacobian, iterations=6, small_gain=QUICK, renew_all=False)
    return Hypothesis(h.effects, fitted)


def select_starts(estimation: EstimationProblem, base: Fit, screened: Sequence[Screened], large: bool) -> list[Start]:
    """Select the candidates with the best prediction; where the discrepancy is large, also by simulation."""
    seen = [s for s in screened if s.visible]
    if not large:
        return [best_start(estimation, base, (s,)) for s in seen[:BY_PREDICTION]]
    first, others = (
        [best_start(estimation, base, (s,), SCALES[:4], USUAL) for s in x]
        for x in (seen[:BY_PREDICTION], seen[BY_PREDICTION:])
    )
    helpful = sorted([*first, *others], key=lambda start: start.cost)[:BY_SIMULATION]
    return [*(start for start in helpful if start in others), *first]


def best_start(
    estimation: EstimationProblem,
    base: Fit,
    chosen: tuple[Screened, ...],
    scales: Sequence[float] = SCALES,
    usual: Sequence[float] = (),
) -> Start:
    """Begin at the fraction of the linear estimates, or of a usual size, that really helps most."""
    parameters = tuple(n for s in chosen for n in s.candidate.parameters)
    begun = [np.concatenate([_estimated(s, scale) for s in chosen]) for scale in scales]
    begun += [np.concatenate([_usual(s, size) for s in chosen]) for size in usual]
    tries = [clipped(parameters, z) for z in begun]
    different = [z for i, z in enumerate(tries) if not any(np.array_equal(z, before) for before in tries[:i])]
    seen = glimpse_of(estimation, base)
    if seen is None:
        costs = _costs(estimation, base, parameters, different)
        return Start(chosen, different[int(np.argmin(costs))], min(costs))
    best = different[int(np.argmin(_costs(seen.estimation, base, parameters, different)))]
    return Start(chosen, best, *_costs(estimation, base, parameters, [best]))


def _costs(
    estimation: EstimationProblem, base: Fit, parameters: Sequence[Parameter], tries: Sequence[FloatArray]
) -> list[float]:
    """Return |r|² at each of these z, with the machine's parameters fixed as they stand in a fit."""
    residuals = with_machine_fixed(estimation, base).residuals([values_at(parameters, z) for z in tries])
    return [float(r @ r) for r in residuals]


def with_machine_fixed(estimation: EstimationProblem, base: Fit) -> EstimationProblem:
    """Fix the machine's parameters as they stand in a fit."""
    return replace(estimation, given={**estimation.given, **base.values})


def fit_start(
    estimation: EstimationProblem, base: Fit, start: Start, progress: Progress, bar: float = np.inf
) -> Hypothesis:
    """Fit the effects alone, then all parameters: what an effect explains by itself needs no retuning.

    Parameters
    ----------
    bar : smallest discrepancy so far; where even the linear prediction of the second fit stays far above it, that
        fit is left out.
    """
    log_try([s.candidate for s in start.chosen], progress)
    fixed, everything = with_machine_fixed(estimation, base), range(len(start.parameters))
    residual = fixed.residual(values_at(start.parameters, start.z))
    columns = derivatives(fixed, start.parameters, start.z, residual, everything)
    renew = everything if len(start.parameters) <= FEW else ()
    alone = fit(fixed, start.parameters, start.z, columns, renew, 5, small_gain=QUICK, renew_all=False)
    both = np.hstack([base.jacobian, alone.jacobian])
    found = Fit((*base.parameters, *start.parameters), np.concatenate([base.z, alone.z]), alone.residual, both)
    if predicted_left(found) + NEAR < CONTENDER * (bar + NEAR):
        found = fit(estimation, found.parameters, found.z, both, iterations=3, small_gain=QUICK, renew_all=False)
    return log_fit(Hypothesis(tuple(s.candidate for s in start.chosen), found), progress)


def predicted_left(fitted: Fit) -> float:
    """Predict the discrepancy that the best step from a fit would leave if the simulation were linear."""
    return (fitted.cost - fitted.predicted_gain) / len(fitted.residual) - 1


def _estimated(s: Screened, scale: float = 1.0) -> FloatArray:
    """Begin at the linear estimates of the amplitudes, kept within what is usual, and at the shapes as screened."""
    if s.candidate.switch:
        return np.ones(1)
    return np.concatenate([scale * np.clip(s.estimate, -2.0, 2.0), _shapes(s)])


def _usual(s: Screened, size: float) -> FloatArray:
    return np.concatenate([np.full(len(s.candidate.amplitudes), 1.0 if s.candidate.switch else size), _shapes(s)])


def _shapes(s: Screened) -> FloatArray:
    return np.array([(s.shape.get(n.name, n.start) - n.start) / n.sd for n in s.candidate.shapes])
