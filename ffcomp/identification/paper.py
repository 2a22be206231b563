"""The paper's identification, step by step (Eqs. 30-49 and 63-69, corrected), with standard uncertainties.

    carriage alone, carriage with a known mass     → m, k, c, b and the drive's d₀ d₁ d₂     (Eqs. 30-43)
    effector struck by a hammer, and its weight    → m₁, m₂                                  (Eqs. 45-49)
    the whole printer at the centre, x, y, z       → b_j, k_j                                (Eqs. 63-69)

Each step fits rational functions to the responses and solves the equations between their coefficients and the
parameters by least squares, each coefficient weighed by its covariance: the paper's redundant equations (36 and 40,
35 and 39) then share their error instead of contradicting each other, and the χ² of each step says whether they do.

Corrected: Eq. 68's s² term is (c+b) b_j, without α; α is the ratio of load to carriage motion, σ_j² of J at the
centre (1/3 along z), not Eq. 69, which forgets that X is not q; M₁ holds the arms' lower halves; y-motion at the
centre does not move a carriage on the x axis, which leaves eight of the nine responses.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from scipy.optimize import least_squares

from ffcomp.errors import MeasurementError, SolverError
from ffcomp.identification.output_error import DAMPING, DRIVE, STIFFNESS, fit_machine
from ffcomp.identification.uncertainty import Estimate, normal
from ffcomp.inference.fit import FitSettings, fit
from ffcomp.inference.problem import EstimationProblem, Observation, Unknown
from ffcomp.measurement.frf import AXES, CARRIAGES, FrequencyResponse
from ffcomp.numerics.serialise import keys
from models.arrays import ComplexArray, FloatArray, constant
from models.kinds import delta_vibration, with_parts
from models.machine import Machine
from models.vibration.substructures import Carriage, Drive

EARLIER = {
    "m": "carriage.mass_kg",
    "k": "carriage.belt_stiffness_n_per_m",
    "c": "carriage.belt_damping_n_s_per_m",
    "b": "carriage.guide_damping_n_s_per_m",
    **dict(zip(("d0", "d1", "d2"), DRIVE, strict=True)),
    "m1": "effector.nozzle_mass_kg",
    "m2": "effector.extruder_mass_kg",
}
CENTRE_MM = 1.0  # from the centre, within which its symmetry is assumed
SILENT = 0.05  # of the largest response of an axis: below it a carriage does not take part

SURE_FREEDOM = 5  # degrees of freedom: with as many, a large χ² widens the intervals
WEIGHED_SD = 1e-6  # relative, of a weight given without an uncertainty
ITERATIONS = 30  # of the linear step: it either converges in ten or never
OUTPUT_ERROR = FitSettings(steps=200, gain=1e-6)


@dataclass(frozen=True, eq=False)
class Joint:
    """Several values and their covariance, by name."""

    names: tuple[str, ...]
    values: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Each value by itself."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return {name: normal(float(v), float(s)) for name, v, s in zip(self.names, self.values, sd, strict=True)}


@dataclass(frozen=True, eq=False)
class Step:
    """The result of one step."""

    json_keys: ClassVar = keys(step="title", chi_squared_per_degree_of_freedom="consistency", numbers="joint.estimates")

    title: str
    joint: Joint
    consistency: float  # χ² by degree of freedom of its redundant equations: 1 if they agree


# ---- sub-model 1 ---------------------------------------------------------------------------------


def carriage_step(alone: FrequencyResponse, loaded: FrequencyResponse) -> Step:
    """Identify m, k, c, b, d₀, d₁, d₂ from the carriage without and with `loaded.added_mass_kg` (Eqs. 30-43).

    Raises
    ------
    SolverError
        If the two responses do not show the effect of the added mass.
    """
    fits = [fit_rational(response, 2, 4) for response in (alone, loaded)]
    added = loaded.added_mass_kg

    def equations(numbers: FloatArray) -> FloatArray:
        return np.concatenate([_coefficients(numbers, 0.0), _coefficients(numbers, added)])

    names = ("m", "k", "c", "b", "d0", "d1", "d2")
    return Step("carriage", *_solved(names, _carriage_start(fits[0], fits[1], added), equations, fits))


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


def hammer_step(struck: FrequencyResponse, total_mass_kg: float, total_sd_kg: float = 0.0) -> Step:
    """Identify m₁, m₂ and the struck axis' b, k from the free effector's accelerance and its weight (Eqs. 45-49).

    Only the ratio of zero to pole and the weight give the masses, so the hammer needs no calibration; its gain is
    fitted too.
    """
    rational = fit_rational(struck, 2, 2)
    zero, pole = abs(rational.zeros[-1]), abs(rational.poles[-1])
    m1 = total_mass_kg * min((zero / pole) ** 2, 0.999)  # Eq. 49
    m2 = total_mass_kg - m1
    damping = max(-2 * rational.zeros[-1].real, 1e-3 * zero)
    start = np.array([m1, m2, damping * m2, zero**2 * m2, rational.numerator[2] * m1])

    def equations(numbers: FloatArray) -> FloatArray:
        m1, m2, b, k, gain = numbers
        return np.array([gain * k, gain * b, gain * m2, (m1 + m2) * k, (m1 + m2) * b]) / (m1 * m2)

    def weighed(numbers: FloatArray) -> FloatArray:
        sd = max(total_sd_kg, WEIGHED_SD * total_mass_kg)
        return np.array([(numbers[0] + numbers[1] - total_mass_kg) / sd])

    axis = struck.input.split("_")[-1]
    names = ("m1", "m2", f"b_{axis}", f"k_{axis}", "gain")
    return Step(f"hammer {axis}", *_solved(names, start, equations, [rational], weighed))


# ---- the whole printer at the centre -------------------------------------------------------------


def assembly_step(machine: Machine, responses: Sequence[FrequencyResponse], earlier: Sequence[Joint]) -> Step:
    """Identify b_j and k_j of one axis j from the carriages' responses to its command (Eqs. 66-68).

    At the centre the axes are apart, and each carriage answers the command of axis j with

        q_i = (J⁻¹)_ij (c s + k)(m₂s² + b_j s + k_j)/D_j(s) G_e,   D_j of Eq. 68 with α = σ_j²

    NOTE: the paper fits free coefficients (Eq. 66) and then solves Eq. 68 for b_j and k_j. At 40 dB that is
    ill-conditioned: the extruder is well damped along x and y (ζ = 0.5 and 0.7) and beyond the band along z, so a
    pole cancels a zero along x in two of three noise draws, and the coefficients scatter by 8 % along y and 40 %
    along z. Here the coefficients are kept to Eq. 68 while fitting, by output error, and the parameters of the steps
    before are held by their uncertainties: k_x, k_y to 0.3 %.

    Parameters
    ----------
    machine : with the parameters of the earlier steps.
    responses : `cmd_j` to `pos_A`, `pos_B`, `pos_C`, at the centre.
    earlier : results of the earlier steps, whose names are in EARLIER.
    """
    axis = responses[0].input.split("_")[-1]
    _require_centre(responses)
    loudest = max(map(_amplitude, responses))
    taking_part = [r for r in responses if _amplitude(r) > SILENT * loudest]
    i = AXES.index(axis)
    mount = (STIFFNESS[i], DAMPING[i])
    known = {EARLIER[n]: (e.value, e.sd) for part in earlier for n, e in part.estimates.items() if n in EARLIER}
    known["carriage.mass_kg"] = (delta_vibration(machine).carriage.mass_kg, known["carriage.mass_kg"][1])
    m2 = delta_vibration(machine).effector.extruder_mass_kg
    fitted = fit_machine(machine, taking_part, known, unknowns=(*known, *mount), starts=_mounts(m2, mount))
    mounts = [fitted.estimates[name] for name in mount]
    joint = Joint((f"k_{axis}", f"b_{axis}"), np.array([e.value for e in mounts]), np.diag([e.sd**2 for e in mounts]))
    return Step(f"assembly {axis}", joint, fitted.misfit)


def _mounts(m2: float, names: Sequence[str]) -> list[dict[str, float]]:
    """List soft and hard, damped and less damped mounts, to begin at when nothing is known."""
    omegas = 2 * np.pi * np.geomspace(12.0, 300.0, 6)
    pairs = [(m2 * w**2, 2 * zeta * w * m2) for w in omegas for zeta in (0.1, 0.5)]
    return [dict(zip(names, pair, strict=True)) for pair in pairs]


def _require_centre(responses: Sequence[FrequencyResponse]) -> None:
    for response in responses:
        place = response.position_mm
        if place is not None and np.hypot(*place[:2]) > CENTRE_MM:
            rule = f"The paper's method needs the printer measured at the centre, not at {place[:2]} mm."
            raise MeasurementError(response.source or "response", [f"{rule} Use the output-error fit."])


def _amplitude(response: FrequencyResponse) -> float:
    return float(np.sqrt(np.mean(np.abs(response.value) ** 2)))


# ---- coefficients to parameters ------------------------------------------------------------------


def _solved(
    names: Sequence[str],
    start: FloatArray,
    equations: Callable[[FloatArray], FloatArray],
    fits: Sequence[RationalFit],
    extra: Callable[[FloatArray], FloatArray] = lambda _: np.empty(0),
) -> tuple[Joint, float]:
    """Solve coefficients = equations(parameters) by weighted least squares, with further whitened residuals `extra`."""
    coefficients = np.concatenate([each.coefficients for each in fits])
    whiten = [np.linalg.cholesky(_positive(_inverse(each.covariance))).T for each in fits]
    ends = np.cumsum([0, *(len(w) for w in whiten)])
    unit = np.where(start == 0, 1.0, np.abs(start))

    def residual(scaled: FloatArray) -> FloatArray:
        numbers = scaled * unit
        error = equations(numbers) - coefficients
        return np.concatenate(
            [*(w @ error[a:e] for w, a, e in zip(whiten, ends, ends[1:], strict=False)), extra(numbers)]
        )

    best = least_squares(residual, start / unit, method="lm", x_scale="jac", max_nfev=2000)
    covariance = _inverse(best.jac.T @ best.jac) * np.outer(unit, unit)
    freedom = len(best.fun) - len(start)
    consistency = 2 * float(best.cost) / freedom
    wider = max(1.0, consistency) if freedom >= SURE_FREEDOM else 1.0
    return Joint(tuple(names), best.x * unit, covariance * wider), consistency


def _inverse(information: FloatArray) -> FloatArray:
    """Invert a positive matrix whose rows have very different sizes."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    return np.linalg.pinv(information / np.outer(size, size), hermitian=True, rcond=1e-15) / np.outer(size, size)


