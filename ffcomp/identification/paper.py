"""The paper's identification, step by step (Eqs. 30-49 and 63-69, corrected), with standard uncertainties.

    carriage alone, carriage with a known mass     → m, k, c, b and the drive's d₀ d₁ d₂     (Eqs. 30-43)
    effector struck by a hammer, and its weight    → m₁, m₂, and b_j, k_j of that axis       (Eqs. 45-49)
    the whole printer, one axis after the other    → b_j, k_j                                (Eqs. 63-69)

The first two fit rational functions to the responses and solve the equations between their coefficients and the
parameters by least squares, each coefficient weighed by its covariance: the paper's redundant equations (36 and 40,
35 and 39) then share their error instead of contradicting each other, and the χ² of each step says whether they do.

NOTE: for the whole printer the paper fits free coefficients too (Eq. 66) and then solves Eq. 68 for b_j and k_j. At
40 dB that is ill-conditioned: the extruder is well damped along x and y (ζ = 0.5 and 0.7) and beyond the band along z,
so a pole cancels a zero along x in two of three noise draws, and the coefficients scatter by 8 % along y and 40 % along
z. Here the coefficients are kept to Eq. 68 while fitting, by output error, and the parameters of the steps before are
held by their uncertainties: k_x, k_y to 0.3 %.

Corrected: Eq. 68's s² term is (c+b) b_j, without α; α is the ratio of load to carriage motion, σ_j² of J at the
centre (1/3 along z), not Eq. 69, which forgets that X is not q; M₁ holds the arms' lower halves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import least_squares

from ffcomp.errors import MeasurementError, SolverError
from ffcomp.identification.axis_spectra import observed_response
from ffcomp.identification.direct import NEUTRAL_DRIVE
from ffcomp.identification.output_error import (
    CARRIAGE,
    DAMPING,
    DRIVE,
    EFFECTOR_MASSES,
    STIFFNESS,
    UNKNOWNS,
    fit_machine,
)
from ffcomp.identification.uncertainty import Estimate, Number, estimates
from ffcomp.inference.fit import FitSettings, fit
from ffcomp.inference.problem import EstimationProblem, Unknown
from ffcomp.measurement.frf import AXES, FrequencyResponse
from ffcomp.numerics.serialise import keys
from models.arrays import ComplexArray, FloatArray
from models.kinds import delta_vibration, with_parts
from models.machine import Machine, with_values

SETUPS = ("carriage", "carriage+mass", "effector", "assembly")
SURE_FREEDOM = 5  # degrees of freedom: with as many, a large χ² widens the intervals
WEIGHED_SD = 1e-6  # relative, of a weight given without an uncertainty
ROUNDING = 1e-12  # of a covariance's diagonal: keeps it positive
ITERATIONS = 30  # of the linear step: it either converges in ten or never
OUTPUT_ERROR = FitSettings(steps=200, gain=1e-6)


@dataclass(frozen=True, eq=False)
class Step:
    """The result of one step."""

    json_keys: ClassVar = keys(step="title", chi_squared_per_degree_of_freedom="consistency", numbers="estimates")

    title: str
    estimates: Mapping[str, Estimate]  # by the names of the machine file
    consistency: float  # χ² by degree of freedom of its redundant equations: 1 if they agree


# ---- all steps -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PaperIdentification:
    """The machine of all steps, its numbers, and each step."""

    machine: Machine
    estimates: Mapping[str, Estimate]  # each from the step that determines it best
    steps: Sequence[Step]


def identify_as_paper(
    start: Machine, responses: Sequence[FrequencyResponse], total_mass_kg: float, total_sd_kg: float
) -> PaperIdentification:
    """Run every step of the paper, from responses of all four setups.

    start : gives the kinematics, the arms' mass and the limits; where no hammer struck along an axis, its mount is
        where the search for another one begins.

    Raises MeasurementError if one of the four measurements is missing; SolverError.
    """
    for setup in SETUPS:
        if all(response.setup != setup for response in responses):
            rule = f"No response with the setup {setup!r} is there; the paper's steps need it."
            raise MeasurementError("the measurements", [rule])
    alone, loaded = (next(r for r in responses if r.setup == setup) for setup in SETUPS[:2])
    parts = delta_vibration(start).carriage
    carriage = carriage_step(alone, loaded, parts.arm_pair_mass_kg / 2)
    hammers = [hammer_step(r, total_mass_kg, total_sd_kg) for r in responses if r.setup == "effector"]
    clearest = min(hammers, key=lambda step: step.estimates[EFFECTOR_MASSES[1]].relative_sd)
    machine = with_parts(start, carriage=replace(parts, drive=parts.drive or NEUTRAL_DRIVE))
    machine = _with(machine, carriage.estimates, *(step.estimates for step in hammers), clearest.estimates)
    masses = {name: clearest.estimates[name] for name in EFFECTOR_MASSES}
    known = {name: (e.value, e.sd) for name, e in {**carriage.estimates, **masses}.items()}
    assembly = []
    for axis, *mount in zip(AXES, STIFFNESS, DAMPING, strict=True):
        moved = [r for r in responses if r.setup == "assembly" and r.input == f"cmd_{axis}"]
        if moved:
            fitted = fit_machine(machine, moved, known, unknowns=(*known, *mount))
            found = {name: fitted.estimates[name] for name in mount}
            assembly.append(Step(f"assembly {axis}", found, fitted.misfit))
    mounts = [each for step in (*hammers, *assembly) for each in step.estimates.items() if each[0] not in masses]
    sharpest = dict(sorted(mounts, key=lambda each: -each[1].relative_sd))
    best = {**carriage.estimates, **masses, **sharpest}
    numbers = {name: best[name] for name in UNKNOWNS if name in best}  # x, y, z: as a file lists them
    return PaperIdentification(_with(machine, numbers), numbers, (carriage, *hammers, *assembly))


def _with(machine: Machine, *found: Mapping[str, Estimate]) -> Machine:
    return with_values(machine, {name: e.value for each in found for name, e in each.items()})


# ---- sub-model 1 ---------------------------------------------------------------------------------


def carriage_step(alone: FrequencyResponse, loaded: FrequencyResponse, arms_kg: float) -> Step:
    """Identify m, k, c, b, d₀, d₁, d₂ from the carriage without and with `loaded.added_mass_kg` (Eqs. 30-43).

    arms_kg : what the arms add to the carriage in both.

    Raises SolverError if the two responses do not show the effect of the added mass.
    """
    fits = [fit_rational(response, 2, 4) for response in (alone, loaded)]

    def equations(numbers: FloatArray) -> list[FloatArray]:
        return [_coefficients(numbers, arms_kg + added) for added in (0.0, loaded.added_mass_kg)]

    start = _carriage_start(fits[0], fits[1], loaded.added_mass_kg)
    start[0] -= arms_kg
    return Step("carriage", *_solved((*CARRIAGE, *DRIVE), start, equations, fits))


def _coefficients(numbers: FloatArray, added_kg: float) -> FloatArray:
    """Compute g₀ g₁ g₂, h₀ h₁ h₂ h₃ of Eq. 42 from the parameters (Eq. 43)."""
    m, k, c, b, d0, d1, d2 = numbers
    m = m + added_kg
    omega2, damping = k / m, (c + b) / m  # ω_n², 2 ζ ω_n
    g = (omega2 * d0, c / m * d0 + omega2 * d1, c / m * d1)
    h = (omega2 * d0, omega2 * d2 + damping * d0, d0 + omega2 + damping * d2, d2 + damping)
    return np.array([*g, *h])


def _carriage_start(alone: RationalFit, loaded: RationalFit, added_kg: float) -> FloatArray:
    """Begin at the paper's closed forms: the pole moved by the mass is the carriage's, the other one the drive's."""
    free, held = (each.poles[each.poles.imag > 0] for each in (alone, loaded))
    if len(free) < 2 or len(held) < 2:
        raise SolverError("The carriage's response does not show two oscillating poles (belt and drive, Eq. 42).")
    pairs = [(i, j) for i in range(2) for j in range(2)]
    drive, same = min(pairs, key=lambda pair: abs(np.log(abs(free[pair[0]]) / abs(held[pair[1]]))))
    omega, omega_loaded = abs(free[1 - drive]), abs(held[1 - same])
    if omega <= 1.02 * omega_loaded:
        raise SolverError(
            f"{1000 * added_kg:g} g on the carriage changed its frequency from {omega / 2 / np.pi:.1f} to "
            f"{omega_loaded / 2 / np.pi:.1f} Hz; it must fall by more than 2 % (Eq. 41)."
        )
    m = omega_loaded**2 / (omega**2 - omega_loaded**2) * added_kg  # Eq. 41
    d0, d2 = abs(free[drive]) ** 2, -2 * free[drive].real
    lead = np.sort(-1 / alone.zeros.real)  # numerator (c s + k)(d1 s + d0): its zeros are −k/c and −d0/d1
    k, total = m * omega**2, -2 * free[1 - drive].real * m  # Eqs. 36 and 35
    c = float(np.clip(lead[-1] * k, 0.02 * total, 0.98 * total))
    return np.array([m, k, c, total - c, d0, lead[0] * d0, d2])


