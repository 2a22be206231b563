"""Selection of the best hypothesis by passes: initial fits, rounds that add effects, a last refinement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ffcomp.diagnose.beginnings import from_beginnings
from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.excerpt_fits import in_whole
from ffcomp.diagnose.exchange import exchanged, likelier, unbent
from ffcomp.diagnose.fit import Fit
from ffcomp.diagnose.growth import BEHIND, with_one_more
from ffcomp.diagnose.hypotheses import (
    ADDED_SHARE,
    LARGE,
    NEARLY_ALL,
    TRACE,
    Hypothesis,
    comparable,
    contains,
    discrepancy_of,
    distinct,
    implausible,
    incomplete,
    leaves_excess,
    likeliest,
    may_join,
    preferring_file,
    significant,
    with_one_within_file,
    within_file,
    without_effect,
)
from ffcomp.diagnose.initial_fits import (
    CONTENDER,
    SCALES,
    USUAL,
    best_start,
    fit_start,
    initial_fits,
    select_starts,
)
from ffcomp.diagnose.intervals import intervals_of, superfluous
from ffcomp.diagnose.parsimony import most_parsimonious, predicted_without, simplest, smaller_rivals
from ffcomp.diagnose.problem import Candidate
from ffcomp.diagnose.progress import Progress, Stage
from ffcomp.diagnose.refinement import (
    begun_anew,
    by_degrees,
    continue_fit,
    continue_or_restart,
    converge,
    drop,
    enriched,
    refine,
    refit,
    restart_from_file,
    with_free_shapes,
)
from ffcomp.diagnose.score_test import Screened, overlap, screen_roughly, similarity
from ffcomp.diagnose.work import ANEW

MOST_EFFECTS = 3  # at once
POOR = 0.15  # of the discrepancy left by one effect: then pairs are tried
LITTLE = 0.02  # of the discrepancy: effects that leave less have begun at the right place
PROMISING = 0.25  # of what an added effect must remove: one that removes less in a coarse fit is not pursued
CONTENDERS = 3  # fitted well
CLOSE = 5.0  # times the best discrepancy: a hypothesis that leaves more keeps its shape
ADDED = 3  # effects that are tried as one more
PAIRED = 5  # candidates whose pairs are tried
ALIKE = 0.5  # cos² of two signatures from which one effect may stand in for the other


@dataclass(frozen=True, eq=False)
class Search:
    """Everything the passes work with."""

    estimation: EstimationProblem
    bases: Sequence[tuple[Fit, Sequence[Screened]]]  # fits of the machine's parameters, with what was screened there
    retuned: Fit  # the machine's parameters alone, at their best
    progress: Progress

    @property
    def little(self) -> float:
        """What may be left of the discrepancy by an effect of a somewhat different shape."""
        return LITTLE * discrepancy_of(self.retuned)

    def may_go_on(self) -> bool:
        """Tell whether the budget allows to try anything more."""
        return self.estimation.problem.work.allows()

    @property
    def quick(self) -> EstimationProblem:
        """The same problem, simulated coarsely."""
        return replace(self.estimation, coarse=True)


@dataclass(frozen=True, eq=False)
class Selection:
    """The best hypothesis so far, and all that were tried."""

    best: Hypothesis
    tried: tuple[Hypothesis, ...]
    complete: bool = False  # no further effect is looked for
    left_nothing: bool = False  # for there is nothing left to explain


Pass = Callable[[Search, Selection], Selection]


def find_best(search: Search) -> Selection:
    """Run all passes but the last."""
    selection = in_rounds(search, _begin(search))
    best = selection.best
    if best.discrepancy > max(LARGE, search.little) or not within_file(best):
        selection = followed_from_beginnings(search, selection)
    return think_again(search, selection)


def in_rounds(search: Search, selection: Selection) -> Selection:
    """Add effects to the best hypothesis, round by round."""
    while not selection.complete:
        for one in ROUND:
            selection = one(search, selection)
            if selection.complete or not search.may_go_on():
                selection = replace(selection, complete=True)
                break
    return selection


def followed_from_beginnings(search: Search, so_far: Selection) -> Selection:
    """Begin anew with the motions' beginnings, where what was found explains too little or bends the file's numbers."""
    search.estimation.problem.work.extend(ANEW)
    found = from_beginnings(search.estimation, search.bases[0][1], search.progress)
    if found is None or found.fit.evidence > so_far.best.fit.evidence:
        return so_far
    return in_rounds(search, Selection(found, (*so_far.tried, found)))


def finish(search: Search, selection: Selection) -> Selection:
    """Run the last passes."""
    for one in FINAL:
        selection = one(search, selection)
    return selection


def on_all_data(search: Search, found: Selection) -> Selection | None:
    """Fit to all data what was found in an excerpt; None if that leaves something that the excerpt did not show."""

    def on_all(h: Hypothesis) -> Hypothesis:
        widened = in_whole(search.estimation.problem, h)
        return continue_fit(search.estimation, widened, search.progress, ", on all data")

    fitted = on_all(found.best)
    little = max(search.estimation.tolerance, TRACE * discrepancy_of(search.retuned))  # no shape is more exact
    missed = incomplete(replace(search.estimation, tolerance=little), fitted) and found.left_nothing
    if missed and len(fitted.effects) < MOST_EFFECTS and search.may_go_on():
        return None
    rivals = smaller_rivals(found.best, found.tried, search.estimation.problem.candidates)[:1]
    return Selection(fitted, tuple(on_all(h) for h in rivals), complete=True)


def _begin(search: Search) -> Selection:
    """Fit the candidates quickly, the contenders well, and those nearly as good as the best in their best shape."""
    search.progress(Stage(4, "fitting the most promising effects"))
    ranked = initial_fits(search.estimation, search.bases, search.progress)
    close = with_one_within_file([h for h in ranked[:CONTENDERS] if comparable(h, ranked[0], CONTENDER)], ranked)
    fitted = fitted_well(search, close)
    best = min(fitted, key=lambda h: h.fit.evidence)
    shaped = _shaped(search, fitted, best)
    tried = (*shaped, *(h for h in ranked if h not in close))
    little = max(search.little, search.estimation.tolerance)
    likeliest_one = straightened(search, min(tried, key=lambda h: h.fit.evidence))
    likeliest_one = preferring_file(likeliest_one, (likeliest_one, *tried), little)
    return Selection(simplest(likeliest_one, tried, search.estimation.problem.candidates), tried)


def _shaped(search: Search, fitted: Sequence[Hypothesis], best: Hypothesis) -> list[Hypothesis]:
    """Converge on the shapes of those nearly as good as the best, the smallest first.

    What is another effect with more numbers stays as it is where that one leaves nothing in its best shape.
    """
    shaped: list[Hypothesis] = []
    for h in sorted(fitted, key=lambda h: h.added):
        whole = [x for x in shaped if len(x.effects) == len(h.effects) == 1 and contains(*x.names, *h.names)]
        needless = any(not incomplete(search.estimation, x) for x in whole)
        nearly = comparable(h, best, CLOSE) and not needless
        shaped.append(converged(search, h) if nearly else h)
    return shaped


def fitted_well(search: Search, close: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Fit contenders well, the likeliest first; those that another leaves far behind stay as they are.

    Of all of them, and of those that leave the file's numbers in reach, only the likeliest is begun anew at these
    numbers: all have been begun there before they were ranked.
    """
    found: list[Hypothesis] = []
    for h in close:
        # what bends the file's numbers is no measure for what does not
        rivals = [i for i, x in enumerate(found) if within_file(x) or not within_file(h)]
        best = min(rivals, key=lambda i: found[i].fit.evidence, default=None)
        # compared as they were ranked: coarse steps leave of strong friction a tenth, which exact ones do not
        # and what needs fewer numbers is not given up for what more of them reach sooner
        behind = best is not None and not comparable(
            h, close[best], CONTENDER if h.added < close[best].added else BEHIND
        )
        spent = bool(found) and not search.may_go_on()
        found.append(h if behind or spent else continue_fit(search.estimation, h, search.progress))
    first = [min(range(len(found)), key=lambda i: found[i].fit.evidence)] if found else []
    held = [i for i, h in enumerate(close) if within_file(h)][:1]
    for i in {*first, *held}:
        found[i] = begun_anew(search.estimation, found[i], search.progress, search.little)
    return found


