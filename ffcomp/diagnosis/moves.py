"""The moves of the search: add an effect, drop one, swap one, reshape one. Each yields fitted hypotheses.

Adding one effect after the other is greedy: the first of two is chosen by what it explains alone, where it may stand
in for a part of the other. So each is also swapped for what helps most beside the rest (sequential floating search:
Pudil, Novovičová & Kittler, Pattern Recognition Letters 15, 1994).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from ffcomp.diagnosis.fidelity import (
    ESTIMATE_SCALES,
    USUAL_SIZES,
    Start,
    best_start,
    by_continuation,
    continue_fit,
    fit_exactly,
    grow,
    predicted_without,
    refit,
    restart_from_file,
    select_starts,
    straightened,
    with_restart,
)
from ffcomp.diagnosis.fit import (
    EstimationProblem,
    Fit,
    clipped,
    derivatives,
    fit,
    intervals_of,
    superfluous,
    values_at,
)
from ffcomp.diagnosis.held_out import motions_against
from ffcomp.diagnosis.hypotheses import (
    FILE_CHANGES,
    NESTED,
    Hypothesis,
    comparable,
    distinct,
    incomplete,
    likeliest,
    log_fit,
    log_try,
    may_join,
    nested,
    significant,
    worth,
)
from ffcomp.diagnosis.problem import Candidate, Parameter, stem_of
from ffcomp.diagnosis.recording_clocks import belongs_to_recording
from ffcomp.diagnosis.score_test import Screened, Subset, pair_evidence, screen, screen_in_subset, similarity, subset_of
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.numerics.stages import Progress
from models.arrays import FloatArray

SHAPE_SHIFTS = (0.0, 1.0, 2.0, 3.0, 4.0)  # standard deviations from the usual, at which a shape is tried
NESTED_SHARES = (0.3, 1.0)  # of the size that a simpler effect has, at which what a richer one adds is tried


@dataclass(frozen=True, eq=False)
class Search:
    """Everything the moves work with."""

    estimation: EstimationProblem
    bases: Sequence[tuple[Fit, Sequence[Screened]]]  # fits of the machine's parameters, with what was screened there
    retuned: Fit  # the machine's parameters alone, at their best
    progress: Progress

    @property
    def little(self) -> float:
        """What may be left of the discrepancy by an effect of a somewhat different shape."""
        return SETTINGS.little * self.retuned.discrepancy

    @property
    def trace(self) -> float:
        """What may be left of the discrepancy by an effect of our shape: no formula is more exact."""
        return SETTINGS.trace * self.retuned.discrepancy

    @property
    def may_go_on(self) -> bool:
        """Whether the budget allows to try anything more."""
        return self.estimation.may_go_on

    @property
    def quick(self) -> EstimationProblem:
        """The same problem, simulated coarsely."""
        return replace(self.estimation, coarse=True)

    @property
    def candidates(self) -> Sequence[Candidate]:
        """The effects that are looked for."""
        return self.estimation.problem.candidates


# ---- add -----------------------------------------------------------------------------------------


def add(search: Search, best: Hypothesis) -> list[Hypothesis]:
    """Fit the best hypothesis with one effect more; where a single one explains poorly, also pairs of the screened."""
    quick, (base, screened), count = search.quick, search.bases[0], SETTINGS.by_simulation
    others = [c for c in search.candidates if may_join(c.name, best.names)]
    starts = select_starts(quick, best.fit, screen_in_subset(quick, best.fit, others)[:count], large=False)
    begun = [(best, start) for start in starts]
    if best.discrepancy > max(SETTINGS.large, search.little) or not best.plausible:
        restarted = restart_from_file(quick, best)
        begun += [(restarted, start) for start in _helpful_starts(quick, restarted, others, count)]
    grown: list[Hypothesis] = []
    for h, start in begun:
        if search.may_go_on:
            grown.append(grow(quick, h, start, search.progress, min((g.discrepancy for g in grown), default=np.inf)))
    ranked = distinct(likeliest(grown))
    poor = best.discrepancy > SETTINGS.poor * search.retuned.discrepancy
    # where one more explains nearly all, the best was half of the answer, and no pair without it is looked for
    if poor and len(best.effects) == 1 and not any(h.discrepancy < search.little for h in ranked):
        pairs = [p for p in combinations(screened[: SETTINGS.paired], 2) if _may_pair(p, ranked)]
        likely = sorted(pairs, key=lambda pair: pair_evidence(base, pair))[: SETTINGS.swaps]
        nothing = Hypothesis((), base)
        ranked += [grow(quick, nothing, best_start(quick, base, pair), search.progress) for pair in likely]
        ranked = likeliest(ranked)
    kept = [h for h in ranked[:2] if comparable(h, ranked[0], SETTINGS.keep_fitted) and _promising(quick, best, h)]
    return fit_fully(search, kept) + [h for h in ranked if h not in kept]


def _helpful_starts(
    quick: EstimationProblem, beside: Hypothesis, others: Sequence[Candidate], count: int
) -> list[Start]:
    """Return the starts of those effects that really help most beside others."""
    starts = select_starts(quick, beside.fit, screen_in_subset(quick, beside.fit, others), large=True)
    return sorted(starts, key=lambda start: start.cost)[:count]


def _may_pair(pair: Sequence[Screened], grown: Sequence[Hypothesis]) -> bool:
    """Tell whether two effects may act together, and were not tried so."""
    one, other = (s.candidate.name for s in pair)
    return {one, other} not in [set(h.names) for h in grown] and not nested(one, other)


def _promising(quick: EstimationProblem, best: Hypothesis, larger: Hypothesis) -> bool:
    """Tell whether a larger hypothesis, fitted coarsely, removes a quarter of what it must there too."""
    if not set(best.names) < set(larger.names):
        return True  # it has replaced an effect: the coarse fits are not one inside the other
    coarse = replace(best.fit, residual=quick.residual(best.fit.values))
    return larger.discrepancy < (1 - SETTINGS.added_share / 4) * coarse.discrepancy


def fit_fully(search: Search, contenders: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Fit contenders fully, the likeliest first; those that another leaves far behind stay as they are.

    Of all of them, and of those with plausible numbers of the file, only the likeliest is begun anew at these numbers:
    all have been begun there before they were ranked.
    """
    fitted: list[Hypothesis] = []
    for h in contenders:
        # what needs implausible numbers is no measure for what does not
        rivals = [i for i, other in enumerate(fitted) if other.plausible or not h.plausible]
        best = min(rivals, key=lambda i: fitted[i].fit.evidence, default=None)
        # compared as they were ranked: coarse steps leave of strong friction a tenth, which exact ones do not;
        # and what needs fewer numbers is not given up for what more of them reach sooner
        behind = best is not None and not comparable(
            h,
            contenders[best],
            SETTINGS.keep_initial if h.effect_count < contenders[best].effect_count else SETTINGS.keep_added,
        )
        spent = bool(fitted) and not search.may_go_on
        fitted.append(h if behind or spent else continue_fit(search.estimation, h, search.progress))
    first = [min(range(len(fitted)), key=lambda i: fitted[i].fit.evidence)] if fitted else []
    held = [i for i, h in enumerate(contenders) if h.plausible][:1]
    for i in {*first, *held}:
        fitted[i] = with_restart(search.estimation, fitted[i], search.progress, search.little)
    return fitted


