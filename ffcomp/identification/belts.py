"""Belts of a CoreXY machine, or towers of a delta, compared by resonance tests along each of them.

A test along one belt excites one motor, but what swings is the head on all belts:

    M ẍ + C ẋ + K x = K x_cmd,   K = Σ_i k_i v_iᵀ v_i,   M = m diag(1, r),

x in the plane, v_i the row that makes the motion of motor (or carriage) i from it, r = 1 on a delta. With equal belts
the tests along mirrored directions show the same spectrum. A softer one moves the peaks apart and makes them unequally
high, and both follow from the k_i: so all tests are fitted together, each with a gain and a floor of its own. The fit
uses the power of all the sensor's axes together, which does not depend on how it is mounted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.identification.axis_spectra import COARSE
from ffcomp.identification.resonance_tests import BeltTest, direction_name
from ffcomp.identification.uncertainty import NINETY_PERCENT, Estimate, normal
from ffcomp.inference.fit import FitResult, FitSettings, best_of, fit
from ffcomp.inference.problem import EstimationProblem, Observation, Unknown
from ffcomp.measurement.modal import single_modes
from ffcomp.numerics.serialise import keys
from models.arrays import FloatArray
from models.machine import Machine

ALIKE = 0.03  # relative stiffness: less is nothing to act upon
SAME_DIRECTION = 0.95  # cosine
REPEATABLE_SD = 0.01  # of a stiffness, by what changes from test to test
START_DAMPING = 0.06
FREQUENCY_LIMITS, DAMPING_LIMITS = (5.0, 250.0), (0.005, 0.5)  # Hz
FREQUENCIES = np.geomspace(18.0, 110.0, 7)  # Hz, where a search begins
RATIOS = (1.0, 1.6, 2.5)  # of the moving masses along y and x, where a search begins
LOG_RATIO_SD = 0.7
LOG_STIFFNESS_SD = 0.3  # weak prior: belts of one machine
LOG_DAMPING_SD = 0.7
POOR = 0.6  # model error of ln S: beyond it there is no verdict
TRIED = 3  # of the starts
AS_IT_IS, SEARCHED, REFINED = FitSettings(steps=0), FitSettings(steps=15, gain=1e-2), FitSettings(rounds=10, gain=1e-4)
STEP = 1e-5


@dataclass(frozen=True, eq=False)
class ExplainedTest:
    """A test, and how well it is explained."""

    json_keys: ClassVar = keys(file="test.spectrum.source", axis="test.axis", model_error="model_error")

    test: BeltTest
    fitted: FloatArray  # (k,) in the units of the measurement
    model_error: float


@dataclass(frozen=True, eq=False)
class BeltComparison:
    """How stiff each belt is against the mean of the others, and the resonances of the head on all of them."""

    json_keys: ClassVar = keys("kind", "sentence", "relative_stiffness", "modes_hz", "damping_ratio", "tests")

    kind: str  # "belt" or "tower"
    rows: FloatArray  # (m, 2) motion of each motor or carriage by x and y
    # of each, against the mean of the others: -0.08 is 8 % softer; by a belt's direction, 1,-1, or a tower's name
    relative_stiffness: Mapping[str, Estimate]
    modes_hz: tuple[Estimate, Estimate]  # the lower one first
    damping_ratio: tuple[float, float]
    tests: Sequence[ExplainedTest]
    sentence: str

    def nearest(self, test: BeltTest) -> str:
        """Return the name of the belt that a test is along."""
        return list(self.relative_stiffness)[int(np.argmax(np.abs(self.rows @ test.direction)))]


def compare_belts(machine: Machine, tests: Sequence[BeltTest]) -> BeltComparison:
    """Fit the stiffness of each belt or tower to the tests along them.

    Raises MeasurementError if a direction is missing, or the tests show no resonance.
    """
    problem = _problem(machine, tests)
    coarse = np.full(len(problem.observations), COARSE)
    starts = sorted(
        (fit(problem, at, AS_IT_IS, errors=coarse) for at in _starts(problem)), key=lambda found: found.cost
    )
    begun = best_of(fit(problem, at.values, SEARCHED, errors=coarse) for at in starts[:TRIED])
    return _result(problem, fit(problem, begun.values, REFINED, errors=coarse))


# ---- the model -----------------------------------------------------------------------------------


class _Problem(EstimationProblem):
    """θ: ln f, ln r, ln ζ₁, ln ζ₂, ln of the stiffness of all but the last belt, then ln g and ln c of each test."""

    def __init__(self, kind: str, names: tuple[str, ...], rows: FloatArray, tests: tuple[BeltTest, ...]) -> None:
        self.kind, self.names, self.tests = kind, names, tests
        self.rows, self.free_ratio = rows, kind == "belt"  # see `BeltComparison`; of the masses along y and x
        (lowest, highest), (least, most) = np.log(FREQUENCY_LIMITS), np.log(DAMPING_LIMITS)
        damping = Unknown("ln damping", float(np.log(START_DAMPING)), LOG_DAMPING_SD, float(least), float(most), STEP)
        self.unknowns = [
            Unknown("ln f", low=float(lowest), high=float(highest), step=STEP),
            Unknown("ln ratio", sd=LOG_RATIO_SD, step=STEP),
            damping,
            damping,
            *[Unknown("ln stiffness", sd=LOG_STIFFNESS_SD, step=STEP)] * (len(rows) - 1),
            *(Unknown("gain or floor", low=a, high=b) for t in tests for a, b in t.spectrum.limits.tolist()),
        ]
        of_last = Observation(np.zeros(1), np.full(1, LOG_STIFFNESS_SD**2))  # the prior of the last belt's stiffness
        self.observations = [*(test.spectrum.observed for test in tests), of_last]

    @property
    def shared(self) -> int:
        return 3 + len(self.rows)

    def stiffness(self, theta: FloatArray) -> FloatArray:
        """(m,) relative, of product 1."""
        free = theta[4 : self.shared]
        return np.exp(np.append(free, -free.sum()))

    def modes(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Frequencies (2,) Hz and shapes (2, 2), one a column, φᵀ M φ = 1."""
        k = np.einsum("m,mi,mj->ij", self.stiffness(theta), self.rows, self.rows)
        root = np.array([1.0, np.exp(-0.5 * theta[1])]) if self.free_ratio else np.ones(2)
        square, shape = np.linalg.eigh(k / k.trace() * 2 * np.outer(root, root))
        return np.exp(theta[0]) * np.sqrt(np.maximum(square, 1e-9)), shape * root[:, None]

    def power(self, number: int, theta: FloatArray) -> FloatArray:
        """Return f² |H d|² of a test through the window, (k,)."""
        frequency, shape = self.modes(theta)
        mass = np.array([1.0, np.exp(theta[1])]) if self.free_ratio else np.ones(2)
        moved: FloatArray = shape * (shape.T @ (mass * self.tests[number].direction))  # (2, modes)
        lines = self.tests[number].spectrum.lines
        along = np.tensordot(moved, single_modes(frequency, np.exp(theta[2:4]), lines.fine_hz), axes=1)  # (2, k, w)
        return np.asarray(lines.power(along[0]) + lines.power(along[1]))

    def model(self, number: int, theta: FloatArray) -> FloatArray:
        nuisance = theta[self.shared + 2 * number : self.shared + 2 * number + 2]
        return self.tests[number].spectrum.shown(self.power(number, theta), nuisance)

    def simulate(self, lanes: Sequence[FloatArray]) -> Iterator[FloatArray]:
        for theta in lanes:
            each = [np.log(self.model(n, theta)) for n in range(len(self.tests))]
            yield np.concatenate([*each, np.log(self.stiffness(theta)[-1:])])


