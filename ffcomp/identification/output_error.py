"""The output-error fit: all frequency responses at once, the machine file's own parameters as unknowns.

    minimise  Σ |H − Ĥ(θ)|²/(σ² + ε²|H|²)  +  Σ ((θ − θ₀)/σ₀)²

σ² is the measured variance, ε the model's own error: zero where the noise explains the residual of a response, else the
share of its values that does. The second sum holds prior knowledge (a part put on a scale), and keeps a parameter that
the data do not determine near the starting file's. Recommended over the paper's method: it uses every measured value
once, needs no fit of coefficients, and works at any position.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from ffcomp.errors import RequestError, SolverError
from ffcomp.identification.axis_spectra import observed_response
from ffcomp.identification.predict import predicted
from ffcomp.identification.uncertainty import Estimate, Number, estimates, normal
from ffcomp.inference.fit import FitResult, FitSettings, best_of, fit
from ffcomp.inference.problem import EstimationProblem, Observation
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.numerics.serialise import keys
from ffcomp.numerics.stages import Now, Stage
from models.arrays import ComplexArray, FloatArray, IntArray
from models.kinds import delta_vibration
from models.machine import Machine, value_of, with_values

STIFFNESS = tuple(f"effector.extruder_stiffness_n_per_m[{i}]" for i in range(3))
DAMPING = tuple(f"effector.extruder_damping_n_s_per_m[{i}]" for i in range(3))
DRIVE = ("carriage.drive.d0_per_s2", "carriage.drive.d1_per_s", "carriage.drive.d2_per_s")
CARRIAGE = (
    "carriage.mass_kg",
    "carriage.belt_stiffness_n_per_m",
    "carriage.belt_damping_n_s_per_m",
    "carriage.guide_damping_n_s_per_m",
)
EFFECTOR_MASSES = ("effector.nozzle_mass_kg", "effector.extruder_mass_kg")
UNKNOWNS = (*CARRIAGE, *DRIVE, *EFFECTOR_MASSES, *STIFFNESS, *DAMPING)
TOTAL_MASS = "effector.total_mass_kg"  # m_1 + m_2, as a scale shows it
SIGNED = {"carriage.drive.d1_per_s": 100.0}  # with its unit; every other parameter is positive

PRIOR_SD = 1.0  # of the logarithm of an unknown parameter: a factor of e
UNDETERMINED = 0.25  # of the weak prior's variance: above it the data say next to nothing; the old value is kept
DELAY_UNIT_S = 1e-3
ROTATION_SD_DEG = 3.0  # of an accelerometer against the printer's axes
ROTATION_UNIT = float(np.radians(ROTATION_SD_DEG)) / PRIOR_SD
COARSE = 0.3  # model error of the coarse fit
FINE = 0.05  # model error when two near fits are compared
OTHER_MOUNTS = (0.02, 50.0)  # factors on a mount's stiffness
NEAR = 0.1  # of the values may be far off where the search for a start ends
STARTS = (1.0, 0.75, 1.33, 0.6, 1.7)  # factors on every frequency of the starting machine
RANDOM_STARTS = 30
STEP = 1e-5  # of differences: the unknowns are of order one
FAR_SD = 2.0  # coarse standard deviations: beyond it a value is far off
ROUGH = FitSettings(steps=30, gain=1e-1, share=1e-3)  # of a start, before it is compared with others
FINAL = FitSettings(steps=100, rounds=10, exact=True)


@dataclass(frozen=True, slots=True)
class ExplainedResponse:
    """How near the fitted machine comes to a response, and its noise."""

    json_keys: ClassVar = keys("points", "relative_error", "relative_noise", "model_error") | {
        name: f"response.{name}" for name in ("source", "setup", "input", "output", "position_mm")
    }

    response: FrequencyResponse
    relative_error: float
    relative_noise: float
    model_error: float  # 0: explained to its noise

    @property
    def points(self) -> int:
        """How many frequencies it has."""
        return len(self.response.frequency_hz)


@dataclass(frozen=True, eq=False)
class Fitted:
    """The result of the output-error fit."""

    machine: Machine
    estimates: Mapping[str, Estimate]  # unknowns by their names in the machine file, and the total mass
    weak: Mapping[str, Mapping[str, float]]  # ill-determined parameter -> the others it is correlated with
    delays_s: Mapping[str, Estimate]  # of each clock
    rotation_deg: Mapping[str, Estimate]  # of the accelerometer about x, y, z; empty: not of captures
    common_scale_sd: float  # relative, of all masses, stiffnesses and dampings together
    beside_scale: Mapping[str, Estimate]  # the unknowns, that common scale being given
    misfit: float  # χ² by degree of freedom against the measured noise alone
    evidence: float  # −2 ln of it: of two models of the same responses the smaller one is preferred
    model_errors: FloatArray  # (r,) ε of each response
    responses: Sequence[FrequencyResponse]
    predictions: Sequence[ComplexArray]  # of the fitted machine, delays included
    kept: tuple[str, ...]  # parameters that stay the starting file's: the data do not determine them
    advice: tuple[str, ...] = ()  # sentences on the fit, and on parameters that are weak

    @property
    def model_error(self) -> float:
        """ε of the typical response (the median): 0 if the model explains most of them to their noise."""
        return float(np.median(self.model_errors))

    @property
    def explained(self) -> list[ExplainedResponse]:
        """How well each response is explained."""
        rows = []
        for r, h, share in zip(self.responses, self.predictions, self.model_errors.tolist(), strict=True):
            size = np.sum(np.abs(r.value) ** 2)
            error = float(np.sqrt(np.sum(np.abs(r.value - h) ** 2) / size))
            rows.append(ExplainedResponse(r, error, float(np.sqrt(np.sum(r.variance) / size)), share))
        return rows


def fit_machine(
    start: Machine,
    responses: Sequence[FrequencyResponse],
    known: Mapping[str, tuple[float, float]] | None = None,
    *,
    unknowns: Sequence[str] = UNKNOWNS,
    starts: Sequence[Mapping[str, float]] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> Fitted:
    """Tune `start` to the responses.

    known : name -> (value, standard uncertainty), of machine-file parameters or of TOTAL_MASS.
    unknowns : parameters that are fitted; all others stay the starting machine's.
    starts : values to begin with in place of the starting machine's, one try each. By default the starting
        machine, four that are slower or faster throughout, and then random ones, until one comes near.

    Raises MeasurementError for a response that the model does not have; SolverError if there are fewer values than
    unknowns, or no start leads anywhere.
    """
    problem = _Problem(start, responses, dict(known or {}), unknowns)
    if problem.count <= len(problem.names):
        raise SolverError("There are fewer measured values than unknown parameters: measure more frequencies.")
    progress(Stage(2, "seeking where to begin"))
    theta = _best_start(problem, starts, progress)
    progress(Stage(4, f"fitting {len(problem.names)} numbers"))
    fitted = fit(
        problem,
        theta,
        FINAL,
        progress=lambda at: progress(f"model error {100 * float(np.max(at.errors)):.2f} % at most"),
    )
    if not np.isfinite(fitted.cost):
        raise SolverError("The output-error fit overflowed: check the measurements' units.")
    return _result(problem, fitted)


# ---- the problem ---------------------------------------------------------------------------------


class _Problem(EstimationProblem):
    """Unknowns are the machine's numbers, then a delay for each clock, then three angles where there are captures."""

    def __init__(
        self,
        start: Machine,
        responses: Sequence[FrequencyResponse],
        known: dict[str, tuple[float, float]],
        fitted: Sequence[str],
    ) -> None:
        self.start, self.responses, self.known = start, responses, known
        has_drive = delta_vibration(start).carriage.drive is not None
        self.names = tuple(name for name in fitted if has_drive or name not in DRIVE)
        if unknown := sorted(set(known) - {*self.names, TOTAL_MASS}):
            raise RequestError(
                f"--known {unknown[0]}: this fit has no such parameter, but {', '.join(self.names)}, {TOTAL_MASS}."
            )
        self.clocks = tuple(sorted({r.clock for r in responses} - {""}))
        self.captures = of_one_capture(responses)  # (g, 3) the responses of one accelerometer along x, y, z
        self.angles = tuple(f"about {axis}" for axis in "xyz") if len(self.captures) else ()
        units = SIGNED | dict.fromkeys(self.clocks, DELAY_UNIT_S) | dict.fromkeys(self.angles, ROTATION_UNIT)
        starts = {name: value_of(start, name) or 1e-12 for name in self.names}
        starts |= dict.fromkeys((*self.clocks, *self.angles), 0.0)
        self.numbers = [Number(name, at, PRIOR_SD, units.get(name, 0.0)) for name, at in starts.items()]
        self.unknowns = [number.unknown(STEP) for number in self.numbers]
        certain = [Observation(np.array([value]), np.array([sd**2])) for value, sd in known.values()]
        self.observations = [*map(observed_response, responses), *certain]
        self.count = 2 * sum(len(r.value) for r in responses)  # of measured values

    def values(self, theta: FloatArray) -> dict[str, float]:
        return {each.name: each.value(float(x)) for each, x in zip(self.numbers, theta, strict=True)}

    def machine(self, theta: FloatArray) -> Machine:
        values = self.values(theta)
        return with_values(self.start, {name: values[name] for name in self.names})

    def model(self, theta: FloatArray) -> list[ComplexArray]:
        values, responses = self.values(theta), predicted(self.machine(theta), self.responses)
        if self.angles:
            responses = rotated(responses, self.captures, np.array([values[angle] for angle in self.angles]))
        return [
            h * np.exp(-2j * np.pi * r.frequency_hz * values.get(r.clock, 0.0))
            for h, r in zip(responses, self.responses, strict=True)
        ]

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        """Predict real, then imaginary parts of each response, then the known parameters."""
        for theta in lanes:
            values = self.values(theta)
            values[TOTAL_MASS] = _total_mass(self.start, values)
            parts = [part for h in self.model(theta) for part in (h.real, h.imag)]
            yield np.concatenate([*parts, [values[name] for name in self.known]])


