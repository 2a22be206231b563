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

from ffcomp.diagnose.acceptance import out_of_reach, rejections, unproven
from ffcomp.diagnose.confounding import competing_with, confounded_with
from ffcomp.diagnose.estimation import EstimationProblem, estimation_problem, excerpt_of
from ffcomp.diagnose.excerpt_fits import in_excerpt
from ffcomp.diagnose.fit import Fit, derivatives, fit
from ffcomp.diagnose.held_out import HeldOut, hold_out
from ffcomp.diagnose.hypotheses import (
    LARGE,
    OWN_NUMBERS,
    Hypothesis,
    discrepancy_of,
    implausible,
    likeliest,
    misfit,
    significant,
)
from ffcomp.diagnose.initial_fits import predicted_left
from ffcomp.diagnose.intervals import intervals_of
from ffcomp.diagnose.noise import (
    NoiseFloor,
    at_least,
    noise_from_repeats,
    noise_from_residual,
    noise_of_sensors,
    noise_share,
    scaled,
    whitener,
)
from ffcomp.diagnose.parsimony import parsimonious_fit
from ffcomp.diagnose.problem import Parameter, Problem
from ffcomp.diagnose.progress import Progress, Stage
from ffcomp.diagnose.recording_delays import belongs_to_recording
from ffcomp.diagnose.recording_faults import Fault, fault_of_recordings, odd_signal
from ffcomp.diagnose.refinement import within_reach
from ffcomp.diagnose.score_test import Screened, screen
from ffcomp.diagnose.selection import LITTLE, Search, Selection, find_best, finish, on_all_data
from ffcomp.diagnose.work import BUDGET
from ffcomp.identify.uncertainty import Estimate
from models.arrays import FloatArray

TOO_LOUD = 0.1  # of the signals: with more noise, nothing found is not nothing there
WRONG_FLOOR = -0.5  # discrepancy, of the noise: with less left than that, the floor is wrong
MOSTLY = 0.9  # of the discrepancy, from which an explanation that failed a test is worth saying
LOOSER = 5.0  # times the file's uncertainties
LOOSELY = 1.5  # times the square that the named effects leave: the file's numbers alone explain as much
EXISTS = 0.05  # the share of the noise by which a discrepancy must stand above it, or
CERTAIN = 4.0  # standard deviations of what short recordings and few repeats may seem to show
PROMISING = 30.0  # −2 ln Z that a candidate must promise, where the discrepancy is smaller than that


FINDINGS = {
    "effects": "effects are named",
    "nothing": "nothing is missing",
    "cannot_tell": "the noise is too loud, or its floor is wrong, to say that nothing is missing",
    "unproven": "one explanation holds most of the discrepancy, but failed a test",
    "unexplained": "there is a discrepancy, and nothing known explains it",
    "recording": "the recordings are at fault: an input shaper, a sensor",
}


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
    finding: str = "nothing"  # more closely: see FINDINGS
    fault: Fault | None = None  # of the recordings
    file_off: Fit | None = (
        None  # the machine's numbers alone, far beyond their uncertainties, where they explain as much
    )
    searched: Hypothesis | None = None  # the best, on the data on which the others were tried
    share: float = 1.0  # of the data on which they were
    cut_short: bool = False  # the search ended at its budget, so that not everything was tried

    @property
    def unproven(self) -> list[HeldOut]:
        """What was left out of the fit, and is not explained there."""
        return [] if self.best is None else unproven(self.held_out, self.estimation.tolerance)

    def behind(self, h: Hypothesis) -> float:
        """Return by how much −2 ln Z of all data a hypothesis that was tried is less likely than the best."""
        best = self.searched or self.best
        return 0.0 if best is None else (h.fit.evidence - best.fit.evidence) / self.share

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