# ---- passes --------------------------------------------------------------------------------------


def refit_best(search: Search, so_far: Selection) -> Selection:
    """Refit the best hypothesis; the selection is complete if that leaves no discrepancy."""
    if len(so_far.best.effects) >= MOST_EFFECTS or not incomplete(search.estimation, so_far.best):
        return replace(so_far, complete=True, left_nothing=not incomplete(search.estimation, so_far.best))
    best = straightened(search, refit(search.estimation, so_far.best, search.progress))
    nothing = not incomplete(search.estimation, best)
    return replace(so_far, best=best, complete=nothing, left_nothing=nothing)


def straightened(search: Search, best: Hypothesis) -> Hypothesis:
    """Fit with exact derivatives what leaves nothing but bends the file's numbers: perhaps it need not.

    A belt's stiffness and a frequency make up for each other: the way back is worth the prior alone, and another effect
    would be added for it.
    """
    if leaves_excess(search.estimation, best.fit) or not implausible(best.fit, best.own):
        return best
    return min(best, refine(search.estimation, best, search.progress), key=lambda h: h.fit.evidence)


def add_effect(search: Search, so_far: Selection) -> Selection:
    """Add the effect that helps most; the selection is complete if none is significant."""
    search.progress(Stage(5, f"looking for one effect more than {' + '.join(so_far.best.names)}"))
    more = add(search, so_far.best)
    tried = (*so_far.tried, *more)
    best = so_far.best
    trace = best.discrepancy < TRACE * discrepancy_of(search.retuned) and not implausible(best.fit, best.own)
    if trace:
        more = [h for h in more if not _is_shape(search, best, h)]
    if not leaves_excess(search.estimation, best.fit):  # only the file's numbers are bent: then that is to be cured
        more = [h for h in more if not implausible(h.fit, h.own)]
    likeliest_one = min(more, key=lambda h: h.fit.evidence, default=best)
    if not significant(likeliest_one.fit, best.fit, NEARLY_ALL if trace else ADDED_SHARE):
        return replace(so_far, tried=tried, complete=True)
    return replace(so_far, best=likeliest_one, tried=tried)


