"""The diagnosis, step by step: noise floor, base fit, gap, screening, contest, further effects, gates.

A gap is what neither noise nor retuning within reach of the stated uncertainties explains. An effect is named only if
it passes every gate:

    a gap exists · it is worth its cost (evidence) · little of the gap is left · little is left at every place the
    numbers were not fitted to · its interval excludes none, and its value is possible

What fails is `unknown`: a gap that nothing explains is never called no gap.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.diagnose.acceptance import Place, held_out, intervals_of, look_alikes, refusals, rivals_of, superfluous
from ffcomp.diagnose.fit import Bench, Fit, bench, derivatives, fit
from ffcomp.diagnose.hypotheses import (
    LARGE,
    Hypothesis,
    Progress,
    contest,
    further,
    gap_of,
    plainest,
    polished,
    settled,
    simplest,
    sparing,
    stretched,
    swapped,
    thorough,
    unsettled,
    without,
    worth,
)
from ffcomp.diagnose.noise import NoiseFloor, noise_from_repeats, noise_from_residual, whitener
from ffcomp.diagnose.problem import Plant
from ffcomp.diagnose.score_test import Screened, screen
from ffcomp.identify.uncertainty import Estimate
from models.arrays import FloatArray

EXISTS = 0.05  # the share of the noise by which a gap must stand above it, or
SURE = 4.0  # standard deviations of what short runs and few repeats may seem to show
SHOWS = 30.0  # −2 ln Z that a candidate must promise, where the gap is smaller than that
POOR = 0.15  # of the gap left by one effect: then pairs are tried
MOST = 3  # effects at once


@dataclass(frozen=True, eq=False)
class Diagnosis:
    verdict: str  # "effects", "none" or "unknown"
    named: Hypothesis | None  # the effects of an `effects` verdict
    best: Hypothesis | None  # the best that was tried, whatever the verdict
    base: Fit
    final: Fit  # of the best: only what the data ask for retuned; else the base
    bench: Bench
    noise: NoiseFloor
    screened: Sequence[Screened]
    tried: Sequence[Hypothesis]
    rivals: Sequence[Hypothesis]  # as likely as what is named
    places: Sequence[Place]
    refused: tuple[str, ...]  # which gates the best hypothesis failed, in words
    intervals: Mapping[str, Estimate] = field(default_factory=dict)  # of all numbers of the best hypothesis

    @property
    def invisible(self) -> list[str]:
        """Effects of which these runs could not show a usual size."""
        return [s.candidate.name for s in self.screened if not s.visible]

    @property
    def confusable(self) -> list[str]:
        """Who else it could be: as likely, or alike to first order."""
        if self.best is None:
            return []
        likely = [name for h in self.rivals for name in h.names if name not in self.best.names]
        return list(dict.fromkeys([*likely, *(name for name, _ in look_alikes(self.best, self.screened))]))


def diagnose(plant: Plant, progress: Progress = lambda _: None) -> Diagnosis:
    """Find the effects that are missing from the plant, if any."""
    noise = noise_floor(plant)
    if not noise.from_repeats:
        progress("no repeats: the noise floor is taken from above the model's band")
    desk = bench(plant, whitener(plant.observations, noise, plant.band_hz))
    chance = SURE * _spread(desk) if noise.from_repeats else 0.0
    desk = replace(desk, slack=max(desk.slack, chance))
    progress("fitting the machine's own numbers")
    nominal = _nominal(desk)
    base = fit(desk, nominal.numbers, nominal.z, nominal.jacobian, iterations=12)
    progress(f"left after retuning: {gap_of(base):+.3f} of the noise")
    least = max(EXISTS, chance) if noise.from_repeats else desk.slack
    small = gap_of(base) < least
    progress(f"screening {len(plant.candidates)} effects")
    quick = replace(desk, coarse=True)
    screened = screen(quick, base, list(plant.candidates))
    if small and not stretched(base) and (not screened or screened[0].evidence > -SHOWS):
        return _nothing(desk, base, noise, screened)
    starts = [(base, screened)]
    if not small or stretched(base):
        # Also from the file's own numbers: with the right effect they need no retuning, and a fit that stretched them
        # to mimic it leads astray; but where they are far off, it is their error that is seen from there.
        starts = [(nominal, screen(quick, nominal, list(plant.candidates))), *starts]
    if stretched(base) and gap_of(base) < LARGE:
        starts = starts[:1]  # numbers that nobody believes explain all: with them every effect looks as good
    best, tried = _searched(desk, starts, base, progress)
    retuned = _retuned(desk, best)
    if gap_of(retuned) < least and not worth(best.fit, retuned, 0.0):
        return _nothing(desk, retuned, noise, screened)
    judged = _judged(desk, base, best, noise, screened, tried)
    # where there was hardly a gap, an effect that fails a gate leaves nothing unexplained
    return _nothing(desk, base, noise, screened) if small and judged.refused else judged


def _nothing(desk: Bench, base: Fit, noise: NoiseFloor, screened: Sequence[Screened]) -> Diagnosis:
    return Diagnosis("none", None, None, base, base, desk, noise, screened, (), (), (), ())


def _retuned(desk: Bench, best: Hypothesis) -> Fit:
    """The machine's numbers alone, from where the best hypothesis has taken them: perhaps they needed no effect."""
    own = len(best.fit.numbers) - sum(len(c.numbers) for c in best.effects)
    numbers, z = best.fit.numbers[:own], best.fit.z[:own]
    return fit(desk, numbers, z, best.fit.jacobian[:, :own], iterations=4)


