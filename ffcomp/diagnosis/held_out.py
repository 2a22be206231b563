"""Predict data that were left out of a fit.

Every place is left out in turn (every experiment, where there is one place only): what a hypothesis says of it then is
what it would say of a place that nobody has measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnosis.fidelity import quickest
from ffcomp.diagnosis.fit import EstimationProblem, Fit, clipped, fit, step_within, values_at
from ffcomp.diagnosis.hypotheses import Hypothesis
from ffcomp.diagnosis.observations import Position, clustered
from ffcomp.diagnosis.problem import Problem
from ffcomp.diagnosis.recording_clocks import clock_parameters
from ffcomp.numerics.serialise import keys
from models.arrays import FloatArray

# an effect whose size differs a little from motion to motion, as dry friction does on another day (EMPS)
DIFFERS = 0.8  # of the residual in a motion, that a size refitted to it leaves at most
DIFFERS_FROM, DIFFERS_BY = 0.02, 0.1  # of the size: what is reported, and what is still the same effect


@dataclass(frozen=True)
class HeldOut:
    """A place left out of the fit: the discrepancy there, as shares of its noise (χ² by row, less one)."""

    position: Position
    experiment: str  # where experiments take turns because there is one place only; else ""
    rows: int
    before: float  # with the machine's parameters retuned at the other positions
    after: float  # with the effects as well
    filed: float = np.inf  # with the original file
    signal: float = np.inf  # with nothing simulated at all
    # in the band: of the error with the file as it is, and with the effects; of the signals; of the noise
    power: tuple[float, ...] = ()

    @property
    def label(self) -> str:
        """Name what was left out: `(55, 20)`, an experiment, or the time at which a window begins."""
        if len(self.position) == 1:
            return f"{self.position[0]:g} s"
        return self.experiment or f"({', '.join(f'{x:.0f}' for x in self.position)})"


def groups(problem: Problem) -> Mapping[tuple[Position, str], list[int]]:
    """Group the observations that are held out together, by index: places with all their experiments and repeats.

    With a single place whole experiments with their repeats take turns; a single experiment leaves nothing to hold out.
    """
    observations = problem.observations
    places = clustered([o.position for o in observations])
    members: dict[tuple[Position, str], list[int]] = {}
    several = len(set(places)) > 1
    for i, (place, o) in enumerate(zip(places, observations, strict=True)):
        members.setdefault((place, "" if several else o.repeat_of), []).append(i)
    return members if len(members) > 1 else {}


def motions_or_groups(problem: Problem) -> Mapping[tuple[Position, str], list[int]]:
    """Group the observations as `groups` does, but those of an axis by its motions, where there are several.

    The windows of one motion depend on each other: vibration continues from one to the next, and so does the place of
    rest. Only another motion tests how an effect depends on place or speed.
    """
    observations, motions = problem.observations, problem.motions
    if len(set(motions)) < 2 or any(len(o.position) > 1 for o in observations):
        return groups(problem)
    first = [motions.index(motion) for motion in sorted(set(motions))]
    return {(observations[i].position, observations[i].name): _members(motions, motions[i]) for i in first}


def _members(motions: Sequence[int], one: int) -> list[int]:
    return [i for i, motion in enumerate(motions) if motion == one]


def hold_out(estimation: EstimationProblem, base: Fit, best: Fit) -> list[HeldOut]:
    """Leave each group out in turn, of both fits: move a fit to the optimum of the others, to first order."""
    left_out, parts = [], groups(estimation.problem)
    alone = [simulate_left_out(estimation, base, members) for members in parts.values()]
    effects = alone if best is base else [simulate_left_out(estimation, best, members) for members in parts.values()]
    each = zip(parts.items(), alone, effects, strict=True)
    for ((position, experiment), members), before, after in each:
        filed = estimation.problem.simulate({}, members)
        nothing = [np.zeros_like(y) for y in filed]
        power = [_power(estimation, y, members) for y in (filed, after, nothing)]
        left_out.append(
            HeldOut(
                position,
                experiment,
                rows=len(estimation.rows_of(members)),
                before=excess(estimation, before, members),
                after=excess(estimation, after, members),
                filed=excess(estimation, filed, members),
                signal=excess(estimation, nothing, members),
                power=(*power, _noise_power(estimation, members)),
            )
        )
    return left_out


def left_elsewhere(estimation: EstimationProblem, fitted: Fit) -> float:
    """Return how much of |r|² stands above noise in groups left out of the fit, each in turn."""
    return sum(
        max(excess(estimation, simulate_left_out(estimation, fitted, members), members), 0.0)
        * len(estimation.rows_of(members))
        for members in motions_or_groups(estimation.problem).values()
    )


def simulate_left_out(
    estimation: EstimationProblem, fitted: Fit, members: Sequence[int], retuned: bool = False
) -> list[FloatArray]:
    """Simulate these observations, (n, m) each, with the parameters that the others alone give.

    Parameters
    ----------
    retuned : the file's numbers are fitted to these observations, within their uncertainties
    """
    z = _fitted_to_others(estimation, fitted, members)
    if retuned:
        z = _retuned_there(estimation, fitted, z, members)
    return estimation.problem.simulate(values_at(fitted.parameters, z), members)


def by_place(estimation: EstimationProblem) -> bool:
    """Tell whether places may bend the file's numbers; an axis has one, and its motions share them."""
    return any(len(o.position) > 1 for o in estimation.problem.observations)


