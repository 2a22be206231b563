"""Three other ways to choose among the same candidates, for the blind bank: each at its best.

All begin where `ffcomp diagnose` does, which spares them what they would fail on: its noise floor and whitening, its
fit of the machine's own numbers, and its signatures, one for every candidate at the best of its shapes, with what
retuning can do projected out. So they regress what is left of the *measured accelerations*; double integration to
forces, which named a third of the effects at best, is not asked of them. They also get the two refusals that work:
`none` below the same threshold, and `unknown` where what they chose leaves more than 15 % of the discrepancy.

SINDy            Sequentially thresholded least squares (Brunton, Proctor & Kutz, 2016) on the signatures: groups of
                 columns are dropped whose share of the explained falls below a threshold; of 30 thresholds the one with
                 the smallest BIC (Mangan, Kutz, Brunton & Proctor, 2017).
Spike and slab   (Nayek et al., arXiv 2012.01937) with the posterior summed over all sets of up to three effects instead
                 of sampled: Zellner's g-prior as the slab, g the number of rows, the noise's size unknown. Named is
                 what is in the model with more than one half.
BIC              Every single effect that the search fitted, nonlinearly and with all numbers free, χ² + k ln n; of the
                 others the linear prediction. The smallest wins; no effect is one of the choices.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnosis.diagnosis import Diagnosis
from ffcomp.diagnosis.fidelity import excerpt_of
from ffcomp.diagnosis.fit import Fit, derivatives, fit
from ffcomp.diagnosis.score_test import screen

FloatArray = NDArray[np.float64]

MOST_LEFT = 0.15  # of the discrepancy
MOST_EFFECTS = 3
THRESHOLDS = np.geomspace(1e-4, 0.5, 30)


class Library:
    """What is left of the measurements, and every candidate's columns, retuning projected out of both.

    columns : (rows, a) of each candidate; excess : of |r|² above the noise.
    """

    def __init__(self, residual: FloatArray, columns: dict[str, FloatArray], excess: float) -> None:
        stacked = np.hstack(list(columns.values()))
        self.rows, self.whole, self.excess = len(residual), float(residual @ residual), excess
        self.gram, self.slope = stacked.T @ stacked, stacked.T @ residual
        ends = np.cumsum([part.shape[1] for part in columns.values()])
        self.places = {
            name: np.arange(end - part.shape[1], end) for (name, part), end in zip(columns.items(), ends, strict=True)
        }

    @property
    def names(self) -> list[str]:
        """The candidates."""
        return list(self.places)

    def explained(self, names: Iterable[str]) -> tuple[float, int]:
        """Return by how much a least-squares fit of some effects lowers |r|², and how many numbers it takes."""
        chosen = [self.places[name] for name in names]
        if not chosen:
            return 0.0, 0
        at = np.concatenate(chosen)
        gram, slope = self.gram[np.ix_(at, at)], self.slope[at]
        small = 1e-9 * np.diag(np.diag(gram) + 1e-300)
        return float(slope @ np.linalg.solve(gram + small, slope)), len(at)


def library_of(found: Diagnosis) -> Library | None:
    """Rebuild what a search screened its candidates with; None where the recordings were at fault."""
    if found.fault is not None:
        return None
    estimation, base = found.estimation, found.base
    part = excerpt_of(estimation, base.discrepancy)
    if part is not None:
        residual = part.residual(base.values)
        jacobian = derivatives(part, base.parameters, base.z, residual, range(len(base.z)))
        estimation, base = part, fit(part, base.parameters, base.z, jacobian, iterations=6)
    screened = screen(replace(estimation, coarse=True), base, list(estimation.problem.candidates))
    columns = {s.candidate.name: _projected(base, s.signature) for s in screened}
    return Library(base.residual, columns, max(base.chi_squared - len(base.residual), 0.0))


def _projected(base: Fit, signature: FloatArray) -> FloatArray:
    return signature - base.jacobian @ np.linalg.solve(base.information, base.jacobian.T @ signature)


def rivals(found: Diagnosis) -> dict[str, dict[str, Any]]:
    """Return the verdict of each method, as JSON."""
    library = library_of(found)
    nothing_there = found.best is None and found.verdict == "none"
    if library is None or nothing_there:
        verdict = "unknown" if library is None else "none"
        return {name: _told(verdict, ()) for name in ("sindy", "spike_slab", "bic")}
    return {
        "sindy": _judged(library, sindy(library)),
        "spike_slab": _judged(library, spike_and_slab(library)),
        "bic": bic(found, library),
    }


def _told(verdict: str, names: Sequence[str]) -> dict[str, Any]:
    return {"verdict": verdict, "effects": [{"name": name, "parameters": {}} for name in names]}


def _judged(library: Library, names: Sequence[str]) -> dict[str, Any]:
    if not names:
        return _told("none" if library.excess < 0.1 * library.rows else "unknown", ())
    left = library.excess - library.explained(names)[0]
    return _told("unknown", ()) if left > MOST_LEFT * library.excess else _told("effects", names)


def sindy(library: Library) -> list[str]:
    """Threshold again and again, at the threshold of the smallest BIC."""
    rows, whole = library.rows, library.whole
    best: tuple[float, list[str]] = (rows * np.log(whole / rows), [])
    for threshold in THRESHOLDS:
        names = library.names
        while names:
            full = library.explained(names)[0]
            without = {name: full - library.explained([n for n in names if n != name])[0] for name in names}
            kept = [name for name in names if without[name] > threshold * max(full, 1e-12)]
            if len(kept) == len(names):
                break
            names = kept
        gain, count = library.explained(names)
        bic_of = rows * np.log(max(whole - gain, 1e-9) / rows) + count * np.log(rows)
        if bic_of < best[0]:
            best = (bic_of, names)
    return best[1]


def spike_and_slab(library: Library) -> list[str]:
    """Sum the posterior over all small sets; return the median model."""
    rows, whole = library.rows, library.whole
    names = library.names
    prior = np.log(1 / len(names))  # one effect is expected
    chance: dict[tuple[str, ...], float] = {}
    for size in range(MOST_EFFECTS + 1):
        for chosen in combinations(names, size):
            gain, count = library.explained(chosen)
            unexplained = 1 - rows / (1 + rows) * min(gain / whole, 1 - 1e-12)
            chance[chosen] = -count / 2 * np.log(1 + rows) - (rows - 1) / 2 * np.log(unexplained) + size * prior
    top = max(chance.values())
    weight = {chosen: np.exp(value - top) for chosen, value in chance.items()}
    total = sum(weight.values())
    return [name for name in names if sum(w for chosen, w in weight.items() if name in chosen) > total / 2]


def bic(found: Diagnosis, library: Library) -> dict[str, Any]:
    """Choose the single effect of the smallest BIC, or none, by the fits of the search."""
    rows = library.rows
    base = library.whole
    linear = {name: library.explained([name]) for name in library.names}
    scores = {name: (base - gain, count) for name, (gain, count) in linear.items()}
    for h in found.tried:
        if len(h.effects) == 1 and len(h.fit.residual) == rows:
            scores[h.names[0]] = (h.fit.chi_squared, h.effect_count)
    scores[""] = (base, 0)
    name = min(scores, key=lambda each: scores[each][0] + scores[each][1] * np.log(rows))
    if not name:
        return _told("none" if library.excess < 0.1 * rows else "unknown", ())
    left = scores[name][0] - rows
    return _told("unknown", ()) if left > MOST_LEFT * library.excess else _told("effects", [name])
