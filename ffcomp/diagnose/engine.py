"""The diagnosis, step by step: noise floor, base fit, gap, screening, refits, gates.

A gap is what neither noise nor retuning within the stated uncertainties explains. An effect is named only if it
passes every gate:

    a gap exists · it is worth its cost (evidence) · little of the gap is left · little is left at every place the
    numbers were not fitted to · its interval excludes none, and its value is possible

What fails is `unknown`: a gap that nothing explains is never called no gap.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from ffcomp.diagnose.fit import Bench, Fit, bench, clipped, derivatives, fit, values_at
from ffcomp.diagnose.noise import NoiseFloor, noise_from_repeats, noise_from_residual, whitener
from ffcomp.diagnose.plant import Candidate, Impossible, Number, Plant
from ffcomp.diagnose.screen import Screened, likeness, screen
from ffcomp.identify.estimates import NINETY_PERCENT, Estimate
from ffcomp.measured.frf import FloatArray

EXISTS = 0.05  # the share of the noise by which a gap must stand above it
WORTH = 10.0  # −2 ln Z
RIVAL = 20.0
LEFT = 0.15  # of the gap may be left
NEAR_NOISE = 0.10  # of the noise: what is left is called nothing
FURTHER = 0.10  # of what remains must a further effect remove
MOST = 3  # effects at once
REFITTED = 6  # candidates that are fitted fully
SCALES = (1.0, 0.5, 0.25, 0.1, 0.03, -0.1, -0.5)  # of a linear estimate
POLISHED = 3
PAIRED = 5  # candidates whose pairs are tried

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Some effects together, all numbers fitted."""

    effects: tuple[Candidate, ...]
    fit: Fit

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(sorted(c.name for c in self.effects))


@dataclass(frozen=True)
class Place:
    """A place left out of the fit: the gap there before and after, as shares of its noise (χ² by row, less one)."""

    place: tuple[float, ...]
    before: float
    after: float

    @property
    def explained(self) -> bool:
        return self.after < max(LEFT * self.before, NEAR_NOISE)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    verdict: str  # "effects", "none" or "unknown"
    named: Hypothesis | None  # the effects of an `effects` verdict
    best: Hypothesis | None  # the best that was tried, whatever the verdict
    base: Fit
    bench: Bench
    noise: NoiseFloor
    screened: Sequence[Screened]
    tried: Sequence[Hypothesis]
    rivals: Sequence[Hypothesis]  # as likely as what is named
    places: Sequence[Place]
    refused: tuple[str, ...]  # which gates the best hypothesis failed, in words
    intervals: Mapping[str, Estimate] = field(default_factory=dict)  # of the best hypothesis' amplitudes and shapes


def diagnose(plant: Plant, progress: Progress = lambda _: None) -> Diagnosis:
    """Find the effects that are missing from the plant, if any."""
    noise = noise_floor(plant)
    if not noise.from_repeats:
        progress("no repeats: the noise floor is taken from above the model's band")
    whiten = whitener(plant.recordings, noise, plant.band_hz)
    desk = bench(plant, whiten)
    progress("fitting the machine's own numbers")
    nominal = _nominal(desk)
    base = fit(desk, nominal.numbers, nominal.z, nominal.jacobian)
    gap = _gap(base)
    progress(f"left after retuning: {gap:+.3f} of the noise")
    if gap < EXISTS:
        return Diagnosis("none", None, None, base, desk, noise, (), (), (), (), ())
    return _searched(desk, nominal, base, noise, progress)


def _nominal(desk: Bench) -> Fit:
    """The machine file as it is, with the derivatives there."""
    numbers = tuple(desk.plant.numbers)
    z = np.zeros(len(numbers))
    residual = desk.residual({})
    return Fit(numbers, z, residual, derivatives(desk, numbers, z, residual, range(len(z))))