def diagnose(problem: Problem, progress: Progress = lambda _: None, budget: float = BUDGET) -> Diagnosis:
    """Find the effects that are missing from the problem's machine, if any.

    Parameters
    ----------
    budget : integration steps after which nothing more is tried; what was found by then is put to the tests.
    """
    problem.work.begin(budget)
    found = _searched(problem, noise_floor(problem), problem.least_density, progress)
    guessed = not found.noise.from_repeats and found.fault is None
    if guessed and found.estimation.whiten.floor is found.noise and _floor_is_wrong(found):
        progress("less is left than the guessed noise: what is left is taken for it, and the search begins anew")
        problem.work.begin(budget)
        found = _searched(problem, scaled(found.noise, _left(found)), {}, progress)
    return replace(_concluded(found), cut_short=problem.work.cut)


def _searched(problem: Problem, noise: NoiseFloor, density: Mapping[str, float], progress: Progress) -> Diagnosis:
    progress(Stage(1, "estimating the noise"))
    if not noise.from_repeats:
        progress("no repeats: the noise floor is taken from above the model's band")
    floor = at_least(noise, problem.observations, problem.band_hz, density)
    estimation = estimation_problem(problem, whitener(problem.observations, floor, problem.band_hz))
    chance = CERTAIN * _spread(estimation) if noise.from_repeats else 0.0
    estimation = replace(estimation, tolerance=max(estimation.tolerance, chance))
    least = max(EXISTS, chance) if noise.from_repeats else estimation.tolerance
    progress(Stage(2, "fitting the machine's own parameters"))
    filed = _as_filed(estimation)
    base = _ended(estimation, fit(estimation, filed.parameters, filed.z, filed.jacobian, iterations=12), least)
    times = float(np.sqrt(max(1.0 + discrepancy_of(base), 0.0)))
    progress(f"the machine's own parameters alone: the error that is left is {times:.4g} times the noise")
    fault = fault_of_recordings(estimation, problem.simulate({}), base)
    if fault is not None:
        return Diagnosis("unknown", None, None, base, base, estimation, noise, [], finding="recording", fault=fault)
    small = discrepancy_of(base) < least
    found = None if small else _in_excerpt(estimation, base, progress)
    if found is None:
        progress(Stage(3, f"screening {len(problem.candidates)} effects"))
        screened = screen(replace(estimation, coarse=True), base, list(problem.candidates))
        if small and not implausible(base) and (not screened or screened[0].evidence > -PROMISING):
            return Diagnosis("none", None, None, base, base, estimation, noise, screened)
        search = Search(estimation, _bases(estimation, filed, base, screened, small), base, progress)
        begun = find_best(search)
        progress(Stage(6, "fitting what was found with exact derivatives"))
        best = finish(search, begun)
        found = _Found(best.best, best, screened)
    none = Diagnosis("none", None, None, base, base, estimation, noise, found.screened)
    selection = found.selection
    progress(Stage(7, "testing it at places that were left out of the fit"))
    retuned = _retuned(estimation, selection.best, least)
    if discrepancy_of(retuned) < least and not _gains(selection.best.fit, retuned, noise):
        return replace(none, base=retuned, final=retuned)
    tested = _tested(none, found, progress)
    # where there was hardly a discrepancy, an effect that fails a test leaves nothing unexplained
    return none if small and tested.rejections else tested


def _gains(best: Fit, retuned: Fit, noise: NoiseFloor) -> bool:
    """Tell whether a hypothesis says more than the machine's own numbers do, where these leave hardly anything.

    By a noise that is only guessed, any number of rows makes the smallest difference significant: there it must take
    a share of what is left.
    """
    if not significant(best, retuned, 0.0):
        return False
    return noise.from_repeats or float(best.chi_squared) < (1 - EXISTS) * float(retuned.chi_squared)


def _concluded(found: Diagnosis) -> Diagnosis:
    """Judge what a search found: never more is said than the noise and what was left out allow."""
    if found.fault is not None:
        return found
    if found.noise.from_repeats and found.estimation.whiten.floor is found.noise and _floor_is_wrong(found):
        return replace(found, verdict="unknown", named=None, finding="cannot_tell")
    if found.verdict == "effects":
        return replace(found, finding="effects", file_off=_file_off(found))
    if found.verdict == "none":
        return _nothing(found)
    explained = found.best is not None and _explained(found.base, found.best) > MOSTLY
    # where an effect explains the gap, though not surely, what one axis does is felt by one signal
    fits = [] if explained else [found.base] if found.best is None else [found.base, found.best.fit]
    fault = odd_signal(found.estimation, fits)
    if fault is not None:
        return replace(found, finding="recording", fault=fault)
    return replace(found, finding="unproven" if explained else "unexplained", file_off=_file_off(found))


