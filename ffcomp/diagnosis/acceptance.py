"""Acceptance tests: what a hypothesis must pass before its effects are named.

Every place is left out of the fit in turn (every experiment, where there is one place only): what a hypothesis says of
it then is what it would say of a place that nobody has measured.

Real machines hold more than one thing, so that no single effect passes all tests. One is named nevertheless, with a
rest, if, where it was left out of the fit,

    it explains most of the discrepancy · it leaves far less than any effect of another family · what it leaves no
    longer looks like it · it does so whichever group is not counted

Of a place that was left out the file's numbers are fitted there, within what the file says: a rest bends them, at every
place otherwise, and a frequency that is off there by a little would hide whatever the effect explains.

An effect that is only the nearest wrong one fails these: another is nearly as near, or its size would have to change
from place to place, so that what is left has its signature.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnosis.fidelity import continue_fit, fit_within_uncertainty, quickest
from ffcomp.diagnosis.fit import (
    EstimationProblem,
    Fit,
    clipped,
    derivatives,
    fit,
    intervals_of,
    step_within,
    superfluous,
    values_at,
    wide_intervals_of,
)
from ffcomp.diagnosis.hypotheses import FILE_CHANGES, LAW_GROUPS, Hypothesis, implausible, likeliest, moved_numbers
from ffcomp.diagnosis.observations import Position, clustered
from ffcomp.diagnosis.problem import Parameter, Problem
from ffcomp.diagnosis.recording_clocks import belongs_to_recording, clock_parameters
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.identification.uncertainty import Estimate
from ffcomp.numerics.stages import Progress
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE

AT_BOUND = 1e-6  # of a parameter's range: no nearer to its end is at it
NARROW = 0.1  # of a number: a range that leaves no more open determines it


# ---- the tests -----------------------------------------------------------------------------------


def rejections(
    base: Fit,
    best: Hypothesis,
    held_out: Sequence[HeldOut],
    intervals: Mapping[str, Estimate],
    tolerance: float,
    signal: float = np.inf,
) -> list[str]:
    """List the acceptance tests that a hypothesis fails, in words; none if it is accepted.

    Parameters
    ----------
    signal : the discrepancy with nothing simulated at all; a worse one of the base is no measure.
    """
    failed, whole = [], min(base.discrepancy, signal)
    if (base.evidence - best.fit.evidence) / best.fit.misfit < SETTINGS.significant:
        failed.append("it is not significantly better than retuning alone")
    if best.discrepancy > max(SETTINGS.left * whole, tolerance):
        failed.append(f"{100 * best.discrepancy / whole:.0f} % of the discrepancy is left")
    failed += [_unexplained(one, tolerance) for one in contradicting(held_out, tolerance)]
    # where retuning alone explains the data as well, but by implausible parameters, there is nothing to gain
    if not held_out:
        failed.append("it was tested nowhere else: there is one experiment only")
    elif not implausible(base) and sum((one.before - one.after) * one.rows for one in held_out) < SETTINGS.significant:
        failed.append("data left out of the fit are simulated no better with it")
    failed += out_of_reach(best)
    if len(best.effects) == SETTINGS.most_effects and set(best.names) <= FILE_CHANGES:
        failed.append(
            "three of the machine file's own numbers would have to be far off at once, as in the file of another "
            "machine: measure this one (ffcomp identify)"
        )
    failed += unfounded(best, intervals)
    for candidate in best.effects:
        if superfluous(candidate, intervals):
            failed.append(f"the interval of {candidate.name} includes no effect at all")
    return failed


def out_of_reach(best: Hypothesis) -> list[str]:
    """Say which of the file's own numbers had to move furthest, if they had to move beyond what the file says."""
    if best.plausible:
        return []
    name, z = max(moved_numbers(best.fit, best.machine_count), key=lambda each: each[1])
    return [
        "with it the machine file's own numbers would have to be off by more than the file says, "
        f"{name} by {z:.1f} times its uncertainty"
    ]


