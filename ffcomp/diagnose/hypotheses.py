"""Hypotheses: some effects together with all numbers fitted; how they are begun, refined, enlarged and compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from ffcomp.diagnose.fit import Bench, Fit, clipped, derivatives, fit, promise, values_at
from ffcomp.diagnose.problem import Candidate, Number
from ffcomp.diagnose.score_test import Screened, likeness, screen
from models.arrays import FloatArray

WORTH = 10.0  # −2 ln Z
FURTHER = 0.4  # of what remains must a further effect remove
SHAPE = 0.1  # of what remains must a freer shape of the same effect remove
NEAR = 0.05  # of the noise, added where gaps are compared
SCALES = (1.0, 0.5, 0.25, 0.1, 0.03, -0.1, -0.5)  # of a linear estimate, and, where that may lead astray,
USUAL = (1.0, 0.5, 0.25, 0.1, 0.03, 0.01, -0.03, -0.1, -0.25, -0.5, -1.0)  # of a usual size
REFITTED, SURPRISING = 6, 3  # candidates that are fitted: by their linear promise, and by what they really do
LARGE = 1.0  # gap, of the noise, from which effects may be too strong to be linear
QUICK = 1e-2  # share of the cost that must still be gained for another step while the order is looked for
CONTENDERS = 3
CONTENDER, CLOSE = 30.0, 5.0  # times what the best leaves
FEW = 4  # numbers whose derivatives are renewed at every step
STRETCHED = 3.0  # mean square of z that retuning may cost before another effect is looked for
KIN = 0.5  # cos² of two signatures from which one effect may stand in for the other
SPREAD = (0.0, 1.0, 2.0, 3.0, 4.0)  # standard deviations from the usual, at which a shape is tried
GROWN = 3  # effects that are tried as one more
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

    @property
    def gap(self) -> float:
        return gap_of(self.fit)


def gap_of(fitted: Fit) -> float:
    """How far the cost stands above noise alone, as a share of it."""
    return fitted.cost / len(fitted.residual) - 1


def misfit(fitted: Fit) -> float:
    """Where a misfit is left, evidence counts for that much less: shapes are never exactly ours."""
    return max(1.0, fitted.chi_squared / len(fitted.residual))


def worth(fitted: Fit, before: Fit, share: float = FURTHER) -> bool:
    """Is the larger model worth its cost, and does it remove a good part of what remains?"""
    remains = max(before.cost - len(before.residual), 0.0)
    gained = (before.evidence - fitted.evidence) / misfit(fitted)
    return gained > WORTH and before.cost - fitted.cost > share * remains


@dataclass(frozen=True, eq=False)
class Entry:
    """A screened effect, or several, with the amplitudes and shapes to begin at."""

    chosen: tuple[Screened, ...]
    z: FloatArray
    cost: float  # with everything else as it was

    @property
    def numbers(self) -> tuple[Number, ...]:
        return tuple(n for s in self.chosen for n in s.candidate.numbers)


def lineup(desk: Bench, start: Fit, screened: Sequence[Screened], large: bool) -> list[Entry]:
    """Those that promise most to first order; where the gap is large, also those that really help most."""
    seen = [s for s in screened if s.visible]
    if not large:
        return [entry(desk, start, (s,)) for s in seen[:REFITTED]]
    first, others = (
        [entry(desk, start, (s,), SCALES[:4], USUAL) for s in x] for x in (seen[:REFITTED], seen[REFITTED:])
    )
    surprising = sorted([*first, *others], key=lambda e: e.cost)[:SURPRISING]
    return [*(e for e in surprising if e in others), *first]


def entry(
    desk: Bench,
    start: Fit,
    chosen: tuple[Screened, ...],
    scales: Sequence[float] = SCALES,
    usual: Sequence[float] = (),
) -> Entry:
    """Begun at the linear estimates, or at the fraction of them or of a usual size that really helps most."""
    numbers = tuple(n for s in chosen for n in s.candidate.numbers)
    begun = [np.concatenate([_start(s, scale) for s in chosen]) for scale in scales]
    begun += [np.concatenate([_usual(s, size) for s in chosen]) for size in usual]
    tries = [clipped(numbers, z) for z in begun]
    different = [z for i, z in enumerate(tries) if not any(np.array_equal(z, before) for before in tries[:i])]
    residuals = _alone(desk, start).residuals([values_at(numbers, z) for z in different])
    costs = [float(r @ r) for r in residuals]
    return Entry(chosen, different[int(np.argmin(costs))], min(costs))


def _alone(desk: Bench, start: Fit) -> Bench:
    """For effects by themselves, the machine's numbers as they stand."""
    return replace(desk, given={**desk.given, **start.values})