def _problem(machine: Machine, tests: Sequence[BeltTest]) -> _Problem:
    deltas = machine.vibration.position_dependent
    kind = "tower" if deltas else "belt"
    places = [test.position_mm[:2] for test in tests if test.position_mm is not None]
    place = np.mean(places, axis=0) if places and deltas else np.zeros(2)
    if deltas:
        rows = np.linalg.inv(machine.kinematics.jacobian(place[None])[0])[:, :2]
    else:
        rows = machine.kinematics.motors[:2, :2]
        if np.count_nonzero(np.abs(rows[0]) > 1e-9) == 1:
            rule = "On this machine a motor moves x or y alone: test AXIS=X and AXIS=Y"
            raise MeasurementError(tests[0].spectrum.source, [f"It was excited along a diagonal. {rule}."])
    towards = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    names = tuple("ABC" if deltas else map(direction_name, towards))
    for name, row in zip(names, towards, strict=True):
        if not any(abs(float(row @ test.direction)) > SAME_DIRECTION for test in tests):
            listed = ", ".join(f"{t.spectrum.source} ({t.axis})" for t in tests)
            axes = " and ".join(f"AXIS={direction_name(other)}" for other in towards)
            rule = f"There is no test along {kind} {name}, so there is nothing to compare"
            raise MeasurementError(listed, [f"{rule}. Run TEST_RESONANCES OUTPUT=raw_data with {axes}."])
    return _Problem(kind, names, rows, tuple(tests))


