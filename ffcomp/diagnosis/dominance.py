"""Named, with a rest: the effect that holds half or more of a discrepancy that nothing explains whole.

Real machines hold more than one thing, so that no single effect passes all tests. One is named nevertheless if, where
it was left out of the fit,

    it explains half of the discrepancy · it leaves far less than any effect of another family · it has one size
    everywhere: what it leaves does not look like it

What is left is measured by its amplitude, averaged over blocks of 5 Hz in a motion: a rest that fills a few, as of a
fan or a pulley that is not round, may be louder than the effect, and is as loud whatever explains all others.

Of a place that was left out the file's numbers are fitted there, within what the file says: a rest bends them, at every
place otherwise, and a frequency that is off there by a little would hide whatever the effect explains.

An effect that is only the nearest wrong one fails these: another is nearly as near, or its size would have to change
from place to place, so that what is left has its signature.

Where each signal is compared by itself, as of a motor and its load, what one leaves says nothing of another: the
friction of a motor is no reason against the coupling that explains all that its load does. There each signal is judged
alone too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.diagnosis.acceptance import undetermined
from ffcomp.diagnosis.fit import EstimationProblem, Fit, intervals_of, solved
from ffcomp.diagnosis.held_out import by_place, left_out, motions_or_groups
from ffcomp.diagnosis.hypotheses import Hypothesis, likeliest
from ffcomp.diagnosis.problem import declared_parameter
from ffcomp.numerics.stages import Progress
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE

MOST_FAMILIES = 3  # that are compared

Scope = NDArray[np.bool_]  # (rows,) by which an effect is judged


@dataclass(frozen=True)
class Rival:
    """The best effect of another family."""

    names: tuple[str, ...]
    explained: float  # share of the discrepancy where it was left out of the fit


@dataclass(frozen=True, eq=False)
class Dominant:
    """The effect that holds half or more of a discrepancy."""

    hypothesis: Hypothesis  # of one effect
    explained: float  # share of the discrepancy where it was left out of the fit
    rivals: tuple[Rival, ...]  # the best first
    signal: str = ""  # whose discrepancy that is; "": of all signals together


def dominant_effect(
    estimation: EstimationProblem, base: Fit, tried: Sequence[Hypothesis], progress: Progress
) -> Dominant | None:
    """Return the effect that holds most of the discrepancy, if one does, or of one signal's.

    Parameters
    ----------
    base : the machine's parameters alone
    tried : hypotheses of the same data
    """
    single = [h for h in tried if len(h.fit.residual) == len(base.residual) and len(h.effects) == 1]
    if not single or len(motions_or_groups(estimation.problem)) < 2:
        return None
    whiten, names = estimation.whiten, sorted({s for o in estimation.whiten.observations for s in o.signals})
    scopes = {"": np.ones(len(base.residual), dtype=bool)}
    if estimation.problem.forces and len(names) > 1:
        scopes |= {name: whiten.of_signal(name) for name in names}
    progress("nothing explains all of it: looking for what explains most")
    asked = _Asked(estimation, base, single, progress)
    found = [each for signal, scope in scopes.items() if (each := asked.dominant(signal, scope)) is not None]
    return max(found, key=lambda each: (not each.signal, each.explained), default=None)


class _Asked:
    """The single effects that were tried, as they explain what was left out of their fits."""

    def __init__(self, estimation: EstimationProblem, base: Fit, single: Sequence[Hypothesis], log: Progress) -> None:
        self.estimation, self.base, self.log = estimation, base, log
        self.single = list({h.names: h for h in reversed(likeliest(single))}.values())  # the likeliest of each effect
        self.parts = motions_or_groups(estimation.problem)
        self.rows = [estimation.rows_of(members) for members in self.parts.values()]
        self.known: dict[str, FloatArray] = {}

    def left_out(self, name: str, fitted: Fit) -> FloatArray:
        """Return what a fit to the others leaves in each group, (rows,) of all."""
        if name not in self.known:
            each = left_out(self.estimation, fitted, self.parts, by_place(self.estimation))
            self.known[name] = np.zeros(len(fitted.residual))
            self.known[name][np.concatenate(self.rows)] = np.concatenate(each)
        return self.known[name]

    def left(self, residual: FloatArray, scope: Scope) -> float:
        """Return the squared mean of the amplitude above noise over all blocks."""
        blocks = self.estimation.blocks[scope]
        count = np.bincount(blocks)
        above = np.maximum(np.bincount(blocks, residual[scope] ** 2) - count, 0.0)
        return float(np.sum(np.sqrt(count * above)) / len(blocks)) ** 2

    def dominant(self, signal: str, scope: Scope) -> Dominant | None:
        """Return the effect that holds most of the discrepancy of one signal, or of all."""
        settings, ahead = self.estimation.settings, self.estimation.settings.ahead
        contenders = self._contenders(scope)
        least = (1 - settings.dominant / 2) * self.left(self.base.residual, scope)
        if min(self.left(h.fit.residual, scope) for h in contenders) > least:
            return None  # even where they were fitted, none explains half of what one must elsewhere
        # an interval may include no effect where only ratios of forces show, as of a servo whose stiffness is a guess
        sound = [h for h in contenders if self._is_sound(h)]
        # by the better of the file, retuned, and of standing still: an axis that is not held may be simulated worse
        whole = min(self.left(r, scope) for r in (self.left_out("", self.base), self.estimation.measured))
        if not sound or whole == 0.0:
            return None
        left = {h.names: self.left(self.left_out(h.names[0], h.fit), scope) for h in sound}
        ranked = sorted(sound, key=lambda h: left[h.names])
        # of causes that leave as much the simplest, which a richer one contains
        alike = [h for h in ranked if left[h.names] * (1 - settings.reshaped_share) <= left[ranked[0].names]]
        cause = _cause(min(alike, key=lambda h: h.kinds))
        laws = [h for h in ranked if _cause(h) == cause]
        near = [h for h in laws if left[h.names] <= ahead * left[laws[0].names]]
        first = min(near, key=lambda h: h.effect_count)
        others = [h for h in ranked if _cause(h) != _cause(first)]
        explained = {h.names: 1 - left[h.names] / whole for h in ranked}
        varies = {h.names: self._varies(h, scope, whole, left[h.names]) for h in ranked}
        for h in ranked:
            self.log(
                f"{h.names[0]} explains {100 * explained[h.names]:.0f} % of what it was not fitted to"
                f"{f' in {signal}' if signal else ''}; {100 * varies[h.names]:.0f} % of what looks like it varies"
            )
        if (
            explained[first.names] < settings.dominant
            or varies[laws[0].names] > settings.varies  # of the law that leaves least: others' shapes are left
            or any(left[other.names] < self._ahead(other, first) * left[first.names] for other in others)
        ):
            return None
        return Dominant(
            first, explained[first.names], tuple(Rival(o.names, explained[o.names]) for o in others), signal
        )

    def _ahead(self, other: Hypothesis, first: Hypothesis) -> float:
        """Return how many times as much another family must leave: less than as much if it has more numbers."""
        settings = self.estimation.settings
        return 1 - settings.reshaped_share if other.kinds > first.kinds else settings.ahead

    def _is_sound(self, h: Hypothesis) -> bool:
        """Tell whether the numbers are determined without which there is no such effect."""
        unknown = undetermined(h, intervals_of(self.estimation, h.fit))
        return not any(declared_parameter(n).is_needed for n in unknown)

    def _contenders(self, scope: Scope) -> list[Hypothesis]:
        """Return the single effects to test: of the families that leave least the best, of the first all its laws."""
        ranked = sorted(self.single, key=lambda h: self.left(h.fit.residual, scope))
        causes = list(dict.fromkeys(_cause(h) for h in ranked))[:MOST_FAMILIES]
        laws = [h for h in ranked if _cause(h) == causes[0]]
        return [*laws, *(next(h for h in ranked if _cause(h) == each) for each in causes[1:])]

    def _varies(self, h: Hypothesis, scope: Scope, whole: float, left: float) -> float:
        """Return how much of what looks like the effect one size does not explain: it should be the same everywhere."""
        residual = self.left_out(h.names[0], h.fit)
        inside = [rows[scope[rows]] for rows in self.rows]
        alike = sum(_explained_by(h, rows, residual[rows]) for rows in inside)
        total = float(np.sum(residual[scope] ** 2))
        looks = left * alike / max(total, 1e-300)
        return looks / max(max(whole - left, 0.0) + looks, 1e-300)


def _cause(h: Hypothesis) -> str:
    return CATALOGUE[h.names[0]].cause


def _explained_by(h: Hypothesis, rows: NDArray[np.int64], residual: FloatArray) -> float:
    """Return how much of a residual the effects' derivatives explain there, beyond what retuning does; of chance none.

    With as many columns as a twentieth of the rows they explain a twentieth of anything.
    """
    from scipy.linalg import lstsq

    columns, machine = h.fit.jacobian[rows][:, h.machine_count :], h.fit.jacobian[rows][:, : h.machine_count]
    information = h.fit.overdispersion * np.eye(h.machine_count) + machine.T @ machine
    projected = columns - machine @ solved(information, machine.T @ columns)
    part = projected @ lstsq(projected, residual, cond=1e-6)[0]
    by_chance = len(projected.T) / len(rows) * float(residual @ residual)
    return max(float(part @ part) - by_chance, 0.0)
