"""Screening: one simulation a candidate tells what it is worth beyond retuning, and for what it can be taken.

Score test with the numbers that may be retuned projected out (Rao 1948; as the Lagrange multiplier test in
econometrics). With N the derivative of the simulation by those numbers, S the candidate's signature, both in units of
their priors, and the base fit at its optimum:

    Σ = I + SᵀS − SᵀN (I + NᵀN)⁻¹ NᵀS,   g = Sᵀr,   gain = gᵀΣ⁻¹g,   Δ(−2 ln Z) = −gain + ln det Σ
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.diagnose.fit import Bench, Fit
from ffcomp.diagnose.plant import Candidate
from ffcomp.measured.frf import FloatArray


@dataclass(frozen=True, eq=False)
class Screened:
    """One candidate with one of its shapes, by its first-order signature."""

    candidate: Candidate
    shape: Mapping[str, float]
    signature: FloatArray  # (rows, a) of the simulation by each amplitude in units of its prior
    estimate: FloatArray  # (a,) linear estimate, in the same units
    gain: float  # of −2 ln likelihood, to first order
    evidence: float  # change of −2 ln Z, to first order: negative is better
    projected: FloatArray  # (rows,) the best combination of the signature, less what retuning can do, length one


def screen(bench: Bench, base: Fit, candidates: Sequence[Candidate]) -> list[Screened]:
    """Every candidate with the best of its shapes, best first."""
    tries = [(c, shape) for c in candidates for shape in c.grid]
    probes = [{**base.values, **c.probe, **shape} for c, shape in tries if len(c.amplitudes) == 1]
    residuals = iter(bench.residuals(probes))
    found: dict[str, Screened] = {}
    for candidate, shape in tries:
        if len(candidate.amplitudes) == 1:
            signature = _column(base, next(residuals), candidate, 0)[:, None]
        else:
            signature = _columns(bench, base, candidate, shape)
        one = _scored(base, candidate, shape, signature)
        if candidate.name not in found or one.evidence < found[candidate.name].evidence:
            found[candidate.name] = one
    return sorted(found.values(), key=lambda s: s.evidence)


def _column(base: Fit, residual: FloatArray, candidate: Candidate, i: int) -> FloatArray:
    amplitude = candidate.amplitudes[i]
    step = (candidate.probe[amplitude.name] - amplitude.start) / amplitude.sd
    return np.asarray((base.residual - residual) / step)


def _columns(bench: Bench, base: Fit, candidate: Candidate, shape: Mapping[str, float]) -> FloatArray:
    """One probe an amplitude, the others without effect."""
    rest = {a.name: a.start for a in candidate.amplitudes}
    probes = [{**base.values, **rest, a.name: candidate.probe[a.name], **shape} for a in candidate.amplitudes]
    columns = [_column(base, r, candidate, i) for i, r in enumerate(bench.residuals(probes))]
    return np.stack(columns, axis=1)


def _scored(base: Fit, candidate: Candidate, shape: Mapping[str, float], signature: FloatArray) -> Screened:
    cross = base.jacobian.T @ signature
    retuned = np.linalg.solve(base.information, cross)
    schur = np.eye(signature.shape[1]) + signature.T @ signature - cross.T @ retuned
    slope = signature.T @ base.residual - retuned.T @ (base.jacobian.T @ base.residual - base.z)
    estimate = np.linalg.solve(schur, slope)
    gain = float(slope @ estimate)
    left = (signature - base.jacobian @ retuned) @ estimate
    length = float(np.linalg.norm(left))
    evidence = -gain + float(np.linalg.slogdet(schur)[1])
    projected = np.asarray(left / length if length else left)
    return Screened(candidate, shape, signature, np.asarray(estimate), gain, evidence, projected)


def likeness(a: Screened, b: Screened) -> float:
    """cos² between two projected signatures: 1 if one can be taken for the other."""
    return float(a.projected @ b.projected) ** 2