def _retuned_there(estimation: EstimationProblem, fitted: Fit, z: FloatArray, members: Sequence[int]) -> FloatArray:
    """Return z (p,) with the file's numbers as these observations have them: two steps, to first order."""
    own = [i for i, n in enumerate(fitted.parameters) if not n.name.startswith("effects.")]
    parameters, j = [fitted.parameters[i] for i in own], fitted.jacobian[estimation.rows_of(members)][:, own]
    alone, scatter = estimation.limited_to(members), fitted.overdispersion
    normal = scatter * np.eye(len(own)) + j.T @ j
    residual = alone.residual(values_at(fitted.parameters, z))
    for _ in range(2):
        step = step_within(parameters, z[own], normal, j.T @ residual - scatter * z[own])
        least = _cost(residual, z[own], scatter)
        for share in (1.0, 0.4, 0.1):
            trial = z.copy()
            trial[own] += share * step
            there = alone.residual(values_at(fitted.parameters, trial))
            if _cost(there, trial[own], scatter) < least:
                z, residual = trial, there
                break
        else:
            break
    return z


def _fitted_to_others(estimation: EstimationProblem, fitted: Fit, members: Sequence[int]) -> FloatArray:
    """Return z (p,) as all but these observations give it.

    The parameters go as far along the step to the others' optimum, to first order, as serves the others best.
    """
    inside = np.ones(len(fitted.residual), dtype=bool)
    inside[estimation.rows_of(members)] = False
    delays = clock_parameters([estimation.problem.observations[i] for i in members])
    keep = [i for i, n in enumerate(fitted.parameters) if n.name not in delays]
    free = tuple(fitted.parameters[i] for i in keep)
    j, r = fitted.jacobian[inside][:, keep], fitted.residual[inside]
    prior = fitted.prior[keep]
    normal, slope = np.diag(prior) + j.T @ j, j.T @ r - prior * fitted.z[keep]
    step, moved = np.zeros(len(fitted.z)), step_within(free, fitted.z[keep], normal, slope)
    step[keep] = moved
    trials = [clipped(fitted.parameters, fitted.z + share * step) for share in (1.0, 0.5, 0.2, 0.05, 0.0)]
    # the whole step, if it brings at least half of what it promises: then there is hardly a better one
    ranked, residual = quickest(estimation, fitted.values)
    promised, before = (
        float(2 * slope @ moved - moved @ normal @ moved),
        _cost(residual[inside], fitted.z, fitted.prior),
    )
    costs = _costs(ranked, fitted, trials[:1], inside)
    if not before - costs[0] > promised / 2:
        costs += _costs(ranked, fitted, trials[1:], inside)
    return _on_their_clocks(estimation, fitted, trials[int(np.argmin(costs))], members)


def _on_their_clocks(estimation: EstimationProblem, fitted: Fit, z: FloatArray, members: Sequence[int]) -> FloatArray:
    """Put what was left out on clocks of its own: z (p,) with the delays of these recordings fitted to them alone.

    They do not depend on the machine, so no other recording determines them. But a late machine and late recordings are
    hard to tell apart: with other recordings the share of each is another, and clocks that stayed would be as wrong.
    """
    delays = clock_parameters([estimation.problem.observations[i] for i in members])
    clocks = [i for i, n in enumerate(fitted.parameters) if n.name in delays]
    if not clocks:
        return z
    return _fitted_there(estimation, fitted, z, members, clocks)


def _fitted_there(
    estimation: EstimationProblem, fitted: Fit, z: FloatArray, members: Sequence[int], which: Sequence[int]
) -> FloatArray:
    """Return z (p,) with some parameters fitted to these observations alone."""
    others = [i for i in range(len(z)) if i not in which]
    alone = estimation.limited_to(members).with_fixed(values_at([fitted.parameters[i] for i in others], z[others]))
    columns = fitted.jacobian[estimation.rows_of(members)][:, which]
    best = fit(alone, tuple(fitted.parameters[i] for i in which), z[which], columns, iterations=3)
    moved = z.copy()
    moved[which] = best.z
    return moved


def _costs(
    estimation: EstimationProblem, fitted: Fit, trials: Sequence[FloatArray], inside: NDArray[np.bool_]
) -> list[float]:
    """Simulate everything with each of these z: the cost of each outside of what is left out."""
    residuals = estimation.residuals([values_at(fitted.parameters, z) for z in trials])
    return [_cost(x[inside], z, fitted.prior) for x, z in zip(residuals, trials, strict=True)]