def _total_mass(start: Machine, values: Mapping[str, float]) -> float:
    return sum(values.get(name, value_of(start, name)) for name in EFFECTOR_MASSES)


# ---- where to begin ------------------------------------------------------------------------------


def _best_start(
    problem: _Problem, starts: Sequence[Mapping[str, float]], progress: Callable[[str], None]
) -> FloatArray:
    """Fit coarsely from several machines and return the best; the first that comes near ends the search.

    The coarse fit weights every value alike (model error 30 %), so that no sharp resonance traps it.
    """

    def fits() -> Iterator[FitResult[_Problem]]:
        for number, start in enumerate([_with(problem, values) for values in starts] or _tries(problem), 1):
            found = _roughly(problem, start, COARSE)
            share = COARSE * float(np.sqrt(np.mean(found.residual[: problem.count] ** 2)))
            progress(f"start {number}: {100 * share:.0f} % of the responses unexplained")
            yield found

    def near(found: FitResult[_Problem]) -> bool:
        return not starts and bool(np.mean(np.abs(found.residual[: problem.count]) > FAR_SD) < NEAR)

    best = best_of(fits(), near)
    return best.values if starts else _other_mounts(problem, best.values, progress)


def _other_mounts(problem: _Problem, best: FloatArray, progress: Callable[[str], None]) -> FloatArray:
    """Try far softer and harder mounts too: a mount taken for one of them is a local optimum that looks fair."""
    found = _roughly(problem, best, FINE)
    progress(Stage(3, "trying softer and harder mounts"))
    for stiffness, damping in zip(STIFFNESS, DAMPING, strict=True):
        if stiffness not in problem.names:
            continue
        progress(Now(f"another {stiffness}"))
        for factor in OTHER_MOUNTS:
            trial = found.values.copy()
            trial[problem.names.index(stiffness)] += np.log(factor)
            trial[problem.names.index(damping)] += np.log(factor) / 2
            found = best_of([found, _roughly(problem, trial, FINE)])
    return found.values