def unfounded(best: Hypothesis, intervals: Mapping[str, Estimate]) -> list[str]:
    """Say of which effect nothing shows what makes it one: a ripple without a pitch, a mode without a frequency.

    A mode that swings far below the band is a mass that stays behind, and stands in for whatever asks for a gain.
    """
    return [
        f"{name.removeprefix('effects.')} is not determined, so nothing shows that it {does}"
        for does, key in (("repeats", ".pitch_mm"), ("swings", ".frequency_hz"))
        for name in [n for n in undetermined(best, intervals) if key in n][:1]
    ]


def undetermined(best: Hypothesis, intervals: Mapping[str, Estimate]) -> list[str]:
    """Return the effects' numbers that the data do not determine: at their bounds, or open over the whole range."""
    return [n.name for n in best.effect_parameters if n.low < n.high and _open(n, intervals[n.name])]


def _open(n: Parameter, interval: Estimate) -> bool:
    at_high = interval.value >= n.high - AT_BOUND * (n.high - max(n.low, -n.high)) if np.isfinite(n.high) else False
    at_low = n.low != 0.0 and np.isfinite(n.low) and interval.value <= n.low + AT_BOUND * abs(n.low)
    wide = n.high - n.low > NARROW * max(abs(n.low), abs(n.high))  # a line's pitch is sought close to where it was seen
    return at_high or at_low or (wide and interval.low <= n.low and interval.high >= n.high)


def contradicting(held_out: Sequence[HeldOut], tolerance: float) -> list[HeldOut]:
    """Return what was left out and contradicts a hypothesis.

    Shapes are never exactly ours: a place, or a window of little motion, that holds a small part of all that has to be
    explained, and that it does not explain, says that it is unproven there, no more; unless it makes things worse there
    by a good part of that.
    """
    minor = SETTINGS.minor_place * sum(max(one.before, 0.0) * one.rows for one in held_out)

    def weighs(one: HeldOut) -> bool:
        worse = one.after > max(SETTINGS.worse_place * one.before, tolerance)
        return one.after * one.rows > (minor / 4 if worse else minor)

    return [one for one in held_out if not one.explained(tolerance) and weighs(one)]


def unproven(held_out: Sequence[HeldOut], tolerance: float) -> list[HeldOut]:
    """Return what was left out and is not explained."""
    return [one for one in held_out if not one.explained(tolerance)]


def _unexplained(one: HeldOut, tolerance: float) -> str:
    if one.before <= tolerance:
        return f"at {one.label}, left out of the fit, it makes things worse"
    return f"at {one.label}, left out of the fit, {100 * one.after / one.before:.0f} % remains"


# ---- what is left out of the fit -----------------------------------------------------------------


