"""Screening: one simulation a candidate tells what it is worth beyond retuning, and for what it can be taken.

Score test with the numbers that may be retuned projected out (Rao 1948; as the Lagrange multiplier test in
econometrics). With N the derivative of the simulation by those numbers, S the candidate's signature, both in units of
their priors, and the base fit at its optimum:

    Σ = I + SᵀS − SᵀN (I + NᵀN)⁻¹ NᵀS,   g = Sᵀr,   gain = gᵀΣ⁻¹g,   Δ(−2 ln Z) = −gain + ln det Σ
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.diagnose.fit import Bench, Fit, bounded_step, promise
from ffcomp.diagnose.problem import Candidate, Number
from models.arrays import FloatArray

SEEN = 3.0  # standard deviations: of an effect of a usual size, to be seen at all


@dataclass(frozen=True, eq=False)
class Screened:
    """One candidate with one of its shapes, by its first-order signature."""

    candidate: Candidate
    shape: Mapping[str, float]
    signature: FloatArray  # (rows, a) of the simulation by each amplitude in units of its prior
    estimate: FloatArray  # (a,) linear estimate, in the same units
    gain: float  # of −2 ln likelihood, to first order
    evidence: float  # change of −2 ln Z, to first order: negative is better
    strength: float  # standard deviations by which an effect of a usual size stands out, retuning allowed
    projected: FloatArray  # (rows,) the best combination of the signature, less what retuning can do, length one

    @property
    def visible(self) -> bool:
        return self.strength > SEEN


def screen(bench: Bench, base: Fit, candidates: Sequence[Candidate]) -> list[Screened]:
    """Every candidate with the best of its shapes and in the better of its forms, best first."""
    alike = _best(base, candidates, _signatures(bench, base, [(c, shape) for c in candidates for shape in c.grid]))
    others = [(c.other, shape) for c in candidates if c.other is not None for shape in _other_shapes(c, alike[c.name])]
    other = _best(base, candidates, _signatures(bench, base, others))
    found = [min((x[c.name] for x in (alike, other) if c.name in x), key=lambda s: s.evidence) for c in candidates]
    return sorted(found, key=lambda s: s.evidence)


def _other_shapes(c: Candidate, best: Screened) -> list[Mapping[str, float]]:
    """Where other amplitudes are asked for, the best shape so far; where another shape is, those of the others."""
    held = {n.name: n.start for n in (c.other or c).shapes if n.low == n.high}
    if not held:
        return [best.shape]
    distinct = {tuple(({**shape, **held}).items()) for shape in c.grid}
    return [dict(shape) for shape in sorted(distinct)]


Tried = tuple[Candidate, Mapping[str, float], FloatArray]


def _best(base: Fit, candidates: Sequence[Candidate], tries: Iterator[Tried]) -> dict[str, Screened]:
    found: dict[str, Screened] = {}
    for candidate, shape, signature in tries:
        one = _scored(base, candidate, shape, signature)
        if candidate.name not in found or one.evidence < found[candidate.name].evidence:
            found[candidate.name] = one
    return found


def _signatures(bench: Bench, base: Fit, tries: Sequence[tuple[Candidate, Mapping[str, float]]]) -> Iterator[Tried]:
    """One probe an amplitude, the others without effect."""
    probes = [{}, *(_probe(c, a.name, shape) for c, shape in tries for a in c.amplitudes)]
    residuals = bench.residuals([{**base.values, **probe} for probe in probes])
    reference = next(residuals)
    for candidate, shape in tries:
        columns = [
            (reference - next(residuals)) * (a.sd / (candidate.probe[a.name] - a.start)) for a in candidate.amplitudes
        ]
        yield candidate, shape, np.stack(columns, axis=1)


def _probe(candidate: Candidate, amplitude: str, shape: Mapping[str, float]) -> dict[str, float]:
    rest = {a.name: a.start for a in candidate.amplitudes}
    return {**rest, amplitude: candidate.probe[amplitude], **shape}


def _scored(base: Fit, candidate: Candidate, shape: Mapping[str, float], signature: FloatArray) -> Screened:
    cross = base.jacobian.T @ signature
    retuned = np.linalg.solve(base.information, cross)
    added = np.eye(signature.shape[1]) + signature.T @ signature
    schur = added - cross.T @ retuned
    step, gain = _joint_step(base, signature, cross, added)
    estimate = step[len(base.z) :]
    left = signature @ estimate + base.jacobian @ step[: len(base.z)]
    left = left - base.jacobian @ np.linalg.solve(base.information, base.jacobian.T @ left)
    length = float(np.linalg.norm(left))
    evidence = -gain + float(np.linalg.slogdet(schur)[1])
    strength = float(np.sqrt(max(np.trace(schur) - len(schur), 0.0)))
    projected = np.asarray(left / length if length else left)
    return Screened(candidate, shape, signature, estimate, gain, evidence, strength, projected)


def _joint_step(base: Fit, signature: FloatArray, cross: FloatArray, added: FloatArray) -> tuple[FloatArray, float]:
    """The best step of the machine's numbers, inside their bounds, and of the amplitudes; and what it gains beyond
    the best of the numbers alone."""
    free = tuple(Number(f"amplitude {i}", 0.0, 1.0) for i in range(signature.shape[1]))
    normal = np.block([[base.information, cross], [cross.T, added]])
    gradient = np.concatenate([base.jacobian.T @ base.residual - base.z, signature.T @ base.residual])
    z = np.concatenate([base.z, np.zeros(len(free))])
    step = bounded_step((*base.numbers, *free), z, normal, gradient)
    return step, float(2 * gradient @ step - step @ normal @ step) - promise(base)


def likeness(a: Screened, b: Screened) -> float:
    """cos² between two projected signatures: 1 if one can be taken for the other."""
    return float(a.projected @ b.projected) ** 2