def _is_shape(search: Search, best: Hypothesis, larger: Hypothesis) -> bool:
    """Tell whether what a larger hypothesis adds does much the same as an effect of the best one.

    Where no more is left than the error of a shape, it is the shape of that effect: how its friction thins with speed.
    """
    signatures = {s.candidate.name: s for s in search.bases[0][1]} if search.bases else {}
    added = [signatures[n] for n in larger.names if n in signatures and n not in best.names]
    named = [signatures[n] for n in best.names if n in signatures]
    return any(overlap(a, b) > ALIKE for a in added for b in named)


def converge_best(search: Search, so_far: Selection) -> Selection:
    """Converge on the shapes of the best hypothesis' effects."""
    return replace(so_far, best=converged(search, so_far.best))


def converged(search: Search, h: Hypothesis) -> Hypothesis:
    """Converge on the shapes of a hypothesis.

    Where it still leaves much, or bends the file's numbers, it goes on by degrees with the shapes it has.
    """
    shaped = converge(search.estimation, h, search.progress)
    much = shaped.discrepancy > max(LARGE, search.little if within_file(shaped) else 0.0)
    unsettled = much and shaped.effects != h.effects and search.may_go_on()
    return by_degrees(search.estimation, shaped, search.progress) if unsettled else shaped


def swap_effects(search: Search, so_far: Selection) -> Selection:
    """Try smaller effects in place of those of the best hypothesis."""
    return replace(so_far, tried=(*so_far.tried, *swap(search, so_far)))


