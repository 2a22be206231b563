"""Find the acceleration that the bound allows, the same one for all sections, then make slower where a limit binds.

The error goes with acceleration, and with the speed of corners; both go together. A low-fidelity forecast finds where
the error would be the bound; the inverse is solved there and the response predicted (`predicted_error.py`) for a third
of the sections, then for all, by the secant method, until at the wanted quantile over printers the error is below the
bound for 99 % of the time and hardly more. Parts beyond a limit of the carriages, or a spot's bound, then become
slower by itself.

One acceleration for all gave shorter prints than one for each move by its own peak of the error: an error above
the bound for a hundredth of the time may be far above it, and a peak has many moves that might be at fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter

import numpy as np

from ffcomp.faster.bound import RaisedLimits, selected_limits
from ffcomp.faster.predicted_error import (
    EXCEEDANCE,
    Ensemble,
    ensemble_percentile,
    error_at_quantile,
    forecast_error,
    histogram,
)
from ffcomp.firmware.program import plan_section
from ffcomp.inverse.command_limits import ACCELERATION, TRAVEL, VELOCITY, utilisation_from_rest
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import WHOLE
from ffcomp.inverse.solve import solve
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.trajectory import Section, Trajectory
from gcode.program import Moves
from models.arrays import FloatArray, IntArray

INFLUENCE_S = (0.03, 0.012)  # moves are held responsible for what comes so much after them, or before them


@dataclass(frozen=True, slots=True)
class Demand:
    """Return each move's demand as a fraction of its limit, (n,)."""

    acceleration: FloatArray  # the error, acceleration and travel
    speed: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SectionPrediction:
    """A section's plan, and the response of its command."""

    plan: Trajectory
    t0: float  # s on the plan's clock: the first moment
    step_s: float
    error: FloatArray  # (m,) times the bound, at the quantile at each moment by itself
    # the rest is of a solved command
    counts: IntArray = field(default_factory=lambda: np.empty((0, 0), dtype=np.int64))  # by printer and its error
    limits_t0: float = 0.0  # s: the beginning of the first segment
    segment_s: float = 1.0
    by_acceleration: FloatArray = field(default_factory=lambda: np.empty(0))  # (k,) of the carriages' limits
    by_speed: FloatArray = field(default_factory=lambda: np.empty(0))  # (k,)

    @property
    def errors(self) -> FloatArray:
        """The largest error that each move is responsible for, times the bound, (n,)."""
        return self._largest(self.error, self.step_s, self.t0)

    @property
    def acceleration_limits(self) -> FloatArray:
        """What each move demands of the carriages' acceleration and travel, (n,)."""
        return self._largest(self.by_acceleration, self.segment_s, self.limits_t0)

    def demand(self, level: float) -> Demand:
        """Return what moves demand if the error may be so many times the bound."""
        error, nothing = self.errors / level, np.zeros(len(self.plan))
        if not len(self.by_speed):
            return Demand(error, nothing)
        by_speed = self._largest(self.by_speed, self.segment_s, self.limits_t0)
        return Demand(np.maximum(error, self.acceleration_limits), by_speed)

    def _largest(self, samples: FloatArray, step_s: float, t0: float) -> FloatArray:
        """Return the largest of the samples (m,), a step apart, that each move is responsible for, (n,)."""
        plan, (after_s, before_s) = self.plan, INFLUENCE_S
        begin, end = plan.start_t - before_s - t0, plan.start_t + plan.duration + after_s - t0
        first = np.clip(np.floor(begin / step_s).astype(np.int64), 0, len(samples) - 1)
        last = np.clip(np.ceil(end / step_s).astype(np.int64), first + 1, len(samples))
        padded = np.append(samples, -np.inf)
        return np.asarray(np.maximum.reduceat(padded, np.column_stack([first, last]).ravel())[::2])


