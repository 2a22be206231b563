"""Beam search for the effects that a machine file lacks.

    expand    score every effect next to each hypothesis of the beam, simulate it at several sizes, and fit it quickly
              from the best one: in coarse simulations of the loudest motions
    fit       fit the likeliest fully, in the smallest form of each effect that pays
    prune     keep the likeliest few; stop when a level gains nothing that is significant
    finish    drop what the best does not need, and fit it with exact derivatives

Adding, dropping and swapping effects need no moves of their own: hypotheses with other effects stand next to each other
in the beam, those with fewer on the level before. Every comparison is by the evidence of nonlinear fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ffcomp.diagnosis.acceptance import retuned_too_far
from ffcomp.diagnosis.fidelity import QUICK_GAIN, RENEWED, continue_fit, fit_exactly, quickest
from ffcomp.diagnosis.fit import (
    EstimationProblem,
    Fit,
    clipped,
    derivatives,
    fit,
    limits_of,
    solved,
    values_at,
)
from ffcomp.diagnosis.held_out import beyond_noise, left_out, motions_or_groups
from ffcomp.diagnosis.hypotheses import (
    Hypothesis,
    comparable,
    distinct,
    held,
    leaves_excess,
    likeliest,
    log_fit,
    log_try,
    may_join,
    significant,
)
from ffcomp.diagnosis.problem import Candidate, Parameter, carried_over
from ffcomp.diagnosis.score_test import Screened, Subset, loudest_motions, screen, subset_of
from ffcomp.diagnosis.settings import SearchSettings
from ffcomp.numerics.stages import Progress, Stage
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE

SIZES = (1.0, 0.2, 0.04, -0.04, -0.2, -1.0)  # of a usual size, where fits may begin
ESTIMATES = (1.0, 0.3)  # of the linear estimate
ADDED_SIZES = (0.1, 0.3, 1.0, -0.1, -0.3, -1.0)  # of the usual size of what a richer form adds
SHIFTS = (0.0, *ADDED_SIZES, 2.0, 3.0, 4.0)  # standard deviations from the usual, where a new shape may begin


@dataclass(frozen=True, eq=False)
class Search:
    """What a search works with."""

    estimation: EstimationProblem
    retuned: Fit  # the machine's parameters alone, at their best
    screened: Sequence[Screened]  # the effects that are looked for, there
    progress: Progress

    @property
    def settings(self) -> SearchSettings:
        """How broad the search is, and what it keeps."""
        return self.estimation.settings

    @property
    def may_go_on(self) -> bool:
        """Whether the budget allows to try anything more."""
        return self.estimation.may_go_on


@dataclass(frozen=True, eq=False)
class Selection:
    """The best hypothesis, and all that were tried."""

    search: Search
    best: Hypothesis
    tried: tuple[Hypothesis, ...]


def find_best(search: Search, begun: Hypothesis | None = None) -> Selection:
    """Search, from a hypothesis that was found in fewer data if there is one, and fit the best exactly."""
    search.progress(Stage(4, "fitting the most promising effects"))
    settings, none = search.settings, Hypothesis((), search.retuned)
    if begun is None:
        quick = _quick_fits(search, none, search.screened, _chosen(search, [search.retuned]))
        beam = _level(search, quick) or [none]
    else:
        beam = [reshape(search, begun)]
    best, tried = beam[0], beam
    while len(best.effects) < settings.most_effects and _leaves_something(search, best) and search.may_go_on:
        search.progress(Stage(5, f"looking for one effect more than {' + '.join(best.names)}"))
        small = leaves_excess(search.estimation, best.fit) and _is_trace(search, best)
        near = [best] if small else [h for h in beam if comparable(h, best, settings.near, settings)]
        chosen = _chosen(search, [h.fit for h in near])
        beam = _level(search, [child for h in near for child in _expanded(search, h, chosen)])
        tried = [*tried, *beam]
        if not beam or not _gains(search, beam[0], best):
            break
        best = beam[0]
    search.progress(Stage(6, "fitting what was found with exact derivatives"))
    return Selection(search, _finished(search, best, tried), tuple(tried))


def _gains(search: Search, larger: Hypothesis, smaller: Hypothesis) -> bool:
    """Tell whether a larger hypothesis explains most of what the smaller one leaves, also where it was not fitted.

    Any effect takes up some of a rest that nothing known explains; of one that formulas may leave, it must take all.
    """
    estimation, settings = search.estimation, search.settings
    share = 1 - settings.left if _is_trace(search, smaller) else settings.added
    if not _explains(search, larger, smaller, share):
        reason = "not significant"
    else:
        least = estimation.tolerance * len(estimation.measured)
        parts = motions_or_groups(estimation.problem)
        before, after = (sum(map(beyond_noise, left_out(estimation, h.fit, parts))) for h in (smaller, larger))
        reason = "" if after < max((1 - share) * before, least) else "leaves too much where it was left out"
    outcome = "dropped" if reason else "kept"
    estimation.trace.add("level", larger.names, evidence=larger.fit.evidence, outcome=outcome, reason=reason)
    return not reason


def _leaves_something(search: Search, h: Hypothesis) -> bool:
    """Tell whether more is left than noise, or hidden in the file's numbers, which had to go too far."""
    return leaves_excess(search.estimation, h.fit) or retuned_too_far(h.fit, search.settings.chance_sd)


