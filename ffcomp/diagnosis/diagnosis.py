"""The diagnosis, stage by stage: problem, residual, candidates, fits, selection, acceptance.

A discrepancy is what neither noise nor retuning within reach of the stated uncertainties explains. Only motions count
that a simulation follows. An effect is named only if its hypothesis passes every acceptance test:

    there is a discrepancy · the effect is significant · little of the discrepancy is left · little is left at every
    position that was left out of the fit · its interval excludes no effect, and the file's numbers are not far off

Otherwise the verdict is `unknown`: an unexplained discrepancy is never reported as none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.diagnosis.acceptance import rejections
from ffcomp.diagnosis.dominance import Dominant, dominant_effect
from ffcomp.diagnosis.fidelity import (
    QUICK_GAIN,
    continue_fit,
    excerpt_of,
    fit_in_excerpt,
    fit_in_whole,
    linearised,
)
from ffcomp.diagnosis.fit import EstimationProblem, Fit, by_deviance, estimation_problem, fit, intervals_of, superfluous
from ffcomp.diagnosis.held_out import HeldOut, hold_out, other_motions
from ffcomp.diagnosis.hypotheses import FILE_CHANGES, Hypothesis, competing_with, error_left, likeliest
from ffcomp.diagnosis.noise import (
    ABOVE,
    NoiseFloor,
    at_least,
    noise_floor,
    noise_share,
    scaled,
    stationary_noise,
    whitener,
)
from ffcomp.diagnosis.problem import Parameter, Problem
from ffcomp.diagnosis.recording_clocks import belongs_to_recording
from ffcomp.diagnosis.recording_faults import Fault, fault_of_recordings, odd_signal
from ffcomp.diagnosis.score_test import Screened, confounded_with, screen
from ffcomp.diagnosis.search import Search, Selection, find_best
from ffcomp.diagnosis.settings import SETTINGS, SearchSettings
from ffcomp.diagnosis.trace import Trace
from ffcomp.identification.uncertainty import Estimate
from ffcomp.numerics.stages import Progress, Stage
from models.arrays import FloatArray

BUDGET_STEPS = 2.4e8  # integration steps of a printer, after which nothing more is tried: 90 s of CPU in 2026
LOOSENED = 5.0  # times the uncertainties, in the fit of the file's numbers that may all be wrong
AS_LOOSE = 1.5  # times the mean square that the effects leave: such a fit explains as much
LEAST_FOLLOWED = 2  # motions that a simulation follows, or all are compared
STATIONARY = 0.25  # noise power: by so much may all windows exceed the quiet ones, of noise
USUAL_S = (1.0, 15.0, 9.0, 11.0, 6.0, 4.0, 6.0)  # of CPU, in each stage of a search that names one effect


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """The verdict, and everything it rests on."""

    verdict: str  # "effects", "none" or "unknown"
    finding: str  # more closely: docs/reference/json.md has what each means
    whole: EstimationProblem  # of all recordings
    estimation: EstimationProblem  # of those that a simulation follows
    noise: NoiseFloor
    base: Fit  # the machine's parameters alone
    final: Fit  # of the best; else the base
    screened: Sequence[Screened] = ()
    named: Hypothesis | None = None  # the effects of an `effects` verdict
    best: Hypothesis | None = None  # the best that was tried, whatever the verdict
    tried: Sequence[Hypothesis] = ()  # the likeliest first
    competing: Sequence[Hypothesis] = ()  # as likely as the best
    searched: Hypothesis | None = None  # the best, on the data on which the others were tried
    share: float = 1.0  # of the data on which they were
    held_out: Sequence[HeldOut] = ()
    others: Sequence[HeldOut] = ()  # motions of an axis, each simulated with what was fitted to the others
    rejections: tuple[str, ...] = ()  # acceptance tests that the best hypothesis failed, in words
    intervals: Mapping[str, Estimate] = field(default_factory=dict)  # of all parameters of the best hypothesis
    fault: Fault | None = None  # of the recordings
    dominant: Dominant | None = None  # the effect that holds most of the discrepancy, and leaves a rest
    file_off: Fit | None = None  # the machine's numbers alone, far beyond their uncertainties, if they explain as much
    cut_short: bool = False  # the search ended at its budget, so that not everything was tried

    @property
    def unproven(self) -> list[HeldOut]:
        """The places left out of the fit that are not explained there."""
        share, least = self.estimation.settings.left, self.estimation.tolerance
        return [one for one in self.held_out if self.best and one.after > max(share * one.before, least)]

    def behind(self, h: Hypothesis) -> float:
        """Return by how much −2 ln Z of all data is larger for a hypothesis that was tried than for the best."""
        best = self.searched or self.best
        return 0.0 if best is None else best.fit.ahead_of(h.fit) / self.share

    def posterior(self, cause: str) -> float:
        """Return the probability that an effect of this cause is there, of all that was tried, and of none."""
        best = self.searched or self.best
        if best is None:
            return 0.0
        behind = np.array([*map(self.behind, self.tried), best.fit.ahead_of(self.base) / self.share])
        likely = np.exp(-0.5 * np.clip(behind, 0.0, 1e3))
        return float(likely[:-1] @ [cause in h.causes for h in self.tried] / likely.sum())

    @property
    def lost(self) -> list[str]:
        """Recordings that no simulation follows, with the effects as without them: nothing is said of these."""
        followed = {o.name for o in self.estimation.problem.observations}
        return list(dict.fromkeys(o.name for o in self.whole.problem.observations if o.name not in followed))

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
        alike = (name for name, _ in confounded_with(self.best.names, self.screened))
        return list(dict.fromkeys([*likely, *alike]))

    @property
    def floor_is_wrong(self) -> bool:
        """Whether less is left than the noise, by a floor that is as it was measured or guessed."""
        return (
            self.estimation.whiten.floor is self.noise
            and mean_square(self.final) - 1 < self.estimation.settings.wrong_floor
        )


def mean_square(fitted: Fit) -> float:
    """Return the mean square of what is left, in units of the noise."""
    return fitted.chi_squared / len(fitted.residual)


def diagnose(
    problem: Problem,
    progress: Progress = lambda _: None,
    budget: float | None = None,
    settings: SearchSettings = SETTINGS,
    trace: Trace | None = None,
) -> Outcome:
    """Find the effects that are missing from the problem's machine, if any.

    Parameters
    ----------
    budget : integration steps after which nothing more is tried; the best by then is put to the tests. None: 90 s of
        CPU of a printer.
    trace : collects every fit and decision.
    """
    budget = BUDGET_STEPS if budget is None else budget
    trace = Trace() if trace is None else trace
    problem.work.begin(budget)
    problem = problem.compared()
    result = _diagnosed(problem, noise_floor(problem), settings, trace, progress, problem.least_density)
    again = None if result.noise.from_repeats or result.fault is not None else _corrected_noise(result)
    if again is not None:
        progress("the residual shows another noise than was guessed: it becomes the noise, and the search starts again")
        problem.work.begin(budget)
        result = _diagnosed(problem, again, settings, trace, progress, {})
    concluded = replace(_concluded(result), cut_short=problem.work.cut)
    names = concluded.best.names if concluded.best is not None else ()
    trace.add("verdict", names, left=concluded.final.discrepancy, outcome=concluded.finding)
    return concluded


def _corrected_noise(result: Outcome) -> NoiseFloor | None:
    """Return the noise that the residual shows where a guessed floor is too high, or too low; None where it is right.

    Too low it is where nothing explains a residual that is the same in every window: a sensor's noise has a colour.
    """
    if result.floor_is_wrong:
        return scaled(result.noise, mean_square(result.final))
    if result.verdict != "unknown":
        return None
    estimation, final = result.estimation, result.final
    observations, whiten = estimation.whiten.observations, estimation.whiten
    simulated = estimation.problem.simulate(final.values)
    errors = [o.measured - y for o, y in zip(observations, simulated, strict=True)]
    raised = stationary_noise(whiten.floor, observations, errors)
    left = whitener(observations, raised, whiten.band_hz)(errors)
    return raised if float(left @ left) / len(left) - 1 < STATIONARY else None


def _spread(estimation: EstimationProblem) -> float:
    """Compute the standard deviation of a discrepancy of zero: of the residual's mean square, and of its floor."""
    observations, rows = estimation.whiten.observations, estimation.whiten.rows
    repeats = [sum(a.repeat_of == b.repeat_of for b in observations) for a in observations]
    apart = sum((part.stop - part.start) * (1 - 1 / n) for part, n in zip(rows, repeats, strict=True))
    return float(np.sqrt(2 / len(estimation.measured) + 2 / apart))