SAMPLE_STRIDE = 3  # one section of so many is predicted first, to see how wrong forecasts are,
LEAST_SAMPLED = 16  # if there are so many
MAX_PREDICTIONS = 3  # times all of it, at most, if
ACCEPTED_P99 = 0.94  # of the bound is not reached
FORECAST_STEPS = 6  # of the search for an acceleration, with forecasts
FORECAST_RTOL = 0.01  # between the forecast and the bound: no more steps
INITIAL_ACCELERATION = 8000.0  # mm/s²
ACCELERATION_RANGE = (50.0, 1e6)  # mm/s²
FORECAST_POWER, PREDICTION_POWER = 0.8, 1.2  # of the acceleration, that the forecast and the error go with: usual,
POWER_RANGE = (0.5, 2.5)  # and at least and at most
LEAST_LOG_STEP = 0.02  # in the acceleration's logarithm: closer points do not determine the power
FORECAST_GAIN = 0.62  # of the forecast is there
CORNER_TIME_S = 1.6e-3  # square corner velocity for an acceleration: so much rings as little of the one as of the other
PEAK_LEVEL = 2.5  # times the bound, that single spots may have
TARGET = 0.98  # of the bound and of the limits
SLOWED_TO = 0.92  # of a limit, that a move comes down to which is beyond it
LEAST_FACTOR = 0.55  # of one round
DEMAND_TOLERANCE = 1.04  # demand that passes: the solution's time scaling slows down what is a little beyond a limit
SLOWING_ROUNDS = 8  # rounds that slow a single section where it is beyond a limit or a spot's bound
REVERSION_ROUNDS = 4  # to give some moves the slicer's motion