def _explains(search: Search, larger: Hypothesis, smaller: Hypothesis, share: float) -> bool:
    """Tell whether a larger hypothesis explains this share of a smaller one's rest, or frees the file's numbers."""
    if leaves_excess(search.estimation, smaller.fit):
        return significant(larger.fit, smaller.fit, search.settings, share)
    far = retuned_too_far(larger.fit, search.settings.chance_sd)
    return not far and significant(larger.fit, smaller.fit, search.settings, 0.0)


def _is_trace(search: Search, h: Hypothesis) -> bool:
    """Tell whether no more is left than the formulas of the effects may leave."""
    return h.is_trace_of(search.retuned.discrepancy, search.settings)


def _inexact(search: Search, h: Hypothesis) -> bool:
    """Tell whether no more is left than the formula of an effect may leave, so that a richer one must take all of it.

    That is a share of what the least of the effects does at the fitted numbers, before any retuning hides a part.
    """
    others = [{n: x for n, x in h.fit.values.items() if n not in {p.name for p in c.parameters}} for c in h.effects]
    least = min(beyond_noise(r) for r in search.estimation.residuals(others))
    return beyond_noise(h.fit.residual) < h.may_leave(search.settings.trace, search.settings) * least


# ---- expand --------------------------------------------------------------------------------------


def _chosen(search: Search, parents: Sequence[Fit]) -> Sequence[int]:
    """Return the motions in which hypotheses of a level are compared: where the likeliest parent leaves most."""
    return loudest_motions(search.estimation, min(parents, key=lambda each: each.evidence).residual)


def _expanded(search: Search, h: Hypothesis, chosen: Sequence[int]) -> list[Hypothesis]:
    """Score the other effects next to a hypothesis, and fit the most promising ones with it quickly.

    A rest that formulas may leave is small, so that the score foretells what a fit will explain of it.
    """
    if not search.may_go_on:
        return []
    part = _loudest(search, h.fit, chosen)
    others = [c for c in search.estimation.problem.candidates if may_join(c.name, h)]
    screened = screen(part.estimation, part.fit, others)
    if _is_trace(search, h):
        screened = [s for s in screened if -s.evidence > search.settings.added * beyond_noise(part.fit.residual)]
    return _quick_fits(search, h, screened, chosen)


def _loudest(search: Search, fitted: Fit, chosen: Sequence[int] | None = None) -> Subset:
    """Return the motions that hold most of a fit's residual, or chosen ones, coarsely where that is enough."""
    quick = quickest(search.estimation, fitted.values)[0]
    return subset_of(quick, fitted, chosen) or Subset(quick, fitted)


def _quick_fits(search: Search, h: Hypothesis, screened: Sequence[Screened], chosen: Sequence[int]) -> list[Hypothesis]:
    """Fit a hypothesis quickly with each visible effect added."""
    part, grown = _loudest(search, h.fit, chosen), list[Hypothesis]()
    for start in _starts(search, part, h, screened):
        if grown and not search.may_go_on:
            break
        grown.append(_grown(search, part, h, start))
    return grown


