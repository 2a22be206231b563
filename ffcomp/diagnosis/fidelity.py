"""The ladder of fidelity above the score test: starts, quick fits, full fits, exact fits, and warm starts between them.

    start     the best of several sizes, simulated coarsely in the motions that hold most of the residual
    quick     a few steps in coarse simulations, derivatives kept where they may be
    full      until a step promises little, kinks as sharp as they are
    exact     with central differences: confounded parameters cancel only in those

A fit that leaves much is begun again elsewhere: at the file's numbers, in quiet motions first (continuation), on an
excerpt of the recordings, or on a short horizon of every motion.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.diagnosis.fit import EstimationProblem, Fit, clipped, derivatives, fit, values_at
from ffcomp.diagnosis.hypotheses import (
    Hypothesis,
    comparable,
    leaves_excess,
    likeliest,
    log_fit,
    log_try,
    may_join,
)
from ffcomp.diagnosis.problem import Candidate, Parameter, Problem
from ffcomp.diagnosis.recording_clocks import belongs_to_recording
from ffcomp.diagnosis.score_test import Screened, squares_by_motion, subset_of
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.numerics.least_squares import SMALL_GAIN
from ffcomp.numerics.stages import Progress, Stage
from models.arrays import FloatArray

ESTIMATE_SCALES = (1.0, 0.5, 0.25, 0.1, 0.03, -0.1, -0.5)  # of a linear estimate, and, where that may lead astray,
USUAL_SIZES = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01, -0.03, -0.1, -0.25, -0.5, -1.0)  # of a usual size
FORCE_LIKE = re.compile(r"_(n|kg)(_|\[|$)")  # in the name of a mass, a force, a stiffness, a damper
HORIZON_SIZES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.1, -0.1, -0.25, -0.5, -1.0)  # of a usual size


# ---- starts --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Start:
    """One or several screened effects, with the amplitudes and shapes to begin at."""

    chosen: tuple[Screened, ...]
    z: FloatArray
    cost: float  # |r|² with everything else as it was

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Of all chosen effects."""
        return tuple(n for s in self.chosen for n in s.candidate.parameters)


def select_starts(estimation: EstimationProblem, base: Fit, screened: Sequence[Screened], large: bool) -> list[Start]:
    """Select the candidates with the best prediction; where the discrepancy is large, also by simulation."""
    visible, count = [s for s in screened if s.visible], SETTINGS.by_score
    if not large:
        return [best_start(estimation, base, (s,)) for s in visible[:count]]
    starts = [best_start(estimation, base, (s,), ESTIMATE_SCALES[:4], USUAL_SIZES) for s in visible]
    helpful = sorted(starts, key=lambda start: start.cost)[: SETTINGS.by_simulation]
    return [*(start for start in helpful if start in starts[count:]), *starts[:count]]


def best_start(
    estimation: EstimationProblem,
    base: Fit,
    chosen: tuple[Screened, ...],
    scales: Sequence[float] = ESTIMATE_SCALES,
    usual: Sequence[float] = (),
) -> Start:
    """Begin at the fraction of the linear estimates, or of a usual size, that really helps most."""
    parameters = tuple(n for s in chosen for n in s.candidate.parameters)
    points = [np.concatenate([_estimated(s, scale) for s in chosen]) for scale in scales]
    points += [np.concatenate([_usual(s, size) for s in chosen]) for size in usual]
    tries = [clipped(parameters, z) for z in points]
    different = [z for i, z in enumerate(tries) if not any(np.array_equal(z, before) for before in tries[:i])]
    subset = subset_of(estimation, base)
    if subset is None:
        costs = _costs(estimation, base, parameters, different)
        return Start(chosen, different[int(np.argmin(costs))], min(costs))
    best = different[int(np.argmin(_costs(subset.estimation, base, parameters, different)))]
    return Start(chosen, best, *_costs(estimation, base, parameters, [best]))


