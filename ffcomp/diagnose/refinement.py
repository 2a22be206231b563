"""Refinement of one hypothesis: continue, refit and refine its fit, and converge on the shapes of its effects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit, clipped, derivatives, fit, values_at
from ffcomp.diagnose.glimpse import glimpse_of
from ffcomp.diagnose.hypotheses import (
    IMPLAUSIBLE,
    LARGE,
    Hypothesis,
    implausible,
    incomplete,
    log_fit,
    log_try,
    significant,
    without_effect,
)
from ffcomp.diagnose.initial_fits import FEW, QUICK
from ffcomp.diagnose.problem import Candidate, Parameter
from ffcomp.diagnose.progress import Progress
from ffcomp.diagnose.recording_delays import belongs_to_recording
from models.arrays import FloatArray

COARSE_ERROR = 1e-3  # of the cost, by which coarse simulations may be off
SHAPE_SHARE = 0.1  # of the discrepancy must a freer shape of the same effect remove
TELLING = 2.0  # −2 ln Z, times the misfit: what a fit may still gain without another effect gaining it in its place
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
    again = continue_fit(estimation, restart_from_file(estimation, h), progress, ", begun anew")
    return min(h, again, key=lambda x: x.fit.evidence)


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
    held = tuple(n if belongs_to_recording(n.name) else _held(n) for n in h.own_parameters)
    parameters = (*held, *h.effect_parameters)
    start = clipped(parameters, h.fit.z)
    found = fit(estimation, parameters, start, h.fit.jacobian, range(h.own, len(parameters)), iterations=8)
    return log_fit(Hypothesis(h.effects, found), progress, " with the file's numbers within reach")


def _held(n: Parameter) -> Parameter:
    most = np.sqrt(IMPLAUSIBLE) * n.sd
    return replace(n, low=max(n.low, n.start - most), high=min(n.high, n.start + most))


# ---- another shape of the same effects -----------------------------------------------------------


@dataclass(frozen=True)
class ShapeChange:
    """Another form of the effects of a hypothesis, to be kept where it pays."""

    note: str
    change: Callable[[Candidate, Candidate], Candidate]  # an effect and the candidate it is of -> its other form
    simpler: bool = False  # it has fewer parameters: kept unless the present form is significantly better
    searched: bool = False  # its new parameters begin where they help most


def _finer(effect: Candidate, _: Candidate) -> Candidate:
    return effect.shaped


def _other(effect: Candidate, _: Candidate) -> Candidate:
    if effect.other is None:
        return effect
    return effect.other if effect.finer else effect.other.shaped


def _first(effect: Candidate, first: Candidate) -> Candidate:
    if effect.other is not None or first.other is None:
        return effect
    if {n.name for n in effect.shapes} - {n.name for n in first.shaped.shapes}:
        return effect  # the same at another spring, which is no simpler
    return first if effect.finer or not first.finer else first.shaped


SHAPE_CHANGES = (
    ShapeChange(" in its own shape", _finer, searched=True),  # usual shapes set free
    ShapeChange(", in its other form", _other),  # a parameter for each tower
    ShapeChange(", in its first", _first, simpler=True),  # one for all towers again
)


def converge(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Try every shape change in turn, and keep those that pay."""
    for change in SHAPE_CHANGES:
        effects = _changed(estimation, h, change)
        if effects == h.effects or not estimation.problem.work.allows():
            continue
        begun = _begun(effects, h)
        if change.searched:
            begun = _placed(estimation, begun, h)
        found = continue_fit(estimation, begun, progress, change.note, h.fit.jacobian[:, : h.own])
        smaller, larger = (found, h) if change.simpler else (h, found)
        if significant(larger.fit, smaller.fit, SHAPE_SHARE) == (larger is found):
            h = found
    return h


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


def _placed(estimation: EstimationProblem, begun: Hypothesis, before: Hypothesis) -> Hypothesis:
    """Begin new parameters, effect by effect, where they help most: far from there, no slope may point the way."""
    parameters, z, seen = begun.fit.parameters, begun.fit.z, glimpse_of(estimation, before.fit)
    ranked_in = replace(estimation if seen is None else seen.estimation, coarse=True)
    for effect in begun.effects:
        new = [i for i, n in enumerate(parameters) if n in effect.parameters and n not in before.fit.parameters]
        steps = SPREAD if len(new) < 3 else SPREAD[::2]
        tries = [z, *(_moved(parameters, z, new, shift) for shift in product(steps, repeat=len(new)))]
        residuals = ranked_in.residuals([values_at(parameters, x) for x in tries])
        costs = [float(r @ r + x @ x) for r, x in zip(residuals, tries, strict=True)]
        z = tries[int(np.argmin(costs))]
    return Hypothesis(begun.effects, replace(begun.fit, z=z))


def _moved(parameters: Sequence[Parameter], z: FloatArray, which: Sequence[int], shift: Sequence[float]) -> FloatArray:
    moved = z.copy()
    moved[list(which)] += shift
    return clipped(parameters, moved)


def _known(n: Parameter, known: Mapping[str, float]) -> float:
    """Return z of the parameter itself, or of all towers, or the mean of the towers'; zero if it is new."""
    stem = n.name.partition("[")[0]
    if n.name in known or stem in known:
        return known.get(n.name, known.get(stem, 0.0))
    parts = [z for name, z in known.items() if name.partition("[")[0] == stem]
    return float(np.mean(parts)) if parts else 0.0