def _spread(desk: Bench) -> float:
    """Standard deviation of the gap if there is none: of the residual's mean square, and of the floor it is held to."""
    observations, rows = desk.whiten.observations, desk.whiten.rows
    alike = [sum(a.repeat_of == b.repeat_of for b in observations) for a in observations]
    apart = sum((part.stop - part.start) * (1 - 1 / n) for part, n in zip(rows, alike, strict=True))
    return float(np.sqrt(2 / len(desk.measured) + 2 / apart))


def _nominal(desk: Bench) -> Fit:
    """The machine file as it is, with the derivatives there."""
    numbers = tuple(desk.plant.numbers)
    z = np.zeros(len(numbers))
    residual = desk.residual({})
    return Fit(numbers, z, residual, derivatives(desk, numbers, z, residual, range(len(z))))


def noise_floor(plant: Plant, simulated: Sequence[FloatArray] | None = None) -> NoiseFloor:
    """From repeats; without any, from what is left above the model's band."""
    floor = noise_from_repeats(plant.observations)
    if floor is not None:
        return floor
    found = plant.simulate({}) if simulated is None else simulated
    errors = [r.measured - y for r, y in zip(plant.observations, found, strict=True)]
    return noise_from_residual(plant.observations, errors, plant.band_hz)


def _searched(
    desk: Bench, starts: Sequence[tuple[Fit, Sequence[Screened]]], base: Fit, progress: Progress
) -> tuple[Hypothesis, list[Hypothesis]]:
    """The best hypothesis, and all that were tried."""
    start, screened = starts[0]
    tried = contest(desk, starts, progress)
    best = simplest(min(tried, key=lambda h: h.fit.evidence), tried)
    while len(best.effects) < MOST and unsettled(desk, best):
        best = thorough(desk, best, progress)
        if not unsettled(desk, best):
            break
        poor = best.gap > POOR * gap_of(base)
        more = further(desk, start, best, screened, poor, progress)
        tried += more
        step = min(more, key=lambda h: h.fit.evidence, default=best)
        if not worth(step.fit, best.fit):
            break
        best = settled(desk, step, progress)
        tried += swapped(desk, best, screened, tried, progress)
        best = simplest(best, tried)
    best = _needed(desk, polished(desk, best, progress), progress)
    return plainest(desk, best, tried, progress), tried


def _needed(desk: Bench, best: Hypothesis, progress: Progress) -> Hypothesis:
    """Without effects that turn out to be nothing."""
    intervals = intervals_of(desk, best.fit, best.fit.values)
    idle = [c for c in best.effects if superfluous(c, intervals)]
    if not idle or len(idle) == len(best.effects):
        return best
    smaller = without(desk, best, idle[0], progress)
    return best if worth(best.fit, smaller.fit) else _needed(desk, polished(desk, smaller, progress), progress)


def _judged(
    desk: Bench,
    base: Fit,
    best: Hypothesis,
    noise: NoiseFloor,
    screened: Sequence[Screened],
    tried: Sequence[Hypothesis],
) -> Diagnosis:
    final = sparing(desk, best)
    intervals = intervals_of(desk, best.fit, final.values)
    places = held_out(desk, base, best.fit)
    refused = tuple(refusals(base, best, places, intervals, desk.slack))
    ranked = sorted([best, *(h for h in tried if h.names != best.names)], key=lambda h: h.fit.evidence)
    return Diagnosis(
        "unknown" if refused else "effects",
        None if refused else best,
        best,
        base,
        final,
        desk,
        noise,
        screened,
        ranked,
        rivals_of(best, ranked),
        places,
        refused,
        intervals,
    )