def _positive(matrix: FloatArray) -> FloatArray:
    """Make a matrix symmetric, with a diagonal that rounding cannot turn negative."""
    return np.asarray((matrix + matrix.T) / 2 + 1e-12 * np.diag(np.diag(matrix)))


# ---- coefficients from a response ------------------------------------------------------------------


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
        floor = 1e-12 * np.mean(np.abs(response.value) ** 2)  # noise-free data: finite weights all the same
        self.observations = [Observation(_real(response.value), np.tile((response.variance + floor) / 2, 2))]

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


# ---- all steps -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PaperIdentification:
    """The machine of all steps, and each step."""

    machine: Machine
    steps: Sequence[Step]

    def __getitem__(self, title: str) -> Step:
        return next(step for step in self.steps if step.title == title)


def identify_as_paper(
    start: Machine, responses: Sequence[FrequencyResponse], total_mass_kg: float, total_sd_kg: float = 0.0
) -> PaperIdentification:
    """Run every step of the paper, from responses of all four setups.

    Parameters
    ----------
    start : gives the kinematics, the arms' mass and the limits; its vibration parameters are replaced, never used.

    Raises
    ------
    MeasurementError
        If one of the four measurements is missing.
    """
    carriage = carriage_step(_only(responses, "carriage"), _only(responses, "carriage+mass"))
    struck = [r for r in responses if r.setup == "effector"]
    hammers = [hammer_step(r, total_mass_kg, total_sd_kg) for r in struck]
    if not hammers:
        raise MeasurementError("the measurements", ["No response of the effector alone (setup 'effector') is there."])
    clearest = min(hammers, key=lambda step: step.joint.covariance[1, 1])
    earlier = (carriage.joint, clearest.joint)
    so_far = _machine(start, *earlier, hammers)
    groups = ([r for r in responses if r.input == f"cmd_{axis}" and r.output in _CARRIAGES] for axis in AXES)
    assembly = [assembly_step(so_far, group, earlier) for group in groups if group]
    steps = (carriage, *hammers, *assembly)
    return PaperIdentification(_machine(start, *earlier, (*hammers, *assembly)), steps)


