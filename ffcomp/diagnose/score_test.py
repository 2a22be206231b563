"""Screen candidates: one simulation an amplitude tells its gain beyond retuning, and what it is confounded with.

Score test with the parameters that may be retuned projected out (Rao 1948; as the Lagrange multiplier test in
econometrics). With N the derivative of the simulation by those parameters, S the candidate's signature, both in units
of their priors, and the base fit at its optimum:

    Σ = I + SᵀS − SᵀN (I + NᵀN)⁻¹ NᵀS,   g = Sᵀr,   gain = gᵀΣ⁻¹g,   Δ(−2 ln Z) = −gain + ln det Σ
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.diagnose.estimation import EstimationProblem
from ffcomp.diagnose.fit import Fit, step_within
from ffcomp.diagnose.glimpse import Glimpse, glimpse_of
from ffcomp.diagnose.problem import Candidate, Parameter
from models.arrays import FloatArray

VISIBLE = 3.0  # standard deviations of an effect of a usual size
LIKELY = 2  # shapes of a candidate that are tried in all motions

Shape = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Screened:
    """One candidate with one of its shapes, by its first-order signature."""

    candidate: Candidate
    shape: Shape
    signature: FloatArray  # (rows, a) of the simulation by each amplitude in units of its prior
    estimate: FloatArray  # (a,) linear estimate, in the same units
    gain: float  # of −2 ln likelihood, to first order
    evidence: float  # change of −2 ln Z, to first order: negative is better
    strength: float  # standard deviations by which an effect of a usual size stands out, retuning allowed
    projected: FloatArray  # (rows,) the best combination of the signature, less what retuning can do, length one

    @property
    def visible(self) -> bool:
        """Whether these recordings would show a usual size."""
        return self.strength > VISIBLE


def screen(estimation: EstimationProblem, base: Fit, candidates: Sequence[Candidate]) -> list[Screened]:
    """Score every candidate with the best of its shapes and in the better of its forms; the best one first."""
    seen = glimpse_of(estimation, base)
    shared = _best(base, _signatures(estimation, base, _likely(seen, [(c, c.grid) for c in candidates])))
    forms = [(c.other, _other_shapes(c, shared[c.name])) for c in candidates if c.other is not None]
    other = _best(base, _signatures(estimation, base, _likely(seen, forms)))
    found = [min((x[c.name] for x in (shared, other) if c.name in x), key=lambda s: s.evidence) for c in candidates]
    whole = 1 / np.sqrt(estimation.share)  # an excerpt shows less than what these recordings could
    return sorted((replace(s, strength=float(whole * s.strength)) for s in found), key=lambda s: s.evidence)


def screen_roughly(estimation: EstimationProblem, base: Fit, candidates: Sequence[Candidate]) -> list[Screened]:
    """Score candidates in the motions of a glimpse only: enough to choose those that are fitted."""
    seen = glimpse_of(estimation, base)
    return screen(estimation, base, candidates) if seen is None else screen(seen.estimation, seen.fit, candidates)


def _likely(seen: Glimpse | None, shapes: Sequence[tuple[Candidate, Sequence[Shape]]]) -> list[tuple[Candidate, Shape]]:
    """List candidates with the shapes to try: of many only the best, as the motions of a glimpse show them."""
    many = [(c, shape) for c, own in shapes for shape in own if len(own) > LIKELY]
    if seen is None or not many:
        return [(c, shape) for c, own in shapes for shape in own]
    tries = _signatures(seen.estimation, seen.fit, many)
    scores = [_scored(seen.fit, c, shape, signature).rank for c, shape, signature in tries]
    ranked = [many[i] for i in sorted(range(len(many)), key=scores.__getitem__)]
    found = []
    for c, own in shapes:
        best = [shape for other, shape in ranked if other is c][:LIKELY]
        found += [(c, shape) for shape in (own if len(own) <= LIKELY else best)]
    return found


def _other_shapes(c: Candidate, best: Screened) -> list[Shape]:
    """List the shapes to try the other form with: the best one so far; all of them where that form fixes a shape."""
    fixed = {n.name: n.start for n in (c.other or c).shapes if n.low == n.high}
    if not fixed:
        return [best.shape]
    distinct = {tuple(({**shape, **fixed}).items()) for shape in c.grid}
    return [dict(shape) for shape in sorted(distinct)]


Tried = tuple[Candidate, Shape, FloatArray]


def _best(base: Fit, tries: Iterator[Tried]) -> dict[str, Screened]:
    found: dict[str, _Scored] = {}
    for candidate, shape, signature in tries:
        one = _scored(base, candidate, shape, signature)
        if candidate.name not in found or one.rank < found[candidate.name].rank:
            found[candidate.name] = one
    return {name: _screened(base, one) for name, one in found.items()}


@dataclass(frozen=True, eq=False)
class _Scored:
    """What products with the signature tell, without another vector of its length."""

    candidate: Candidate
    shape: Shape
    signature: FloatArray
    step: FloatArray  # of the machine's parameters and the amplitudes together
    gain: float
    evidence: float
    strength: float

    @property
    def rank(self) -> tuple[bool, float]:
        """Order the shapes of one candidate: a ripple half a turn off explains as much, by an amplitude below zero."""
        estimate = self.step[-len(self.candidate.amplitudes) :]
        sizes = zip(self.candidate.amplitudes, estimate, strict=True)
        return any(not n.low <= n.start + n.sd * z <= n.high for n, z in sizes), self.evidence


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


def _scored(base: Fit, candidate: Candidate, shape: Shape, signature: FloatArray) -> _Scored:
    cross = base.jacobian.T @ signature
    added = np.eye(signature.shape[1]) + signature.T @ signature
    schur = added - cross.T @ np.linalg.solve(base.information, cross)
    step, gain = _joint_step(base, signature, cross, added)
    evidence = -gain + float(np.linalg.slogdet(schur)[1])
    strength = float(np.sqrt(max(np.trace(schur) - len(schur), 0.0)))
    return _Scored(candidate, shape, signature, step, gain, evidence, strength)


def _screened(base: Fit, one: _Scored) -> Screened:
    """Complete what is kept of a candidate."""
    own, estimate = one.step[: len(base.z)], one.step[len(base.z) :]
    along = one.signature @ estimate
    # (1 − J (I + JᵀJ)⁻¹ Jᵀ)(S e + J s) = S e + J (s − (I + JᵀJ)⁻¹ Jᵀ (S e + J s))
    seen = base.jacobian.T @ along + (base.information - np.eye(len(own))) @ own
    left = along + base.jacobian @ (own - np.linalg.solve(base.information, seen))
    length = float(np.linalg.norm(left))
    projected = np.asarray(left / length if length else left)
    return Screened(one.candidate, one.shape, one.signature, estimate, one.gain, one.evidence, one.strength, projected)


def _joint_step(base: Fit, signature: FloatArray, cross: FloatArray, added: FloatArray) -> tuple[FloatArray, float]:
    """Find the best joint step of the machine's parameters, inside their bounds, and of the amplitudes.

    Returns the step and its gain beyond the best step of the parameters alone.
    """
    free = tuple(Parameter(f"amplitude {i}", 0.0, 1.0) for i in range(signature.shape[1]))
    normal = np.block([[base.information, cross], [cross.T, added]])
    gradient = np.concatenate([base.slope - base.z, signature.T @ base.residual])
    z = np.concatenate([base.z, np.zeros(len(free))])
    step = step_within((*base.parameters, *free), z, normal, gradient)
    return step, float(2 * gradient @ step - step @ normal @ step) - base.predicted_gain


def overlap(a: Screened, b: Screened) -> float:
    """Return cos² between two signatures as they are: retuning may tell apart what does much the same."""
    ours, theirs = a.signature @ a.estimate, b.signature @ b.estimate
    length = float((ours @ ours) * (theirs @ theirs))
    return float(ours @ theirs) ** 2 / length if length else 0.0


def similarity(a: Screened, b: Screened) -> float:
    """Return cos² between two projected signatures: 1 where the effects are fully confounded."""
    return float(a.projected @ b.projected) ** 2