class SectionSearch:
    """The search for one section's quickest motion, from rest to rest."""

    def __init__(
        self, model: InverseModel, ensemble: Ensemble, limits: PlannerLimits, slicers: Moves, ceiling: RaisedLimits
    ) -> None:
        self.model, self.ensemble, self.limits = model, ensemble, limits
        self.slicers, self.ceiling, self.free = slicers, ceiling, ~ceiling.kept
        self.top = ceiling.moves.acceleration  # of each move, if known
        self.reverted = np.zeros(len(slicers), dtype=np.bool_)
        self.state = model.machine.equilibrium(slicers.start[0, :3])
        self.predicted: SectionPrediction | None = None  # the last one; of the same moves once all is done
        self.accelerate(INITIAL_ACCELERATION, float(ceiling.bound_mm.max()))

    def accelerate(self, acceleration: float, bound_mm: float) -> None:
        """Give the moves an acceleration, as far as they may have it, and forecast the error.

        acceleration : mm/s², of what has this bound; more or less for another one
        """
        top, free, scaled = self.ceiling.moves, self.free, acceleration * self.ceiling.bound_mm / bound_mm
        corner = np.minimum(CORNER_TIME_S * scaled, top.square_corner_velocity)
        self.moves = replace(
            top,
            acceleration=np.where(free, np.minimum(scaled, self.top), top.acceleration),
            square_corner_velocity=np.where(free, corner, top.square_corner_velocity),
        )
        self.forecasted = self.forecast(self.moves)

    def forecast(self, moves: Moves) -> SectionPrediction:
        """Plan, and forecast the error."""
        plan = plan_section(self.limits, moves, 0.0)
        t, nominal, changes = forecast_error(self.model.sensitivity, plan, 0.0, plan.end_t)
        at = plan.move_at(t)
        error = error_at_quantile(nominal, changes, 1.0 / self.ceiling.bound_mm[at], self.ensemble.quantile_sd)
        return SectionPrediction(plan, t[0], self.model.sensitivity.row_s, error)

    def predict(self, moves: Moves) -> SectionPrediction:
        """Plan, solve and predict.

        NOTE: segments that the firmware cannot execute in their time are left to the time scaling of the solution.
        """
        model, s = self.model, self.model.settings
        plan = plan_section(self.limits, moves, 0.0)
        written = WHOLE.written(plan, Section(0, len(moves), True, 0.0, plan.end_t), s)
        solution = solve(model, written.reference, self.state, keep_response=True, enforce_limits=False)
        path = np.append(plan.start_t, plan.end_t), np.vstack([moves.start[:, :3], moves.end[-1:, :3]])
        t = self.ensemble.times(written, solution)
        errors = *self.ensemble.errors(written, solution, path), 1.0 / self.ceiling.bound_mm[plan.move_at(t)]
        utilisation = utilisation_from_rest(solution.vertices, model.limits)[1:-1]
        at_quantile, counts = error_at_quantile(*errors, self.ensemble.quantile_sd), histogram(*errors)
        return SectionPrediction(
            plan,
            t[0],
            t[1] - t[0],
            at_quantile,
            counts=counts,
            limits_t0=written.reference.t0,
            segment_s=s.segment_s,
            by_acceleration=utilisation[:, [ACCELERATION, TRAVEL]].max(axis=(1, 2)),
            by_speed=utilisation[:, VELOCITY].max(axis=1),
        )

    def verify(self) -> None:
        """Predict, and learn what the carriages allow."""
        self.predicted = self.predict(self.moves)
        demand = self.predicted.acceleration_limits
        allowed = self.moves.acceleration * (TARGET / demand)
        self.top = np.where(demand > TARGET, np.minimum(self.top, allowed), self.top)

    def settle(self, level: float) -> None:
        """Slow down what is beyond the level or a limit; give the slicer's motion back where a spot stays above it.

        The solution's own time scaling slows any remaining violation.
        """
        for _ in range(SLOWING_ROUNDS):
            demand = self._verified.demand(level)
            if not (self.free & (np.maximum(demand.acceleration, demand.speed) > DEMAND_TOLERANCE)).any():
                return
            self.moves = self._slower(demand)
            self.predicted = self.predict(self.moves)
        moves = self.moves
        for _ in range(REVERSION_ROUNDS):
            spots = self.free & ~self.reverted & (self._verified.errors > DEMAND_TOLERANCE * level)
            if not spots.any():
                return
            self.reverted |= spots
            self.moves = selected_limits(self.slicers, moves, self.reverted)
            self.predicted = self.predict(self.moves)

    @property
    def _verified(self) -> SectionPrediction:
        if self.predicted is None:
            self.predicted = self.predict(self.moves)
        return self.predicted

    def _slower(self, demand: Demand) -> Moves:
        moves = self.moves
        by_acceleration = np.where(self.free, _slowing_factor(demand.acceleration, LEAST_FACTOR), 1.0)
        by_speed = np.where(self.free, _slowing_factor(demand.speed, 0.8), 1.0)
        return replace(
            moves,
            acceleration=moves.acceleration * by_acceleration,
            square_corner_velocity=moves.square_corner_velocity * by_acceleration,
            speed=moves.speed * by_speed,
        )