@dataclass(frozen=True)
class HeldOut:
    """A place left out of the fit: the discrepancy there, as shares of its noise (χ² by row, less one)."""

    position: Position
    experiment: str  # where experiments take turns, for there is one place only; else ""
    rows: int
    before: float  # with the machine's parameters retuned at the other positions
    after: float  # with the effects as well
    filed: float = np.inf  # with the file as it is
    signal: float = np.inf  # with nothing simulated at all
    power: tuple[float, ...] = ()  # in the band: of the error with the file as it is, with the effects; of the signals
    noise_power: float = 0.0  # of the noise alone, as `power`

    def explained(self, tolerance: float) -> bool:
        """Whether little is left; `tolerance` is a share of the noise."""
        return self.after < max(
            SETTINGS.left * self.before, tolerance, min(SETTINGS.left_near_noise * self.before, SETTINGS.near_noise)
        )

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

    The other windows of a motion tell much of each: what rings on, and where it came to rest. What an effect by place
    or by speed says of another motion they do not tell.
    """
    observations, motions = problem.observations, problem.motions
    if len(set(motions)) < 2 or any(len(o.position) > 1 for o in observations):
        return groups(problem)
    first = [motions.index(motion) for motion in sorted(set(motions))]
    return {(observations[i].position, observations[i].name): _members(motions, motions[i]) for i in first}


def _members(motions: Sequence[int], one: int) -> list[int]:
    return [i for i, motion in enumerate(motions) if motion == one]


Groups = Mapping[tuple[Position, str], Sequence[int]]


def hold_out(
    estimation: EstimationProblem, base: Fit, best: Fit, parts: Groups | None = None, retuned: bool = False
) -> list[HeldOut]:
    """Leave each group out in turn, of both fits: move a fit to the optimum of the others, to first order.

    Parameters
    ----------
    retuned : as `_left_out` takes it
    """
    left_out, parts = [], groups(estimation.problem) if parts is None else parts
    alone = [_left_out(estimation, base, members, retuned) for members in parts.values()]
    effects = alone if best is base else [_left_out(estimation, best, members, retuned) for members in parts.values()]
    each = zip(parts.items(), alone, effects, strict=True)
    for ((position, experiment), members), before, after in each:
        filed = estimation.problem.simulate({}, members)
        nothing = [np.zeros_like(y) for y in filed]
        power = tuple(_power(estimation, y, members) for y in (filed, after, nothing))
        left_out.append(
            HeldOut(
                position,
                experiment,
                rows=len(estimation.rows_of(members)),
                before=excess(estimation, before, members),
                after=excess(estimation, after, members),
                filed=excess(estimation, filed, members),
                signal=excess(estimation, nothing, members),
                power=power,
                noise_power=_noise_power(estimation, members),
            )
        )
    return left_out


def motions_against(estimation: EstimationProblem, larger: Fit, smaller: Fit) -> bool:
    """Leave each motion out in turn: tell whether the larger model simulates as many of them worse as better.

    What a motion alone shows is in no other: left out, it is simulated neither better nor worse.
    """
    motions = estimation.problem.motions
    better = worse = 0
    for one in sorted(set(motions)) if len(set(motions)) > 1 else ():
        members = _members(motions, one)
        less, more = (excess(estimation, _left_out(estimation, each, members), members) for each in (smaller, larger))
        worse += more > max(SETTINGS.worse_place * less, estimation.tolerance)
        better += less > max(SETTINGS.worse_place * more, estimation.tolerance)
    return worse >= max(better, 1)


def _left_out(
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


def _by_place(estimation: EstimationProblem) -> bool:
    """Tell whether places may bend the file's numbers; an axis has one, and its motions share them."""
    return any(len(o.position) > 1 for o in estimation.problem.observations)


def _retuned_there(estimation: EstimationProblem, fitted: Fit, z: FloatArray, members: Sequence[int]) -> FloatArray:
    """Return z (p,) with the file's numbers as these observations have them: two steps, to first order."""
    own = [i for i, n in enumerate(fitted.parameters) if not n.name.startswith("effects.")]
    parameters, j = [fitted.parameters[i] for i in own], fitted.jacobian[estimation.rows_of(members)][:, own]
    alone, normal = estimation.limited_to(members), np.eye(len(own)) + j.T @ j
    residual = alone.residual(values_at(fitted.parameters, z))
    for _ in range(2):
        step, least = step_within(parameters, z[own], normal, j.T @ residual - z[own]), _cost(residual, z[own])
        for share in (1.0, 0.4, 0.1):
            trial = z.copy()
            trial[own] += share * step
            there = alone.residual(values_at(fitted.parameters, trial))
            if _cost(there, trial[own]) < least:
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
    normal, slope = np.eye(len(keep)) + j.T @ j, j.T @ r - fitted.z[keep]
    step, moved = np.zeros(len(fitted.z)), step_within(free, fitted.z[keep], normal, slope)
    step[keep] = moved
    trials = [clipped(fitted.parameters, fitted.z + share * step) for share in (1.0, 0.5, 0.2, 0.05, 0.0)]
    # the whole step, if it brings at least half of what it promises: then there is hardly a better one
    ranked, residual = quickest(estimation, fitted.values)
    promised, before = float(2 * slope @ moved - moved @ normal @ moved), _cost(residual[inside], fitted.z)
    costs = _costs(ranked, fitted, trials[:1], inside)
    if not before - costs[0] > promised / 2:
        costs += _costs(ranked, fitted, trials[1:], inside)
    return _on_their_clocks(estimation, fitted, trials[int(np.argmin(costs))], members)