def think_again(search: Search, so_far: Selection) -> Selection:
    """Exchange effects that were found one after the other, and add one for a number of the file that bends."""
    estimation, best, others = search.estimation, so_far.best, list[Hypothesis]()
    if len(best.effects) > 1 and incomplete(estimation, best) and search.may_go_on():
        best = converge(estimation, best, search.progress)  # one that replaced another as simpler has its first shape
    if len(best.effects) > 1 and incomplete(estimation, best):
        others += exchanged(estimation, best, so_far.tried, search.progress)
        best = likelier(best, others)
    if leaves_excess(estimation, best.fit):
        pairs = [h for h in likeliest(so_far.tried) if len(h.effects) == 2 and set(best.names) < set(h.names)]
        others += [richer for h in (best, *pairs[:1]) for richer in enriched(estimation, h, search.progress)]
        best = likelier(best, others)
    if not within_file(best) and len(best.effects) < MOST_EFFECTS:
        others += unbent(estimation, best, search.progress)
        best = likelier(best, others)
    return replace(so_far, best=best, tried=(*so_far.tried, *others))


def keep_simplest(search: Search, so_far: Selection) -> Selection:
    """Prefer fewer effects or parameters where more are not significant."""
    return replace(so_far, best=simplest(so_far.best, so_far.tried, search.estimation.problem.candidates))


def refine_best(search: Search, so_far: Selection) -> Selection:
    """Fit the best hypothesis with exact derivatives."""
    return replace(so_far, best=refine(search.estimation, so_far.best, search.progress))


def drop_superfluous(search: Search, so_far: Selection) -> Selection:
    """Drop effects whose intervals include none, or that the others can do without, while nothing significant is lost.

    A number of the file that is off may bring in an effect beside the right one, before that one is found. And where
    the others leave nothing, what no two motions agree on is the error of their shapes, however significant it is.
    """
    best = so_far.best
    intervals, agreed = (
        intervals_of(search.estimation, best.fit, best.fit.values, scatter=scatter) for scatter in (False, True)
    )
    without = {c.name: predicted_without(best, c) for c in best.effects}
    disputed = [c for c in best.effects if superfluous(c, agreed)]
    idle = [
        c
        for c in best.effects
        if c in disputed or superfluous(c, intervals) or not significant(best.fit, without[c.name])
    ]
    if not idle or len(best.effects) == 1:
        return so_far
    least = min(idle, key=lambda c: without[c.name].evidence)
    smaller = drop(search.estimation, best, least, search.progress)
    nothing_lost = least in disputed and _nothing(search, smaller.fit) and within_file(smaller)
    if significant(best.fit, smaller.fit) and not nothing_lost:
        return so_far
    return drop_superfluous(search, refine_best(search, replace(so_far, best=smaller)))


def _nothing(search: Search, fitted: Fit) -> bool:
    """Tell whether a fit leaves no more than the noise, or than what the error of a shape may leave."""
    return discrepancy_of(fitted) < max(search.estimation.tolerance, TRACE * discrepancy_of(search.retuned))


def keep_most_parsimonious(search: Search, so_far: Selection) -> Selection:
    """Prefer a competing hypothesis of fewer parameters that fits as well."""
    best = most_parsimonious(search.estimation, so_far.best, so_far.tried, search.progress)
    return replace(so_far, best=best)


def free_shapes(search: Search, so_far: Selection) -> Selection:
    """Set usual shapes free where the data ask for it."""
    return replace(so_far, best=with_free_shapes(search.estimation, so_far.best, search.progress))


ROUND: tuple[Pass, ...] = (refit_best, add_effect, converge_best, swap_effects, keep_simplest)
FINAL: tuple[Pass, ...] = (refine_best, drop_superfluous, keep_most_parsimonious, free_shapes)


# ---- add and swap effects ------------------------------------------------------------------------