def noise_floor(plant: Plant, simulated: Sequence[FloatArray] | None = None) -> NoiseFloor:
    """From repeats; without any, from what is left above the model's band."""
    floor = noise_from_repeats(plant.recordings)
    if floor is not None:
        return floor
    found = plant.simulate({}) if simulated is None else simulated
    errors = [r.measured - y for r, y in zip(plant.recordings, found, strict=True)]
    return noise_from_residual(plant.recordings, errors, plant.band_hz)


def _gap(fitted: Fit) -> float:
    """How far the cost stands above noise alone, as a share of it."""
    return fitted.cost / len(fitted.residual) - 1


# ---- search --------------------------------------------------------------------------------------


def _searched(desk: Bench, nominal: Fit, base: Fit, noise: NoiseFloor, progress: Progress) -> Diagnosis:
    """Candidates are screened and refitted from the machine file's own numbers, not from the retuned ones: with the
    right effect they need no retuning, and a base fit that stretched them to mimic it leads astray."""
    candidates = list(desk.plant.candidates)
    progress(f"screening {len(candidates)} effects")
    screened = screen(desk, nominal, candidates)
    tried = _polished(desk, [refitted(desk, nominal, (s,), progress) for s in screened[:REFITTED]], progress)
    best = min(tried, key=lambda h: h.fit.evidence)
    while _gap(best.fit) > max(NEAR_NOISE / 2, FURTHER * _gap(base)) and len(best.effects) < MOST:
        further = _further(desk, nominal, best, candidates, screened, progress)
        tried += further
        step = min(further, key=lambda h: h.fit.evidence, default=best)
        if not _worth(step.fit, best.fit):
            break
        best = step
    best = _pruned(desk, base, best, tried)
    places = held_out(desk, base, best.fit)
    intervals = intervals_of(desk, best)
    refused = tuple(_refusals(base, best, places, intervals))
    rivals = [h for h in tried if h.names != best.names and len(h.effects) == len(best.effects) and _rival(h, best)]
    named = None if refused else best
    return Diagnosis(
        "unknown" if refused else "effects",
        named,
        best,
        base,
        desk,
        noise,
        screened,
        sorted(tried, key=lambda h: h.fit.evidence),
        rivals,
        places,
        refused,
        intervals,
    )


def refitted(desk: Bench, base: Fit, chosen: Sequence[Screened], progress: Progress) -> Hypothesis:
    """All numbers together, beginning at the linear estimates."""
    effects = tuple(s.candidate for s in chosen)
    added = tuple(n for c in effects for n in c.numbers)
    numbers = (*base.numbers, *added)
    start = _best_scale(desk, base, numbers, chosen)
    first = len(base.numbers)
    renew = list(range(first, len(numbers)))
    found = fit(desk, numbers, start, _with_columns(desk, base, numbers, start, renew), renew, iterations=8)
    progress(f"{' + '.join(c.name for c in effects)}: {_gap(found):+.3f} of the noise is left")
    return Hypothesis(effects, found)


def _polished(desk: Bench, tried: Sequence[Hypothesis], progress: Progress) -> list[Hypothesis]:
    """The best few fitted to the end, all derivatives taken anew: what separates rivals is in the last per cent."""
    ranked = sorted(tried, key=lambda h: h.fit.evidence)
    polished = []
    for h in ranked[:POLISHED]:
        found = fit(desk, h.fit.numbers, h.fit.z, iterations=12)
        progress(f"{' + '.join(h.names)}, polished: {_gap(found):+.3f} of the noise is left")
        polished.append(Hypothesis(h.effects, found))
    return [*polished, *ranked[POLISHED:]]


def _with_columns(
    desk: Bench, base: Fit, numbers: Sequence[Number], start: FloatArray, renew: Sequence[int]
) -> FloatArray:
    z = clipped(numbers, start)
    residual = desk.residual(values_at(numbers, z))
    return np.hstack([base.jacobian, derivatives(desk, numbers, z, residual, renew)])