def _on_their_clocks(estimation: EstimationProblem, fitted: Fit, z: FloatArray, members: Sequence[int]) -> FloatArray:
    """Put what was left out on clocks of its own: z (p,) with the delays of these recordings fitted to them alone.

    They say nothing of the machine, so nothing else tells them. But a late machine and late recordings are hard to
    tell apart: with other recordings the share of each is another, and clocks that stayed would be wrong by as much.
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
    return [_cost(x[inside], z) for x, z in zip(residuals, trials, strict=True)]


def _cost(residual: FloatArray, z: FloatArray) -> float:
    return float(residual @ residual + z @ z)


def residual_left_out(
    estimation: EstimationProblem, simulated: Sequence[FloatArray], members: Sequence[int]
) -> FloatArray:
    """Return measured - simulated of what was left out, whitened: (rows,)."""
    return np.asarray(estimation.measured[estimation.rows_of(members)] - estimation.whiten(simulated, members))


def excess(estimation: EstimationProblem, simulated: Sequence[FloatArray], members: Sequence[int]) -> float:
    """Return the mean square of that residual, less one."""
    left = residual_left_out(estimation, simulated, members)
    return float(left @ left) / len(left) - 1


def to_explain(held_out: Sequence[HeldOut]) -> float:
    """Return how much there is to explain where it was left out: by the better of the file and of retuning.

    An axis that nothing holds may be simulated worse than if it stood still: what ends that explains nothing.
    """
    return min(sum(max(getattr(one, key), 0.0) * one.rows for one in held_out) for key in ("before", "filed", "signal"))


def explained_elsewhere(held_out: Sequence[HeldOut]) -> float:
    """Return the share of it that a hypothesis explains; windows and places weigh what there is to explain in them."""
    whole = to_explain(held_out)
    return 1 - sum(max(one.after, 0.0) * one.rows for one in held_out) / whole if whole > 0 else 0.0


def _power(estimation: EstimationProblem, simulated: Sequence[FloatArray], members: Sequence[int]) -> float:
    """Power of the error, not whitened."""
    observations = [estimation.problem.observations[i] for i in members]
    parts = [
        estimation.whiten.spectrum(observation, observation.measured - y)[0]
        for observation, y in zip(observations, simulated, strict=True)
    ]
    return float(sum(np.sum(np.abs(part) ** 2) for part in parts))


def _noise_power(estimation: EstimationProblem, members: Sequence[int]) -> float:
    """Power of the floor alone, in the same unit."""
    whiten, total = estimation.whiten, 0.0
    for observation in (estimation.problem.observations[i] for i in members):
        _, frequency = whiten.spectrum(observation, observation.measured)
        power = 2 * whiten.power(observation)
        total += sum(float(np.sum(whiten.floor.at(s, frequency))) * power for s in observation.signals)
    return total


# ---- other motions ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class OtherMotion:
    """A motion of an axis, simulated with what was fitted to the others; rms of errors as shares of its signals."""

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
    least = noise + SETTINGS.differs * (left - noise)
    for i in sizes:
        there = _fitted_there(estimation, fitted, z, members, [i])
        n = fitted.parameters[i]
        was, now = (n.start + n.sd * float(x[i]) for x in (z, there))
        less = power(values_at(fitted.parameters, there))
        changed = now / was - 1 if was else np.inf
        if less < least and SETTINGS.differs_from < abs(changed) < SETTINGS.differs_by:
            result, least = (
                replace(result, number=n.name, changed=changed, refitted=float(np.sqrt(less / signals))),
                less,
            )
    return result


# ---- named, with a rest ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rival:
    """The best effect of another family."""

    names: tuple[str, ...]
    explained: float  # share of the discrepancy where it was left out of the fit


@dataclass(frozen=True, eq=False)
class Dominant:
    """The effect that holds most of a discrepancy."""

    hypothesis: Hypothesis  # of one effect
    explained: float  # share of the discrepancy where it was left out of the fit
    rivals: tuple[Rival, ...]  # the best first


@dataclass(frozen=True, eq=False)
class _Tested:
    """A hypothesis where it was left out of the fit."""

    hypothesis: Hypothesis
    left: FloatArray  # (groups,) of |r|² beyond noise
    alike: float  # share of what is left that has the effects' signature


def dominant_effect(
    estimation: EstimationProblem, base: Fit, tried: Sequence[Hypothesis], best: Hypothesis, progress: Progress
) -> Dominant | None:
    """Return the effect that holds most of the discrepancy, if one does.

    Parameters
    ----------
    base : the machine's parameters alone
    tried : hypotheses of the same data
    best : it may be of several effects; where it leaves far less, one that holds most is among them
    """
    contenders = _contenders([h for h in tried if len(h.fit.residual) == len(base.residual)])
    parts = motions_or_groups(estimation.problem)
    if not contenders or len(parts) < 2:
        return None
    if min(h.discrepancy for h in contenders) > (1 - SETTINGS.dominant / 2) * base.discrepancy:
        return None  # even where they were fitted, none explains half of what one must elsewhere
    progress("nothing explains all of it: looking for what explains most")
    sound = [h for h in (_fitted(estimation, h, progress) for h in contenders) if _sound(estimation, h)]
    if not sound:
        return None
    held_out = hold_out(estimation, base, base, parts, retuned=_by_place(estimation))
    whole = to_explain(held_out)
    ranked = sorted((_tested(estimation, h, parts) for h in sound), key=lambda each: float(each.left.sum()))
    first = _simplest([each for each in ranked if _law_group(each.hypothesis) == _law_group(ranked[0].hypothesis)])
    others = [each for each in ranked if _law_group(each.hypothesis) != _law_group(first.hypothesis)]
    explained = [1 - float(each.left.sum()) / whole for each in (first, *others)]
    for each in ranked:
        share = 100 * (1 - float(each.left.sum()) / whole)
        progress(
            f"{each.hypothesis.names[0]} explains {share:.0f} % of what it was not fitted to; "
            f"{100 * each.alike:.0f} % of the rest looks like it"
        )
    if (
        explained[0] < SETTINGS.dominant
        or _better_without(best, first.hypothesis)
        or first.alike > SETTINGS.signature
        or not all(_ahead(first, other.left) for other in others)
        or not _everywhere(first, held_out, whole)
    ):
        return None
    rivals = tuple(Rival(o.hypothesis.names, x) for o, x in zip(others, explained[1:], strict=True))
    return Dominant(first.hypothesis, explained[0], rivals)


def _contenders(tried: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the single effects to test: of the families that leave least the best, of the first all its laws."""
    best: dict[str, Hypothesis] = {}
    for h in likeliest(tried):
        if len(h.effects) == 1:
            best.setdefault(h.names[0], h)
    ranked = sorted(best.values(), key=lambda h: h.discrepancy)
    groups = list(dict.fromkeys(_law_group(h) for h in ranked))[: SETTINGS.by_simulation]
    laws = [h for h in ranked if groups and _law_group(h) == groups[0]]
    return [*laws, *(next(h for h in ranked if _law_group(h) == each) for each in groups[1:])]