def add_file_change(search: Search, best: Hypothesis) -> list[Hypothesis]:
    """Add an effect that is a change of a number of the file, begun at the file: the other one of two may be it.

    Above all the one that does what the number did that moved furthest.
    """
    others = [c for c in search.candidates if c.name in FILE_CHANGES and c.name not in best.names]
    if not others or not search.may_go_on:
        return []
    rest = restart_from_file(search.quick, best)
    starts = select_starts(search.quick, rest.fit, screen_in_subset(search.quick, rest.fit, others), large=True)
    starts = sorted(starts, key=lambda start: start.cost)
    alike = _like_the_furthest(search, best, others)
    tried = [*starts[: SETTINGS.swaps], *(start for start in starts[SETTINGS.swaps :] if _name(start) == alike)]
    grown = {_name(start): grow(search.quick, rest, start, search.progress) for start in tried}
    # the file's numbers go back for the price of their prior alone: that is seen at the end of a fit only
    near = [h for h in likeliest(list(grown.values()))[:1] if comparable(h, best, SETTINGS.keep_straight)]
    same = grown.get(alike)
    if same is not None and same not in near and comparable(same, best, SETTINGS.keep_fitted):
        near.append(same)
    return [h for h in (refit(search.estimation, h, search.progress) for h in near) if h.plausible]