def search(sections: Sequence[SectionSearch], still_s: float) -> float:
    """Make the moves of all sections as quick as the bound allows; return the error's 99th percentile, times the bound.

    still_s : of the print, besides
    """
    if not sections:
        return 0.0
    rounds = _CommonAcceleration(sections, still_s)
    rounds.accelerate()
    if len(sections) >= LEAST_SAMPLED:
        sample = sections[SAMPLE_STRIDE // 2 :: SAMPLE_STRIDE]
        rounds.verify(sample, still_s * _duration_s(sample) / _duration_s(sections))
        rounds.step_to_target()
        rounds.percentiles.clear()  # of some sections, not of all
    tried = []  # the quickest motion that keeps the bound is the best; if none does, the one that is nearest to it
    for number in range(MAX_PREDICTIONS):
        if number:
            rounds.step_to_target()
        p99 = rounds.verify(sections, still_s)
        tried.append(((max(p99, 1.0), _duration_s(sections)), [(each.moves, each.predicted) for each in sections]))
        if ACCEPTED_P99 <= p99 <= 1.0 or (p99 < 1.0 and rounds.at_ceiling):
            break
    _, best = min(tried, key=itemgetter(0))
    for each, (moves, predicted) in zip(sections, best, strict=True):
        each.moves, each.predicted = moves, predicted
        each.settle(PEAK_LEVEL)
    return _percentile(sections, still_s)


class _CommonAcceleration:
    """All sections, and the acceleration that is the same for all of them."""

    def __init__(self, sections: Sequence[SectionSearch], still_s: float) -> None:
        self.sections, self.still_s = sections, still_s
        self.acceleration = INITIAL_ACCELERATION
        self.percentiles: list[tuple[float, float]] = []  # accelerations, and their percentiles
        self.bound_mm = max(float(each.ceiling.bound_mm.max()) for each in sections)

    def accelerate(self) -> None:
        known: list[tuple[float, float]] = []
        for step in range(FORECAST_STEPS):
            for each in self.sections:
                each.accelerate(self.acceleration, self.bound_mm)
            p99 = max(FORECAST_GAIN * _forecast_percentile(self.sections, self.still_s), 1e-3)
            known.append((self.acceleration, p99))
            met = abs(p99 / TARGET - 1.0) < FORECAST_RTOL or (p99 < TARGET and self.at_ceiling)
            if met or step == FORECAST_STEPS - 1:
                return
            self.acceleration = secant(known, FORECAST_POWER)

    def step_to_target(self) -> None:
        self.acceleration = secant(self.percentiles, PREDICTION_POWER)
        for each in self.sections:
            each.accelerate(self.acceleration, self.bound_mm)

    @property
    def at_ceiling(self) -> bool:
        share = min(float(each.ceiling.bound_mm.min()) for each in self.sections) / self.bound_mm
        return self.acceleration * share >= max(float(each.top[each.free].max()) for each in self.sections)

    def verify(self, sample: Sequence[SectionSearch], still_s: float) -> float:
        """Predict the error of some sections; return its percentile."""
        for each in sample:
            each.verify()
        p99 = _percentile(sample, still_s)
        self.percentiles.append((self.acceleration, p99))
        return p99


def secant(
    known: Sequence[tuple[float, float]], usual: float, target: float = TARGET, powers: Sequence[float] = POWER_RANGE
) -> float:
    """Return the acceleration where the error's percentile meets the target, by the secant method in logarithms.

    known : accelerations, mm/s², and percentiles; the last two give the exponent, or `usual` where they cannot
    powers : the lowest and the highest exponent
    """
    now, p99 = known[-1]
    power = usual
    if len(known) > 1 and abs(np.log(now / known[-2][0])) > LEAST_LOG_STEP:
        power = float(np.clip(np.log(p99 / known[-2][1]) / np.log(now / known[-2][0]), powers[0], powers[1]))
    return float(np.clip(now * (target / max(p99, 1e-9)) ** (1.0 / power), *ACCELERATION_RANGE))


def _duration_s(sections: Sequence[SectionSearch]) -> float:
    return sum(each.forecasted.plan.end_t for each in sections)


def _percentile(sections: Sequence[SectionSearch], still_s: float) -> float:
    """Return the error that a printer at the quantile has for as long as it may, times the bound."""
    trials = [each.predicted for each in sections if each.predicted is not None]
    counts = [each.counts for each in trials]
    return ensemble_percentile(counts, still_s / trials[0].step_s, sections[0].ensemble.safety)


def _forecast_percentile(sections: Sequence[SectionSearch], still_s: float) -> float:
    """Return the forecast that is exceeded as long as it may be, times the bound: in proportion to `_percentile`."""
    error = np.concatenate([each.forecasted.error for each in sections])
    samples = len(error) + still_s / sections[0].forecasted.step_s
    beyond = min(int(EXCEEDANCE * samples), len(error) - 1)
    return float(np.partition(error, len(error) - 1 - beyond)[len(error) - 1 - beyond])


def _slowing_factor(demand: FloatArray, least: float) -> FloatArray:
    """Return by how much moves become slower, (n,)."""
    return np.where(demand > 1.0, np.clip(SLOWED_TO / np.maximum(demand, 1e-3), least, 1.0), 1.0)