def _floor_is_wrong(found: Diagnosis) -> bool:
    return _left(found) - 1 < WRONG_FLOOR


def _left(found: Diagnosis) -> float:
    """Return the mean square of what is left, in units of the noise."""
    return float(found.final.chi_squared) / len(found.final.residual)


def _nothing(found: Diagnosis) -> Diagnosis:
    """Say `none` only where noise leaves room to see something; test what was retuned where it was not fitted."""
    estimation = found.estimation
    if noise_share(estimation.whiten, found.noise) > TOO_LOUD:
        return replace(found, verdict="unknown", finding="cannot_tell")
    return replace(found, held_out=hold_out(estimation, found.base, found.base))


def _explained(base: Fit, best: Hypothesis) -> float:
    """Return the share of the discrepancy that a hypothesis explains beyond retuning."""
    before, left = discrepancy_of(base), best.discrepancy
    return 1 - max(left, 0.0) / before if before > 0 else 0.0


def _file_off(found: Diagnosis) -> Fit | None:
    """Fit the machine's own numbers alone, far beyond what the file allows, where they may be what is wrong.

    A stiffness or a mass may be named because another of the file's numbers is wrong, and where several are, nothing
    known explains it: only its owner knows how well they are known.
    """
    best = found.best
    if best is None or (found.named is not None and not set(found.named.names) <= OWN_NUMBERS):
        return None
    loose = tuple(_loosened(n) for n in found.base.parameters)
    begun = Fit(loose, found.base.z / LOOSER, found.base.residual, found.base.jacobian * LOOSER)
    alone = fit(found.estimation, loose, begun.z, begun.jacobian, iterations=6)
    as_good = alone.chi_squared / len(alone.residual) - 1 < max(
        LOOSELY * best.fit.chi_squared / len(alone.residual) - 1, found.estimation.tolerance
    )
    return alone if as_good else None


def _loosened(n: Parameter) -> Parameter:
    if belongs_to_recording(n.name):
        return n
    low = n.start - LOOSER * (n.start - n.low)
    high = n.start + LOOSER * (n.high - n.start)
    return replace(n, sd=LOOSER * n.sd, low=max(low, 0.05 * n.start) if n.start > 0 else low, high=high)


def noise_floor(problem: Problem, simulated: Sequence[FloatArray] | None = None) -> NoiseFloor:
    """Take the noise from repeats; without any, from what is left above the model's band.

    Parameters
    ----------
    simulated : (n, m) an observation with the file as it is, if it is known already.
    """
    floor = noise_from_repeats(problem.observations)
    if floor is not None:
        return floor
    known = problem.least_density  # of positions: what their sensors and the simulation cannot tell apart
    if known and all(name in known for o in problem.observations for name in o.signals):
        return noise_of_sensors(problem.observations, known)
    found = problem.simulate({}) if simulated is None else simulated
    errors = [o.measured - y for o, y in zip(problem.observations, found, strict=True)]
    above = noise_from_residual(problem.observations, errors, problem.band_hz)
    if not known:
        return above
    sensors = noise_of_sensors(problem.observations, known)
    return replace(sensors, density={**above.density, **{name: sensors.density[name] for name in known}})


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


def _retuned(estimation: EstimationProblem, best: Hypothesis, least: float) -> Fit:
    """Fit the machine's parameters alone, from where the best hypothesis took them: perhaps they need no effect."""
    own = best.own
    found = fit(estimation, best.own_parameters, best.fit.z[:own], best.fit.jacobian[:, :own], iterations=4)
    return _ended(estimation, found, least) if significant(best.fit, found, 0.0) else found