def _costs(
    estimation: EstimationProblem, base: Fit, parameters: Sequence[Parameter], tries: Sequence[FloatArray]
) -> list[float]:
    """Return |r|² at each of these z, with the machine's parameters fixed as they stand in a fit."""
    residuals = estimation.with_fixed(base.values).residuals([values_at(parameters, z) for z in tries])
    return [float(r @ r) for r in residuals]


def _estimated(s: Screened, scale: float) -> FloatArray:
    """Begin at the linear estimates of the amplitudes, kept within what is usual, and at the shapes as screened."""
    if s.candidate.switch:
        return np.ones(1)
    return np.concatenate([scale * np.clip(s.estimate, -2.0, 2.0), _shapes(s.candidate, s)])


def _usual(s: Screened, size: float) -> FloatArray:
    amplitudes = np.full(len(s.candidate.amplitudes), 1.0 if s.candidate.switch else size)
    return np.concatenate([amplitudes, _shapes(s.candidate, s)])


def _shapes(candidate: Candidate, s: Screened) -> FloatArray:
    """Return z of a candidate's shapes as they were screened."""
    return np.array([(s.shape.get(n.name, n.start) - n.start) / n.sd for n in candidate.shapes])


# ---- quick fits ----------------------------------------------------------------------------------


def grow(
    estimation: EstimationProblem, h: Hypothesis, start: Start, progress: Progress, bar: float = np.inf
) -> Hypothesis:
    """Add effects quickly: fit first the effects together, for what they explain needs no retuning, then everything.

    Parameters
    ----------
    bar : smallest discrepancy so far; where even the linear prediction of the second fit stays far above it, that
        fit is left out.
    """
    effects, first = (*h.effects, *(s.candidate for s in start.chosen)), not h.effects
    log_try(effects, progress)
    parameters, z = (*h.effect_parameters, *start.parameters), np.concatenate([h.effect_z, start.z])
    alone = estimation.with_fixed(values_at(h.machine_parameters, h.fit.z[: h.machine_count]))
    every = range(len(parameters))
    columns = derivatives(alone, parameters, z, alone.residual(values_at(parameters, z)), every)
    renew = every if len(parameters) <= SETTINGS.renewed * (1 if first else 2) else ()
    added = fit(alone, parameters, z, columns, renew, 5, SETTINGS.quick_gain, renew_all=False)
    both, z = np.hstack([h.machine_jacobian, added.jacobian]), np.concatenate([h.fit.z[: h.machine_count], added.z])
    grown = Fit((*h.machine_parameters, *parameters), z, added.residual, both)
    factor, least = SETTINGS.keep_initial if first else SETTINGS.keep_added, SETTINGS.exists
    if grown.predicted_discrepancy + least < factor * (bar + least):
        iterations = 3 if first else 4
        grown = fit(estimation, grown.parameters, z, both, (), iterations, SETTINGS.quick_gain, renew_all=False)
    return log_fit(Hypothesis(effects, grown), progress)


# ---- full fits -----------------------------------------------------------------------------------


def continue_fit(
    estimation: EstimationProblem, h: Hypothesis, progress: Progress, note: str = "", known: FloatArray | None = None
) -> Hypothesis:
    """Continue a fit from derivatives taken anew, with every kink as sharp as it is.

    Parameters
    ----------
    known : (rows, machine_count) derivatives by the machine's parameters, where they are known well enough.
    """
    log_try(h.effects, progress, note)
    every, machine = range(len(h.fit.parameters)), h.machine_count
    ranked, residual = quickest(estimation, h.fit.values)
    which = every if known is None else every[-h.effect_count :]
    columns = derivatives(ranked, h.fit.parameters, h.fit.z, residual, which, rough=machine)
    if known is not None:
        columns = np.hstack([known, columns])
    renew = every[-h.effect_count :] if h.effect_count <= SETTINGS.renewed else ()
    fitted = _fit_quickly(estimation, h.fit.parameters, h.fit.z, columns, renew, 10, SETTINGS.quick_gain, rough=machine)
    return log_fit(Hypothesis(h.effects, fitted), progress, note)