# ---- the search ----------------------------------------------------------------------------------


def _diagnosed(
    problem: Problem,
    noise: NoiseFloor,
    settings: SearchSettings,
    trace: Trace,
    progress: Progress,
    least_density: Mapping[str, float | FloatArray],
) -> Outcome:
    progress(Stage(1, "estimating the noise"))
    if noise.origin == ABOVE:
        progress("no repeats: the noise floor is taken from above the model's band")
    floor = at_least(noise, problem.observations, problem.band_hz, least_density)
    estimation = estimation_problem(problem, whitener(problem.observations, floor, problem.band_hz), settings, trace)
    chance = settings.chance_sd * _spread(estimation) if noise.from_repeats else 0.0
    estimation = replace(estimation, tolerance=max(estimation.tolerance, chance))
    least = max(settings.exists, chance) if noise.from_repeats else estimation.tolerance
    progress(Stage(2, "fitting the machine's own parameters"))
    filed = linearised(estimation, problem.parameters, np.zeros(len(problem.parameters)))
    base = fit(estimation, filed.parameters, filed.z, filed.jacobian, small_gain=QUICK_GAIN / 10)
    progress(f"the machine's own parameters alone: {error_left(base)}")
    none = Outcome(
        verdict="none", finding="nothing", base=base, final=base, whole=estimation, estimation=estimation, noise=noise
    )
    fault = fault_of_recordings(estimation, problem.simulate({}), base)
    if fault is not None:
        return replace(none, verdict="unknown", finding="recording", fault=fault)
    small = base.discrepancy < least
    if not small:
        none = _followed(none, base.values)
    data, retuned, count = none.estimation, none.base, f"{len(problem.candidates)} effects"
    if (part := excerpt_of(data, retuned.discrepancy)) is not None:
        data, retuned = part, fit_in_excerpt(part, retuned)
        count += f" in {100 * part.share:.0f} % of the data: the discrepancy is large"
    progress(Stage(3, f"screening {count}"))
    screened = screen(replace(data, coarse=True), retuned, list(problem.candidates))
    none = replace(none, screened=screened)
    hint = noise.from_repeats and screened and screened[0].evidence < -3 * settings.significant
    if small and not hint:
        return none
    found = find_best(Search(data, retuned, screened, progress))
    best = _fitted_to_all(none, found.search, found.best)
    more = _followed(none, best.fit.values)
    if more is not none:
        progress("with what was found a simulation follows other motions: searching on in these")
        begun = fit_in_whole(more.estimation, best, progress)
        none, found = more, find_best(Search(more.estimation, more.base, screened, progress), begun)
        best = found.best
    progress(Stage(7, "testing it at places that were left out of the fit"))
    tested = _tested(none, found, best)
    if tested.rejections and not small:
        tested = _with_a_rest(none, found, tested)
    # where there was hardly a discrepancy, an effect that fails a test leaves nothing unexplained
    return none if small and tested.rejections else tested