_CARRIAGES = tuple(f"pos_{name}" for name in CARRIAGES)


def _only(responses: Sequence[FrequencyResponse], setup: str) -> FrequencyResponse:
    for response in responses:
        if response.setup == setup:
            return response
    raise MeasurementError(
        "the measurements", [f"No response with the setup {setup!r} is there; the paper's steps need it."]
    )


def _machine(start: Machine, carriage: Joint, hammer: Joint, mounts: Sequence[Step]) -> Machine:
    """Assemble the machine; the mount of each axis is from the step that determines it best."""
    arms = delta_vibration(start).carriage.arm_pair_mass_kg
    stiffness = np.array(delta_vibration(start).effector.extruder_stiffness_n_per_m)
    damping = np.array(delta_vibration(start).effector.extruder_damping_n_s_per_m)
    for i, axis in enumerate(AXES):
        joints = [step.joint for step in mounts if f"k_{axis}" in step.joint.names]
        if joints:
            stiffness[i] = min(joints, key=lambda j: _spread(j, f"k_{axis}"))[f"k_{axis}"]
            damping[i] = min(joints, key=lambda j: _spread(j, f"b_{axis}"))[f"b_{axis}"]
    drive = Drive(carriage["d0"], carriage["d1"], carriage["d2"])
    parts = Carriage(carriage["m"] - arms / 2, arms, carriage["k"], carriage["c"], carriage["b"], drive)
    effector = replace(
        delta_vibration(start).effector,
        nozzle_mass_kg=hammer["m1"],
        extruder_mass_kg=hammer["m2"],
        extruder_stiffness_n_per_m=constant(stiffness),
        extruder_damping_n_s_per_m=constant(damping),
    )
    return with_parts(start, carriage=parts, effector=effector)


def _spread(joint: Joint, name: str) -> float:
    i = joint.names.index(name)
    return float(joint.covariance[i, i])