def _fit_quickly(
    estimation: EstimationProblem,
    parameters: Sequence[Parameter],
    start: FloatArray,
    jacobian: FloatArray,
    renew: Sequence[int],
    iterations: int,
    small_gain: float = SMALL_GAIN,
    rough: int = 0,
    exact: bool = False,
    little: float = -1.0,
) -> Fit:
    """Fit coarsely where that errs by nothing that matters, and more than `little` is left; see `fit`."""
    ranked, _ = quickest(estimation, values_at(parameters, clipped(parameters, start)), little)
    fitted = fit(ranked, parameters, start, jacobian, renew, iterations, small_gain, exact=exact, rough=rough)
    if ranked is estimation:
        return fitted
    z, jacobian = fitted.z, fitted.jacobian
    if quickest(estimation, fitted.values, little)[0] is estimation:
        return fit(estimation, parameters, z, jacobian, renew, iterations, small_gain, exact=exact, rough=rough)
    return replace(fitted, residual=estimation.residual(fitted.values))


def quickest(
    estimation: EstimationProblem, values: Mapping[str, float], little: float = -1.0
) -> tuple[EstimationProblem, FloatArray]:
    """Return the problem, coarse where that errs by nothing that matters beside what is left, and its residual.

    Parameters
    ----------
    little : discrepancy up to which it is not coarse.
    """
    residual = estimation.residual(values)
    if estimation.coarse or float(residual @ residual) < (1 + little) * len(residual):
        return estimation, residual
    quick = replace(estimation, coarse=True)
    roughly = quick.residual(values)
    return (quick, roughly) if _negligible(roughly - residual, residual) else (estimation, residual)


def _negligible(error: FloatArray, residual: FloatArray) -> bool:
    return float(error @ error) < SETTINGS.coarse_error * float(residual @ residual)