def _name(start: Start) -> str:
    return start.chosen[0].candidate.name


def _like_the_furthest(search: Search, best: Hypothesis, others: Sequence[Candidate]) -> str:
    """Return which of these effects does nearly what that number of the file does that moved furthest; "" if none."""
    moved = [
        0.0 if belongs_to_recording(n.name) else abs(z)
        for n, z in zip(best.machine_parameters, best.fit.z, strict=False)
    ]
    there = subset_of(search.quick, best.fit) or Subset(search.quick, best.fit)
    column = there.fit.jacobian[:, int(np.argmax(moved))]

    def share(s: Screened) -> float:
        part = s.signature @ np.linalg.lstsq(s.signature, column, rcond=None)[0]
        return float(part @ part) / max(float(column @ column), 1e-300)

    first = max(screen(there.estimation, there.fit, others), key=share)
    return first.candidate.name if share(first) > SETTINGS.confounded else ""


# ---- drop ----------------------------------------------------------------------------------------


def drop(search: Search, best: Hypothesis) -> Hypothesis:
    """Drop effects whose intervals include none, or that the others can do without, while nothing significant is lost.

    A number of the file that is off may bring in an effect beside the right one, before that one is there. And what no
    two motions agree on is the error of the others' shapes, however significant it is, where these leave nothing, or
    where it does as much harm as good to motions that it was not fitted to.
    """
    estimation = search.estimation
    intervals, agreed = (intervals_of(estimation, best.fit, best.fit.values, scatter=each) for each in (False, True))
    without = {c.name: predicted_without(best, c) for c in best.effects}
    disputed = [c for c in best.effects if superfluous(c, agreed)]
    idle = [
        c
        for c in best.effects
        if c in disputed or superfluous(c, intervals) or not significant(best.fit, without[c.name])
    ]
    if not idle or len(best.effects) == 1:
        return best
    least = min(idle, key=lambda c: without[c.name].evidence)
    smaller = refit(estimation, best.without(least), search.progress)
    nothing_left = smaller.discrepancy < max(estimation.tolerance, search.trace)
    if worth(best.fit, smaller.fit, estimation.whiten.floor):
        spurious = least in disputed and smaller.plausible
        if not (spurious and (nothing_left or motions_against(estimation, best.fit, smaller.fit))):
            return best
    return drop(search, fit_exactly(estimation, smaller, search.progress))


# ---- swap ----------------------------------------------------------------------------------------