def contest(desk: Bench, starts: Sequence[tuple[Fit, Sequence[Screened]]], progress: Progress) -> list[Hypothesis]:
    """The screened ones fitted quickly, the best of them fitted well, those nearly as good in their best shape.

    starts : fits of the machine's numbers to begin at, each with what was screened there.
    """
    quick = replace(desk, coarse=True)
    begun: list[Hypothesis] = []
    for start, screened in starts:
        for e in lineup(quick, start, screened, gap_of(start) > LARGE):
            bar = min((h.gap for h in begun), default=np.inf)
            begun.append(refitted(quick, start, e, progress, bar))
    begun.sort(key=lambda h: h.fit.evidence)
    field = sorted((_pursued(quick, h, begun[0]) for h in _distinct(begun)), key=lambda h: h.fit.evidence)
    close = [h for h in field[:CONTENDERS] if _nearly(h, field[0], CONTENDER)]
    fitted = [_either(desk, h, progress) for h in close]
    best = min(fitted, key=lambda h: h.fit.evidence)
    shaped = [settled(desk, h, progress) if _nearly(h, best, CLOSE) else h for h in fitted]
    return shaped + [h for h in field if h not in close]


def _distinct(ranked: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The best of each kind."""
    return [h for i, h in enumerate(ranked) if h.names not in [before.names for before in ranked[:i]]]


def _pursued(desk: Bench, h: Hypothesis, best: Hypothesis) -> Hypothesis:
    """A few steps more, if there is hope."""
    if not _nearly(h, best, CONTENDER):
        return h
    found = fit(desk, h.fit.numbers, h.fit.z, h.fit.jacobian, iterations=6, small=QUICK, again=False)
    return Hypothesis(h.effects, found)


def _nearly(h: Hypothesis, best: Hypothesis, factor: float) -> bool:
    return h.gap + NEAR <= factor * max(best.gap + NEAR, NEAR)


def refitted(desk: Bench, start: Fit, e: Entry, progress: Progress, bar: float = np.inf) -> Hypothesis:
    """First the effects alone, then all numbers: what an effect explains by itself needs no retuning. Where even the
    linear promise of that stays far above the gap that another effect left, `bar`, it is not tried."""
    alone, everything = _alone(desk, start), range(len(e.numbers))
    columns = derivatives(alone, e.numbers, e.z, alone.residual(values_at(e.numbers, e.z)), everything)
    renew = everything if len(e.numbers) <= FEW else ()
    own = fit(alone, e.numbers, e.z, columns, renew, iterations=5, small=QUICK, again=False)
    both = np.hstack([start.jacobian, own.jacobian])
    found = Fit((*start.numbers, *e.numbers), np.concatenate([start.z, own.z]), own.residual, both)
    promised = (found.cost - promise(found)) / len(own.residual) - 1
    if promised + NEAR < CONTENDER * (bar + NEAR):
        found = fit(desk, found.numbers, found.z, both, iterations=3, small=QUICK, again=False)
    return _told(Hypothesis(tuple(s.candidate for s in e.chosen), found), progress)


def refined(
    desk: Bench, h: Hypothesis, progress: Progress, note: str = "", known: FloatArray | None = None
) -> Hypothesis:
    """Fitted on from derivatives taken anew, with every kink as sharp as it is.

    known : (rows, own) derivatives by the machine's numbers, where they are known well enough.
    """
    everything = range(len(h.fit.numbers))
    added = sum(len(c.numbers) for c in h.effects)
    asked = everything if known is None else everything[-added:]
    columns = derivatives(desk, h.fit.numbers, h.fit.z, desk.residual(h.fit.values), asked)
    if known is not None:
        columns = np.hstack([known, columns])
    renew = everything[-added:] if added <= FEW else ()
    found = fit(desk, h.fit.numbers, h.fit.z, columns, renew, iterations=10, small=QUICK)
    return _told(Hypothesis(h.effects, found), progress, note)


def grounded(desk: Bench, h: Hypothesis) -> Hypothesis:
    """The effects fitted again with the machine's numbers as in the file: where these were stretched to help, the
    effects may have been led astray."""
    own = _own(h)
    added, renew = h.fit.numbers[own:], range(len(h.fit.numbers) - own)
    columns = derivatives(desk, added, h.fit.z[own:], desk.residual(values_at(added, h.fit.z[own:])), renew)
    alone = fit(desk, added, h.fit.z[own:], columns, renew if len(added) <= 2 * FEW else (), 6, QUICK, again=False)
    z = np.concatenate([np.zeros(own), alone.z])
    rest = derivatives(desk, h.fit.numbers, z, alone.residual, range(own))
    return Hypothesis(h.effects, Fit(h.fit.numbers, z, alone.residual, np.hstack([rest, alone.jacobian])))


def _own(h: Hypothesis) -> int:
    """How many of the fitted numbers are the machine's."""
    return len(h.fit.numbers) - sum(len(c.numbers) for c in h.effects)


def _either(desk: Bench, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fitted on from where it is; where that leaves a gap, also from the file's own numbers."""
    found = refined(desk, h, progress)
    if found.gap < LARGE and not _stretched(found):
        return found
    again = refined(desk, grounded(desk, found), progress, ", begun anew")
    return min(found, again, key=lambda x: x.fit.evidence)


def thorough(desk: Bench, h: Hypothesis, progress: Progress) -> Hypothesis:
    """Fitted to the end: what another effect is worth must not be what this fit had not yet found."""
    begun = refined(desk, h, progress)
    found = fit(desk, begun.fit.numbers, begun.fit.z, begun.fit.jacobian, iterations=8, small=QUICK / 10)
    return _told(Hypothesis(h.effects, found), progress, " to the end")


def without(desk: Bench, h: Hypothesis, dropped: Candidate, progress: Progress) -> Hypothesis:
    """The others only."""
    return thorough(desk, _rest(h, dropped), progress)


def _rest(h: Hypothesis, dropped: Candidate) -> Hypothesis:
    effects = tuple(c for c in h.effects if c.name != dropped.name)
    keep = [i for i, n in enumerate(h.fit.numbers) if n not in dropped.numbers]
    numbers = tuple(h.fit.numbers[i] for i in keep)
    return Hypothesis(effects, Fit(numbers, h.fit.z[keep], h.fit.residual, h.fit.jacobian[:, keep]))


def polished(desk: Bench, h: Hypothesis, progress: Progress) -> Hypothesis:
    """With exact derivatives: numbers that do the same cancel only in those. Begun at the file's own numbers if the
    effects by themselves explain as much there."""
    own = _own(h)
    added = h.fit.numbers[own:]
    alone = fit(desk, added, h.fit.z[own:], h.fit.jacobian[:, own:], range(len(added)), iterations=5, again=False)
    start = np.concatenate([np.zeros(own), alone.z]) if alone.evidence < h.fit.evidence else h.fit.z
    return _told(
        Hypothesis(h.effects, fit(desk, h.fit.numbers, start, h.fit.jacobian, iterations=5, exact=True)),
        progress,
        " at the end",
    )


def _told(h: Hypothesis, progress: Progress, note: str = "") -> Hypothesis:
    progress(f"{' + '.join(c.name for c in h.effects)}{note}: {h.gap:+.3f} of the noise is left")
    return h


def _start(s: Screened, scale: float = 1.0) -> FloatArray:
    """z of the amplitudes by the linear estimate, kept within what is usual, and of the shapes as screened."""
    if s.candidate.switch:
        return np.ones(1)
    return np.concatenate([scale * np.clip(s.estimate, -2.0, 2.0), _shapes(s)])


def _usual(s: Screened, size: float) -> FloatArray:
    return np.concatenate([np.full(len(s.candidate.amplitudes), 1.0 if s.candidate.switch else size), _shapes(s)])


def _shapes(s: Screened) -> FloatArray:
    return np.array([(s.shape.get(n.name, n.start) - n.start) / n.sd for n in s.candidate.shapes])


# ---- another shape of the same effects -----------------------------------------------------------


def settled(desk: Bench, h: Hypothesis, progress: Progress) -> Hypothesis:
    """With the shapes that effects usually have set free, and a number for each tower, where that pays; with one for
    all towers where three do not."""
    for change, note in (("finer", " in its own shape"), ("other", ", in its other form"), ("first", ", in its first")):
        effects = _changed(desk, h, change)
        if effects == h.effects:
            continue
        begun = _begun(effects, h)
        if change == "finer":
            begun = _placed(desk, begun, h)
        found = refined(desk, begun, progress, note, h.fit.jacobian[:, : _own(h)])
        smaller, larger = (found, h) if change == "first" else (h, found)
        if worth(larger.fit, smaller.fit, SHAPE) == (larger is found):
            h = found
    return h


def _changed(desk: Bench, h: Hypothesis, change: str) -> tuple[Candidate, ...]:
    """The effects in another form; as they are if what is left is nothing anyway."""
    by_name = {c.name: c for c in desk.plant.candidates}
    if change == "first":
        return tuple(_first(c, by_name[c.name]) for c in h.effects)
    if largest_excess(desk, h.fit) < desk.slack:
        return h.effects
    return tuple(c.shaped if change == "finer" else _other(c) for c in h.effects)


def _other(candidate: Candidate) -> Candidate:
    if candidate.other is None:
        return candidate
    return candidate.other if candidate.finer else candidate.other.shaped


def _first(candidate: Candidate, first: Candidate) -> Candidate:
    if candidate.other is not None or first.other is None:
        return candidate
    return first if candidate.finer or not first.finer else first.shaped


def _begun(effects: tuple[Candidate, ...], h: Hypothesis) -> Hypothesis:
    """Other numbers for the same effects, where they stand now."""
    own = h.fit.numbers[: _own(h)]
    numbers = (*own, *(n for c in effects for n in c.numbers))
    known = {n.name: float(z) for n, z in zip(h.fit.numbers, h.fit.z, strict=True)}
    z = clipped(numbers, np.array([_known(n, known) for n in numbers]))
    return Hypothesis(effects, Fit(numbers, z, h.fit.residual, h.fit.jacobian))


def _placed(desk: Bench, begun: Hypothesis, before: Hypothesis) -> Hypothesis:
    """The numbers that are new, effect by effect, where they really help most: far from there, nothing may point the
    way."""
    numbers, z = begun.fit.numbers, begun.fit.z
    for effect in begun.effects:
        new = [i for i, n in enumerate(numbers) if n in effect.numbers and n not in before.fit.numbers]
        steps = SPREAD if len(new) < 3 else SPREAD[::2]
        tries = [z, *(_moved(numbers, z, new, shift) for shift in product(steps, repeat=len(new)))]
        residuals = desk.residuals([values_at(numbers, x) for x in tries])
        costs = [float(r @ r + x @ x) for r, x in zip(residuals, tries, strict=True)]
        z = tries[int(np.argmin(costs))]
    return Hypothesis(begun.effects, replace(begun.fit, z=z))


def _moved(numbers: Sequence[Number], z: FloatArray, which: Sequence[int], shift: Sequence[float]) -> FloatArray:
    moved = z.copy()
    moved[list(which)] += shift
    return clipped(numbers, moved)


def _known(n: Number, known: Mapping[str, float]) -> float:
    """The number's own z, or that of all towers, or the mean of the towers'; zero if it is new."""
    stem = n.name.partition("[")[0]
    if n.name in known or stem in known:
        return known.get(n.name, known.get(stem, 0.0))
    parts = [z for name, z in known.items() if name.partition("[")[0] == stem]
    return float(np.mean(parts)) if parts else 0.0


def unsettled(desk: Bench, h: Hypothesis) -> bool:
    """A gap is left somewhere, or the machine's numbers had to be stretched to close it."""
    return largest_excess(desk, h.fit) > desk.slack or _stretched(h)


def _stretched(h: Hypothesis) -> bool:
    return stretched(h.fit, _own(h))


def stretched(fitted: Fit, own: int | None = None) -> bool:
    """Did the machine's numbers, the first `own`, have to move further than their uncertainties make likely?"""
    z = fitted.z[:own]
    return float(z @ z) > STRETCHED * len(z)


def largest_excess(desk: Bench, fitted: Fit) -> float:
    """Of any recording, above its noise, as a share of it."""
    parts = [fitted.residual[rows] for rows in desk.whiten.rows]
    return max(float(r @ r) / len(r) - 1 for r in parts)


# ---- more effects, or fewer ----------------------------------------------------------------------


def further(
    desk: Bench, start: Fit, best: Hypothesis, screened: Sequence[Screened], poor: bool, progress: Progress
) -> list[Hypothesis]:
    """The best hypothesis with one effect more; and where a single one explains poorly, the pairs of the screened."""
    quick, others = replace(desk, coarse=True), [c for c in desk.plant.candidates if c.name not in best.names]
    begun = [(best, e) for e in lineup(quick, best.fit, screen(quick, best.fit, others)[:GROWN], large=False)]
    if best.gap > LARGE or _stretched(best):
        state = grounded(quick, best)
        begun += [(state, e) for e in _likely(quick, state, screen(quick, state.fit, others))]
    grown = _distinct(sorted((_grown(quick, *one, progress) for one in begun), key=lambda h: h.fit.evidence))
    if poor and len(best.effects) == 1:
        pairs = [p for p in combinations(screened[:PAIRED], 2) if {s.candidate.name for s in p} not in _names(grown)]
        likely = sorted(pairs, key=lambda p: _pair_evidence(start, p))[:2]
        grown += [refitted(quick, start, entry(quick, start, pair), progress) for pair in likely]
    ranked = sorted(grown, key=lambda h: h.fit.evidence)
    fitted = [_either(desk, h, progress) for h in ranked[:2] if _nearly(h, ranked[0], CLOSE)]
    return fitted + ranked[len(fitted) :]


def _names(hypotheses: Sequence[Hypothesis]) -> list[set[str]]:
    return [set(h.names) for h in hypotheses]


def _likely(desk: Bench, state: Hypothesis, again: Sequence[Screened]) -> list[Entry]:
    everyone = lineup(desk, state.fit, again, large=True)
    return sorted(everyone, key=lambda e: e.cost)[:GROWN]


def _grown(desk: Bench, state: Hypothesis, e: Entry, progress: Progress) -> Hypothesis:
    """One effect more: first the effects together, then all numbers."""
    own = _own(state)
    numbers = (*state.fit.numbers[own:], *e.numbers)
    given = dict(list(state.fit.values.items())[:own])
    alone, everything = replace(desk, given={**desk.given, **given}), range(len(numbers))
    z = np.concatenate([state.fit.z[own:], e.z])
    columns = derivatives(alone, numbers, z, alone.residual(values_at(numbers, z)), everything)
    renew = everything if len(numbers) <= 2 * FEW else ()
    effects = fit(alone, numbers, z, columns, renew, iterations=5, small=QUICK, again=False)
    both = np.hstack([state.fit.jacobian[:, :own], effects.jacobian])
    z = np.concatenate([state.fit.z[:own], effects.z])
    found = fit(desk, (*state.fit.numbers[:own], *numbers), z, both, iterations=4, small=QUICK, again=False)
    return _told(Hypothesis((*state.effects, *(s.candidate for s in e.chosen)), found), progress)


def swapped(
    desk: Bench, best: Hypothesis, screened: Sequence[Screened], tried: Sequence[Hypothesis], progress: Progress
) -> list[Hypothesis]:
    """The best with one of its effects replaced by a plainer one that looks like it."""
    found = []
    for effect in best.effects:
        ours = [s for s in screened if s.candidate.name == effect.name]
        for s in screened:
            plainer = len(s.candidate.numbers) < len(effect.numbers) and s.candidate.name not in best.names
            known = {s.candidate.name, *best.names} - {effect.name}
            if plainer and known not in _names(tried) and any(likeness(s, o) > KIN for o in ours):
                others = _rest(grounded(desk, best), effect)
                begun = entry(desk, others.fit, (s,), SCALES[:4], USUAL)
                found.append(settled(desk, _either(desk, _grown(desk, others, begun, progress), progress), progress))
    return found


def _pair_evidence(start: Fit, pair: Sequence[Screened]) -> float:
    signature = np.hstack([s.signature for s in pair])
    cross = start.jacobian.T @ signature
    schur = np.eye(signature.shape[1]) + signature.T @ signature - cross.T @ np.linalg.solve(start.information, cross)
    slope = signature.T @ start.residual
    return float(-slope @ np.linalg.solve(schur, slope) + np.linalg.slogdet(schur)[1])


def simplest(best: Hypothesis, tried: Sequence[Hypothesis]) -> Hypothesis:
    """Fewer effects, or fewer numbers, where more are not worth it."""
    size = lambda h: (len(h.effects), len(h.fit.numbers))  # noqa: E731
    fewer = [h for h in tried if size(h) < size(best) and (len(h.effects) == len(best.effects) or _within(h, best))]
    for h in sorted(fewer, key=lambda h: h.fit.evidence):
        if not worth(best.fit, h.fit):
            return h
    return best


def plainest(desk: Bench, best: Hypothesis, tried: Sequence[Hypothesis], progress: Progress) -> Hypothesis:
    """Another with as many effects and fewer numbers, if it turns out as good once it is fitted as well."""
    rivals = [h for h in tried if h.names != best.names and len(h.effects) == len(best.effects)]
    plainer = [h for h in rivals if len(h.fit.numbers) < len(best.fit.numbers) and h.gap < best.gap + NEAR]
    for h in sorted(plainer, key=lambda h: h.fit.evidence)[:1]:
        found = polished(desk, h, progress)
        if not worth(best.fit, found.fit):
            return found
    return best


def _within(h: Hypothesis, best: Hypothesis) -> bool:
    return set(h.names) < set(best.names)


def sparing(desk: Bench, h: Hypothesis) -> Fit:
    """Only those of the machine's numbers retuned that the data ask for, one after the other; the rest as in the file.

    Numbers and effects that do nearly the same share an error of the data among them. If the file is right, this gives
    it all to the effect.
    """
    own = _own(h)
    chosen, scale = list(range(own, len(h.fit.numbers))), misfit(h.fit)
    target = h.fit.residual + h.fit.jacobian @ h.fit.z
    normal, slope = h.fit.jacobian.T @ h.fit.jacobian, h.fit.jacobian.T @ target
    for _ in range(own):
        before = _evidence(normal, slope, chosen, scale)
        trials = [(_evidence(normal, slope, [*chosen, i], scale), i) for i in range(own) if i not in chosen]
        if min(trials)[0] > before - WORTH:
            break
        chosen.append(min(trials)[1])
    keep = sorted(chosen)
    z = np.asarray(np.linalg.solve(np.eye(len(keep)) + normal[np.ix_(keep, keep)], slope[keep]))
    numbers, renew = [h.fit.numbers[i] for i in keep], range(len(keep)) if len(keep) <= FEW else ()
    found = fit(desk, numbers, z, h.fit.jacobian[:, keep], renew, iterations=4)
    # where the file is far off, the way there is not linear: then all numbers stay as they were fitted
    return found if found.cost - h.fit.cost < WORTH * scale * (own + 1) else h.fit


def _evidence(normal: FloatArray, slope: FloatArray, chosen: Sequence[int], scale: float) -> float:
    information = np.eye(len(chosen)) + normal[np.ix_(chosen, chosen)]
    gained = slope[chosen] @ np.linalg.solve(information, slope[chosen])
    return float(-gained / scale + np.linalg.slogdet(information)[1])
