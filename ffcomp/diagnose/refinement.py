"""Refinement of one hypothesis: continue, refit and refine its fit, and converge on the shapes of its effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit, clipped, derivatives, fit, values_at
from ffcomp.diagnose.glimpse import glimpse_of, quietest_motions
from ffcomp.diagnose.hypotheses import (
    CONTAINED,
    IMPLAUSIBLE,
    LARGE,
    SIGNIFICANT,
    Hypothesis,
    implausible,
    incomplete,
    log_fit,
    log_try,
    misfit,
    significant,
    without_effect,
)
from ffcomp.diagnose.initial_fits import FEW, QUICK
from ffcomp.diagnose.problem import Candidate, Parameter, stem_of
from ffcomp.diagnose.progress import Progress
from ffcomp.diagnose.recording_delays import belongs_to_recording
from models.arrays import FloatArray

COARSE_ERROR = 1e-3  # of the cost, by which coarse simulations may be off
SETTLED = 0.02  # of the discrepancy, that a shape leaves: no other kind of shape is asked for
SHAPE_SHARE = 0.1  # of the discrepancy must a freer shape of the same effect remove
TELLING = 2.0  # −2 ln Z, times the misfit: what a fit may still gain without another effect gaining it in its place
FEWEST, FURTHER = 2, 2  # motions to begin with where a fit goes by degrees, and by which it goes on
SHARES = (0.3, 1.0)  # of the size that a simpler effect has, at which what a richer one adds is tried
SPREAD = (0.0, 1.0, 2.0, 3.0, 4.0)  # standard deviations from the usual, at which a shape is tried


def continue_fit(
    estimation: EstimationProblem, h: Hypothesis, progress: Progress, note: str = "", known: FloatArray | None = None
) -> Hypothesis:
    """Continue a fit from derivatives taken anew, with every kink as sharp as it is.

    Parameters
    ----------
    known : (rows, own) derivatives by the machine's parameters, where they are known well enough.
    """
    log_try(h.effects, progress, note)
    everything = range(len(h.fit.parameters))
    asked = everything if known is None else everything[-h.added :]
    ranked, residual = _quickest(estimation, h.fit.values)
    columns = derivatives(ranked, h.fit.parameters, h.fit.z, residual, asked, rough=h.own)
    if known is not None:
        columns = np.hstack([known, columns])
    renew = everything[-h.added :] if h.added <= FEW else ()
    found = fit(ranked, h.fit.parameters, h.fit.z, columns, renew, iterations=10, small_gain=QUICK, rough=h.own)
    if ranked is not estimation:
        exact = estimation.residual(found.values)
        if _negligible(found.residual - exact, exact):
            found = replace(found, residual=exact)
        else:
            begun = found.jacobian
            found = fit(estimation, found.parameters, found.z, begun, renew, 10, small_gain=QUICK, rough=h.own)
    return log_fit(Hypothesis(h.effects, found), progress, note)


def _quickest(estimation: EstimationProblem, values: Mapping[str, float]) -> tuple[EstimationProblem, FloatArray]:
    """Return the problem, coarse where that errs by nothing that matters beside what is left, and its residual."""
    quick, residual = replace(estimation, coarse=True), estimation.residual(values)
    if estimation.coarse:
        return estimation, residual
    roughly = quick.residual(values)
    return (quick, roughly) if _negligible(roughly - residual, residual) else (estimation, residual)


def _negligible(error: FloatArray, residual: FloatArray) -> bool:
    return float(error @ error) < COARSE_ERROR * float(residual @ residual)


def restart_from_file(estimation: EstimationProblem, h: Hypothesis) -> Hypothesis:
    """Fit the effects again with the machine's parameters as in the file.

    Where the machine's parameters became implausible to help, the effects may have been led astray.
    """
    own, added = h.own, h.effect_parameters
    renew = range(len(added))
    ranked, residual = _quickest(estimation, values_at(added, h.effect_z))
    columns = derivatives(ranked, added, h.effect_z, residual, renew)
    alone = fit(ranked, added, h.effect_z, columns, renew if len(added) <= 2 * FEW else (), 6, QUICK, renew_all=False)
    z = np.concatenate([np.zeros(own), alone.z])
    rest = derivatives(ranked, h.fit.parameters, z, alone.residual, range(own), rough=own)
    return Hypothesis(h.effects, Fit(h.fit.parameters, z, alone.residual, np.hstack([rest, alone.jacobian])))


def continue_or_restart(
    estimation: EstimationProblem, h: Hypothesis, progress: Progress, little: float = LARGE
) -> Hypothesis:
    """Continue a fit; where that leaves a large discrepancy, also restart from the file, and keep the likelier.

    Parameters
    ----------
    little : discrepancy that is not large.
    """
    return begun_anew(estimation, continue_fit(estimation, h, progress), progress, little)


def begun_anew(estimation: EstimationProblem, h: Hypothesis, progress: Progress, little: float = LARGE) -> Hypothesis:
    """Restart a fit that leaves a large discrepancy, or implausible parameters, from the file; keep the likelier."""
    if h.discrepancy < max(little, LARGE) and not implausible(h.fit, h.own):
        return h
    if not estimation.problem.work.allows():
        return h
    restarted = restart_from_file(estimation, h)  # with fresh derivatives by the machine's parameters
    again = continue_fit(estimation, restarted, progress, ", begun anew", restarted.fit.jacobian[:, : h.own])
    better = min(h, again, key=lambda x: x.fit.evidence)
    return better if better.discrepancy < max(little, LARGE) else by_degrees(estimation, better, progress)


def by_degrees(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit in the motions that are understood best, then in more and more of them; keep the likelier.

    What is driven far beyond where it is linear answers a small change of a number by another motion altogether, so
    that no slope points the way from afar. Quiet motions bring the numbers near enough for the louder ones.
    """
    quiet = quietest_motions(estimation, h.fit.residual)
    begun = h
    for count in range(FEWEST, len(quiet), FURTHER):
        if not estimation.problem.work.allows():
            return h
        chosen = [i for i, motion in enumerate(estimation.problem.motions) if motion in quiet[:count]]
        part = estimation.limited_to(chosen)
        begun = taken_over(part, begun) if begun is not h else _at_file(part, h)
        begun = continue_fit(part, begun, progress, f", in {count} quiet motions")
    found = continue_fit(estimation, taken_over(estimation, begun), progress, ", by degrees")
    return min(h, found, key=lambda x: x.fit.evidence)


