"""The score test, the lowest rung of the ladder of fidelity: one simulation an amplitude predicts an effect's gain.

Score test with the parameters that may be retuned projected out (Rao 1948; as the Lagrange multiplier test in
econometrics). With N the derivative of the simulation by those parameters, S the candidate's signature, both in units
of their priors, and the base fit at its optimum:

    Σ = I + SᵀS − SᵀN (I + NᵀN)⁻¹ NᵀS,   g = Sᵀr,   gain = gᵀΣ⁻¹g,   Δ(−2 ln Z) = −gain + ln det Σ

Where many shapes or sizes are ranked, the motions that hold most of the residual rank them as all motions do; the best
are then simulated in every motion (multi-fidelity; successive halving: Jamieson & Talwalkar, AISTATS 2016).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ffcomp.diagnosis.fit import EstimationProblem, Fit, solved, step_within
from ffcomp.diagnosis.problem import Candidate, Parameter
from models.arrays import FloatArray
from models.effects.catalogue import CATALOGUE
from models.effects.effect import Effect

Shape = Mapping[str, float]
SUBSET_SHARE = 0.5  # of |r|², that the motions of a subset hold
MOST_SHAPES = 2  # of each candidate, that are scored in every motion
CONFOUNDED = 0.8  # cos² of projected signatures, from which effects are confounded


# ---- a subset of the motions ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Subset:
    """A problem and a fit of it, in a few motions."""

    estimation: EstimationProblem
    fit: Fit


def subset_of(estimation: EstimationProblem, fitted: Fit, chosen: Sequence[int] | None = None) -> Subset | None:
    """Return the motions in which most of a fit's residual is; None where that would hardly be quicker.

    chosen : motions to take instead, so that fits of several hypotheses compare.
    """
    if estimation.only is not None:
        return None  # it is one already
    chosen = loudest_motions(estimation, fitted.residual) if chosen is None else chosen
    motions = estimation.problem.motions
    if len(chosen) > estimation.settings.subset_worth * len(set(motions)):
        return None
    members = [i for i, motion in enumerate(motions) if motion in chosen]
    rows = estimation.rows_of(members)
    part = replace(fitted, residual=fitted.residual[rows], jacobian=fitted.jacobian[rows])
    return Subset(estimation.limited_to(members), part)


def loudest_motions(estimation: EstimationProblem, residual: FloatArray) -> Sequence[int]:
    """Return as few motions as hold most of a residual, two or more, those that hold most of it first."""
    squares = np.bincount(estimation.motions, residual**2)
    ranked = sorted(set(estimation.problem.motions), key=lambda motion: -squares[motion])
    for n in range(2, len(ranked)):
        if squares[ranked[:n]].sum() >= SUBSET_SHARE * squares.sum():
            return ranked[:n]
    return ranked


# ---- the test ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Screened:
    """One candidate with one of its shapes, by its first-order signature next to a fit without it."""

    base: Fit
    candidate: Candidate
    shape: Shape
    signature: FloatArray  # (rows, a) of the simulation by each amplitude in units of its prior
    step: FloatArray  # of the machine's parameters and the amplitudes together, to first order
    evidence: float  # change of −2 ln Z, to first order: negative is better
    strength: float  # standard deviations by which an effect of a usual size stands out, retuning allowed
    visible: bool = False  # whether these recordings would show a usual size

    @property
    def estimate(self) -> FloatArray:
        """(a,) the amplitudes, in units of their priors."""
        return self.step[len(self.base.z) :]

    @property
    def rank(self) -> tuple[bool, float]:
        """Order the shapes of one candidate: a ripple half a turn off explains as much, by an amplitude below zero."""
        sizes = zip(self.candidate.amplitudes, self.estimate, strict=True)
        return any(not n.low <= n.start + n.sd * z <= n.high for n, z in sizes), self.evidence

    @cached_property
    def projected(self) -> FloatArray:
        """(rows,) the best combination of the signature, less what retuning can do, length one."""
        jacobian, own = self.base.jacobian, self.step[: len(self.base.z)]
        explained = self.signature @ self.estimate
        # (1 − J (I + JᵀJ)⁻¹ Jᵀ)(S e + J s) = S e + J (s − (I + JᵀJ)⁻¹ Jᵀ (S e + J s))
        retuned = solved(self.base.information, jacobian.T @ (explained + jacobian @ own))
        left = explained + jacobian @ (own - retuned)
        length = float(np.linalg.norm(left))
        return np.asarray(left / length if length else left)


def screen(estimation: EstimationProblem, base: Fit, candidates: Sequence[Candidate]) -> list[Screened]:
    """Score every candidate with the best of its shapes and in the better of its forms; the best one first."""
    subset = subset_of(estimation, base)
    shared = _best(base, _signatures(estimation, base, _likely(subset, [(c, c.grid) for c in candidates])))
    forms = [(c.other, _other_shapes(c, shared[c.name])) for c in candidates if c.other is not None]
    other = _best(base, _signatures(estimation, base, _likely(subset, forms)))
    best = [min((x[c.name] for x in (shared, other) if c.name in x), key=lambda s: s.evidence) for c in candidates]
    whole = 1 / np.sqrt(estimation.share)  # an excerpt shows less than what these recordings could
    limit = estimation.settings.visible_sd / whole
    return sorted((replace(s, visible=s.strength > limit) for s in best), key=lambda s: s.evidence)


def _likely(
    subset: Subset | None, shapes: Sequence[tuple[Candidate, Sequence[Shape]]]
) -> list[tuple[Candidate, Shape]]:
    """List candidates with the shapes to try: of many only the best, as the motions of a subset show them."""
    few = MOST_SHAPES
    many = [(c, shape) for c, grid in shapes for shape in grid if len(grid) > few]
    if subset is None or not many:
        return [(c, shape) for c, grid in shapes for shape in grid]
    tries = _signatures(subset.estimation, subset.fit, many)
    scores = [_scored(subset.fit, c, shape, signature).rank for c, shape, signature in tries]
    ranked = [many[i] for i in sorted(range(len(many)), key=scores.__getitem__)]
    likely = []
    for c, grid in shapes:
        best = [shape for other, shape in ranked if other is c][:few]
        likely += [(c, shape) for shape in (grid if len(grid) <= few else best)]
    return likely


def _other_shapes(c: Candidate, best: Screened) -> list[Shape]:
    """List the shapes to try the other form with: the best one so far; all of them where that form fixes a shape."""
    fixed = {n.name: n.start for n in (c.other or c).shapes if n.low == n.high}
    several = [shape for shape in (c.other or c).grid if not shape.keys() <= best.shape.keys()]
    if several and not fixed:  # lines, whose shapes are not those of one
        return list(several)
    if not fixed:
        return [best.shape]
    distinct = {tuple(({**shape, **fixed}).items()) for shape in c.grid}
    return [dict(shape) for shape in sorted(distinct)]


Tried = tuple[Candidate, Shape, FloatArray]


def _best(base: Fit, tries: Iterator[Tried]) -> dict[str, Screened]:
    best: dict[str, Screened] = {}
    for tried in tries:
        one = _scored(base, *tried)
        if one.candidate.name not in best or one.rank < best[one.candidate.name].rank:
            best[one.candidate.name] = one
    return best


def _signatures(estimation: EstimationProblem, base: Fit, tries: Sequence[tuple[Candidate, Shape]]) -> Iterator[Tried]:
    """Simulate one probe an amplitude, the others without effect."""
    probes = [{}, *(_probe(c, a.name, shape) for c, shape in tries for a in c.amplitudes)]
    residuals = estimation.residuals([{**base.values, **probe} for probe in probes])
    without = next(residuals)
    for candidate, shape in tries:
        columns = [
            (without - next(residuals)) * (a.sd / (candidate.probe[a.name] - a.start)) for a in candidate.amplitudes
        ]
        yield candidate, shape, np.stack(columns, axis=1)


def _probe(candidate: Candidate, amplitude: str, shape: Shape) -> dict[str, float]:
    rest = {a.name: a.start for a in candidate.amplitudes}
    return {**rest, amplitude: candidate.probe[amplitude], **shape}


def _scored(base: Fit, candidate: Candidate, shape: Shape, signature: FloatArray) -> Screened:
    cross = base.jacobian.T @ signature
    added = np.eye(signature.shape[1]) + signature.T @ signature
    schur = added - cross.T @ solved(base.information, cross)
    step, gain = _joint_step(base, signature, cross, added)
    evidence = -gain + float(np.linalg.slogdet(schur)[1])
    strength = float(np.sqrt(max(np.trace(schur) - len(schur), 0.0)))
    return Screened(base, candidate, shape, signature, step, evidence, strength)


def _joint_step(base: Fit, signature: FloatArray, cross: FloatArray, added: FloatArray) -> tuple[FloatArray, float]:
    """Find the best joint step of the machine's parameters, inside their bounds, and of the amplitudes.

    Returns the step and its gain beyond the best step of the parameters alone.
    """
    free = tuple(Parameter(f"amplitude {i}", 0.0, 1.0) for i in range(signature.shape[1]))
    normal = np.block([[base.information, cross], [cross.T, added]])
    gradient = np.concatenate([base.slope - base.prior * base.z, signature.T @ base.residual])
    z = np.concatenate([base.z, np.zeros(len(free))])
    step = step_within((*base.parameters, *free), z, normal, gradient)
    return step, float(2 * gradient @ step - step @ normal @ step) - base.predicted_gain


def similarity(a: Screened, b: Screened) -> float:
    """Return cos² between two projected signatures: 1 where the effects are fully confounded."""
    return float(a.projected @ b.projected) ** 2


def confounded_with(
    names: Sequence[str], screened: Sequence[Screened], limit: float = CONFOUNDED
) -> list[tuple[str, float]]:
    """List candidates whose signature is like that of a named effect: name and cos², the most similar first."""
    named = [s for s in screened if s.candidate.name in names]
    others = [s for s in screened if s.candidate.name not in names and s.visible]
    similar = {o.candidate.name: max((similarity(o, s) for s in named), default=0.0) for o in others}
    return sorted(((name, c) for name, c in similar.items() if c > limit), key=lambda pair: -pair[1])


def separated_by(ours: Sequence[str], theirs: Sequence[str], catalogue: Mapping[str, Effect] = CATALOGUE) -> str:
    """Return the catalogue's advice on telling one of our effects from one of theirs; "" if it has none."""
    sentences = (
        catalogue[a].confounded_with.get(b) or catalogue[b].confounded_with.get(a) for a in ours for b in theirs
    )
    return next(filter(None, sentences), "")