def _starts(problem: _Problem) -> list[FloatArray]:
    starts = []
    for ratio in RATIOS if problem.free_ratio else RATIOS[:1]:
        for frequency in FREQUENCIES:
            theta = np.zeros(problem.shared + 2 * len(problem.tests))
            theta[:4] = np.log([frequency, ratio, START_DAMPING, START_DAMPING])
            own = [test.spectrum.begin_at(problem.power(n, theta)) for n, test in enumerate(problem.tests)]
            theta[problem.shared :] = np.concatenate(own)
            starts.append(theta)
    return starts


# ---- the result ----------------------------------------------------------------------------------


def _result(problem: _Problem, found: FitResult[_Problem]) -> BeltComparison:
    theta, covariance, errors = found.values, found.covariance, found.errors.tolist()
    frequency, _ = problem.modes(theta)
    damping = np.exp(theta[2:4])
    _check_resonance(problem, float(frequency.mean()), float(damping.mean()), max(errors))
    stiffness = {name: _relative(problem, theta, covariance, i) for i, name in enumerate(problem.names)}
    sd = [float(np.sqrt(covariance[0, 0])) * f for f in frequency]
    return BeltComparison(
        kind=problem.kind,
        rows=problem.rows,
        relative_stiffness=stiffness,
        modes_hz=(normal(float(frequency[0]), sd[0]), normal(float(frequency[1]), sd[1])),
        damping_ratio=(float(damping[0]), float(damping[1])),
        tests=[ExplainedTest(test, problem.model(n, theta), errors[n]) for n, test in enumerate(problem.tests)],
        sentence=_sentence(problem, stiffness),
    )


def _check_resonance(problem: _Problem, frequency: float, damping: float, error: float) -> None:
    sources = ", ".join(test.spectrum.source for test in problem.tests)
    for test in problem.tests:
        low, high = test.spectrum.frequency_hz[[0, -1]]
        remedy = test.spectrum.beyond(frequency, damping)
        if remedy or not low < frequency < high:
            rule = f"The {problem.kind}s cannot be compared: no resonance lies between {low:.0f} and {high:.0f} Hz."
            raise MeasurementError(sources, [f"{rule} {remedy or 'Test them again with a harder excitation.'}"])
    if error > POOR:
        rule = f"The {problem.kind}s cannot be compared: two modes describe the tests to {100 * error:.0f} % only"
        raise MeasurementError(sources, [f"{rule}. Fasten what rattles, and the sensor, and test them again."])


def _relative(problem: _Problem, theta: FloatArray, covariance: FloatArray, number: int) -> Estimate:
    """Compare one stiffness with the mean of the others: its logarithm is linear in the unknown ones."""
    free, others = slice(4, problem.shared), len(problem.rows) - 1
    each = np.vstack([np.eye(others), -np.ones(others)])  # ln stiffness by the unknowns
    slope = each[number] - np.delete(each, number, axis=0).mean(axis=0)
    sd = float(np.sqrt(slope @ covariance[free, free] @ slope + REPEATABLE_SD**2))
    return normal(float(np.expm1(slope @ theta[free])), sd)


def _sentence(problem: _Problem, stiffness: Mapping[str, Estimate]) -> str:
    pair = problem.kind == "belt"
    name, e = max(stiffness.items(), key=lambda each: -each[1].value if pair else abs(each[1].value))
    half = NINETY_PERCENT * e.sd
    if abs(e.value) < max(ALIKE, half):
        what = "The two belts are" if pair else "The three towers' belts are"
        return f"{what} alike within ± {100 * max(ALIKE, abs(e.value) + half):.0f} %."
    who, others = (f"The belt of axis={name}", "one") if pair else (f"Tower {name}'s belt", "two")
    low, high = sorted(100 * abs(bound) for bound in (e.low, e.high))
    return (
        f"{who} is {100 * abs(e.value):.0f} % {'softer' if e.value < 0 else 'stiffer'} than the other {others} (90 %: "
        f"{low:.0f} to {high:.0f} %). Check its tension, its pulleys' screws and its clamps, and test again."
    )
