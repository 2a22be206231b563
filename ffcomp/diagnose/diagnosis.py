"""The diagnosis, stage by stage: problem, residual, candidates, fits, selection, acceptance.

A discrepancy is what neither noise nor retuning within reach of the stated uncertainties explains. An effect is named
only if its hypothesis passes every acceptance test:

    there is a discrepancy · the effect is significant · little of the discrepancy is left · little is left at every
    position that was left out of the fit · its interval excludes no effect, and its value is feasible

Otherwise the verdict is `unknown`: an unexplained discrepancy is never reported as none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.diagnose.acceptance import HeldOut, hold_out, rejections
from ffcomp.diagnose.confounding import competing_with, confounded_with
from ffcomp.diagnose.estimation import EstimationProblem, estimation_problem
from ffcomp.diagnose.fit import Fit, derivatives, fit
from ffcomp.diagnose.hypotheses import LARGE, Hypothesis, Progress, discrepancy_of, implausible, likeliest, significant
from ffcomp.diagnose.intervals import intervals_of
from ffcomp.diagnose.noise import NoiseFloor, noise_from_repeats, noise_from_residual, whitener
from ffcomp.diagnose.parsimony import parsimonious_fit
from ffcomp.diagnose.problem import Problem
from ffcomp.diagnose.score_test import Screened, screen
from ffcomp.diagnose.selection import Search, Selection, select
from ffcomp.identify.uncertainty import Estimate
from models.arrays import FloatArray

EXISTS = 0.05  # the share of the noise by which a discrepancy must stand above it, or
CERTAIN = 4.0  # standard deviations of what short recordings and few repeats may seem to show
PROMISING = 30.0  # −2 ln Z that a candidate must promise, where the discrepancy is smaller than that


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The verdict, and everything it rests on."""

    verdict: str  # "effects", "none" or "unknown"
    named: Hypothesis | None  # the effects of an `effects` verdict
    best: Hypothesis | None  # the best that was tried, whatever the verdict
    base: Fit  # the machine's own parameters alone
    final: Fit  # of the best: only the parameters that the data ask for retuned; else the base
    estimation: EstimationProblem
    noise: NoiseFloor
    screened: Sequence[Screened]
    tried: Sequence[Hypothesis] = ()  # the likeliest first
    competing: Sequence[Hypothesis] = ()  # as likely as the best
    held_out: Sequence[HeldOut] = ()
    rejections: tuple[str, ...] = ()  # acceptance tests that the best hypothesis failed, in words
    intervals: Mapping[str, Estimate] = field(default_factory=dict)  # of all parameters of the best hypothesis

    @property
    def invisible(self) -> list[str]:
        """Effects of which these recordings could not show a usual size."""
        return [s.candidate.name for s in self.screened if not s.visible]

    @property
    def confounded(self) -> list[str]:
        """Other effects that it could be: as likely, or confounded to first order."""
        if self.best is None:
            return []
        likely = [name for h in self.competing for name in h.names if name not in self.best.names]
        return list(dict.fromkeys([*likely, *(name for name, _ in confounded_with(self.best, self.screened))]))


def diagnose(problem: Problem, progress: Progress = lambda _: None) -> Diagnosis:
    """Find the effects that are missing from the problem's machine, if any."""
    noise = noise_floor(problem)
    if not noise.from_repeats:
        progress("no repeats: the noise floor is taken from above the model's band")
    estimation = estimation_problem(problem, whitener(problem.observations, noise, problem.band_hz))
    chance = CERTAIN * _spread(estimation) if noise.from_repeats else 0.0
    estimation = replace(estimation, tolerance=max(estimation.tolerance, chance))
    least = max(EXISTS, chance) if noise.from_repeats else estimation.tolerance
    progress("fitting the machine's own parameters")
    filed = _as_filed(estimation)
    base = fit(estimation, filed.parameters, filed.z, filed.jacobian, iterations=12)
    progress(f"left after retuning: {discrepancy_of(base):+.3f} of the noise")
    progress(f"screening {len(problem.candidates)} effects")
    screened = screen(replace(estimation, coarse=True), base, list(problem.candidates))
    none = Diagnosis("none", None, None, base, base, estimation, noise, screened)
    small = discrepancy_of(base) < least
    if small and not implausible(base) and (not screened or screened[0].evidence > -PROMISING):
        return none
    bases = _bases(estimation, filed, base, screened, small)
    selection = select(Search(estimation, bases, base, progress))
    retuned = _retuned(estimation, selection.best)
    if discrepancy_of(retuned) < least and not significant(selection.best.fit, retuned, 0.0):
        return replace(none, base=retuned, final=retuned)
    tested = _tested(none, selection)
    # where there was hardly a discrepancy, an effect that fails a test leaves nothing unexplained
    return none if small and tested.rejections else tested