def _ended(estimation: EstimationProblem, fitted: Fit, least: float) -> Fit:
    """Fit the machine's parameters alone to the end, where they leave nothing but are far off to do so.

    Numbers that make up for each other in all that was recorded go far astray on the way, and come back for the price
    of their prior alone; that little is seen with exact derivatives only. An effect is not to be named for it.
    """
    if min(discrepancy_of(fitted), predicted_left(fitted)) > least or not implausible(fitted):
        return fitted
    ended = fit(estimation, fitted.parameters, fitted.z, fitted.jacobian, iterations=10, exact=True)
    return min(fitted, ended, key=lambda each: each.evidence)


@dataclass(frozen=True, eq=False)
class _Found:
    """What a search has found."""

    searched: Hypothesis  # the best, on the data on which the others were tried
    selection: Selection  # the best on all data, and all that were tried
    screened: Sequence[Screened]
    share: float = 1.0  # of the data, on which the others were tried


def _in_excerpt(estimation: EstimationProblem, base: Fit, progress: Progress) -> _Found | None:
    """Search in an excerpt of the recordings and fit what is found to all; None if all is needed for the search."""
    part = excerpt_of(estimation, discrepancy_of(base))
    if part is None:
        return None
    told = (
        f"screening {len(part.problem.candidates)} effects in {100 * part.share:.0f} % of the data, for they stand out"
    )
    progress(Stage(3, told))
    filed = _as_filed(part)
    begun = in_excerpt(part, base)
    retuned = fit(part, begun.parameters, begun.z, begun.jacobian, iterations=6)
    screened = screen(replace(part, coarse=True), retuned, list(part.problem.candidates))
    found = find_best(Search(part, _bases(part, filed, retuned, screened, small=False), retuned, progress))
    progress(Stage(6, "fitting what was found to all data"))
    whole = Search(estimation, (), base, progress)
    best = on_all_data(whole, found)
    if best is None:
        progress("all data show more than the excerpt: the search begins anew in all of it")
        return None
    last = finish(whole, best)
    return _Found(found.best, replace(last, tried=found.tried), screened, part.share)


def _believable(none: Diagnosis, best: Hypothesis, progress: Progress) -> Hypothesis:
    """Hold the file's numbers to what it says of them, where the best hypothesis leaves hardly more with them so.

    In loud data they move to make up for an effect's shape, which is never exactly ours, without being needed.
    """
    if not out_of_reach(best):
        return best
    held = within_reach(none.estimation, best, progress)
    little = max(LITTLE * discrepancy_of(none.base), none.estimation.tolerance)
    return held if held.discrepancy < little else best


def _tested(none: Diagnosis, found: _Found, progress: Progress) -> Diagnosis:
    """Put the best hypothesis to the acceptance tests."""
    searched, estimation = found.searched, none.estimation
    best = _believable(none, found.selection.best, progress)
    final = parsimonious_fit(estimation, best)
    intervals = intervals_of(estimation, best.fit, final.values)
    held_out = hold_out(estimation, none.base, best.fit)
    failed = tuple(rejections(none.base, best, held_out, intervals, estimation.tolerance))
    if best.names != searched.names:  # a smaller rival, or fewer effects
        searched = next((h for h in likeliest(found.selection.tried) if h.names == best.names), searched)
    ranked = likeliest([searched, *(h for h in found.selection.tried if h.names != best.names)])
    return replace(
        none,
        verdict="unknown" if failed else "effects",
        named=None if failed else best,
        best=best,
        final=final,
        searched=searched,
        share=found.share,
        tried=ranked,
        competing=competing_with(searched, ranked, found.share, discrepancy_of(none.base)),
        held_out=held_out,
        rejections=failed,
        # a shape that is not ours is wrong alike in all blocks of frequencies and all motions: Birge's ratio
        # (Physical Review 40, 1932) on top of what they show
        intervals=intervals_of(estimation, best.fit, final.values, True, float(np.sqrt(misfit(best.fit)))),
    )