# ---- sub-model 2 ---------------------------------------------------------------------------------


def hammer_step(struck: FrequencyResponse, total_kg: float, total_sd_kg: float) -> Step:
    """Identify m₁, m₂ and the struck axis' k, b from the free effector's accelerance and its weight (Eqs. 45-49).

    Only the ratio of zero to pole and the weight give the masses, so the hammer needs no calibration; its gain is
    fitted too.
    """
    rational = fit_rational(struck, 2, 2)
    zero, pole = abs(rational.zeros[-1]), abs(rational.poles[-1])
    m1 = total_kg * min((zero / pole) ** 2, 0.999)  # Eq. 49
    m2 = total_kg - m1
    damping = max(-2 * rational.zeros[-1].real, 1e-3 * zero)
    start = np.array([m1, m2, zero**2 * m2, damping * m2, rational.numerator[2] * m1])

    def equations(numbers: FloatArray) -> list[FloatArray]:
        m1, m2, k, b, gain = numbers
        return [np.array([gain * k, gain * b, gain * m2, (m1 + m2) * k, (m1 + m2) * b]) / (m1 * m2)]

    def weighed(numbers: FloatArray) -> FloatArray:
        return (numbers[:1] + numbers[1:2] - total_kg) / max(total_sd_kg, WEIGHED_SD * total_kg)

    i = AXES.index(struck.input[-1])
    names = (*EFFECTOR_MASSES, STIFFNESS[i], DAMPING[i])
    found, consistency = _solved((*names, "gain"), start, equations, [rational], weighed)
    return Step(f"hammer {AXES[i]}", {name: found[name] for name in names}, consistency)