def _followed(none: Outcome, values: Mapping[str, float]) -> Outcome:
    """Compare only motions that a simulation follows: it leaves less of them than one that stands still.

    Beyond, as where a resonance has jumped, the motion depends on how it began, and no residual leads to its cause.
    """
    whole, problem = none.whole, none.whole.problem
    left, signal = (np.bincount(whole.motions, x**2) for x in (whole.residual(values), whole.measured))
    chosen = [i for i, motion in enumerate(problem.motions) if left[motion] < signal[motion]]
    if len({problem.motions[i] for i in chosen}) < LEAST_FOLLOWED:
        chosen = list(range(len(problem.motions)))
    if [problem.observations[i].name for i in chosen] == [o.name for o in none.estimation.problem.observations]:
        return none
    if len(chosen) == len(problem.motions):
        return replace(none, estimation=whole, base=none.final)
    estimation = whole.on_part(problem.only(chosen))
    return replace(none, estimation=estimation, base=fit_in_excerpt(estimation, none.final))


def _fitted_to_all(none: Outcome, search: Search, h: Hypothesis) -> Hypothesis:
    """Fit a hypothesis to all that is compared, where the search had an excerpt of it."""
    return h if search.estimation is none.estimation else fit_in_whole(none.estimation, h, search.progress)


# ---- the verdict ---------------------------------------------------------------------------------


