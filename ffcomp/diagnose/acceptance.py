"""Gates: what a hypothesis must pass before its effects are named; held-out places, intervals, look-alikes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.diagnose.fit import Bench, Fit, bounded_step, clipped, values_at
from ffcomp.diagnose.hypotheses import WORTH, Hypothesis, gap_of, misfit, stretched
from ffcomp.diagnose.problem import Candidate, Number, Plant
from ffcomp.diagnose.score_test import Screened, likeness
from ffcomp.identify.uncertainty import NINETY_PERCENT, Estimate
from models.arrays import FloatArray

LEFT = 0.15  # of the gap may be left; at one place
LEFT_NEAR, NEAR = 0.3, 0.44  # as much, if the error is then within 1.2 times the noise
RIVAL = 20.0  # −2 ln Z
SHARES = (1.0, 0.5, 0.2, 0.05, 0.0)  # of a step
ALIKE = 0.8  # cos² from which one effect can be taken for another


@dataclass(frozen=True)
class Place:
    """A place left out of the fit: the gap there, as shares of its noise (χ² by row, less one)."""

    place: tuple[float, ...]
    before: float  # with its numbers retuned at the other places
    after: float  # with the effects as well
    rows: int
    power: tuple[float, ...]  # in the band: of the error with the file as it is, with the effects; of the signals

    def explained(self, slack: float) -> bool:
        """slack : of the noise, as well as it is known."""
        return self.after < max(LEFT * self.before, slack, min(LEFT_NEAR * self.before, NEAR))


def refusals(
    base: Fit, best: Hypothesis, places: Sequence[Place], intervals: Mapping[str, Estimate], slack: float
) -> list[str]:
    """Which gates a hypothesis fails, in words; none if it is to be believed."""
    refused = []
    if (base.evidence - best.fit.evidence) / misfit(best.fit) < WORTH:
        refused.append("it is not worth its cost against retuning alone")
    if best.gap > max(LEFT * gap_of(base), slack):
        refused.append(f"{100 * best.gap / gap_of(base):.0f} % of the gap are left")
    refused += [_unexplained(place, slack) for place in places if not place.explained(slack)]
    # where retuning alone explains the data as well, but by numbers that nobody believes, there is nothing to gain
    if not stretched(base) and sum((p.before - p.after) * p.rows for p in places) < WORTH:
        refused.append("what was left out of the fit is simulated no better with it")
    for candidate in best.effects:
        if superfluous(candidate, intervals):
            refused.append(f"the interval of {candidate.name} includes no effect at all")
    return refused


def _unexplained(place: Place, slack: float) -> str:
    at = ", ".join(f"{x:.0f}" for x in place.place)
    if place.before <= slack:
        return f"at ({at}), left out of the fit, it makes things worse"
    return f"at ({at}), left out of the fit, {100 * place.after / place.before:.0f} % are left"


def superfluous(candidate: Candidate, intervals: Mapping[str, Estimate]) -> bool:
    """Its intervals include no effect at all."""
    return not candidate.switch and all(_includes(intervals[a.name], a.start) for a in candidate.amplitudes)


def _includes(interval: Estimate, value: float) -> bool:
    return interval.low <= value <= interval.high


def held_out(desk: Bench, base: Fit, best: Fit) -> list[Place]:
    """Each place in turn left out: both fits moved to the optimum of the others, to first order, then simulated there.

    With a single place the recordings take turns instead: weaker, but better than nothing.
    """
    found = []
    for place, members in groups(desk.plant).items():
        filed = desk.plant.simulate({}, members)
        before, after = _left_out(desk, base, members), _left_out(desk, best, members)
        nothing = [np.zeros_like(y) for y in filed]
        power = tuple(_power(desk, y, members) for y in (filed, after, nothing))
        gaps = _excess(desk, before, members), _excess(desk, after, members)
        found.append(Place(place, *gaps, rows=len(desk.rows_at(members)), power=power))
    return found


def groups(plant: Plant) -> dict[tuple[float, ...], list[int]]:
    places: dict[tuple[float, ...], list[int]] = {}
    for i, observation in enumerate(plant.observations):
        places.setdefault(observation.place, []).append(i)
    if len(places) > 1:
        return places
    return {(float(i),): [i] for i in range(len(plant.observations))}


def _left_out(desk: Bench, fitted: Fit, members: Sequence[int]) -> list[FloatArray]:
    """These recordings simulated, (n, m) each, as the others alone would have it: as far along the step to their
    optimum, to first order, as serves them best."""
    inside = np.ones(len(fitted.residual), dtype=bool)
    inside[desk.rows_at(members)] = False
    j, r = fitted.jacobian[inside], fitted.residual[inside]
    normal, slope = np.eye(len(fitted.z)) + j.T @ j, j.T @ r - fitted.z
    step = bounded_step(fitted.numbers, fitted.z, normal, slope)
    trials = [clipped(fitted.numbers, fitted.z + share * step) for share in SHARES]
    residuals = desk.residuals([values_at(fitted.numbers, z) for z in trials])
    costs = [float(x[inside] @ x[inside] + z @ z) for x, z in zip(residuals, trials, strict=True)]
    return desk.plant.simulate(values_at(fitted.numbers, trials[int(np.argmin(costs))]), members)


def _excess(desk: Bench, simulated: Sequence[FloatArray], members: Sequence[int]) -> float:
    left = desk.measured[desk.rows_at(members)] - desk.whiten(simulated, members)
    return float(left @ left) / len(left) - 1


def _power(desk: Bench, simulated: Sequence[FloatArray], members: Sequence[int]) -> float:
    """Of the error, not whitened."""
    parts = [
        desk.whiten.spectrum(observation, observation.measured - y)[0]
        for observation, y in zip([desk.plant.observations[i] for i in members], simulated, strict=True)
    ]
    return float(sum(np.sum(np.abs(part) ** 2) for part in parts))


def intervals_of(desk: Bench, fitted: Fit, values: Mapping[str, float]) -> dict[str, Estimate]:
    """90 % intervals of every number about the values that are named, as wide as all numbers together leave them."""
    covariance = fitted.covariance(desk.whiten.frequencies(), desk.whiten.rows)
    sd = np.sqrt(np.diag(covariance))
    return {
        n.name: _interval(n, values.get(n.name, n.start), n.sd * float(s))
        for n, s in zip(fitted.numbers, sd, strict=True)
    }


def _interval(n: Number, value: float, spread: float) -> Estimate:
    low, high = max(n.low, value - NINETY_PERCENT * spread), min(n.high, value + NINETY_PERCENT * spread)
    return Estimate(value, spread, low, high)


def rivals_of(best: Hypothesis, tried: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Other effects, as many, nearly as likely."""
    scale = misfit(best.fit)
    others = [h for h in tried if h.names != best.names and len(h.effects) == len(best.effects)]
    return [h for h in others if (h.fit.evidence - best.fit.evidence) / scale < RIVAL]


def look_alikes(best: Hypothesis, screened: Sequence[Screened], limit: float = ALIKE) -> list[tuple[str, float]]:
    """Candidates whose signature is like that of a named effect: name and cos²."""
    ours = [s for s in screened if s.candidate.name in best.names]
    others = [s for s in screened if s.candidate.name not in best.names and s.visible]
    alike = {o.candidate.name: max((likeness(o, s) for s in ours), default=0.0) for o in others}
    return sorted(((name, c) for name, c in alike.items() if c > limit), key=lambda pair: -pair[1])