def _better_without(best: Hypothesis, first: Hypothesis) -> bool:
    """Tell whether the best explanation does without the family, and leaves far less."""
    without = _law_group(first) not in {LAW_GROUPS.get(name, name) for name in best.names}
    return without and SETTINGS.ahead * best.discrepancy < first.discrepancy


def _law_group(h: Hypothesis) -> str:
    return LAW_GROUPS.get(h.names[0], h.names[0])


def _simplest(laws: Sequence[_Tested]) -> _Tested:
    """Return the law of fewest numbers that no other leaves far behind; `laws` : the one that leaves least first."""
    few = sorted(laws, key=lambda each: _needed(each.hypothesis))
    return next(each for each in few if each.left.sum() <= SETTINGS.ahead * laws[0].left.sum())


def _needed(h: Hypothesis) -> int:
    """Count the numbers without which there is no such effect; others have a usual value."""
    return sum(p.role == "amplitude" or p.default is None for p in CATALOGUE[h.names[0]].parameters)


def _fitted(estimation: EstimationProblem, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fit to the end, with the file's numbers no further off than the file says: the rest would bend them."""
    fitted = continue_fit(estimation, h, progress)
    return fit_within_uncertainty(estimation, fitted, progress) if out_of_reach(fitted) else fitted


def _tested(estimation: EstimationProblem, h: Hypothesis, parts: Groups) -> _Tested:
    left, alike, total = [], 0.0, 0.0
    for members in parts.values():
        simulated = _left_out(estimation, h.fit, members, retuned=_by_place(estimation))
        residual, rows = residual_left_out(estimation, simulated, members), estimation.rows_of(members)
        squares = float(residual @ residual)
        left.append(max(squares - len(rows), 0.0))
        alike, total = alike + _explained_by(h, rows, residual), total + squares
    return _Tested(h, np.array(left), alike / max(total, 1e-300))


def _explained_by(h: Hypothesis, rows: FloatArray, residual: FloatArray) -> float:
    """Return how much of a residual the effects' derivatives explain there, beyond what retuning does; of chance none.

    With as many columns as a twentieth of the rows they explain a twentieth of anything.
    """
    from scipy.linalg import lstsq

    columns, machine = h.fit.jacobian[rows][:, h.machine_count :], h.fit.jacobian[rows][:, : h.machine_count]
    information = np.eye(h.machine_count) + machine.T @ machine
    projected = columns - machine @ np.linalg.solve(information, machine.T @ columns)
    part = projected @ lstsq(projected, residual, cond=1e-6)[0]
    by_chance = len(projected.T) / len(rows) * float(residual @ residual)
    return max(float(part @ part) - by_chance, 0.0)


def _ahead(first: _Tested, left: FloatArray) -> bool:
    """Tell whether something else leaves far more, (groups,), whichever group is not counted."""
    apart = left - SETTINGS.ahead * first.left
    return bool(np.all(apart.sum() - apart > 0.0))


def _everywhere(first: _Tested, held_out: Sequence[HeldOut], whole: float) -> bool:
    """Tell whether it is as far ahead of retuning alone, which leaves `whole`, whichever group is not counted."""
    before = np.array([max(one.before, 0.0) * one.rows for one in held_out])
    return _ahead(first, before * whole / max(before.sum(), 1e-300))


def _sound(estimation: EstimationProblem, h: Hypothesis) -> bool:
    """Tell whether the file stays plausible, what is to repeat or swing does, and any of its numbers is determined.

    A rest bends the file's numbers, in quiet data as far as they may go: then the effect must hold most with the file
    as it is, for what numbers at their ends explain another file would.

    Its interval may include no effect where only ratios of forces show, as of a servo whose stiffness is a guess.
    """
    squares = [z**2 for _, z in moved_numbers(h.fit, h.machine_count)]
    held = sum(squares) <= SETTINGS.implausible * len(squares) * (1 + 1e-9)  # what is held there is not beyond it
    ends = sum(square > SETTINGS.implausible * (1 - 1e-9) for square in squares)
    if not held or (ends > max(len(squares) / 2, SETTINGS.most_effects) and not _holds_most_as_filed(estimation, h)):
        return False
    if unfounded(h, intervals_of(estimation, h.fit, h.fit.values, scatter=True)):
        return False
    numbers = [n for n in h.effect_parameters if n.low < n.high]
    return not numbers or len(undetermined(h, wide_intervals_of(estimation, h.fit, h.fit.values))) < len(numbers)


def _holds_most_as_filed(estimation: EstimationProblem, h: Hypothesis) -> bool:
    """Tell whether the effect explains most of what the file as it is leaves, without any of its numbers retuned."""
    machine = zip(h.machine_parameters, h.fit.z, strict=False)
    filed = values_at(h.machine_parameters, np.array([z if belongs_to_recording(n.name) else 0.0 for n, z in machine]))
    there, every = estimation.with_fixed(filed), range(h.effect_count)
    without = there.residual({})
    begun = there.residual(values_at(h.effect_parameters, h.effect_z))
    columns = derivatives(there, h.effect_parameters, h.effect_z, begun, every)
    alone = fit(there, h.effect_parameters, h.effect_z, columns, every, 6)
    return alone.chi_squared < (1 - SETTINGS.dominant) * float(without @ without)