def _with_a_rest(none: Outcome, found: Selection, tested: Outcome) -> Outcome:
    """Name the effect that holds most of the discrepancy, if one does; else leave the verdict as it is."""
    search = found.search
    dominant = dominant_effect(search.estimation, search.retuned, tested.tried, search.progress)
    if dominant is None:
        return tested
    alone = _tested(none, found, _fitted_to_all(none, search, dominant.hypothesis))
    rejections = alone.rejections or tested.rejections
    return replace(alone, verdict="unknown", named=None, dominant=dominant, rejections=rejections)


def _tested(none: Outcome, found: Selection, best: Hypothesis) -> Outcome:
    """Put the best hypothesis to the acceptance tests."""
    estimation, tried, share = none.estimation, found.tried, found.search.estimation.share
    intervals = _proven_intervals(none, best, found.search.progress)
    held_out = hold_out(estimation, none.base, best.fit)
    failed = tuple(rejections(estimation, best, held_out, intervals))
    estimation.trace.add("accept", best.names, outcome="refused" if failed else "kept", reason="; ".join(failed))
    there = found.best
    if best.names != there.names:  # a smaller rival, or fewer effects
        there = next((h for h in likeliest(tried) if h.names == best.names), there)
    ranked = likeliest([there, *(h for h in tried if h.names != best.names)])
    return replace(
        none,
        verdict="unknown" if failed else "effects",
        named=None if failed else best,
        best=best,
        final=best.fit,
        searched=there,
        share=share,
        tried=ranked,
        competing=competing_with(there, ranked, estimation.settings, share, none.base.discrepancy),
        held_out=held_out,
        rejections=failed,
        intervals=intervals,
    )


def _proven_intervals(none: Outcome, best: Hypothesis, progress: Progress) -> dict[str, Estimate]:
    """Return the intervals, narrowed where they include no effect although the fit without it is far worse."""
    intervals = intervals_of(none.estimation, best.fit)
    for c in best.effects:
        if superfluous(c, intervals):
            rest = best.without(c, none.estimation.problem.parameters)
            without = continue_fit(none.estimation, rest, progress).fit if rest.effects else none.base
            intervals = by_deviance(c, best.fit, without, intervals)
    return intervals


def _concluded(result: Outcome) -> Outcome:
    """Judge what a search returned: claim no more than the noise and the places left out allow."""
    if result.fault is not None:
        return result
    if result.noise.from_repeats and result.floor_is_wrong:
        return replace(result, verdict="unknown", named=None, finding="cannot_tell")
    if result.verdict == "effects":
        others = other_motions(result.estimation, result.base, result.final)
        return replace(result, finding="effects", file_off=_file_off(result), others=others)
    if result.verdict == "none":
        return _nothing(result)
    explained = max(result.final.discrepancy, 0.0) < result.estimation.settings.left * result.base.discrepancy
    # where an effect explains the gap, though not surely, one axis acts on one signal alone
    fault = odd_signal(result.estimation, [] if explained else [result.base, result.final])
    if fault is not None:
        return replace(result, finding="recording", fault=fault, dominant=None)
    if result.dominant is not None:
        others = other_motions(result.estimation, result.base, result.final)
        return replace(result, finding="dominant", others=others)
    return replace(result, finding="unproven" if explained else "unexplained", file_off=_file_off(result))


def _nothing(result: Outcome) -> Outcome:
    """Say `none` only where noise leaves room to see something; test what was retuned where it was not fitted."""
    estimation = result.estimation
    if noise_share(estimation.whiten, estimation.measured) > estimation.settings.loud_noise:
        return replace(result, verdict="unknown", finding="cannot_tell")
    return replace(result, held_out=hold_out(estimation, result.base, result.base))


def _file_off(result: Outcome) -> Fit | None:
    """Fit the machine's own numbers alone, far beyond what the file allows, where they may be what is wrong.

    A stiffness or a mass may be named because another of the file's numbers is wrong, and where several are, nothing
    known explains it: only its owner knows how well they are known.
    """
    best, base = result.best, result.base
    if best is None or (result.named is not None and not set(result.named.names) <= FILE_CHANGES):
        return None
    looser = np.array([1.0 if belongs_to_recording(n.name) else LOOSENED for n in base.parameters])
    loose = [
        n if times == 1.0 else Parameter.near(n.name, n.start, times * n.sd)
        for n, times in zip(base.parameters, looser, strict=True)
    ]
    alone = fit(result.estimation, loose, base.z / looser, base.jacobian * looser)
    rows = len(alone.residual)
    enough = max(AS_LOOSE * best.fit.chi_squared / rows - 1, result.estimation.tolerance)
    return alone if mean_square(alone) - 1 < enough else None