def _cost(residual: FloatArray, z: FloatArray, prior: FloatArray | float) -> float:
    return float(residual @ residual + z @ (prior * z))


def residual_left_out(
    estimation: EstimationProblem, simulated: Sequence[FloatArray], members: Sequence[int]
) -> FloatArray:
    """Return measured - simulated of what was left out, whitened: (rows,)."""
    return np.asarray(estimation.measured[estimation.rows_of(members)] - estimation.whiten(simulated, members))


def excess(estimation: EstimationProblem, simulated: Sequence[FloatArray], members: Sequence[int]) -> float:
    """Return the mean square of that residual, less one."""
    left = residual_left_out(estimation, simulated, members)
    return float(left @ left) / len(left) - 1


def left_of(held_out: Sequence[HeldOut]) -> float:
    """Return the share of it that is left, in units of the noise or of the signals, whichever is larger.

    Where one band is loud or quiet by far, one of the two is blind to all others.
    """
    white = sum(max(one.after, 0.0) * one.rows for one in held_out) / max(to_explain(held_out), 1e-300)
    filed, after, signals, noise = np.sum([one.power for one in held_out], axis=0)
    return max(white, float(max(after - noise, 0.0) / max(min(filed, signals) - noise, 1e-300)))


def to_explain(held_out: Sequence[HeldOut]) -> float:
    """Return how much there is to explain where it was left out: by the better of the file and of retuning.

    An axis that nothing holds may be simulated worse than if it stood still: what ends that explains nothing.
    """
    return min(sum(max(getattr(one, key), 0.0) * one.rows for one in held_out) for key in ("before", "filed", "signal"))


def _power(estimation: EstimationProblem, simulated: Sequence[FloatArray], members: Sequence[int]) -> float:
    """Power of the error, not whitened."""
    each = [estimation.problem.observations[i] for i in members]
    parts = [estimation.whiten.band_power(o, o.measured - y) for o, y in zip(each, simulated, strict=True)]
    return float(np.sum(np.concatenate(parts)))


def _noise_power(estimation: EstimationProblem, members: Sequence[int]) -> float:
    """Power of the floor alone, in the same unit."""
    whiten = estimation.whiten
    parts = [whiten.noise_power(estimation.problem.observations[i], whiten.floor) for i in members]
    return float(np.sum(np.concatenate(parts)))


# ---- other motions ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class OtherMotion:
    """A motion of an axis, simulated with what was fitted to the others; rms of errors as shares of its signals."""

    json_keys: ClassVar = keys("after", "number", "changed", "refitted", recording="name", before="filed")

    name: str  # of its recording
    filed: float  # with the file as it is
    after: float  # with the effects
    number: str = ""  # of an effect, that is another in this motion: refitted to it alone, it explains most of the rest
    changed: float = 0.0  # by this share
    refitted: float = 0.0  # what is left then

    @property
    def worse(self) -> bool:
        """Whether it is simulated worse than with the file as it is."""
        return self.after > self.filed


def other_motions(estimation: EstimationProblem, best: Hypothesis) -> list[OtherMotion]:
    """Leave each motion of an axis out of the fit, whole; none where there is only one, or places take turns.

    The same effect may be a little larger in one recording than in others, as dry friction is on another day: a size
    that is refitted to it alone, and changes little, then explains a good part of what is left.
    """
    parts, sizes = motions_or_groups(estimation.problem), [a.name for c in best.effects for a in c.amplitudes]
    if parts.keys() == groups(estimation.problem).keys():
        return []
    which = [i for i, n in enumerate(best.fit.parameters) if n.name in sizes]
    return [_other_motion(estimation, best.fit, members, which) for members in parts.values()]


def _other_motion(
    estimation: EstimationProblem, fitted: Fit, members: Sequence[int], sizes: Sequence[int]
) -> OtherMotion:
    problem, noise = estimation.problem, _noise_power(estimation, members)
    measured = [problem.observations[i].measured for i in members]
    signals = _power(estimation, [np.zeros_like(x) for x in measured], members)

    def power(values: Mapping[str, float]) -> float:
        return _power(estimation, problem.simulate(values, members), members)

    z = _fitted_to_others(estimation, fitted, members)
    left = power(values_at(fitted.parameters, z))
    name = Path(problem.observations[members[0]].name.rpartition(" from ")[0]).name
    filed, after = (float(np.sqrt(x / signals)) for x in (power({}), left))
    result = OtherMotion(name, filed, after)
    least = noise + DIFFERS * (left - noise)
    for i in sizes:
        there = _fitted_there(estimation, fitted, z, members, [i])
        n = fitted.parameters[i]
        was, now = (n.start + n.sd * float(x[i]) for x in (z, there))
        less = power(values_at(fitted.parameters, there))
        changed = now / was - 1 if was else np.inf
        if less < least and DIFFERS_FROM < abs(changed) < DIFFERS_BY:
            result = replace(result, number=n.name, changed=changed, refitted=float(np.sqrt(less / signals)))
            least = less
    return result