def _best_scale(desk: Bench, base: Fit, numbers: Sequence[Number], chosen: Sequence[Screened]) -> FloatArray:
    """The linear estimates, or the fraction of them that really helps most: a strong effect is not linear."""
    starts = [clipped(numbers, np.concatenate([base.z, *(_start(s, scale) for s in chosen)])) for scale in SCALES]
    residuals = desk.residuals([values_at(numbers, start) for start in starts])
    return starts[int(np.argmin([r @ r for r in residuals]))]


def _start(s: Screened, scale: float = 1.0) -> FloatArray:
    """z of the amplitudes by the linear estimate, kept within what is typical, and of the shapes as screened."""
    amplitudes = scale * np.clip(s.estimate, -2.0, 2.0)
    shapes = [(s.shape.get(n.name, n.start) - n.start) / n.sd for n in s.candidate.shapes]
    return np.concatenate([amplitudes, shapes])


def _further(
    desk: Bench,
    base: Fit,
    best: Hypothesis,
    candidates: Sequence[Candidate],
    screened: Sequence[Screened],
    progress: Progress,
) -> list[Hypothesis]:
    """The best hypothesis with one effect more, and, the first time, the pairs of the best screened."""
    others = [c for c in candidates if c.name not in best.names]
    again = screen(desk, best.fit, others)
    grown = [_grown(desk, best, s, progress) for s in again[:2]]
    if len(best.effects) > 1:
        return grown
    pairs = [p for p in combinations(screened[:PAIRED], 2) if {s.candidate.name for s in p} not in _names(grown)]
    likely = sorted(pairs, key=lambda p: _pair_evidence(base, p))[:2]
    return grown + [refitted(desk, base, pair, progress) for pair in likely]


def _names(hypotheses: Sequence[Hypothesis]) -> list[set[str]]:
    return [set(h.names) for h in hypotheses]


def _grown(desk: Bench, best: Hypothesis, s: Screened, progress: Progress) -> Hypothesis:
    numbers = (*best.fit.numbers, *s.candidate.numbers)
    start = np.concatenate([best.fit.z, _start(s)])
    retuned = sum(len(c.numbers) for c in best.effects)
    renew = list(range(len(best.fit.numbers) - retuned, len(numbers)))
    columns = _with_columns(desk, best.fit, numbers, start, range(len(best.fit.numbers), len(numbers)))
    found = fit(desk, numbers, start, columns, renew, iterations=8)
    progress(f"{' + '.join([*best.names, s.candidate.name])}: {_gap(found):+.3f} of the noise is left")
    return Hypothesis((*best.effects, s.candidate), found)


def _pair_evidence(base: Fit, pair: Sequence[Screened]) -> float:
    signature = np.hstack([s.signature for s in pair])
    cross = base.jacobian.T @ signature
    schur = np.eye(signature.shape[1]) + signature.T @ signature - cross.T @ np.linalg.solve(base.information, cross)
    slope = signature.T @ base.residual
    return float(-slope @ np.linalg.solve(schur, slope) + np.linalg.slogdet(schur)[1])


def _pruned(desk: Bench, base: Fit, best: Hypothesis, tried: Sequence[Hypothesis]) -> Hypothesis:
    """Without the effects that are not needed: a smaller hypothesis that is nearly as good wins."""
    smaller = [h for h in tried if set(h.names) < set(best.names)]
    for h in sorted(smaller, key=lambda h: h.fit.evidence):
        if not _worth(best.fit, h.fit):
            return h
    return best


def _worth(fitted: Fit, before: Fit) -> bool:
    """Is the larger model worth its cost, and does it remove a good part of what remains?"""
    misfit = max(1.0, fitted.chi_squared / len(fitted.residual))
    remains = before.cost - len(before.residual)
    return (before.evidence - fitted.evidence) / misfit > WORTH and before.cost - fitted.cost > FURTHER * remains


def _rival(h: Hypothesis, best: Hypothesis) -> bool:
    misfit = max(1.0, best.fit.chi_squared / len(best.fit.residual))
    return (h.fit.evidence - best.fit.evidence) / misfit < RIVAL


# ---- gates ---------------------------------------------------------------------------------------