def add(search: Search, best: Hypothesis) -> list[Hypothesis]:
    """Fit the best hypothesis with one effect more; where a single one explains poorly, also pairs of the screened."""
    estimation, quick, (start, screened) = search.estimation, search.quick, search.bases[0]
    others = [c for c in estimation.problem.candidates if may_join(c.name, best.names)]
    added = select_starts(quick, best.fit, screen_roughly(quick, best.fit, others)[:ADDED], large=False)
    begun = [(best, one) for one in added]
    if best.discrepancy > max(LARGE, search.little) or implausible(best.fit, best.own):
        restarted = restart_from_file(quick, best)
        helpful = select_starts(quick, restarted.fit, screen_roughly(quick, restarted.fit, others), large=True)
        begun += [(restarted, one) for one in sorted(helpful, key=lambda one: one.cost)[:ADDED]]
    tried: list[Hypothesis] = []
    for one in begun:
        if search.may_go_on():
            bar = min((h.discrepancy for h in tried), default=np.inf)
            tried.append(with_one_more(quick, *one, search.progress, bar))
    grown = distinct(likeliest(tried))
    poor = best.discrepancy > POOR * discrepancy_of(search.retuned)
    # where one more explains nearly all, the best was half of the answer, and no pair without it is looked for
    if poor and len(best.effects) == 1 and not any(h.discrepancy < search.little for h in grown):
        pairs = [p for p in combinations(screened[:PAIRED], 2) if _may_pair(p, grown)]
        likely = sorted(pairs, key=lambda pair: _pair_evidence(start, pair))[:2]
        grown += [fit_start(quick, start, best_start(quick, start, pair), search.progress) for pair in likely]
    ranked = likeliest(grown)
    pursued = [h for h in ranked[:2] if comparable(h, ranked[0], CLOSE) and _promising(quick, best, h)]
    fitted = fitted_well(search, pursued)
    return fitted + [h for h in ranked if h not in pursued]


def _promising(quick: EstimationProblem, best: Hypothesis, larger: Hypothesis) -> bool:
    """Tell whether a larger hypothesis, fitted coarsely, removes a part of what the best one leaves there too."""
    if not set(best.names) < set(larger.names):
        return True  # it has replaced an effect: the coarse fits are not one inside the other
    residual = quick.residual(best.fit.values)
    left = (float(residual @ residual) + float(best.fit.z @ best.fit.z)) / len(residual) - 1
    return larger.discrepancy < (1 - PROMISING * ADDED_SHARE) * left


def _may_pair(pair: Sequence[Screened], grown: Sequence[Hypothesis]) -> bool:
    """Tell whether two effects may act together, and were not tried so."""
    one, other = (s.candidate.name for s in pair)
    return {one, other} not in _names(grown) and not contains(one, other)


def _names(hypotheses: Sequence[Hypothesis]) -> list[set[str]]:
    return [set(h.names) for h in hypotheses]


def _pair_evidence(base: Fit, pair: Sequence[Screened]) -> float:
    """Predict the change of −2 ln Z by two effects together, to first order."""
    signature = np.hstack([s.signature for s in pair])
    cross = base.jacobian.T @ signature
    schur = np.eye(signature.shape[1]) + signature.T @ signature - cross.T @ np.linalg.solve(base.information, cross)
    slope = signature.T @ base.residual
    return float(-slope @ np.linalg.solve(schur, slope) + np.linalg.slogdet(schur)[1])


def swap(search: Search, so_far: Selection) -> list[Hypothesis]:
    """Fit the best hypothesis with one of its effects replaced by a smaller one that is nearly confounded with it."""
    estimation, progress, best, found = search.estimation, search.progress, so_far.best, list[Hypothesis]()
    screened = search.bases[0][1]
    for effect in best.effects:
        for s in screened:
            if _may_replace(s, effect, so_far, screened) and search.may_go_on():
                others = without_effect(restart_from_file(estimation, best), effect)
                begun = best_start(estimation, others.fit, (s,), SCALES[:4], USUAL)
                grown = with_one_more(estimation, others, begun, progress)
                found.append(converge(estimation, continue_or_restart(estimation, grown, progress), progress))
    return found


def _may_replace(s: Screened, effect: Candidate, so_far: Selection, screened: Sequence[Screened]) -> bool:
    """Tell whether an effect is smaller than one of the best hypothesis, similar to it, and not tried there yet."""
    names = so_far.best.names
    if len(s.candidate.parameters) >= len(effect.parameters) or s.candidate.name in names:
        return False
    if {s.candidate.name, *names} - {effect.name} in _names(so_far.tried):
        return False
    return any(similarity(s, own) > ALIKE for own in screened if own.candidate.name == effect.name)