def _roughly(problem: _Problem, theta: FloatArray, error: float) -> FitResult[_Problem]:
    """Fit well enough to compare where two starts lead, with one model error for all responses."""
    return fit(problem, theta, ROUGH, errors=np.full(len(problem.observations), error))


def _tries(problem: _Problem) -> Iterator[FloatArray]:
    """Yield the starting machine, slower and faster ones, then random ones (the same in every call)."""
    for factor in STARTS:
        yield _faster(problem, factor)
    rng = np.random.default_rng(0)
    for _ in range(RANDOM_STARTS):
        theta = _faster(problem, float(np.exp(rng.uniform(-0.5, 0.5))))
        yield theta + rng.uniform(-1.0, 1.0, len(theta))


def _with(problem: _Problem, values: Mapping[str, float]) -> FloatArray:
    return np.array([each.at(values.get(each.name, each.start)) for each in problem.numbers])


def _faster(problem: _Problem, factor: float) -> FloatArray:
    """Multiply every natural frequency of the starting machine; keep the damping ratios."""
    powers = {name: 2 if "stiffness" in name or "d0" in name else 1 for name in problem.names if "mass" not in name}
    return _with(problem, {n.name: n.start * factor ** powers[n.name] for n in problem.numbers if n.name in powers})


# ---- the result ----------------------------------------------------------------------------------


