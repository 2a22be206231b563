"""Named, with a rest: the one effect that holds most of a discrepancy which nothing explains whole.

Real machines hold more than one thing, so that no single effect passes the acceptance tests. One is named nevertheless
if, where it was left out of the fit,

    it explains most of the discrepancy · it leaves far less than any effect of another family · what it leaves no
    longer looks like it · it does so whichever group is not counted

An effect that is only the nearest wrong one fails these: another is nearly as near, or its size would have to change
from place to place, so that what is left has its signature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.diagnosis.acceptance import (
    HeldOut,
    groups,
    hold_out,
    out_of_reach,
    residual_left_out,
    simulate_left_out,
    to_explain,
    undetermined,
)
from ffcomp.diagnosis.fidelity import continue_fit, fit_within_uncertainty
from ffcomp.diagnosis.fit import EstimationProblem, Fit, intervals_of
from ffcomp.diagnosis.hypotheses import KIN, Hypothesis, likeliest
from ffcomp.diagnosis.settings import SETTINGS
from ffcomp.numerics.stages import Progress
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE


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
    if not contenders or len(groups(estimation.problem)) < 2:
        return None
    progress("nothing explains all of it: looking for what explains most")
    held_out = hold_out(estimation, base, base)
    whole = to_explain(held_out)
    tested = [_tested(estimation, _fitted(estimation, h, progress)) for h in contenders]
    ranked = sorted(tested, key=lambda each: float(each.left.sum()))
    ranked = [each for each in ranked if _sound(estimation, each.hypothesis)]
    if not ranked:
        return None
    first = _simplest([each for each in ranked if _kin(each.hypothesis) == _kin(ranked[0].hypothesis)])
    others = [each for each in ranked if _kin(each.hypothesis) != _kin(first.hypothesis)]
    explained = [1 - float(each.left.sum()) / whole for each in (first, *others)]
    for each in ranked:
        share = 100 * (1 - float(each.left.sum()) / whole)
        told = f"{share:.0f} % of what it was not fitted to; {100 * each.alike:.0f} % of the rest looks like it"
        progress(f"{each.hypothesis.names[0]} explains {told}")
    if (
        explained[0] < SETTINGS.dominant
        or _better_without(best, first.hypothesis)
        or first.alike > SETTINGS.signature
        or not all(_ahead(first, other) for other in others)
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
    kin = list(dict.fromkeys(_kin(h) for h in ranked))[: SETTINGS.by_simulation]
    laws = [h for h in ranked if kin and _kin(h) == kin[0]]
    return [*laws, *(next(h for h in ranked if _kin(h) == each) for each in kin[1:])]


def _better_without(best: Hypothesis, first: Hypothesis) -> bool:
    """Tell whether the best explanation does without the family, and leaves far less."""
    without = _kin(first) not in {KIN.get(name, name) for name in best.names}
    return without and SETTINGS.ahead * best.discrepancy < first.discrepancy


def _kin(h: Hypothesis) -> str:
    return KIN.get(h.names[0], h.names[0])


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


def _tested(estimation: EstimationProblem, h: Hypothesis) -> _Tested:
    left, alike, total = [], 0.0, 0.0
    for members, simulated in zip(
        groups(estimation.problem).values(), simulate_left_out(estimation, h.fit), strict=True
    ):
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
    own = columns - machine @ np.linalg.solve(information, machine.T @ columns)
    part = own @ lstsq(own, residual, cond=1e-6)[0]
    by_chance = len(own.T) / len(rows) * float(residual @ residual)
    return max(float(part @ part) - by_chance, 0.0)


def _ahead(first: _Tested, other: _Tested) -> bool:
    """Tell whether another effect leaves far more, whichever group is not counted."""
    apart = other.left - SETTINGS.ahead * first.left
    return bool(np.all(apart.sum() - apart > 0.0))


def _everywhere(first: _Tested, held_out: Sequence[HeldOut], whole: float) -> bool:
    """Tell whether it is as far ahead of retuning alone, which leaves `whole`, whichever group is not counted."""
    before = np.array([max(one.before, 0.0) * one.rows for one in held_out])
    before *= whole / max(before.sum(), 1e-300)
    apart = before - SETTINGS.ahead * first.left
    return bool(np.all(apart.sum() - apart > 0.0))


def _sound(estimation: EstimationProblem, h: Hypothesis) -> bool:
    """Tell whether the file stays plausible with it, and what is to repeat does.

    Its interval may include no effect where only ratios of forces show, as of a servo whose stiffness is a guess.
    """
    intervals = intervals_of(estimation, h.fit, h.fit.values, scatter=True)
    return not out_of_reach(h) and not any(".pitch_mm" in name for name in undetermined(h, intervals))