def refit(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit to the end, so that the gain of another effect is not what this fit had not yet reached."""
    begun = continue_fit(estimation, h, progress)
    gain = min(SETTINGS.quick_gain / 10, 2.0 / len(begun.fit.residual))
    fitted = fit(estimation, begun.fit.parameters, begun.fit.z, begun.fit.jacobian, (), 8, gain, rough=h.machine_count)
    ended = log_fit(Hypothesis(h.effects, fitted), progress, " to the end")
    return ended if ended.plausible else _rescaled(estimation, ended)


def _rescaled(estimation: EstimationProblem, h: Hypothesis) -> Hypothesis:
    """Multiply all masses and forces by the factor that the file's numbers would have, where that is likelier.

    Where no force is measured the motion tells their ratios alone, so that the prior alone tells the factor; and
    derivatives of dry friction do not cancel well enough to show the way there.
    """
    parameters, machine = h.fit.parameters, h.machine_count
    scaled = [i for i, n in enumerate(parameters) if FORCE_LIKE.search(n.name)]
    numbers = [parameters[i] for i in scaled]
    start, sd, x = np.array([(n.start, n.sd, h.fit.values[n.name]) for n in numbers]).reshape(-1, 3).T
    of_file = np.array(scaled) < machine
    if not of_file.any():
        return h
    weight = (x / sd**2)[of_file]
    factor = float(weight @ start[of_file]) / float(weight @ x[of_file])
    z, jacobian = h.fit.z.copy(), h.fit.jacobian.copy()
    z[scaled] = (factor * x - start) / sd
    jacobian[:, scaled] /= factor
    z = clipped(parameters, z)
    fitted = Fit(parameters, z, estimation.residual(values_at(parameters, z)), jacobian)
    return min(h, Hypothesis(h.effects, fitted), key=lambda each: each.fit.evidence)


def fit_exactly(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit with exact derivatives: confounded parameters cancel only in those.

    It begins at the file's parameters if the effects by themselves explain as much there.
    """
    if h.exact:
        return h
    log_try(h.effects, progress, " with exact derivatives")
    added, columns = h.effect_parameters, h.fit.jacobian[:, h.machine_count :]
    alone = fit(estimation, added, h.effect_z, columns, range(len(added)), 5, renew_all=False)
    from_file = np.concatenate([np.zeros(h.machine_count), alone.z])
    start = from_file if alone.evidence < h.fit.evidence else h.fit.z
    fitted = _fit_quickly(estimation, h.fit.parameters, start, h.fit.jacobian, (), 5, exact=True, little=SETTINGS.large)
    return log_fit(Hypothesis(h.effects, fitted, exact=True), progress, " at the end")


def straightened(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit with exact derivatives what leaves nothing but needs implausible numbers of the file: perhaps it need not.

    A belt's stiffness and a frequency make up for each other: the way back is worth the prior alone, and another effect
    would be added for it.
    """
    if leaves_excess(estimation, h.fit) or h.plausible:
        return h
    return min(h, fit_exactly(estimation, h, progress), key=lambda each: each.fit.evidence)


def fit_within_uncertainty(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit with the file's numbers held to what it says of them: what moved them may be an effect's shape."""
    log_try(h.effects, progress, " with the file's numbers within reach")
    parameters = (*_held(h.machine_parameters, float(np.sqrt(SETTINGS.implausible))), *h.effect_parameters)
    start, renew = clipped(parameters, h.fit.z), range(h.machine_count, len(parameters))
    fitted = _fit_quickly(estimation, parameters, start, h.fit.jacobian, renew, 8, little=SETTINGS.large)
    return log_fit(Hypothesis(h.effects, fitted), progress, " with the file's numbers within reach")


def _held(parameters: Sequence[Parameter], times: float) -> tuple[Parameter, ...]:
    """Hold the file's numbers to so many times their uncertainties; delays of recordings stay free."""
    return tuple(
        n
        if belongs_to_recording(n.name)
        else replace(n, low=max(n.low, n.start - times * n.sd), high=min(n.high, n.start + times * n.sd))
        for n in parameters
    )


def parsimonious_fit(estimation: EstimationProblem, h: Hypothesis) -> Fit:
    """Retune only those of the machine's parameters that the data need, one after the other (forward selection).

    Parameters and effects that are nearly confounded share an error of the data among them. If the file is right,
    this gives it all to the effect.
    """
    machine, scale = h.machine_count, h.fit.misfit
    chosen, target = list(range(machine, len(h.fit.parameters))), h.fit.residual + h.fit.jacobian @ h.fit.z
    normal, slope = h.fit.jacobian.T @ h.fit.jacobian, h.fit.jacobian.T @ target

    def evidence(columns: Sequence[int]) -> float:
        information = np.eye(len(columns)) + normal[np.ix_(columns, columns)]
        gain = slope[columns] @ np.linalg.solve(information, slope[columns])
        return float(-gain / scale + np.linalg.slogdet(information)[1])

    for _ in range(machine):
        trials = [(evidence([*chosen, i]), i) for i in range(machine) if i not in chosen]
        if min(trials)[0] > evidence(chosen) - SETTINGS.significant:
            break
        chosen.append(min(trials)[1])
    keep = sorted(chosen)
    z = np.asarray(np.linalg.solve(np.eye(len(keep)) + normal[np.ix_(keep, keep)], slope[keep]))
    parameters, renew = [h.fit.parameters[i] for i in keep], range(len(keep)) if len(keep) <= SETTINGS.renewed else ()
    fitted = fit(estimation, parameters, z, h.fit.jacobian[:, keep], renew, iterations=4)
    # where the file is far off, the way there is not linear: then all parameters stay as they were fitted
    return fitted if fitted.cost - h.fit.cost < SETTINGS.significant * scale * (machine + 1) else h.fit


def predicted_without(h: Hypothesis, effect: Candidate) -> Fit:
    """Predict the fit of a hypothesis without one of its effects, to first order."""
    keep = [i for i, n in enumerate(h.fit.parameters) if n not in effect.parameters]
    columns, target = h.fit.jacobian[:, keep], h.fit.residual + h.fit.jacobian @ h.fit.z
    z = np.asarray(np.linalg.solve(np.eye(len(keep)) + columns.T @ columns, columns.T @ target), dtype=np.float64)
    return Fit(tuple(h.fit.parameters[i] for i in keep), z, target - columns @ z, columns)


# ---- restarts ------------------------------------------------------------------------------------


def restart_from_file(estimation: EstimationProblem, h: Hypothesis) -> Hypothesis:
    """Fit the effects again with the machine's parameters as in the file.

    Where the machine's parameters became implausible to help, the effects may have been led astray.
    """
    machine, added = h.machine_count, h.effect_parameters
    ranked, residual = quickest(estimation, values_at(added, h.effect_z))
    columns = derivatives(ranked, added, h.effect_z, residual, range(len(added)))
    renew = range(len(added)) if len(added) <= 2 * SETTINGS.renewed else ()
    alone = fit(ranked, added, h.effect_z, columns, renew, 6, SETTINGS.quick_gain, renew_all=False)
    z = np.concatenate([np.zeros(machine), alone.z])
    rest = derivatives(ranked, h.fit.parameters, z, alone.residual, range(machine), rough=machine)
    return Hypothesis(h.effects, Fit(h.fit.parameters, z, alone.residual, np.hstack([rest, alone.jacobian])))


def with_restart(
    estimation: EstimationProblem, h: Hypothesis, progress: Progress, little: float = SETTINGS.large
) -> Hypothesis:
    """Restart a fit that leaves a large discrepancy, or implausible parameters, from the file; keep the likelier.

    Parameters
    ----------
    little : discrepancy that is not large.
    """
    enough = max(little, SETTINGS.large)
    if (h.discrepancy < enough and h.plausible) or not estimation.may_go_on:
        return h
    restarted = restart_from_file(estimation, h)  # with fresh derivatives by the machine's parameters
    again = continue_fit(estimation, restarted, progress, ", begun anew", restarted.machine_jacobian)
    better = min(h, again, key=lambda each: each.fit.evidence)
    return better if better.discrepancy < enough else by_continuation(estimation, better, progress)


def by_continuation(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit in the motions that are understood best, then in more and more of them; keep the likelier.

    What is driven far beyond where it is linear answers a small change of a number by another motion altogether, so
    that no slope points the way from afar. Quiet motions bring the numbers near enough for the louder ones.
    """
    squares = squares_by_motion(estimation, h.fit.residual)
    quiet, begun = sorted(squares, key=lambda motion: squares[motion]), h.at_file()
    for count in range(2, len(quiet), 2):
        if not estimation.may_go_on:
            return h
        part = estimation.limited_to([i for i, m in enumerate(estimation.problem.motions) if m in quiet[:count]])
        begun = continue_fit(part, transferred(part, begun), progress, f", in {count} quiet motions")
        if count + 2 < len(quiet) and _no_better(part, begun, h):  # the last step is taken in any case
            return h
    if len(quiet) <= 2:
        begun = h
    fitted = continue_fit(estimation, transferred(estimation, begun), progress, ", by degrees")
    return min(h, fitted, key=lambda each: each.fit.evidence)


def transferred(part: EstimationProblem, h: Hypothesis) -> Hypothesis:
    """Take values over into a problem of other rows; derivatives are taken anew by whoever fits."""
    residual = part.residual(h.fit.values)
    return Hypothesis(h.effects, Fit(h.fit.parameters, h.fit.z, residual, np.zeros((len(residual), len(h.fit.z)))))


def _no_better(part: EstimationProblem, begun: Hypothesis, h: Hypothesis) -> bool:
    """Tell whether what was fitted to a part leaves nearly as much there as another that was fitted to all.

    Beyond that part it is no better either: the way through it leads nowhere.
    """
    there = transferred(part, h).discrepancy
    return begun.discrepancy > max(SETTINGS.large, (1 - SETTINGS.reshaped_share) * there)


# ---- excerpts ------------------------------------------------------------------------------------


def excerpt_of(estimation: EstimationProblem, discrepancy: float) -> EstimationProblem | None:
    """Return the problem on an excerpt of its data that shows such a discrepancy, of the noise, as surely.

    None where the discrepancy is too small for that, or there is no excerpt.
    """
    information = discrepancy * len(estimation.measured)
    if discrepancy < 2 * estimation.tolerance or information < SETTINGS.excerpt_information:
        return None
    problem = estimation.problem.excerpt()
    if problem is None:
        return None
    part = estimation.on_part(problem)
    return None if part.share * information < SETTINGS.excerpt_information else part


def fit_in_excerpt(part: EstimationProblem, fitted: Fit) -> Fit:
    """Take a fit of the machine's parameters over to an excerpt, which knows no delays of recordings that it omits."""
    known = {n.name for n in part.problem.parameters}
    keep = [i for i, n in enumerate(fitted.parameters) if n.name in known]
    return linearised(part, tuple(fitted.parameters[i] for i in keep), fitted.z[keep])


def linearised(estimation: EstimationProblem, parameters: Sequence[Parameter], z: FloatArray) -> Fit:
    """Return the fit at z, (p,), with the derivatives there."""
    residual = estimation.residual(values_at(parameters, z))
    return Fit(tuple(parameters), z, residual, derivatives(estimation, parameters, z, residual, range(len(z))))


def hypothesis_in_whole(problem: Problem, h: Hypothesis) -> Hypothesis:
    """Give a hypothesis all of a problem's parameters, those that it had none of as they are in the file.

    What is left and the derivatives have to be computed anew.
    """
    fitted = {n.name: (n, float(z)) for n, z in zip(h.machine_parameters, h.fit.z, strict=False)}
    machine = [fitted.get(n.name, (n, 0.0)) for n in problem.parameters]
    parameters = (*(n for n, _ in machine), *h.effect_parameters)
    z = np.array([*(x for _, x in machine), *h.effect_z])
    return Hypothesis(h.effects, Fit(parameters, z, h.fit.residual, np.zeros((len(h.fit.residual), len(z)))))


# ---- a warm start on a short horizon -------------------------------------------------------------


def from_short_horizon(
    estimation: EstimationProblem, screened: Sequence[Screened], instead: Hypothesis, progress: Progress
) -> Hypothesis | None:
    """Fit what explains the first instants of all motions, and follow it to their ends, on longer and longer horizons.

    What is driven far beyond where it is linear forgets how it began: a small change of a number ends, after some
    impacts, in another motion altogether, so that the cost has countless minima, and no slope points the way from
    afar. Of the first quarter of a second it has few (Ribeiro, Tiels, Umenberger, Schön & Aguirre, Automatica 121,
    2020). So effects are ranked there, each in its freest form and from several sizes.

    Returns
    -------
    A hypothesis fitted to all of `estimation`; None where nothing explains the first instants, or there are none, or
    where it explains a longer horizon no better than `instead`.
    """
    seconds = _first_horizon_s(estimation)
    part = short_horizon(estimation, seconds)
    if part is None:
        return None
    progress(Stage(5, "looking at how the motions begin"))
    machine = tuple(part.problem.parameters)
    nothing = Hypothesis((), Fit(machine, np.zeros(len(machine)), np.zeros(0), np.zeros((0, 0))))
    nothing = _fitted_anew(part, nothing, 10)
    enough = SETTINGS.horizon_left * nothing.discrepancy
    best = _likeliest_there(part, [(nothing, s) for s in screened], SETTINGS.swaps, progress)
    if best is not None and best.discrepancy > enough:
        others = [(best, s) for s in screened if may_join(s.candidate.name, best.names)]
        best = _likeliest_there(part, others, 1, progress)
    if best is None or best.discrepancy > enough:
        return None
    seconds *= SETTINGS.horizon_growth
    while (part := short_horizon(estimation, seconds)) is not None and part.may_go_on:
        best = log_fit(_fitted_anew(part, best, 6), progress, f", in the first {seconds:.2g} s")
        if _no_better(part, best, instead):
            return None
        seconds *= SETTINGS.horizon_growth
    return continue_fit(estimation, transferred(estimation, best), progress, ", from the beginnings")


def short_horizon(estimation: EstimationProblem, seconds: float) -> EstimationProblem | None:
    """Return the problem of each motion's first seconds, simulated coarsely; None where that is all of it."""
    problem = estimation.problem.short_horizon(seconds)
    return None if problem is None else replace(estimation.on_part(problem), coarse=True)


def _first_horizon_s(estimation: EstimationProblem) -> float:
    """Return how much of each motion shows the discrepancy."""
    whole, seconds = estimation.residual({}), SETTINGS.horizon_s
    shown = SETTINGS.horizon_shown * float(whole @ whole) / len(whole)
    while (part := short_horizon(estimation, seconds)) is not None:
        residual = part.residual({})
        if float(residual @ residual) / len(residual) > shown:
            break
        seconds *= SETTINGS.horizon_growth
    return seconds


def _likeliest_there(
    part: EstimationProblem, tries: Sequence[tuple[Hypothesis, Screened]], each: int, progress: Progress
) -> Hypothesis | None:
    """Fit those that help most where they begin, each beside what it is added to; return the likeliest.

    With the file's numbers held to what it says, where that explains nearly as much: impacts alone can make up for
    much.
    """
    starts = sorted((start for beside, s in tries for start in _free_starts(part, beside, s)), key=lambda x: x[1])
    fitted: list[Hypothesis] = []
    for h, _ in starts:
        alike = sum(h.names == other.names for other in fitted)
        if len(fitted) < SETTINGS.by_score and alike < each and part.may_go_on:
            log_try(h.effects, progress, ", in the beginnings")
            fitted.append(log_fit(_fitted_anew(part, h, 10), progress, ", in the beginnings"))
    if not fitted:
        return None
    free = likeliest(fitted)[0]
    at_file = free.at_file()
    parameters = (*_held(free.machine_parameters, 2.5), *free.effect_parameters)
    begun = replace(at_file, fit=replace(at_file.fit, parameters=parameters))
    held = log_fit(_fitted_anew(part, begun, 10), progress, ", with the file's numbers held")
    return held if comparable(held, free, 4.0) else free


def _free_starts(part: EstimationProblem, beside: Hypothesis, s: Screened) -> list[tuple[Hypothesis, float]]:
    """Return an effect in its freest form beside others, at each of the usual sizes, with |r|² there."""
    effect = (s.candidate.other or s.candidate).shaped
    shapes, finer = _shapes(effect, s), len(s.candidate.finer)
    parameters, starts = (*beside.fit.parameters, *effect.parameters), []
    for size in (1.0,) if effect.switch else HORIZON_SIZES:
        tries = []
        for shift in (0.0, 1.0) if finer else (0.0,):  # standard deviations from the usual finer shape
            moved = shapes + shift * (np.arange(len(shapes)) >= len(shapes) - finer)
            z = np.concatenate([beside.fit.z, np.full(len(effect.amplitudes), size), moved])
            tries.append(clipped(parameters, z))
        costs = [float(r @ r) for r in part.residuals([values_at(parameters, z) for z in tries])]
        best = int(np.argmin(costs))
        grown = Hypothesis((*beside.effects, effect), replace(beside.fit, parameters=parameters, z=tries[best]))
        starts.append((grown, costs[best]))
    return starts


def _fitted_anew(part: EstimationProblem, h: Hypothesis, steps: int) -> Hypothesis:
    """Fit all parameters, every derivative taken anew at every step."""
    begun, every = linearised(part, h.fit.parameters, h.fit.z), range(len(h.fit.parameters))
    fitted = fit(part, begun.parameters, begun.z, begun.jacobian, every, steps, SETTINGS.quick_gain / 10)
    return Hypothesis(h.effects, fitted)