def _result(problem: _Problem, fitted: FitResult[_Problem]) -> Fitted:
    theta, covariance = fitted.values, fitted.covariance
    sd, values = np.sqrt(np.diag(covariance)), problem.values(theta)
    found = estimates(problem.numbers, theta, sd**2)
    of_machine = {name: found[name] for name in problem.names}
    scale_sd, beside = _beside_common_scale(problem, values, covariance)
    total = _total_mass(problem.start, values)
    noise = np.concatenate([o.noise for o in problem.observations])
    chi = np.sum(((fitted.residual * fitted.sd) ** 2 / noise)[: problem.count])
    return Fitted(
        machine=problem.machine(theta),
        estimates=of_machine | {TOTAL_MASS: normal(total, total * scale_sd)},
        weak=_weak(problem, covariance),
        delays_s={clock: found[clock] for clock in problem.clocks},
        rotation_deg={angle[-1]: found[angle].scaled(float(np.degrees(1.0))) for angle in problem.angles},
        common_scale_sd=scale_sd,
        beside_scale=estimates(problem.numbers[: len(problem.names)], theta, beside),
        misfit=float(chi) / (problem.count - len(theta)),
        evidence=fitted.evidence,
        model_errors=fitted.errors[: len(problem.responses)],
        responses=problem.responses,
        predictions=problem.model(theta),
        kept=tuple(name for name, s in zip(problem.names, sd, strict=False) if (s / PRIOR_SD) ** 2 > UNDETERMINED),
        advice=tuple(fitted.doubt(f"{len(problem.names)} numbers")),
    )


def _beside_common_scale(
    problem: _Problem, values: Mapping[str, float], covariance: FloatArray
) -> tuple[float, FloatArray]:
    """Return the sd of all masses, stiffnesses and dampings together, and each unknown's variance (p,) given that.

    Without a force or a weight, motion determines their ratios only: so they are uncertain all together. Their scale is
    taken to be the effector's mass, which is what one can weigh.
    """
    weight = np.zeros(len(covariance))
    mass = [values[name] if name in EFFECTOR_MASSES else 0.0 for name in problem.names]
    weight[: len(mass)] = np.array(mass) / _total_mass(problem.start, values)
    along = covariance @ weight
    variance = float(weight @ along)
    if variance == 0.0:  # the effector's masses are not fitted
        return 0.0, np.diag(covariance)
    return float(np.sqrt(variance)), np.maximum(np.diag(covariance) - along**2 / variance, 0.0)


WEAK_SD = 0.1  # a parameter known worse than 10 % is weak
STRONG_CORRELATION = 0.9


def _weak(problem: _Problem, covariance: FloatArray) -> dict[str, dict[str, float]]:
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    weak = {}
    for i, name in enumerate(problem.names):
        if sd[i] > WEAK_SD:
            others = {o: float(correlation[i, k]) for k, o in enumerate(problem.names) if k != i}
            weak[name] = {o: c for o, c in others.items() if abs(c) > STRONG_CORRELATION}
    return weak


_OUTPUTS = ("acc_x", "acc_y", "acc_z")


def of_one_capture(responses: Sequence[FrequencyResponse]) -> IntArray:
    """Return which responses are the three axes of one capture, (g, 3); those of a laboratory have no clock."""
    captures: dict[tuple[object, ...], dict[str, int]] = {}
    for number, r in enumerate(responses):
        if r.clock and r.setup == "assembly" and r.output in _OUTPUTS:
            repeat = 0
            while r.output in captures.setdefault((r.clock, r.input, r.position_mm, repeat), {}):
                repeat += 1  # the same experiment, captured again
            captures[r.clock, r.input, r.position_mm, repeat][r.output] = number
    rows = [[axes[name] for name in _OUTPUTS] for axes in captures.values() if len(axes) == len(_OUTPUTS)]
    alike = [row for row in rows if len({len(responses[i].frequency_hz) for i in row}) == 1]
    return np.array(alike, dtype=np.int64).reshape(-1, 3)


def rotated(predictions: Sequence[ComplexArray], captures: IntArray, angles_rad: FloatArray) -> list[ComplexArray]:
    """Turn the predicted responses of captures (g, 3) as a sensor turned by a rotation vector (3,) measures them."""
    turned = list(predictions)
    matrix = Rotation.from_rotvec(angles_rad).as_matrix()
    for row in captures:
        three = matrix @ np.stack([predictions[i] for i in row])
        for i, each in zip(row, three, strict=True):
            turned[i] = each
    return turned