# ---- coefficients to parameters ------------------------------------------------------------------


def _solved(
    names: Sequence[str],
    start: FloatArray,
    equations: Callable[[FloatArray], Sequence[FloatArray]],
    fits: Sequence[RationalFit],
    extra: Callable[[FloatArray], FloatArray] = lambda _: np.empty(0),
) -> tuple[dict[str, Estimate], float]:
    """Solve coefficients = equations(parameters) by weighted least squares, with further whitened residuals `extra`."""
    numbers = [Number(name, at, unit=abs(at) or 1.0) for name, at in zip(names, start.tolist(), strict=True)]
    covariances = [each.covariance for each in fits]
    spreads = [np.linalg.cholesky(each + ROUNDING * np.diag(np.diag(each))) for each in covariances]

    def residual(x: FloatArray) -> FloatArray:
        values = np.array([number.value(at) for number, at in zip(numbers, x.tolist(), strict=True)])
        each = zip(spreads, equations(values), fits, strict=True)
        errors = [solve_triangular(spread, found - of.coefficients, lower=True) for spread, found, of in each]
        return np.concatenate([*errors, extra(values)])

    best = least_squares(residual, np.zeros(len(start)), method="lm", x_scale="jac", max_nfev=2000)
    inverse = np.linalg.pinv(best.jac)
    freedom = len(best.fun) - len(start)
    consistency = 2 * float(best.cost) / freedom
    wider = max(1.0, consistency) if freedom >= SURE_FREEDOM else 1.0
    return estimates(numbers, best.x, wider * np.sum(inverse**2, axis=1)), consistency