def _at_file(part: EstimationProblem, h: Hypothesis) -> Hypothesis:
    """Begin at the file's numbers, with the effects as they are."""
    return taken_over(part, replace(h, fit=replace(h.fit, z=np.concatenate([np.zeros(h.own), h.effect_z]))))


def taken_over(part: EstimationProblem, h: Hypothesis) -> Hypothesis:
    """Take over values into a problem of other rows; derivatives are taken anew by whoever fits."""
    residual = part.residual(h.fit.values)
    return replace(h, fit=Fit(h.fit.parameters, h.fit.z, residual, np.zeros((len(residual), len(h.fit.z)))))


def refit(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit to the end, so that the gain of another effect is not what this fit had not yet reached."""
    begun = continue_fit(estimation, h, progress)
    worth = min(QUICK / 10, TELLING / len(begun.fit.residual))
    found = fit(estimation, begun.fit.parameters, begun.fit.z, begun.fit.jacobian, (), 8, small_gain=worth, rough=h.own)
    return log_fit(Hypothesis(h.effects, found), progress, " to the end")


def drop(estimation: EstimationProblem, h: Hypothesis, dropped: Candidate, progress: Progress) -> Hypothesis:
    """Refit without one of the effects."""
    return refit(estimation, without_effect(h, dropped), progress)


def refine(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit with exact derivatives: confounded parameters cancel only in those.

    It begins at the file's own parameters if the effects by themselves explain as much there.
    """
    log_try(h.effects, progress, " with exact derivatives")
    own, added = h.own, h.effect_parameters
    alone = fit(estimation, added, h.effect_z, h.fit.jacobian[:, own:], range(len(added)), 5, renew_all=False)
    start = np.concatenate([np.zeros(own), alone.z]) if alone.evidence < h.fit.evidence else h.fit.z
    found = fit(estimation, h.fit.parameters, start, h.fit.jacobian, iterations=5, exact=True)
    return log_fit(Hypothesis(h.effects, found), progress, " at the end")


def within_reach(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit with the file's numbers held to what it says of them: what moved them may be an effect's shape."""
    log_try(h.effects, progress, " with the file's numbers within reach")
    parameters = (*held_to(h.own_parameters, float(np.sqrt(IMPLAUSIBLE))), *h.effect_parameters)
    start = clipped(parameters, h.fit.z)
    found = fit(estimation, parameters, start, h.fit.jacobian, range(h.own, len(parameters)), iterations=8)
    return log_fit(Hypothesis(h.effects, found), progress, " with the file's numbers within reach")


def held_to(own: Sequence[Parameter], times: float) -> tuple[Parameter, ...]:
    """Hold the file's numbers to so many times their uncertainties; delays of recordings stay free."""
    return tuple(
        n
        if belongs_to_recording(n.name)
        else replace(n, low=max(n.low, n.start - times * n.sd), high=min(n.high, n.start + times * n.sd))
        for n in own
    )


# ---- another shape of the same effects -----------------------------------------------------------


@dataclass(frozen=True)
class ShapeChange:
    """Another form of the effects of a hypothesis, to be kept where it pays."""

    note: str
    change: Callable[[Candidate, Candidate], Candidate]  # an effect and the candidate it is of -> its other form
    simpler: bool = False  # it has fewer parameters: kept unless the present form is significantly better
    searched: bool = False  # its new parameters begin where they help most


def _finer(effect: Candidate, first: Candidate) -> Candidate:
    return effect if _of_other_kind(effect, first) else effect.shaped


def _bent(effect: Candidate, first: Candidate) -> Candidate:
    return _whole(effect, first).of_other_kind if first.bent and not _of_other_kind(effect, first) else effect


def _unbent(effect: Candidate, first: Candidate) -> Candidate:
    return _whole(effect, first).shaped if _of_other_kind(effect, first) else effect


def _other(effect: Candidate, first: Candidate) -> Candidate:
    if effect.other is None:
        return effect
    if _of_other_kind(effect, first):
        return effect.other.of_other_kind
    return effect.other if effect.finer else effect.other.shaped


def _first(effect: Candidate, first: Candidate) -> Candidate:
    if effect.other is not None or first.other is None:
        return effect
    if _of_other_kind(effect, first):
        return first.of_other_kind
    if {n.name for n in effect.shapes} - {n.name for n in first.shaped.shapes}:
        return effect  # the same at another spring, which is no simpler
    return first if effect.finer or not first.finer else first.shaped


def _of_other_kind(effect: Candidate, first: Candidate) -> bool:
    """Tell whether an effect has the shapes of its other kind."""
    return not {stem_of(n.name) for n in effect.shapes}.isdisjoint(stem_of(n.name) for n in first.bent)


def _whole(effect: Candidate, first: Candidate) -> Candidate:
    """Return the candidate that an effect is of, with all that may be set free."""
    return first.other if effect.other is None and first.other is not None else first


OWN_SHAPE = ShapeChange(" in its own shape", _finer, searched=True)  # usual shapes set free
BENT = ShapeChange(", bent before it slides", _bent, searched=True)  # others in their place
UNBENT = ShapeChange(", in the shape of the first kind", _unbent, searched=True)
SHAPE_CHANGES = (
    ShapeChange(", in its other form", _other),  # a parameter for each tower
    ShapeChange(", in its first", _first, simpler=True),  # one for all towers again
)


def converge(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Try every shape change in turn, and keep those that pay."""
    before = h.discrepancy
    for change in (*_kinds(estimation, h), *SHAPE_CHANGES):
        effects = _changed(estimation, h, change)
        if effects == h.effects or not estimation.problem.work.allows():
            continue
        if _settled(h, before, change):
            continue
        begun = _begun(effects, h)
        if change.searched:
            begun, _ = _placed(estimation, begun, h)
        found = continue_fit(estimation, begun, progress, change.note, h.fit.jacobian[:, : h.own])
        smaller, larger = (found, h) if change.simpler else (h, found)
        if significant(larger.fit, smaller.fit, SHAPE_SHARE) == (larger is found):
            h = found
    return h


def _settled(h: Hypothesis, before: float, change: ShapeChange) -> bool:
    """Tell whether one kind of shape explains so much that the other one need not be tried.

    Where friction bends, one that creeps may still bend the file's damping; the other way round nothing is bent.
    """
    if change not in (BENT, UNBENT) or h.discrepancy >= SETTLED * before:
        return False
    return change is UNBENT or not implausible(h.fit, h.own)


def _kinds(estimation: EstimationProblem, h: Hypothesis) -> tuple[ShapeChange, ...]:
    """Return the changes that set shapes free, first the kind that leaves less where it begins: often no more is asked.

    It saves the fit of the other kind, which leads far astray.
    """
    if not any(c.bent for c in h.effects):
        return (OWN_SHAPE,)
    freed = [_changed(estimation, h, kind) for kind in (BENT, OWN_SHAPE)]
    if h.effects in freed or not estimation.problem.work.allows():
        return OWN_SHAPE, BENT
    bent, own = (_placed(estimation, _begun(effects, h), h)[1] for effects in freed)
    return (BENT, OWN_SHAPE, UNBENT) if bent < own else (OWN_SHAPE, BENT)


def with_free_shapes(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Set the usual shapes of the effects free where that is significant, little as it may explain.

    A shape that is held where it usually is bends the numbers beside it, by more than their intervals say.
    """
    effects = tuple(c.shaped for c in h.effects)
    if effects == h.effects or not estimation.problem.work.allows():
        return h
    log_try(effects, progress, " in its own shape")
    begun = _placed(estimation, _begun(effects, h), h)[0].fit
    own, everything = h.own, range(len(begun.parameters))
    residual = estimation.residual(begun.values)
    columns = derivatives(estimation, begun.parameters, begun.z, residual, everything[own:])
    start = np.hstack([h.fit.jacobian[:, :own], columns])
    found = Hypothesis(effects, fit(estimation, begun.parameters, begun.z, start, iterations=6, exact=True))
    gained = (h.fit.evidence - found.fit.evidence) / misfit(found.fit)
    return log_fit(found, progress, " in its own shape") if gained > SIGNIFICANT else h


def enriched(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> list[Hypothesis]:
    """Fit each effect in turn in its richer form, if it has one (`CONTAINED`): one hypothesis for each.

    A fit begins at the numbers of the simpler form: from usual sizes it may end far from them.
    """
    by_name, found = {c.name: c for c in estimation.problem.candidates}, list[Hypothesis]()
    for effect in h.effects:
        richer = next(
            (by_name[name] for name, own in CONTAINED.items() if own == effect.name and name in by_name), None
        )
        if richer is None or not estimation.problem.work.allows():
            continue
        form = richer.other if effect.other is None and richer.other is not None else richer
        form = form.of_other_kind if _of_other_kind(effect, by_name[effect.name]) else form.shaped
        begun = _begun_richer(estimation, h, effect, form)
        found.append(converge(estimation, continue_fit(estimation, begun, progress), progress))
    return found


def _begun_richer(estimation: EstimationProblem, h: Hypothesis, effect: Candidate, form: Candidate) -> Hypothesis:
    """Exchange an effect for its richer form, at the numbers that it has; what is new begins where it helps most."""
    renamed = {
        f"effects.{form.name}.{name.split('.', 2)[2]}": x for name, x in h.fit.values.items() if _of(effect, name)
    }
    known = {**h.fit.values, **renamed}
    effects = tuple(form if c is effect else c for c in h.effects)
    parameters = (*h.own_parameters, *(n for c in effects for n in c.parameters))
    z = np.array([(known.get(n.name, n.start) - n.start) / n.sd for n in parameters])
    sizes = {_part(n.name): n.sd * z[i] for i, n in enumerate(parameters) if n in form.amplitudes and n.name in known}
    added = [
        (i, sizes.get(_part(n.name), 0.0) / n.sd)
        for i, n in enumerate(parameters)
        if _is_new(n, form.amplitudes, known)
    ]
    shapes = [i for i, n in enumerate(parameters) if _is_new(n, form.shapes, known)][:1]
    tries = []
    for share, shift in product(SHARES, SPREAD):
        tried = z.copy()
        for i, size in added:
            tried[i] = share * size
        tries.append(_moved(parameters, tried, shapes, [shift] * len(shapes)))
    residuals = replace(estimation, coarse=True).residuals([values_at(parameters, x) for x in tries])
    costs = [float(r @ r + x @ x) for r, x in zip(residuals, tries, strict=True)]
    return Hypothesis(effects, Fit(parameters, tries[int(np.argmin(costs))], h.fit.residual, h.fit.jacobian))


def _of(effect: Candidate, name: str) -> bool:
    return name.startswith(f"effects.{effect.name}.")


def _part(name: str) -> str:
    """Return which tower or axis a parameter is of."""
    return name.partition("[")[2]


def _is_new(n: Parameter, among: Sequence[Parameter], known: Mapping[str, float]) -> bool:
    return n in among and n.name not in known


def _changed(estimation: EstimationProblem, h: Hypothesis, change: ShapeChange) -> tuple[Candidate, ...]:
    """Change the effects' form; leave them where a richer one has nothing left to explain.

    Numbers of the file that had to be bent are something to explain: one change for all belts bends those of the axes
    that have none.
    """
    if not change.simpler and not incomplete(estimation, h):
        return h.effects
    by_name = {c.name: c for c in estimation.problem.candidates}
    return tuple(change.change(c, by_name[c.name]) for c in h.effects)


def _begun(effects: tuple[Candidate, ...], h: Hypothesis) -> Hypothesis:
    """Take over the present values for the effects' other parameters."""
    parameters = (*h.own_parameters, *(n for c in effects for n in c.parameters))
    known = {n.name: float(z) for n, z in zip(h.fit.parameters, h.fit.z, strict=True)}
    z = clipped(parameters, np.array([_known(n, known) for n in parameters]))
    return Hypothesis(effects, Fit(parameters, z, h.fit.residual, h.fit.jacobian))


def _placed(estimation: EstimationProblem, begun: Hypothesis, before: Hypothesis) -> tuple[Hypothesis, float]:
    """Begin new parameters, effect by effect, where they help most: far from there, no slope may point the way.

    Returns
    -------
    The hypothesis, and the cost that it has there.
    """
    parameters, z, cost, seen = begun.fit.parameters, begun.fit.z, np.inf, glimpse_of(estimation, before.fit)
    ranked_in = replace(estimation if seen is None else seen.estimation, coarse=True)
    for effect in begun.effects:
        new = [i for i, n in enumerate(parameters) if n in effect.parameters and n not in before.fit.parameters]
        steps = SPREAD if len(new) < 3 else SPREAD[::2]
        tries = [z, *(_moved(parameters, z, new, shift) for shift in product(steps, repeat=len(new)))]
        residuals = ranked_in.residuals([values_at(parameters, x) for x in tries])
        costs = [float(r @ r + x @ x) for r, x in zip(residuals, tries, strict=True)]
        z, cost = tries[int(np.argmin(costs))], min(costs)
    return Hypothesis(begun.effects, replace(begun.fit, z=z)), cost


def _moved(parameters: Sequence[Parameter], z: FloatArray, which: Sequence[int], shift: Sequence[float]) -> FloatArray:
    moved = z.copy()
    moved[list(which)] += shift
    return clipped(parameters, moved)


def _known(n: Parameter, known: Mapping[str, float]) -> float:
    """Return z of the parameter itself, or of all towers, or the mean of the towers'; zero if it is new."""
    stem = stem_of(n.name)
    if n.name in known or stem in known:
        return known.get(n.name, known.get(stem, 0.0))
    parts = [z for name, z in known.items() if stem_of(name) == stem]
    return float(np.mean(parts)) if parts else 0.0