def swap(search: Search, best: Hypothesis, tried: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Fit a hypothesis with each of its effects in turn swapped for those that help most beside the others."""
    known, grown = [set(h.names) for h in tried], list[Hypothesis]()
    for effect in best.effects:
        if not search.may_go_on:
            break
        rest = restart_from_file(search.quick, best.without(effect))
        possible = [c for c in search.candidates if c.name != effect.name and may_join(c.name, rest.names)]
        others = [c for c in possible if {*rest.names, c.name} not in known]
        starts = _helpful_starts(search.quick, rest, others, SETTINGS.swaps)
        grown += [grow(search.quick, rest, start, search.progress) for start in starts]
    ranked = distinct(likeliest(grown))
    kept = [
        h
        for h in ranked[: SETTINGS.swaps]
        if comparable(h, min(best, ranked[0], key=lambda each: each.discrepancy), SETTINGS.keep_fitted)
    ]
    return [_fitted_in_best_shape(search, h, best) for h in kept]


def swap_for_alike(search: Search, best: Hypothesis, tried: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Fit a hypothesis with one of its effects replaced by a smaller one that does much the same.

    Or by any that is confounded with it: which of the two it is shows beside the others only.
    """
    screened, fitted, known = search.bases[0][1], list[Hypothesis](), [set(h.names) for h in tried]
    restarted: Hypothesis | None = None
    for effect in best.effects:
        named = [s for s in screened if s.candidate.name == effect.name]
        for s in screened:
            name, smaller = s.candidate.name, len(s.candidate.parameters) < len(effect.parameters)
            new = name not in best.names and {name, *best.names} - {effect.name} not in known
            enough = SETTINGS.alike if smaller else SETTINGS.confounded
            if new and any(similarity(s, each) > enough for each in named) and search.may_go_on:
                restarted = restarted or restart_from_file(search.estimation, best)
                rest = restarted.without(effect)
                start = best_start(search.estimation, rest.fit, (s,), ESTIMATE_SCALES[:4], USUAL_SIZES)
                grown = grow(search.estimation, rest, start, search.progress)
                fitted.append(_fitted_in_best_shape(search, grown, best))
    return fitted


def _fitted_in_best_shape(search: Search, h: Hypothesis, best: Hypothesis) -> Hypothesis:
    """Fit what replaces an effect of the best hypothesis.

    Where that leaves far more, or as much as without what was put in its place, no restart or shape is tried.
    """
    fitted = continue_fit(search.estimation, h, search.progress)
    idle = [c for c in fitted.effects if c.name not in best.names and not _gains(fitted, c)]
    if idle or not comparable(fitted, best, SETTINGS.keep_initial):
        return fitted
    return reshape(search.estimation, with_restart(search.estimation, fitted, search.progress), search.progress)


def _gains(h: Hypothesis, effect: Candidate) -> bool:
    """Tell whether an effect removes a tenth of what is left without it, as predicted."""
    return significant(h.fit, predicted_without(h, effect), SETTINGS.reshaped_share)


def swap_for_nested(search: Search, h: Hypothesis) -> list[Hypothesis]:
    """Fit each effect in turn in the richer model that contains it (`NESTED`), if there is one: one hypothesis each.

    A fit begins at the numbers of the simpler form: from usual sizes it may end far from them.
    """
    by_name, fitted = {c.name: c for c in search.candidates}, list[Hypothesis]()
    for effect in h.effects:
        names = [name for name, simpler in NESTED.items() if simpler == effect.name and name in by_name]
        if not names or not search.may_go_on:
            continue
        richer = by_name[names[0]]
        form = richer.other if effect.other is None and richer.other is not None else richer
        form = form.of_alternative_kind if _is_alternative(effect, by_name[effect.name]) else form.shaped
        begun = _started_richer(search.quick, h, effect, form)
        fitted.append(
            reshape(search.estimation, continue_fit(search.estimation, begun, search.progress), search.progress)
        )
    return fitted


def swap_for_law_within(search: Search, best: Hypothesis) -> Hypothesis:
    """Exchange each law for the simpler one that it contains, at the numbers that it has, where that loses nothing.

    A richer law may only have led to the right place: what it has beyond the simpler one is then not determined.
    """
    by_name = {c.name: c for c in search.candidates}
    for effect in best.effects:
        if (simple := by_name.get(NESTED.get(effect.name, ""))) is None:
            continue
        kinds = [kind for c in (simple, simple.other or simple) for kind in (c.shaped, c.of_alternative_kind)]
        prefix = f"effects.{effect.name}."
        values = {n.replace(prefix, f"effects.{simple.name}."): x for n, x in best.fit.values.items()}
        form = max(kinds, key=lambda c: sum(n.name in values for n in c.parameters))
        kept = replace(
            form,
            amplitudes=tuple(n for n in form.amplitudes if n.name in values),
            shapes=tuple(n for n in form.shapes if n.name in values),
            other=None,
        )
        effects = tuple(kept if c is effect else c for c in best.effects)
        parameters = (*best.machine_parameters, *(n for c in effects for n in c.parameters))
        z = np.array([(values[n.name] - n.start) / n.sd for n in parameters])
        begun = Hypothesis(effects, Fit(parameters, clipped(parameters, z), best.fit.residual, best.fit.jacobian))
        smaller = continue_fit(search.estimation, begun, search.progress)
        if not comparable(smaller, best, SETTINGS.keep_initial):
            continue
        smaller = fit_exactly(search.estimation, smaller, search.progress)
        best = best if worth(best.fit, smaller.fit, search.estimation.whiten.floor) else smaller
    return best


def _started_richer(quick: EstimationProblem, h: Hypothesis, effect: Candidate, form: Candidate) -> Hypothesis:
    """Exchange an effect for its richer form, at the numbers that it has; what is new begins where it helps most."""
    prefix = f"effects.{effect.name}."
    renamed = {
        f"effects.{form.name}.{n.removeprefix(prefix)}": x for n, x in h.fit.values.items() if n.startswith(prefix)
    }
    known = {**h.fit.values, **renamed}
    effects = tuple(form if c is effect else c for c in h.effects)
    parameters = (*h.machine_parameters, *(n for c in effects for n in c.parameters))
    z = np.array([(known.get(n.name, n.start) - n.start) / n.sd for n in parameters])
    # by tower or axis, the size that the simpler form has there
    sizes = {_index(n): n.sd * z[i] for i, n in enumerate(parameters) if n in form.amplitudes and n.name in known}
    new = [(i, n) for i, n in enumerate(parameters) if n.name not in known]
    added = [(i, sizes.get(_index(n), 0.0) / n.sd) for i, n in new if n in form.amplitudes]
    shapes = [i for i, n in new if n in form.shapes][:1]
    tries = []
    for share, shift in product(NESTED_SHARES, SHAPE_SHIFTS):
        trial = z.copy()
        for i, size in added:
            trial[i] = share * size
        tries.append(_shifted(parameters, trial, shapes, [shift] * len(shapes)))
    best, _ = _cheapest(quick, parameters, tries)
    return Hypothesis(effects, Fit(parameters, best, h.fit.residual, h.fit.jacobian))


def _index(n: Parameter) -> str:
    """Return which tower or axis a parameter is of."""
    return n.name.partition("[")[2]


# ---- reshape -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ShapeChange:
    """Another form of the effects of a hypothesis, to be kept where it pays."""

    note: str
    change: Callable[[Candidate, Candidate], Candidate]  # an effect and the candidate it is of -> its other form
    simpler: bool = False  # it has fewer parameters: kept unless the present form is significantly better
    searched: bool = False  # its new parameters begin where they help most


def _freed(effect: Candidate, first: Candidate) -> Candidate:
    return effect if _is_alternative(effect, first) else effect.shaped


def _alternative(effect: Candidate, first: Candidate) -> Candidate:
    possible = first.alternative and not _is_alternative(effect, first)
    return _whole(effect, first).of_alternative_kind if possible else effect


def _usual(effect: Candidate, first: Candidate) -> Candidate:
    return _whole(effect, first).shaped if _is_alternative(effect, first) else effect


def _other(effect: Candidate, first: Candidate) -> Candidate:
    if effect.other is None:
        return effect
    if _is_alternative(effect, first):
        return effect.other.of_alternative_kind
    return effect.other if effect.finer else effect.other.shaped


def _first(effect: Candidate, first: Candidate) -> Candidate:
    if effect.other is not None or first.other is None:
        return effect
    if _is_alternative(effect, first):
        return first.of_alternative_kind
    if {n.name for n in effect.shapes} - {n.name for n in first.shaped.shapes}:
        return effect  # the same at another spring, which is no simpler
    return first if effect.finer or not first.finer else first.shaped


def _is_alternative(effect: Candidate, first: Candidate) -> bool:
    """Tell whether an effect has the shapes of its alternative kind."""
    return not {stem_of(n.name) for n in effect.shapes}.isdisjoint(stem_of(n.name) for n in first.alternative)


def _whole(effect: Candidate, first: Candidate) -> Candidate:
    """Return the candidate that an effect is of, with all that may be set free."""
    return first.other if effect.other is None and first.other is not None else first


FREED = ShapeChange(" in its own shape", _freed, searched=True)  # usual shapes set free
ALTERNATIVE = ShapeChange(", bent before it slides", _alternative, searched=True)  # others in their place
USUAL = ShapeChange(", in the shape of the first kind", _usual, searched=True)
SHAPE_CHANGES = (
    ShapeChange(", in its other form", _other),  # a parameter for each tower
    ShapeChange(", in its first", _first, simpler=True),  # one for all towers again
)


def reshape(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Try every shape change in turn, and keep those that pay."""
    before = h.discrepancy
    for change in (*_kinds(estimation, h), *SHAPE_CHANGES):
        effects = _changed(estimation, h, change)
        if effects == h.effects or not estimation.may_go_on or _settled(h, before, change):
            continue
        begun = _with_effects(effects, h)
        if change.searched:
            begun, _ = _placed(estimation, begun, h)
        fitted = continue_fit(estimation, begun, progress, change.note, h.machine_jacobian)
        smaller, larger = (fitted, h) if change.simpler else (h, fitted)
        if significant(larger.fit, smaller.fit, SETTINGS.reshaped_share) == (larger is fitted):
            h = straightened(estimation, fitted, progress)
    return h


def reshape_thoroughly(search: Search, h: Hypothesis) -> Hypothesis:
    """Reshape; where that leaves much, or needs implausible numbers, go on by continuation with the shapes it has."""
    shaped = reshape(search.estimation, h, search.progress)
    much = shaped.discrepancy > max(SETTINGS.large, search.little if shaped.plausible else 0.0)
    unsettled = much and shaped.effects != h.effects and search.may_go_on
    return by_continuation(search.estimation, shaped, search.progress) if unsettled else shaped


def free_shapes(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Set the usual shapes of the effects free where that is significant, little as it may explain.

    A shape that is held where it usually is moves the numbers beside it, by more than their intervals say.
    """
    effects = tuple(c.shaped for c in h.effects)
    if effects == h.effects or not estimation.may_go_on:
        return h
    log_try(effects, progress, " in its own shape")
    begun = _placed(estimation, _with_effects(effects, h), h)[0].fit
    residual, which = estimation.residual(begun.values), range(h.machine_count, len(begun.parameters))
    start = np.hstack([h.machine_jacobian, derivatives(estimation, begun.parameters, begun.z, residual, which)])
    freed = Hypothesis(effects, fit(estimation, begun.parameters, begun.z, start, iterations=6, exact=True))
    gain = (h.fit.evidence - freed.fit.evidence) / freed.fit.misfit
    return log_fit(freed, progress, " in its own shape") if gain > SETTINGS.significant else h


def _settled(h: Hypothesis, before: float, change: ShapeChange) -> bool:
    """Tell whether one kind of shape explains so much that the other one need not be tried.

    Where friction bends, one that creeps may still move the file's damping; the other way round nothing is moved.
    """
    if change not in (ALTERNATIVE, USUAL) or h.discrepancy >= SETTINGS.little * before:
        return False
    return change is USUAL or h.plausible


def _kinds(estimation: EstimationProblem, h: Hypothesis) -> tuple[ShapeChange, ...]:
    """Return the changes that set shapes free, first the kind that leaves less where it begins: often it suffices.

    It saves the fit of the other kind, which leads far astray.
    """
    if not any(c.alternative for c in h.effects):
        return (FREED,)
    effects = [_changed(estimation, h, kind) for kind in (ALTERNATIVE, FREED)]
    if h.effects in effects or not estimation.may_go_on:
        return FREED, ALTERNATIVE
    alternative, freed = (_placed(estimation, _with_effects(each, h), h)[1] for each in effects)
    return (ALTERNATIVE, FREED, USUAL) if alternative < freed else (FREED, ALTERNATIVE)


def _changed(estimation: EstimationProblem, h: Hypothesis, change: ShapeChange) -> tuple[Candidate, ...]:
    """Change the effects' form; leave them where a richer one has nothing left to explain.

    Implausible numbers of the file are something to explain: one change for all belts moves those of the axes that have
    none.
    """
    if not change.simpler and not incomplete(estimation, h):
        return h.effects
    by_name = {c.name: c for c in estimation.problem.candidates}
    return tuple(change.change(c, by_name[c.name]) for c in h.effects)


def _with_effects(effects: tuple[Candidate, ...], h: Hypothesis) -> Hypothesis:
    """Take over the present values for other forms of the effects: of all towers, or the mean of the towers'."""
    parameters = (*h.machine_parameters, *(n for c in effects for n in c.parameters))
    known = {n.name: float(z) for n, z in zip(h.fit.parameters, h.fit.z, strict=True)}

    def z_of(n: Parameter) -> float:
        stem = stem_of(n.name)
        if n.name in known or stem in known:
            return known.get(n.name, known.get(stem, 0.0))
        parts = [z for name, z in known.items() if stem_of(name) == stem]
        return float(np.mean(parts)) if parts else 0.0

    z = clipped(parameters, np.array([z_of(n) for n in parameters]))
    return Hypothesis(effects, Fit(parameters, z, h.fit.residual, h.fit.jacobian))


def _placed(estimation: EstimationProblem, begun: Hypothesis, before: Hypothesis) -> tuple[Hypothesis, float]:
    """Begin new parameters, effect by effect, where they help most: far from there, no slope may point the way.

    Returns
    -------
    The hypothesis, and the cost that it has there.
    """
    parameters, z, cost, subset = begun.fit.parameters, begun.fit.z, np.inf, subset_of(estimation, before.fit)
    quick = replace(estimation if subset is None else subset.estimation, coarse=True)
    for effect in begun.effects:
        new = [i for i, n in enumerate(parameters) if n in effect.parameters and n not in before.fit.parameters]
        steps = SHAPE_SHIFTS if len(new) < 3 else SHAPE_SHIFTS[::2]
        tries = [z, *(_shifted(parameters, z, new, shift) for shift in product(steps, repeat=len(new)))]
        z, cost = _cheapest(quick, parameters, tries)
    return Hypothesis(begun.effects, replace(begun.fit, z=z)), cost


def _cheapest(
    quick: EstimationProblem, parameters: Sequence[Parameter], tries: Sequence[FloatArray]
) -> tuple[FloatArray, float]:
    """Return the z (p,) that costs least, and its cost."""
    residuals = quick.residuals([values_at(parameters, z) for z in tries])
    costs = [float(r @ r + z @ z) for r, z in zip(residuals, tries, strict=True)]
    return tries[int(np.argmin(costs))], min(costs)


def _shifted(
    parameters: Sequence[Parameter], z: FloatArray, which: Sequence[int], shift: Sequence[float]
) -> FloatArray:
    shifted = z.copy()
    shifted[list(which)] += shift
    return clipped(parameters, shifted)
