"""Named, with a rest: the effect that holds most of a discrepancy that nothing explains whole.

Real machines hold more than one thing, so that no single effect passes all tests. One is named nevertheless if, where
it was left out of the fit,

    it explains most of the discrepancy · it leaves far less than any effect of another family · what it leaves no
    longer looks like it · it does so whichever group is not counted

Of a place that was left out the file's numbers are fitted there, within what the file says: a rest bends them, at every
place otherwise, and a frequency that is off there by a little would hide whatever the effect explains.

An effect that is only the nearest wrong one fails these: another is nearly as near, or its size would have to change
from place to place, so that what is left has its signature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.diagnosis.acceptance import unfounded
from ffcomp.diagnosis.fit import EstimationProblem, Fit, intervals_of, solved
from ffcomp.diagnosis.held_out import (
    Groups,
    HeldOut,
    by_place,
    hold_out,
    motions_or_groups,
    residual_left_out,
    simulate_left_out,
    to_explain,
)
from ffcomp.diagnosis.hypotheses import Hypothesis, likeliest
from ffcomp.numerics.stages import Progress
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE

MOST_FAMILIES = 3  # that are compared


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
    if min(h.discrepancy for h in contenders) > (1 - estimation.settings.dominant / 2) * base.discrepancy:
        return None  # even where they were fitted, none explains half of what one must elsewhere
    progress("nothing explains all of it: looking for what explains most")
    # an interval may include no effect where only ratios of forces show, as of a servo whose stiffness is a guess
    sound = [h for h in contenders if not unfounded(h, intervals_of(estimation, h.fit, h.fit.values, scatter=True))]
    if not sound:
        return None
    held_out = hold_out(estimation, base, base, parts, retuned=by_place(estimation))
    whole, ahead = to_explain(held_out), estimation.settings.ahead
    ranked = sorted((_tested(estimation, h, parts) for h in sound), key=lambda each: float(each.left.sum()))
    first = _simplest(
        [each for each in ranked if _law_group(each.hypothesis) == _law_group(ranked[0].hypothesis)], ahead
    )
    others = [each for each in ranked if _law_group(each.hypothesis) != _law_group(first.hypothesis)]
    explained = [1 - float(each.left.sum()) / whole for each in (first, *others)]
    for each in ranked:
        share = 100 * (1 - float(each.left.sum()) / whole)
        progress(
            f"{each.hypothesis.names[0]} explains {share:.0f} % of what it was not fitted to; "
            f"{100 * each.alike:.0f} % of the rest looks like it"
        )
    if (
        explained[0] < estimation.settings.dominant
        or _better_without(best, first.hypothesis, ahead)
        or ranked[0].alike > estimation.settings.signature  # of the law that leaves least: others' shapes are left
        or not all(_ahead(first, other.left, ahead) for other in others)
        or not _everywhere(first, held_out, whole, ahead)
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
    groups = list(dict.fromkeys(_law_group(h) for h in ranked))[:MOST_FAMILIES]
    laws = [h for h in ranked if groups and _law_group(h) == groups[0]]
    return [*laws, *(next(h for h in ranked if _law_group(h) == each) for each in groups[1:])]


def _better_without(best: Hypothesis, first: Hypothesis, ahead: float) -> bool:
    """Tell whether the best explanation does without the family, and leaves far less."""
    without = _law_group(first) not in {CATALOGUE[name].cause for name in best.names}
    return without and ahead * best.discrepancy < first.discrepancy


def _law_group(h: Hypothesis) -> str:
    return CATALOGUE[h.names[0]].cause


def _simplest(laws: Sequence[_Tested], ahead: float) -> _Tested:
    """Return the law of fewest numbers that no other leaves far behind; `laws` : the one that leaves least first."""
    few = sorted(laws, key=lambda each: _needed(each.hypothesis))
    return next(each for each in few if each.left.sum() <= ahead * laws[0].left.sum())


def _needed(h: Hypothesis) -> int:
    """Count the numbers without which there is no such effect; others have a usual value."""
    return sum(p.role == "amplitude" or p.default is None for p in CATALOGUE[h.names[0]].parameters)


def _tested(estimation: EstimationProblem, h: Hypothesis, parts: Groups) -> _Tested:
    left, alike, total = [], 0.0, 0.0
    for members in parts.values():
        simulated = simulate_left_out(estimation, h.fit, members, retuned=by_place(estimation))
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
    information = h.fit.overdispersion * np.eye(h.machine_count) + machine.T @ machine
    projected = columns - machine @ solved(information, machine.T @ columns)
    part = projected @ lstsq(projected, residual, cond=1e-6)[0]
    by_chance = len(projected.T) / len(rows) * float(residual @ residual)
    return max(float(part @ part) - by_chance, 0.0)


def _ahead(first: _Tested, left: FloatArray, ahead: float) -> bool:
    """Tell whether something else leaves far more, (groups,), whichever group is not counted."""
    apart = left - ahead * first.left
    return bool(np.all(apart.sum() - apart > 0.0))


def _everywhere(first: _Tested, held_out: Sequence[HeldOut], whole: float, ahead: float) -> bool:
    """Tell whether it is as far ahead of retuning alone, which leaves `whole`, whichever group is not counted."""
    before = np.array([max(one.before, 0.0) * one.rows for one in held_out])
    return _ahead(first, before * whole / max(before.sum(), 1e-300), ahead)
