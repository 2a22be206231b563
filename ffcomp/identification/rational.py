"""Rational fits of measured frequency responses: several responses, one denominator, started from the data.

    H_r(s) = (b_r0 + b_r1 s + …)/(a_0 + a_1 s + … + s^n)

First the iteratively reweighted linear least squares of Sanathanan & Koerner (IEEE Trans. Autom. Control 8, 1963),
which needs no start; then nonlinear least squares on the output error from the best of its iterates, which is the
maximum-likelihood estimate for circular complex noise of the stated variance (Pintelon & Schoukens, System
Identification, 2012, 9.11). Inside, frequencies are scaled to order one; outside everything is in s, 1/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ffcomp.errors import SolverError
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.numerics.least_squares import minimise
from models.arrays import ComplexArray, FloatArray

ITERATIONS = 30  # of the linear step: it either converges in ten or never


@dataclass(frozen=True, eq=False)
class RationalFit:
    """The fitted coefficients, all in powers of s, lowest first."""

    numerators: FloatArray  # (r, nb + 1)
    denominator: FloatArray  # (na + 1,), the last one is 1
    covariance: FloatArray  # (p, p), p = r (nb + 1) + na: numerators row by row, then the denominator without its 1

    @property
    def poles(self) -> ComplexArray:
        """(na,) 1/s, slowest first."""
        roots = np.roots(self.denominator[::-1]).astype(np.complex128)
        return roots[np.argsort(np.abs(roots))]

    def zeros(self, response: int = 0) -> ComplexArray:
        """Return the zeros of one response, (nb,) 1/s, slowest first."""
        roots = np.roots(self.numerators[response][::-1]).astype(np.complex128)
        return roots[np.argsort(np.abs(roots))]


def fit_rational(responses: Sequence[FrequencyResponse], numerator_order: int, denominator_order: int) -> RationalFit:
    """Fit responses on one frequency grid with a common denominator.

    Raises
    ------
    SolverError
        If there are fewer measured values than unknowns, or no finite fit.
    """
    s, value = responses[0].s, np.stack([r.value for r in responses])
    variance = np.stack([r.variance for r in responses])
    unknowns = len(value) * (numerator_order + 1) + denominator_order
    if 2 * value.size < unknowns + 1:
        raise SolverError(f"{value.size} measured values cannot determine a rational fit of {unknowns} coefficients.")
    scale = float(np.max(np.abs(s))) / 2
    floor = 1e-12 * np.mean(np.abs(value) ** 2)  # noise-free data: finite weights all the same
    problem = _Problem(s / scale, value, np.sqrt(2 / (variance + floor)), numerator_order, denominator_order)
    theta = start = _linear_start(problem)
    solution = minimise(problem.residual, start, problem.jacobian, evaluations=400)
    if solution.converged or solution.cost < np.sum(problem.residual(start) ** 2):
        theta = solution.x
    return _unscaled(problem, theta, scale)


@dataclass(frozen=True, eq=False)
class _Problem:
    """One fit in scaled frequency; unknowns are the numerators row by row, then the denominator without its 1."""

    x: ComplexArray  # (k,)
    value: ComplexArray  # (r, k)
    weight: FloatArray  # (r, k), 1/standard deviation of a real or imaginary part
    nb: int
    na: int

    def parts(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Evaluate N : (r, k) and D : (k,)."""
        rows = theta[: -self.na].reshape(len(self.value), self.nb + 1)
        above = rows @ np.vander(self.x, self.nb + 1, increasing=True).T
        below = np.vander(self.x, self.na + 1, increasing=True) @ np.append(theta[-self.na :], 1.0)
        return above, below

    def residual(self, theta: FloatArray) -> FloatArray:
        above, below = self.parts(theta)
        return _real(self.weight * (above / below - self.value)).ravel()

    def jacobian(self, theta: FloatArray) -> FloatArray:
        above, below = self.parts(theta)
        return self._columns(self.weight / below, -self.weight * above / below**2)

    def _columns(self, of_numerator: ComplexArray, of_denominator: ComplexArray) -> FloatArray:
        """Build (2 r k, p) from the factors of the powers of x in numerator and denominator, (r, k) both."""
        r, k = self.value.shape
        powers = np.vander(self.x, max(self.nb + 1, self.na), increasing=True).T  # (·, k)
        above = np.zeros((r, k, r, self.nb + 1), dtype=np.complex128)
        for i in range(r):
            above[i, :, i] = (powers[: self.nb + 1] * of_numerator[i]).T
        below = np.einsum("pk,rk->rkp", powers[: self.na], of_denominator)
        joined = np.concatenate([above.reshape(r, k, -1), below], axis=2)
        return np.stack([joined.real, joined.imag]).reshape(2 * r * k, -1)

    def linear_step(self, below: ComplexArray) -> FloatArray:
        """Minimise |w (N − H D)/D_before|: the Sanathanan-Koerner step."""
        weight = self.weight / np.abs(below)
        columns = self._columns(weight.astype(np.complex128), -weight * self.value)
        target = _real(weight * self.value * self.x**self.na).ravel()
        norm = np.linalg.norm(columns, axis=0)
        norm[norm == 0] = 1.0
        return np.asarray(np.linalg.lstsq(columns / norm, target, rcond=None)[0] / norm)


def _real(values: ComplexArray) -> FloatArray:
    return np.stack([values.real, values.imag])


def _linear_start(problem: _Problem) -> FloatArray:
    """Return the iterate with the smallest output error."""
    below = np.ones_like(problem.x)
    best, least = None, np.inf
    for _ in range(ITERATIONS):
        theta = problem.linear_step(below)
        cost = float(np.sum(problem.residual(theta) ** 2))
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


def _unscaled(problem: _Problem, theta: FloatArray, scale: float) -> RationalFit:
    nb, na, r = problem.nb, problem.na, len(problem.value)
    chi_squared = float(np.sum(problem.residual(theta) ** 2))
    freedom = 2 * problem.value.size - len(theta)
    back = scale ** (na - np.concatenate([np.tile(np.arange(nb + 1), r), np.arange(na)]).astype(float))
    j = problem.jacobian(theta)
    covariance = scaled_inverse(j.T @ j) * max(1.0, chi_squared / max(freedom, 1)) * np.outer(back, back)
    coefficients = theta * back
    numerators = coefficients[:-na].reshape(r, nb + 1)
    return RationalFit(numerators, np.append(coefficients[-na:], 1.0), covariance)


def scaled_inverse(information: NDArray[np.float64]) -> FloatArray:
    """Invert a positive matrix whose rows have very different sizes."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    return np.linalg.pinv(information / np.outer(size, size), hermitian=True, rcond=1e-15) / np.outer(size, size)