@dataclass(frozen=True, eq=False)
class _Start:
    """An effect in one of its forms, with the starting values of a fit."""

    effect: Candidate
    z: FloatArray  # (p + k,) of the parameters of a hypothesis, and of its own

    def values(self, h: Hypothesis) -> dict[str, float]:
        """Return the values of all parameters, by name."""
        return values_at((*h.fit.parameters, *self.effect.parameters), self.z)


def _starts(search: Search, part: Subset, h: Hypothesis, screened: Sequence[Screened]) -> list[_Start]:
    """Return where the fit of each visible effect begins: its form and size that leave least.

    An effect is not linear in its size, so that the score test may miss it, and the size that helps most before
    anything is retuned is not the one to begin with. So each size is simulated, and what retuning explains of the
    residual is projected out. That says where to begin, not which effect will fit: play that is too wide by a third
    explains nothing. The file's numbers are bent by what is missing, so that they are tried as they are, too.
    """
    machines = [h.fit.z] if h.effects else [h.fit.z, np.zeros_like(h.fit.z)]
    tries = [
        _Start(form, np.concatenate([machine, z]))
        for s in screened
        if s.visible
        for form in _first_forms(s.candidate)
        for z in _sizes(s, form)
        for machine in machines
    ]
    residuals = part.estimation.residuals([start.values(h) for start in tries])
    costs = [_retuned_cost(part.fit, r, t.z[: len(h.fit.z)]) for t, r in zip(tries, residuals, strict=True)]
    best: dict[str, _Start] = {}
    for _, start in sorted(zip(costs, tries, strict=True), key=lambda each: each[0]):
        best.setdefault(start.effect.name, start)
    return list(best.values())


def _retuned_cost(fitted: Fit, r: FloatArray, z: FloatArray) -> float:
    """Return what is left of |r|² + φ|z|² once the parameters z (p,) of a fit follow, to first order."""
    prior = fitted.prior * z
    slope = fitted.jacobian.T @ r - prior
    return float(r @ r + z @ prior - slope @ solved(fitted.information, slope))


def _first_forms(c: Candidate) -> list[Candidate]:
    """Return an effect as it is, and in its other form unless that only has a number for each tower or axis."""
    by_tower = c.other is not None and len(c.other.amplitudes) > len(c.amplitudes) and c.other.grid == c.grid
    return [c] if c.other is None or by_tower else [c, c.other]


def _sizes(s: Screened, form: Candidate) -> list[FloatArray]:
    """Return the z, (k,) each, to try: parts of the linear estimate, and of a usual size."""
    shapes = np.array([(s.shape.get(n.name, n.start) - n.start) / n.sd for n in form.shapes])
    if form.switch:
        return [np.ones(1)]
    count = len(form.amplitudes)
    sizes = [np.full(count, size) for size in SIZES]
    if form is s.candidate:
        sizes += [scale * np.clip(s.estimate, -2.0, 2.0) for scale in ESTIMATES]
    tries = [clipped(form.parameters, np.concatenate([a, shapes])) for a in sizes]
    return [z for i, z in enumerate(tries) if np.any(z[:count]) and not any(np.array_equal(z, x) for x in tries[:i])]


def _grown(search: Search, part: Subset, h: Hypothesis, start: _Start) -> Hypothesis:
    """Fit a hypothesis with one effect more, everything together: a few steps in the loudest motions."""
    effects = (*h.effects, start.effect)
    log_try(effects, search.progress)
    machine = held(h.machine_parameters, effects)
    parameters = (*machine, *h.effect_parameters, *start.effect.parameters)
    z = clipped(parameters, start.z)
    residual, every = part.estimation.residual(values_at(parameters, z)), range(len(parameters))
    new = every[len(h.fit.parameters) :]
    columns = np.hstack([part.fit.jacobian, derivatives(part.estimation, parameters, z, residual, new)])
    renewed = new if len(new) <= RENEWED else ()
    fitted = fit(part.estimation, parameters, z, columns, renewed, 6, QUICK_GAIN, renew_all=False)
    return log_fit(search.estimation, Hypothesis(effects, fitted), search.progress, ", quickly")


# ---- fit -----------------------------------------------------------------------------------------


