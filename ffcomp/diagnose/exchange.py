"""Second thoughts about what a greedy search has found.

It adds effects one after the other. The first of two is chosen by what it explains alone, where it may stand in for a
part of the other: then the second is found, and the first is wrong. So each is exchanged for what helps most beside the
rest (sequential floating search: Pudil, Novovičová & Kittler, Pattern Recognition Letters 15, 1994). And where an
effect bends a number of the file, an effect that is a change of such a number may be the other one of two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.growth import with_one_more
from ffcomp.diagnose.hypotheses import (
    CONTAINED,
    OWN_NUMBERS,
    SIGNIFICANT,
    Hypothesis,
    comparable,
    distinct,
    likeliest,
    may_join,
    misfit,
    significant,
    within_file,
    without_effect,
)
from ffcomp.diagnose.initial_fits import Start, select_starts
from ffcomp.diagnose.problem import Candidate
from ffcomp.diagnose.progress import Progress
from ffcomp.diagnose.refinement import begun_anew, continue_fit, converge, refit, restart_from_file
from ffcomp.diagnose.score_test import screen_roughly

TRIED = 2  # effects that are tried in the place of each
AS_GOOD = 2.0  # times the discrepancy of one that bends the file's numbers: more may not be left in a quick fit
CLOSE = 5.0  # times the best discrepancy: one that leaves more in its quick fit is not pursued


def exchanged(
    estimation: EstimationProblem, best: Hypothesis, tried: Sequence[Hypothesis], progress: Progress
) -> list[Hypothesis]:
    """Fit a hypothesis with each of its effects in turn exchanged for those that help most beside the others."""
    quick, found = replace(estimation, coarse=True), list[Hypothesis]()
    known = [set(h.names) for h in tried]
    for effect in best.effects:
        if not estimation.problem.work.allows():
            break
        rest = restart_from_file(quick, without_effect(best, effect))
        possible = [c for c in estimation.problem.candidates if c.name != effect.name and may_join(c.name, rest.names)]
        others = [c for c in possible if {*rest.names, c.name} not in known]
        found += [with_one_more(quick, rest, start, progress) for start in _most_helpful(quick, rest, others)]
    ranked = distinct(likeliest(found))
    pursued = [h for h in ranked[:TRIED] if comparable(h, min(best, ranked[0], key=_left), CLOSE)]
    return [_fitted(estimation, h, progress) for h in pursued]


def unbent(estimation: EstimationProblem, best: Hypothesis, progress: Progress) -> list[Hypothesis]:
    """Fit a hypothesis that bends the file's numbers with an effect that is a change of one, begun at the file."""
    quick = replace(estimation, coarse=True)
    own = [c for c in estimation.problem.candidates if c.name in OWN_NUMBERS and c.name not in best.names]
    if not own or not estimation.problem.work.allows():
        return []
    rest = restart_from_file(quick, best)
    grown = [with_one_more(quick, rest, start, progress) for start in _most_helpful(quick, rest, own)]
    # the file's numbers go back for the price of their prior alone: that is seen at the end of a fit only
    fitted = [refit(estimation, h, progress) for h in likeliest(grown)[:1] if comparable(h, best, AS_GOOD)]
    return [h for h in fitted if within_file(h)]


def likelier(best: Hypothesis, tried: Sequence[Hypothesis]) -> Hypothesis:
    """Return another hypothesis of as many effects that is likelier beyond doubt, or of one more.

    One more must take a good share of what is left, or straighten the file's numbers.

    One that has an effect with more numbers in place of the same with fewer must take a good share of what is left,
    as anything that is added: there is always something for more numbers to explain.
    """
    as_many = [h for h in tried if len(h.effects) == len(best.effects)]
    as_many = [h for h in as_many if not _is_richer_form(h, best) or significant(h.fit, best.fit)]
    more = [h for h in tried if len(h.effects) == len(best.effects) + 1]
    more = [h for h in more if significant(h.fit, best.fit) or (within_file(h) and not within_file(best))]
    found = min([*as_many, *more], key=lambda h: h.fit.evidence, default=best)
    gained = (best.fit.evidence - found.fit.evidence) / misfit(found.fit)
    return found if gained > SIGNIFICANT else best


def _is_richer_form(h: Hypothesis, best: Hypothesis) -> bool:
    """Tell whether a hypothesis has all effects of another, one of them with more numbers."""
    return [CONTAINED.get(name) for name in set(h.names) - set(best.names)] == [*(set(best.names) - set(h.names))]


def _most_helpful(quick: EstimationProblem, rest: Hypothesis, others: Sequence[Candidate]) -> list[Start]:
    starts = select_starts(quick, rest.fit, screen_roughly(quick, rest.fit, others), large=True)
    return sorted(starts, key=lambda start: start.cost)[:TRIED]


def _fitted(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    return converge(estimation, begun_anew(estimation, continue_fit(estimation, h, progress), progress), progress)


def _left(h: Hypothesis) -> float:
    return h.discrepancy
