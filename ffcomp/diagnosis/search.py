"""Sequential floating search for the effects of a machine: forward selection with steps back.

    begin     quick fits of the promising candidates, full fits of the contenders, their best shapes
    round     add the effect that helps most, reshape, swap for what is alike, keep the simplest; while significant
    restart   where too little is explained: a warm start on a short horizon, and rounds from there
    float     swap each effect for what helps most beside the rest, for a richer model, add a change of the file
    finish    exact derivatives; drop what is superfluous; a smaller rival; free shapes

Sequential floating forward selection: Pudil, Novovičová & Kittler, Pattern Recognition Letters 15, 1994. Every step is
accepted by the evidence of nonlinear fits (`hypotheses.significant`), never by a prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.diagnosis.fidelity import (
    continue_fit,
    fit_exactly,
    from_short_horizon,
    grow,
    hypothesis_in_whole,
    refit,
    select_starts,
    straightened,
)
from ffcomp.diagnosis.fit import fit
from ffcomp.diagnosis.hypotheses import (
    NESTED,
    Hypothesis,
    comparable,
    competing_with,
    distinct,
    incomplete,
    leaves_excess,
    likeliest,
    nested,
    prefer_plausible,
    significant,
    simplest,
    smaller_rivals,
    with_a_plausible,
)
from ffcomp.diagnosis.moves import (
    Search,
    add,
    add_file_change,
    drop,
    fit_fully,
    free_shapes,
    reshape,
    reshape_thoroughly,
    swap,
    swap_for_alike,
    swap_for_law_within,
    swap_for_nested,
)
from ffcomp.diagnosis.score_test import overlap
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.numerics.stages import Stage


@dataclass(frozen=True, eq=False)
class Selection:
    """The best hypothesis so far, and all that were tried."""

    best: Hypothesis
    tried: tuple[Hypothesis, ...]
    left_nothing: bool = False  # the rounds ended because there was nothing left to explain
    shaped: bool = False  # the best one's shapes are those that pay


def find_best(search: Search) -> Selection:
    """Run the search up to its final fits."""
    selection = _rounds(search, _begin(search))
    best = selection.best
    if best.discrepancy > max(SETTINGS.large, search.little) or not best.plausible:
        if search.estimation.problem.short_horizon(SETTINGS.horizon_s) is not None:
            search.estimation.problem.work.extend(SETTINGS.restart_steps)
        warm = from_short_horizon(search.estimation, search.bases[0][1], best, search.progress)
        if warm is not None and warm.fit.evidence <= best.fit.evidence:
            selection = _rounds(search, Selection(warm, (*selection.tried, warm)))
    return _floating(search, selection)


def finish(search: Search, selection: Selection) -> Selection:
    """Fit the best hypothesis exactly, drop what it can do without, and set its shapes free where the data need it."""
    best = drop(search, fit_exactly(search.estimation, selection.best, search.progress))
    for rival in smaller_rivals(best, selection.tried, search.candidates)[:1]:
        smaller = fit_exactly(search.estimation, rival, search.progress)
        best = best if significant(best.fit, smaller.fit) else smaller
    best = _likelier_at_the_end(search, best, selection)
    best = swap_for_law_within(search, best)
    return replace(selection, best=free_shapes(search.estimation, best, search.progress))


def _likelier_at_the_end(search: Search, best: Hypothesis, selection: Selection) -> Hypothesis:
    """Fit a rival that was nearly as likely exactly as well: which of the two is likelier shows at the end.

    What was likelier already was passed over for a reason.
    """
    near = likeliest(competing_with(selection.best, selection.tried))
    behind = [h for h in near if h.plausible and h.fit.evidence > selection.best.fit.evidence]
    for rival in [h for h in behind if len(h.effects) == len(best.effects) and not _is_richer(h, best)][:1]:
        equal = fit_exactly(search.estimation, rival, search.progress)
        best = equal if equal.plausible and equal.fit.evidence < best.fit.evidence else best
    return best


def on_all_data(search: Search, selection: Selection) -> Selection | None:
    """Fit to all data what an excerpt selected; None if that leaves something that the excerpt did not show."""

    def on_all(h: Hypothesis) -> Hypothesis:
        return continue_fit(
            search.estimation, hypothesis_in_whole(search.estimation.problem, h), search.progress, ", on all data"
        )

    best = on_all(selection.best)
    tolerant = replace(search.estimation, tolerance=max(search.estimation.tolerance, search.trace))
    missed = incomplete(tolerant, best) and selection.left_nothing
    if missed and len(best.effects) < SETTINGS.most_effects and search.may_go_on:
        return None
    rivals = smaller_rivals(selection.best, selection.tried, search.candidates)[:1]
    return Selection(best, tuple(on_all(h) for h in rivals))


# ---- begin ---------------------------------------------------------------------------------------


def _begin(search: Search) -> Selection:
    """Fit the candidates quickly, the contenders fully, and those nearly as good as the best in their best shape."""
    search.progress(Stage(4, "fitting the most promising effects"))
    ranked = _initial_fits(search)
    near = [h for h in ranked[: SETTINGS.by_simulation] if comparable(h, ranked[0], SETTINGS.keep_initial)]
    contenders = with_a_plausible(near, ranked)
    fitted = fit_fully(search, contenders)
    best = min(fitted, key=lambda h: h.fit.evidence)
    tried = (*_shaped(search, fitted, best), *(h for h in ranked if h not in contenders))
    best = straightened(search.estimation, min(tried, key=lambda h: h.fit.evidence), search.progress)
    best = prefer_plausible(best, (best, *tried), max(search.little, search.estimation.tolerance))
    return Selection(simplest(best, tried, search.candidates), tried)


def _initial_fits(search: Search) -> list[Hypothesis]:
    """Fit the promising candidates quickly, from every base; one hypothesis a candidate, the likeliest first."""
    quick, fitted = search.quick, list[Hypothesis]()
    for base, screened in search.bases:
        for start in select_starts(quick, base, screened, base.discrepancy > SETTINGS.large):
            if fitted and not search.may_go_on:
                break
            bar = min((h.discrepancy for h in fitted), default=np.inf)
            fitted.append(grow(quick, Hypothesis((), base), start, search.progress, bar))
    ranked = distinct(likeliest(fitted))
    held = [h for h in ranked if h.plausible]  # what needs implausible numbers is no measure for what does not
    near = [*ranked[: SETTINGS.by_score], *held[:1]]

    def pursued(h: Hypothesis) -> Hypothesis:
        """Take a few steps more with a contender."""
        best = held[0] if h in held else ranked[0]
        if h not in near or not comparable(h, best, SETTINGS.keep_initial):
            return h
        further = fit(quick, h.fit.parameters, h.fit.z, h.fit.jacobian, (), 6, SETTINGS.quick_gain, renew_all=False)
        return Hypothesis(h.effects, further)

    return likeliest([pursued(h) for h in ranked])


def _shaped(search: Search, fitted: Sequence[Hypothesis], best: Hypothesis) -> list[Hypothesis]:
    """Reshape those nearly as good as the best, the smallest first.

    What is another effect with more numbers stays as it is where that one leaves nothing in its best shape, and so does
    what one in its best shape leaves far behind.
    """
    shaped: list[Hypothesis] = []
    for h in sorted(fitted, key=lambda each: each.effect_count):
        simpler = [x for x in shaped if len(x.effects) == len(h.effects) == 1 and nested(*x.names, *h.names)]
        needless = any(not incomplete(search.estimation, x) for x in simpler)
        nearly = comparable(h, best, SETTINGS.keep_fitted) and not needless
        rivals = [x for x in shaped if x.plausible or not h.plausible]
        nearly = nearly and all(comparable(h, x, SETTINGS.keep_initial) for x in rivals)
        shaped.append(reshape_thoroughly(search, h) if nearly else h)
    return shaped


# ---- rounds --------------------------------------------------------------------------------------


def _rounds(search: Search, selection: Selection) -> Selection:
    """Add effects to the best hypothesis, round by round, until none is significant or nothing is left."""
    best, tried, shaped = selection.best, selection.tried, selection.shaped
    while len(best.effects) < SETTINGS.most_effects and incomplete(search.estimation, best):
        best = straightened(search.estimation, refit(search.estimation, best, search.progress), search.progress)
        if not incomplete(search.estimation, best) or not search.may_go_on:
            break
        larger, more = _larger(search, best)
        tried = (*tried, *more)
        if larger is None:
            return Selection(best, tried, shaped=shaped)
        best = larger
        if search.may_go_on:
            best = reshape_thoroughly(search, best)
        reshaped = best
        if search.may_go_on:
            best, tried = _swapped(search, best, tried)
        if search.may_go_on:
            best = simplest(best, tried, search.candidates)
        shaped = best is reshaped
        if not search.may_go_on:
            break
    return Selection(best, tried, left_nothing=not incomplete(search.estimation, best), shaped=shaped)


def _swapped(
    search: Search, best: Hypothesis, tried: tuple[Hypothesis, ...]
) -> tuple[Hypothesis, tuple[Hypothesis, ...]]:
    """Swap effects for what is alike; one that is likelier beyond doubt takes their place at once."""
    alike = swap_for_alike(search, best, tried)
    return accepted(best, [h for h in alike if h.plausible or not best.plausible]), (*tried, *alike)


def _larger(search: Search, best: Hypothesis) -> tuple[Hypothesis | None, list[Hypothesis]]:
    """Add the effect that helps most; None if none is significant; and all that were tried."""
    search.progress(Stage(5, f"looking for one effect more than {' + '.join(best.names)}"))
    possible = more = add(search, best)
    trace = best.discrepancy < search.trace and best.plausible
    if trace:
        possible = [h for h in possible if not _is_shape(search, best, h)]
    if not leaves_excess(search.estimation, best.fit):  # only the file's numbers are implausible: that is to be cured
        possible = [h for h in possible if h.plausible]
    larger = min(possible, key=lambda h: h.fit.evidence, default=best)
    share = SETTINGS.added_share_of_trace if trace else SETTINGS.added_share
    return (larger if significant(larger.fit, best.fit, share) else None), more


def _is_shape(search: Search, best: Hypothesis, larger: Hypothesis) -> bool:
    """Tell whether what a larger hypothesis adds does much the same as an effect of the best one.

    Where no more is left than the error of a shape, it is the shape of that effect: how its friction thins with speed.
    """
    signatures = {s.candidate.name: s for s in search.bases[0][1]} if search.bases else {}
    added = [signatures[n] for n in larger.names if n in signatures and n not in best.names]
    named = [signatures[n] for n in best.names if n in signatures]
    return any(overlap(a, b) > SETTINGS.alike for a in added for b in named)


# ---- floating ------------------------------------------------------------------------------------


def _floating(search: Search, selection: Selection) -> Selection:
    """Swap effects that were added one after the other, and add one for a number of the file that is implausible."""
    estimation, best, others = search.estimation, selection.best, list[Hypothesis]()
    if len(best.effects) > 1 and not selection.shaped and incomplete(estimation, best) and search.may_go_on:
        best = reshape(estimation, best, search.progress)  # one that replaced another as simpler has its first shape
    if len(best.effects) > 1 and incomplete(estimation, best):
        others += swap(search, best, selection.tried)
        best = accepted(best, others)
    if leaves_excess(estimation, best.fit):
        pairs = [h for h in likeliest(selection.tried) if len(h.effects) == 2 and set(best.names) < set(h.names)]
        others += [richer for h in (best, *pairs[:1]) for richer in swap_for_nested(search, h)]
        best = accepted(best, others)
    if not best.plausible and len(best.effects) < SETTINGS.most_effects:
        others += add_file_change(search, best)
        best = accepted(best, others)
    return replace(selection, best=best, tried=(*selection.tried, *others))


def accepted(best: Hypothesis, tried: Sequence[Hypothesis]) -> Hypothesis:
    """Return another hypothesis of as many effects that is likelier beyond doubt, or of one more.

    One more must take a good share of what is left, or make the file's numbers plausible. One that has an effect with
    more numbers in place of the same with fewer must take a good share of what is left, as anything that is added:
    there is always something for more numbers to explain.
    """
    as_many = [h for h in tried if len(h.effects) == len(best.effects)]
    as_many = [h for h in as_many if not _is_richer(h, best) or significant(h.fit, best.fit)]
    more = [h for h in tried if len(h.effects) == len(best.effects) + 1]
    more = [h for h in more if significant(h.fit, best.fit) or (h.plausible and not best.plausible)]
    likelier = min([*as_many, *more], key=lambda h: h.fit.evidence, default=best)
    gain = (best.fit.evidence - likelier.fit.evidence) / likelier.fit.misfit
    return likelier if gain > SETTINGS.significant else best


def _is_richer(h: Hypothesis, best: Hypothesis) -> bool:
    """Tell whether a hypothesis has all effects of another, one of them with more numbers."""
    return [NESTED.get(name) for name in set(h.names) - set(best.names)] == [*(set(best.names) - set(h.names))]