def noise_floor(problem: Problem, simulated: Sequence[FloatArray] | None = None) -> NoiseFloor:
    """Take the noise from repeats; without any, from what is left above the model's band.

    Parameters
    ----------
    simulated : (n, m) an observation with the file as it is, if it is known already.
    """
    floor = noise_from_repeats(problem.observations)
    if floor is not None:
        return floor
    found = problem.simulate({}) if simulated is None else simulated
    errors = [o.measured - y for o, y in zip(problem.observations, found, strict=True)]
    return noise_from_residual(problem.observations, errors, problem.band_hz)


def _spread(estimation: EstimationProblem) -> float:
    """Compute the standard deviation of a discrepancy of zero: of the residual's mean square, and of its floor."""
    observations, rows = estimation.whiten.observations, estimation.whiten.rows
    repeats = [sum(a.repeat_of == b.repeat_of for b in observations) for a in observations]
    apart = sum((part.stop - part.start) * (1 - 1 / n) for part, n in zip(rows, repeats, strict=True))
    return float(np.sqrt(2 / len(estimation.measured) + 2 / apart))


def _as_filed(estimation: EstimationProblem) -> Fit:
    """Return the machine file as it is, with the derivatives there."""
    parameters = tuple(estimation.problem.parameters)
    z = np.zeros(len(parameters))
    residual = estimation.residual({})
    return Fit(parameters, z, residual, derivatives(estimation, parameters, z, residual, range(len(z))))


def _bases(
    estimation: EstimationProblem, filed: Fit, base: Fit, screened: Sequence[Screened], small: bool
) -> list[tuple[Fit, Sequence[Screened]]]:
    """Select the fits of the machine's parameters to begin the search at, with the candidates screened there.

    The file's own parameters are one of them: with the right effect they need no retuning, and a fit that made them
    implausible to mimic it leads astray; but where they are far off, it is their error that is seen from there.
    """
    if small and not implausible(base):
        return [(base, screened)]
    from_file = (filed, screen(replace(estimation, coarse=True), filed, list(estimation.problem.candidates)))
    if implausible(base) and discrepancy_of(base) < LARGE:
        return [from_file]  # implausible parameters explain all: with them every effect looks as good
    return [from_file, (base, screened)]


def _retuned(estimation: EstimationProblem, best: Hypothesis) -> Fit:
    """Fit the machine's parameters alone, from where the best hypothesis took them: perhaps they need no effect."""
    own = best.own
    return fit(estimation, best.own_parameters, best.fit.z[:own], best.fit.jacobian[:, :own], iterations=4)


def _tested(none: Diagnosis, selection: Selection) -> Diagnosis:
    """Put the best hypothesis to the acceptance tests."""
    best, estimation = selection.best, none.estimation
    final = parsimonious_fit(estimation, best)
    intervals = intervals_of(estimation, best.fit, final.values)
    held_out = hold_out(estimation, none.base, best.fit)
    failed = tuple(rejections(none.base, best, held_out, intervals, estimation.tolerance))
    ranked = likeliest([best, *(h for h in selection.tried if h.names != best.names)])
    return replace(
        none,
        verdict="unknown" if failed else "effects",
        named=None if failed else best,
        best=best,
        final=final,
        tried=ranked,
        competing=competing_with(best, ranked),
        held_out=held_out,
        rejections=failed,
        intervals=intervals,
    )