def _level(search: Search, children: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Fit the likeliest children fully, each in the form that pays: the beam, the likeliest first."""
    ranked = distinct(likeliest(children))
    far = search.settings.near**2  # of quick fits, which are rough
    chosen = [h for h in ranked[: search.settings.width] if comparable(h, ranked[0], far, search.settings)]
    for h in ranked:
        outcome, reason = ("kept", "") if h in chosen else ("dropped", "others leave less of the loudest motions")
        search.estimation.trace.add(
            "prune", h.names, left=h.discrepancy, evidence=h.fit.evidence, outcome=outcome, reason=reason
        )
    fitted: list[Hypothesis] = []
    for h in chosen:
        if not fitted or search.may_go_on:
            fitted.append(continue_fit(search.estimation, h, search.progress))
    fitted, beam = likeliest(fitted), list[Hypothesis]()
    near = [h for h in fitted if comparable(h, fitted[0], search.settings.near, search.settings)]
    for h in fitted:
        laws = [other for other in near if other.causes == h.causes]  # the smallest's richer forms are those of all
        beam.append(reshape(search, h) if laws and h is min(laws, key=lambda law: law.effect_count) else h)
    return likeliest(beam)


def reshape(search: Search, h: Hypothesis) -> Hypothesis:
    """Go over to richer forms of the effects while something is left and they pay.

    A form has other numbers free: its usual shape, a number for each tower, a law that contains it.
    """
    while leaves_excess(search.estimation, h.fit) and search.may_go_on:
        share = 1 - search.settings.left if _inexact(search, h) else search.settings.reshaped_share
        best = h
        for start in _richer(search, h, share):
            if not leaves_excess(search.estimation, best.fit):
                break  # the smaller form explains all
            known = h.fit.jacobian[:, : h.machine_count]
            fitted = continue_fit(search.estimation, start, search.progress, ", in another form", known)
            if significant(fitted.fit, best.fit, search.settings, share):
                best = fitted
        if best is h:
            break
        h = best
    return h


def _richer(search: Search, h: Hypothesis, share: float) -> list[Hypothesis]:
    """Return the smallest starts with one effect in a form with more numbers that promise most of what any does.

    What a form adds begins where it helps most, with everything else retuned to first order; one that promises less
    than half of what it must bring is left out.
    """
    part, begun, settings = _loudest(search, h.fit), list[tuple[float, Hypothesis]](), search.settings
    for effects in _other_forms(search, h):
        start = _mapped(effects, h)
        if start.effect_count > h.effect_count:
            begun.append(_best_start(part, start, h))
    now = part.fit.chi_squared + float(part.fit.z @ (part.fit.prior * part.fit.z))
    enough = now - share * max(now - len(part.fit.residual), 0.0) / 2
    best = min((cost for cost, _ in begun), default=np.inf)
    near = [each for each in begun if each[0] < min(enough, now - settings.added * (now - best))]
    return [
        start
        for _, start in sorted(near, key=lambda each: (each[1].needed, each[1].effect_count, each[0]))[: settings.forms]
    ]


def _best_start(part: Subset, start: Hypothesis, h: Hypothesis) -> tuple[float, Hypothesis]:
    """Return where a fit in another form begins, and what is left of |r|² + φ|z|² there, retuned to first order.

    Its new numbers are set where they help most: sizes with the shapes that are searched, for one does nothing without
    the other, and then each optional shape.
    """
    parameters, z, cost = start.fit.parameters, start.fit.z, np.inf
    new = [i for i, n in enumerate(parameters) if carried_over(h.fit.values, n.name) is None]
    sizes = [i for i in new if parameters[i].name in {n.name for c in start.effects for n in c.amplitudes}]
    grids = {i: own for i in new if i not in sizes and (own := _searched(start, parameters[i]))}
    sized = product(ADDED_SIZES if sizes else (0.0,), *grids.values())
    together = [(point[0],) * len(sizes) + point[1:] for point in sized]
    stages: list[tuple[list[int], list[tuple[float, ...]]]] = [([*sizes, *grids], together)]
    stages += [([i], [(shift,) for shift in SHIFTS]) for i in new if i not in (*sizes, *grids)]
    for which, points in stages:
        tries = np.repeat(z[None], len(points), axis=0)
        tries[:, which] = np.array(points)
        tries = np.clip(tries, *limits_of(parameters))
        costs = [
            _retuned_cost(part.fit, r, part.fit.z)
            for r in part.estimation.residuals([values_at(parameters, x) for x in tries])
        ]
        if min(costs) < cost:
            z, cost = tries[int(np.argmin(costs))], min(costs)
    return cost, replace(start, fit=replace(start.fit, z=z))


def _other_forms(search: Search, h: Hypothesis) -> list[tuple[Candidate, ...]]:
    """Return the effects with one of them in another form, or by another law of its cause where that is asked for."""
    found: list[tuple[Candidate, ...]] = []
    for effect in h.effects:
        laws = [
            c for c in search.estimation.problem.candidates if CATALOGUE[c.name].cause == CATALOGUE[effect.name].cause
        ]
        kinds = [
            form for c in laws for each in (c, c.other or c) for form in (each, each.shaped, each.of_alternative_kind)
        ]
        different = {frozenset(n.name for n in form.parameters): form for form in kinds}
        different.pop(frozenset(n.name for n in effect.parameters), None)
        found += [tuple(form if c is effect else c for c in h.effects) for form in different.values()]
    return found


def _mapped(effects: tuple[Candidate, ...], h: Hypothesis) -> Hypothesis:
    """Take over the present values for other forms of the effects: of all towers, or the mean of the towers'."""
    parameters = (*h.machine_parameters, *(n for c in effects for n in c.parameters))
    known = h.fit.values

    def z_of(n: Parameter) -> float:
        x = carried_over(known, n.name)
        return 0.0 if x is None else (x - n.start) / n.sd

    z = clipped(parameters, np.array([z_of(n) for n in parameters]))
    unknown = np.zeros((len(h.fit.residual), len(z)))
    return Hypothesis(effects, replace(h.fit, parameters=parameters, z=z, jacobian=unknown))


def _searched(h: Hypothesis, shape: Parameter) -> list[float]:
    """Return the z of a new shape where a search for the effect begins; none of an optional one."""
    points = {point[shape.name] for c in h.effects for point in c.grid if shape.name in point}
    return [(x - shape.start) / shape.sd for x in sorted(points)]


# ---- finish --------------------------------------------------------------------------------------


def _finished(search: Search, best: Hypothesis, tried: Sequence[Hypothesis]) -> Hypothesis:
    """Leave out of the best hypothesis the effects that it does not need, and fit it with exact derivatives.

    Of others as many with fewer numbers, and of laws of its family, too: what quick fits make of the two is no reason
    for more numbers. One that leaves too much to be named, even with a rest, stays as it is.
    """
    if best.discrepancy > (1 - search.settings.added) * search.retuned.discrepancy:
        search.estimation.trace.add("finish", best.names, outcome="as it is", reason="it leaves too much")
        return best
    best = fit_exactly(search.estimation, _without_idle(search, best, tried), search.progress)
    others = [h for h in likeliest(tried) if len(h.effects) == len(best.effects)]
    for law in (True, False):
        alike = [h for h in others if (h.causes == best.causes) == law and comparable(h, best, 2.0, search.settings)]
        for h in [h for h in alike if (h.needed < best.needed if law else h.kinds < best.kinds)][:1]:
            simpler = fit_exactly(search.estimation, h, search.progress)
            gains = significant(best.fit, simpler.fit, search.settings, search.settings.reshaped_share)
            if (law and _inexact(search, simpler)) or not gains:
                best = simpler
    return best


def _without_idle(search: Search, best: Hypothesis, tried: Sequence[Hypothesis]) -> Hypothesis:
    """Drop the effects that explain too little of what the others leave, fitted without them."""
    estimation = search.estimation
    while len(best.effects) > 1:
        rests = [best.without(c, estimation.problem.parameters) for c in best.effects]
        fitted = [continue_fit(estimation, rest, search.progress) for rest in rests]
        known = [h for h in tried if h.names in [rest.names for rest in rests]]
        smaller = likeliest([*fitted, *known])[0]
        needed = _explains(search, best, smaller, search.settings.added)
        outcome, reason = "refused" if needed else "kept", f"of {' + '.join(best.names)}"
        estimation.trace.add("drop", smaller.names, outcome=outcome, reason=reason)
        if needed:
            break
        best = smaller
    return best
