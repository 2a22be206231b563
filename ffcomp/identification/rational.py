"""Rational fit of a measured frequency response, started from the data.

    H(s) = (b_0 + b_1 s + …)/(a_0 + a_1 s + … + s^n)

First the iteratively reweighted linear least squares of Sanathanan & Koerner (IEEE Trans. Autom. Control 8, 1963),
which needs no start; then nonlinear least squares on the output error from the best of its iterates, which is the
maximum-likelihood estimate for circular complex noise of the stated variance (Pintelon & Schoukens, System
Identification, 2012, 9.11). Inside, frequencies are scaled to order one; outside everything is in s, 1/s.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.errors import SolverError
from ffcomp.inference.fit import FitSettings, fit
from ffcomp.inference.problem import EstimationProblem, Observation, Unknown
from ffcomp.measurement.frf import FrequencyResponse
from models.arrays import ComplexArray, FloatArray

ITERATIONS = 30  # of the linear step: it either converges in ten or never
OUTPUT_ERROR = FitSettings(steps=200, gain=1e-6)


@dataclass(frozen=True, eq=False)
class RationalFit:
    """The fitted coefficients, all in powers of s, lowest first."""

    numerator: FloatArray  # (nb + 1,)
    denominator: FloatArray  # (na + 1,), the last one is 1
    covariance: FloatArray  # (p, p), p = nb + 1 + na: the numerator, then the denominator without its 1

    @property
    def coefficients(self) -> FloatArray:
        """(p,) all but the denominator's 1."""
        return np.append(self.numerator, self.denominator[:-1])

    @property
    def poles(self) -> ComplexArray:
        """(na,) 1/s, slowest first."""
        return _roots(self.denominator)

    @property
    def zeros(self) -> ComplexArray:
        """(nb,) 1/s, slowest first."""
        return _roots(self.numerator)


def _roots(polynomial: FloatArray) -> ComplexArray:
    roots = np.roots(polynomial[::-1]).astype(np.complex128)
    return roots[np.argsort(np.abs(roots))]


def fit_rational(response: FrequencyResponse, numerator_order: int, denominator_order: int) -> RationalFit:
    """Fit a response.

    Raises
    ------
    SolverError
        If there are fewer measured values than unknowns, or no finite fit.
    """
    nb, na, lines = numerator_order, denominator_order, len(response.value)
    unknowns = nb + 1 + na
    if 2 * lines < unknowns + 1:
        raise SolverError(f"{lines} measured values cannot determine a rational fit of {unknowns} coefficients.")
    scale = float(np.max(np.abs(response.s))) / 2
    problem = _Problem(response, scale, nb, na)
    found = fit(problem, _linear_start(problem), OUTPUT_ERROR)
    back = scale ** (na - np.concatenate([np.arange(nb + 1), np.arange(na)]).astype(float))
    misfit = max(1.0, found.cost / max(2 * lines - unknowns, 1))
    values = found.values * back
    covariance = found.covariance * misfit * np.outer(back, back)
    return RationalFit(values[:-na], np.append(values[-na:], 1.0), covariance)


class _Problem(EstimationProblem):
    """One fit in scaled frequency; unknowns are the numerator, then the denominator without its 1."""

    def __init__(self, response: FrequencyResponse, scale: float, nb: int, na: int) -> None:
        self.value, self.na = response.value, na
        self.powers = np.vander(response.s / scale, max(nb, na) + 1, increasing=True)  # (k, ·)
        self.above, self.below = self.powers[:, : nb + 1], self.powers[:, : na + 1]
        self.unknowns = [*(Unknown(f"b{i}") for i in range(nb + 1)), *(Unknown(f"a{i}") for i in range(na))]
        floor = 1e-12 * np.mean(np.abs(response.value) ** 2)  # noise-free data: finite weights all the same
        self.observations = [Observation(_real(response.value), np.tile((response.variance + floor) / 2, 2))]

    def parts(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Evaluate numerator and denominator, (k,) each."""
        return self.above @ theta[: -self.na], self.below @ np.append(theta[-self.na :], 1.0)

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        for theta in lanes:
            above, below = self.parts(theta)
            yield _real(above / below)

    def slopes(self, values: FloatArray) -> FloatArray:
        above, below = self.parts(values)
        return _real(self._columns(1 / below, -above / below**2))

    def _columns(self, of_numerator: ComplexArray, of_denominator: ComplexArray) -> ComplexArray:
        """Return (k, p) from the factors (k,) of the powers of x in numerator and denominator."""
        return np.hstack([self.above * of_numerator[:, None], self.below[:, :-1] * of_denominator[:, None]])

    def linear_step(self, below: ComplexArray) -> FloatArray:
        """Minimise |w (N − H D)/D_before|: the Sanathanan-Koerner step."""
        weight = 1 / (self.deviations(np.zeros(1))[: len(below)] * np.abs(below))
        columns = _real(self._columns(weight.astype(np.complex128), -weight * self.value))
        target = _real(weight * self.value * self.powers[:, self.na])
        norm = np.linalg.norm(columns, axis=0)
        norm[norm == 0] = 1.0
        return np.asarray(np.linalg.lstsq(columns / norm, target, rcond=None)[0] / norm)

    def output_error(self, theta: FloatArray) -> float:
        """Return χ² of the response itself."""
        (simulated,) = self.simulate([theta])
        return float(np.sum(self.whitened(simulated, self.deviations(np.zeros(1))) ** 2))


def _real(values: ComplexArray) -> FloatArray:
    return np.concatenate([values.real, values.imag])


def _linear_start(problem: _Problem) -> FloatArray:
    """Return the iterate with the smallest output error."""
    below = np.ones_like(problem.value)
    best, least = None, np.inf
    for _ in range(ITERATIONS):
        theta = problem.linear_step(below)
        cost = problem.output_error(theta)
        if np.isfinite(cost) and cost < least:
            best, least = theta, cost
        below = problem.parts(_stabilised(theta, problem.na))[1]
    if best is None:
        raise SolverError("No rational fit was found: the linear start never became finite.")
    return best


def _stabilised(theta: FloatArray, na: int) -> FloatArray:
    """Mirror poles of the right half-plane into the left: only for the next weighting."""
    roots = np.roots(np.append(theta[-na:], 1.0)[::-1])
    roots = np.where(roots.real > 0, -roots.conj(), roots)
    return np.concatenate([theta[:-na], np.real(np.poly(roots))[::-1][:-1]])