# ---- coefficients from a response ----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class RationalFit:
    """H(s) = (b_0 + b_1 s + …)/(a_0 + a_1 s + … + s^n): the coefficients, lowest power first."""

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
    """Fit a response, frequencies scaled to order one inside.

    First the iteratively reweighted linear least squares of Sanathanan & Koerner (IEEE Trans. Autom. Control 8, 1963),
    which needs no start; then the output error from the best of its iterates, which is the maximum-likelihood estimate
    for circular complex noise of the stated variance (Pintelon & Schoukens, System Identification, 2012, 9.11).

    Raises SolverError if there are fewer measured values than unknowns, or no finite fit.
    """
    nb, na, lines = numerator_order, denominator_order, len(response.value)
    unknowns = nb + 1 + na
    if 2 * lines < unknowns + 1:
        raise SolverError(f"{lines} measured values cannot determine a rational fit of {unknowns} coefficients.")
    scale = float(np.max(np.abs(response.s))) / 2
    problem = _Rational(response, scale, nb, na)
    found = fit(problem, _linear_start(problem), OUTPUT_ERROR)
    back = scale ** (na - np.concatenate([np.arange(nb + 1), np.arange(na)]).astype(float))
    misfit = max(1.0, found.cost / max(2 * lines - unknowns, 1))
    values = found.values * back
    covariance = found.covariance * misfit * np.outer(back, back)
    return RationalFit(values[:-na], np.append(values[-na:], 1.0), covariance)


class _Rational(EstimationProblem):
    """One fit in scaled frequency; unknowns are the numerator, then the denominator without its 1."""

    def __init__(self, response: FrequencyResponse, scale: float, nb: int, na: int) -> None:
        self.value, self.na = response.value, na
        self.powers = np.vander(response.s / scale, max(nb, na) + 1, increasing=True)  # (k, ·)
        self.above, self.below = self.powers[:, : nb + 1], self.powers[:, : na + 1]
        self.unknowns = [*(Unknown(f"b{i}") for i in range(nb + 1)), *(Unknown(f"a{i}") for i in range(na))]
        self.observations = [observed_response(response)]

    def parts(self, theta: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Evaluate numerator and denominator, (k,) each."""
        return self.above @ theta[: -self.na], self.below @ np.append(theta[-self.na :], 1.0)

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        for theta in lanes:
            above, below = self.parts(theta)
            yield _real(above / below)

    def linear_step(self, below: ComplexArray) -> FloatArray:
        """Minimise |w (N − H D)/D_before|: the Sanathanan-Koerner step."""
        weight = 1 / (self.deviations(np.zeros(1))[: len(below)] * np.abs(below))
        of_denominator = -(weight * self.value)[:, None] * self.below[:, :-1]
        columns = _real(np.hstack([weight[:, None] * self.above, of_denominator]))
        target = _real(weight * self.value * self.powers[:, self.na])
        norm = np.linalg.norm(columns, axis=0)
        norm[norm == 0] = 1.0
        return np.asarray(np.linalg.lstsq(columns / norm, target, rcond=None)[0] / norm)


def _real(values: ComplexArray) -> FloatArray:
    return np.concatenate([values.real, values.imag])


def _linear_start(problem: _Rational) -> FloatArray:
    """Return the iterate with the smallest output error."""
    below, sd = np.ones_like(problem.value), problem.deviations(np.zeros(1))
    best, least = None, np.inf
    for _ in range(ITERATIONS):
        theta = problem.linear_step(below)
        (simulated,) = problem.simulate([theta])
        cost = float(np.sum(problem.whitened(simulated, sd) ** 2))
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