def _refusals(base: Fit, best: Hypothesis, places: Sequence[Place], intervals: Mapping[str, Estimate]) -> list[str]:
    misfit = max(1.0, best.fit.chi_squared / len(best.fit.residual))
    refusals = []
    if (base.evidence - best.fit.evidence) / misfit < WORTH:
        refusals.append("it is not worth its cost against retuning alone")
    if _gap(best.fit) > max(LEFT * _gap(base), NEAR_NOISE):
        refusals.append(f"{100 * _gap(best.fit) / _gap(base):.0f} % of the gap are left")
    for place in places:
        if not place.explained:
            at = ", ".join(f"{x:.0f}" for x in place.place)
            refusals.append(f"at ({at}) mm, left out of the fit, {100 * place.after / place.before:.0f} % are left")
    for candidate in best.effects:
        if all(_includes(intervals[a.name], a.start) for a in candidate.amplitudes):
            refusals.append(f"the interval of {candidate.name} includes no effect at all")
    return refusals


def _includes(interval: Estimate, value: float) -> bool:
    return interval.low <= value <= interval.high


def held_out(desk: Bench, base: Fit, best: Fit) -> list[Place]:
    """Each place in turn left out: both fits moved to the optimum of the others, to first order, then simulated there.

    With a single place the recordings take turns instead: weaker, but better than nothing.
    """
    return [
        Place(place, _excess_at(desk, base, members), _excess_at(desk, best, members))
        for place, members in groups(desk.plant).items()
    ]


def groups(plant: Plant) -> dict[tuple[float, ...], list[int]]:
    places: dict[tuple[float, ...], list[int]] = {}
    for i, recording in enumerate(plant.recordings):
        places.setdefault(recording.place, []).append(i)
    if len(places) > 1:
        return places
    return {(float(i),): [i] for i in range(len(plant.recordings))}


def _excess_at(desk: Bench, fitted: Fit, members: Sequence[int]) -> float:
    rows = desk.rows_at(members)
    inside = np.ones(len(fitted.residual), dtype=bool)
    inside[rows] = False
    j, r = fitted.jacobian[inside], fitted.residual[inside]
    step = np.linalg.solve(np.eye(len(fitted.z)) + j.T @ j, j.T @ r - fitted.z)
    z = clipped(fitted.numbers, fitted.z + step)
    try:
        simulated = desk.plant.simulate(values_at(fitted.numbers, z), members)
    except Impossible:  # the others alone lead nowhere: then what was fitted to all of them has to do
        simulated = desk.plant.simulate(fitted.values, members)
    left = desk.measured[rows] - desk.whiten(simulated, members)
    return float(left @ left) / len(left) - 1


def intervals_of(desk: Bench, hypothesis: Hypothesis) -> dict[str, Estimate]:
    """90 % intervals of every number of the effects."""
    fitted = hypothesis.fit
    covariance = fitted.covariance(desk.whiten.frequencies(), desk.whiten.rows)
    sd = np.sqrt(np.diag(covariance))
    found = {}
    for n, z, s in zip(fitted.numbers, fitted.z, sd, strict=True):
        value, spread = n.start + n.sd * float(z), n.sd * float(s)
        low, high = max(n.low, value - NINETY_PERCENT * spread), min(n.high, value + NINETY_PERCENT * spread)
        found[n.name] = Estimate(value, spread, low, high)
    return found


def confusable(diagnosis: Diagnosis, limit: float = 0.8) -> list[tuple[str, float]]:
    """Candidates whose signature is like that of a named effect: name and cos²."""
    if diagnosis.best is None:
        return []
    ours = [s for s in diagnosis.screened if s.candidate.name in diagnosis.best.names]
    others = [s for s in diagnosis.screened if s.candidate.name not in diagnosis.best.names]
    alike = {o.candidate.name: max((likeness(o, s) for s in ours), default=0.0) for o in others}
    return sorted(((name, c) for name, c in alike.items() if c > limit), key=lambda pair: -pair[1])
