"""Fits that begin with the beginnings of all motions, and go on to more and more of them.

What is driven far beyond where it is linear forgets how it began: a small change of a number ends, after some impacts,
in another motion altogether, so that what is left has countless minima, and no slope points the way from afar. Of the
first quarter of a second it has few (Ribeiro, Tiels, Umenberger, Schön & Aguirre, Automatica 121, 2020). So effects
are ranked there, each in its freest form and from several sizes, and the best one is followed to the motions' ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem, on_part
from ffcomp.diagnose.fit import Fit, clipped, derivatives, fit, values_at
from ffcomp.diagnose.hypotheses import Hypothesis, comparable, likeliest, log_fit, log_try, may_join
from ffcomp.diagnose.initial_fits import QUICK
from ffcomp.diagnose.problem import Candidate
from ffcomp.diagnose.progress import Progress, Stage
from ffcomp.diagnose.refinement import continue_fit, held_to, taken_over
from ffcomp.diagnose.score_test import Screened

FIRST_S, GROWN = 0.25, 1.4  # how much of each motion is fitted first, and by how much more each time
SHOWN = 0.15  # of the mean square that the file leaves altogether, from which a beginning shows enough
SHIFTS = (0.0, 1.0)  # standard deviations from the usual, at which a finer shape is tried
FITTED, EACH = 6, 2  # fits to the beginnings, alone and beside one; of one effect alone
SIZES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.1, -0.1, -0.25, -0.5, -1.0)  # of a usual size
HELD = 2.5  # standard deviations from the file's numbers
POORER = 4.0  # times the discrepancy there may be left with the file's numbers held
EXPLAINED = 0.1  # of the discrepancy there may be left by what is followed
STEPS, FURTHER = 10, 6  # of the first fits, and of each later one


def from_beginnings(
    estimation: EstimationProblem, screened: Sequence[Screened], progress: Progress
) -> Hypothesis | None:
    """Find what explains the motions' beginnings, and follow it to their ends.

    Returns
    -------
    A hypothesis fitted to all of `estimation`; None where nothing explains the beginnings, or there are none.
    """
    seconds = _first_s(estimation)
    part = beginning_of(estimation, seconds)
    if part is None:
        return None
    progress(Stage(5, "looking at how the motions begin"))
    own = tuple(part.problem.parameters)
    nothing = Hypothesis((), Fit(own, np.zeros(len(own)), np.zeros(0), np.zeros((0, 0))))
    nothing = _fitted(part, nothing, STEPS)
    best = _ranked(part, [(nothing, s) for s in screened], EACH, progress)
    if best is not None and best.discrepancy > EXPLAINED * nothing.discrepancy:
        others = [(best, s) for s in screened if may_join(s.candidate.name, best.names)]
        best = _ranked(part, others, 1, progress)
    if best is None or best.discrepancy > EXPLAINED * nothing.discrepancy:
        return None
    followed = _followed(estimation, best, GROWN * seconds, progress)
    return continue_fit(estimation, taken_over(estimation, followed), progress, ", from the beginnings")


def _followed(estimation: EstimationProblem, h: Hypothesis, seconds: float, progress: Progress) -> Hypothesis:
    """Fit to so much of each motion, then to more and more."""
    while (part := beginning_of(estimation, seconds)) is not None and part.problem.work.allows():
        h = log_fit(_fitted(part, h, FURTHER), progress, f", in the first {seconds:.2g} s")
        seconds *= GROWN
    return h


def _held(h: Hypothesis) -> Hypothesis:
    """Begin at the file's numbers, and hold them to what it says: by impacts alone much can be made up for."""
    own = held_to(h.own_parameters, HELD)
    z = np.concatenate([np.zeros(h.own), h.effect_z])
    return replace(h, fit=replace(h.fit, parameters=(*own, *h.effect_parameters), z=z))


def _first_s(estimation: EstimationProblem) -> float:
    """Return how much of each motion shows the discrepancy."""
    whole = estimation.residual({})
    shown, seconds = SHOWN * float(whole @ whole) / len(whole), FIRST_S
    while (part := beginning_of(estimation, seconds)) is not None:
        residual = part.residual({})
        if float(residual @ residual) / len(residual) > shown:
            break
        seconds *= GROWN
    return seconds


def beginning_of(estimation: EstimationProblem, seconds: float) -> EstimationProblem | None:
    """Return the estimation problem of the beginnings, simulated coarsely; None where that is all."""
    problem = estimation.problem.beginnings(seconds)
    return None if problem is None else replace(on_part(estimation, problem), coarse=True)


def _ranked(
    part: EstimationProblem, tried: Sequence[tuple[Hypothesis, Screened]], each: int, progress: Progress
) -> Hypothesis | None:
    """Fit those that help most where they begin, each beside what it is added to; return the likeliest."""
    starts = sorted((start for beside, s in tried for start in _starts(part, beside, s)), key=lambda start: start[1])
    found: list[Hypothesis] = []
    for h, _ in starts:
        same = sum(h.names == x.names for x in found)
        if len(found) < FITTED and same < each and part.problem.work.allows():
            log_try(h.effects, progress, ", in the beginnings")
            found.append(log_fit(_fitted(part, h, STEPS), progress, ", in the beginnings"))
    if not found:
        return None
    free = likeliest(found)[0]
    held = log_fit(_fitted(part, _held(free), STEPS), progress, ", with the file's numbers held")
    return held if comparable(held, free, POORER) else free


def _starts(part: EstimationProblem, beside: Hypothesis, s: Screened) -> list[tuple[Hypothesis, float]]:
    """Return an effect in its freest form beside others, at each of the usual sizes, with |r|² there."""
    effect = _freest(s.candidate)
    shapes = [(s.shape.get(n.name, n.start) - n.start) / n.sd for n in effect.shapes]
    finer, parameters = len(s.candidate.finer), (*beside.fit.parameters, *effect.parameters)
    found = []
    for size in (1.0,) if effect.switch else SIZES:
        tries = []
        for shift in SHIFTS if finer else SHIFTS[:1]:
            moved = [x + (shift if i >= len(shapes) - finer else 0.0) for i, x in enumerate(shapes)]
            z = np.concatenate([beside.fit.z, np.full(len(effect.amplitudes), size), moved])
            tries.append(clipped(parameters, z))
        costs = [float(r @ r) for r in part.residuals([values_at(parameters, z) for z in tries])]
        best = int(np.argmin(costs))
        grown = Hypothesis((*beside.effects, effect), replace(beside.fit, parameters=parameters, z=tries[best]))
        found.append((grown, costs[best]))
    return found


def _freest(candidate: Candidate) -> Candidate:
    return (candidate.other or candidate).shaped


def _fitted(part: EstimationProblem, h: Hypothesis, steps: int) -> Hypothesis:
    """Fit all parameters to the beginnings, every derivative taken anew at every step."""
    parameters, z, everything = h.fit.parameters, h.fit.z, range(len(h.fit.parameters))
    columns = derivatives(part, parameters, z, part.residual(values_at(parameters, z)), everything)
    return replace(h, fit=fit(part, parameters, z, columns, everything, steps, small_gain=QUICK / 10))
