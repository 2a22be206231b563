"""Find the acceleration that the bound allows, the same one for all sections.

The error goes with acceleration, and with the speed of corners; both go together. A low-fidelity forecast finds where
the error would be the bound; the inverse is solved there and the response predicted (`predicted_error.py`), by the
secant method, until at the wanted quantile over printers the error is below the bound for 99 % of the time and hardly
more.

One acceleration for all gave shorter prints than one for each move by its own peak of the error: an error above
the bound for a hundredth of the time may be far above it, and a peak has many moves that might be at fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from ffcomp.faster.bound import RaisedLimits
from ffcomp.faster.predicted_error import (
    EXCEEDANCE,
    Ensemble,
    ensemble_percentile,
    error_at_quantile,
    forecast_error,
    histogram,
)
from ffcomp.firmware.program import plan_section
from ffcomp.inverse.command_limits import ACCELERATION, TRAVEL
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.solve import solve
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.trajectory import Section, Trajectory
from gcode.program import Moves
from models.arrays import FloatArray, IntArray

INFLUENCE_S = (0.03, 0.012)  # moves are held responsible for what comes so much after them, or before them


MAX_PREDICTIONS = 3  # at most, if
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
TARGET = 0.98  # of the bound and of the limits


class SectionSearch:
    """The search for one section's quickest motion, from rest to rest."""

    counts: IntArray  # (printers, bins) moments of the solved command by printer and its error

    def __init__(
        self, model: InverseModel, ensemble: Ensemble, limits: PlannerLimits, slicers: Moves, ceiling: RaisedLimits
    ) -> None:
        self.model, self.ensemble, self.limits, self.ceiling = model, ensemble, limits, ceiling
        self.free = ~ceiling.kept
        self.top = ceiling.moves.acceleration  # of each move, if known
        self.state = model.machine.equilibrium(slicers.start[0, :3])
        self.accelerate(INITIAL_ACCELERATION, float(ceiling.bound_mm.max()))

    def accelerate(self, acceleration: float, bound_mm: float) -> None:
        """Give the moves an acceleration, as far as they may have it, plan them, and forecast the error.

        acceleration : mm/s², of what has this bound; more or less for another one
        """
        top, free, scaled = self.ceiling.moves, self.free, acceleration * self.ceiling.bound_mm / bound_mm
        corner = np.minimum(CORNER_TIME_S * scaled, top.square_corner_velocity)
        self.moves = replace(
            top,
            acceleration=np.where(free, np.minimum(scaled, self.top), top.acceleration),
            square_corner_velocity=np.where(free, corner, top.square_corner_velocity),
        )
        plan = plan_section(self.limits, self.moves, 0.0)
        t, nominal, changes = forecast_error(self.model.sensitivity, plan, 0.0, plan.end_t)
        scale = 1.0 / self.ceiling.bound_mm[plan.move_at(t)]
        self.planned_s = plan.end_t
        self.forecast = error_at_quantile(nominal, changes, scale, self.ensemble.quantile_sd)  # (m,) times the bound

    def verify(self) -> None:
        """Solve and predict, and learn what the carriages allow.

        NOTE: segments that the firmware cannot execute in their time are left to the time scaling of the solution.
        """
        model, s = self.model, self.model.settings
        plan = plan_section(self.limits, self.moves, 0.0)
        reference = Reference(plan, Section(0, len(self.moves), True, 0.0, plan.end_t), s)
        solution = solve(model, reference, self.state)
        t = self.ensemble.times(reference)
        errors = self.ensemble.errors(reference, solution.vertices)
        self.counts = histogram(*errors, 1.0 / self.ceiling.bound_mm[plan.move_at(t)])
        utilisation = solution.demand[1:-1, [ACCELERATION, TRAVEL]]
        demand = _largest(utilisation.max(axis=(1, 2)), s.segment_s, reference.t0, plan)
        allowed = self.moves.acceleration * (TARGET / demand)
        self.top = np.where(demand > TARGET, np.minimum(self.top, allowed), self.top)


def _largest(samples: FloatArray, step_s: float, t0: float, plan: Trajectory) -> FloatArray:
    """Return the largest of the samples (m,), a step apart, that each move is responsible for, (n,)."""
    after_s, before_s = INFLUENCE_S
    begin, end = plan.start_t - before_s - t0, plan.start_t + plan.duration + after_s - t0
    first = np.clip(np.floor(begin / step_s).astype(np.int64), 0, len(samples) - 1)
    last = np.clip(np.ceil(end / step_s).astype(np.int64), first + 1, len(samples))
    padded = np.append(samples, -np.inf)
    return np.asarray(np.maximum.reduceat(padded, np.column_stack([first, last]).ravel())[::2])


def search(sections: Sequence[SectionSearch], still_s: float) -> float:
    """Make the moves of all sections as quick as the bound allows; return the error's 99th percentile, times the bound.

    The solution's own time scaling slows down moves beyond a carriage's limit.

    still_s : of the print, besides
    """
    if not sections:
        return 0.0
    rounds = _CommonAcceleration(sections, still_s)
    rounds.accelerate()
    tried = []  # the quickest motion that keeps the bound is the best; if none does, the one that is nearest to it
    for number in range(MAX_PREDICTIONS):
        if number:
            rounds.step_to_target()
        p99, lasting_s = rounds.verify(), sum(each.planned_s for each in sections)
        tried.append(((max(p99, 1.0), lasting_s), p99, [each.moves for each in sections]))
        if ACCEPTED_P99 <= p99 <= 1.0 or (p99 < 1.0 and rounds.at_ceiling):
            break
    _, p99, best = min(tried, key=itemgetter(0))
    for each, moves in zip(sections, best, strict=True):
        each.moves = moves
    return p99


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
            self._accelerate_all()
            p99 = max(FORECAST_GAIN * self._forecast_percentile(), 1e-3)
            known.append((self.acceleration, p99))
            met = abs(p99 / TARGET - 1.0) < FORECAST_RTOL or (p99 < TARGET and self.at_ceiling)
            if met or step == FORECAST_STEPS - 1:
                return
            self.acceleration = secant(known, FORECAST_POWER)

    def step_to_target(self) -> None:
        self.acceleration = secant(self.percentiles, PREDICTION_POWER)
        self._accelerate_all()

    def _accelerate_all(self) -> None:
        for each in self.sections:
            each.accelerate(self.acceleration, self.bound_mm)

    @property
    def at_ceiling(self) -> bool:
        share = min(float(each.ceiling.bound_mm.min()) for each in self.sections) / self.bound_mm
        return self.acceleration * share >= max(float(each.top[each.free].max()) for each in self.sections)

    def verify(self) -> float:
        """Predict the error; return what a printer at the quantile has for as long as it may, times the bound."""
        for each in self.sections:
            each.verify()
        ensemble, counts = self.sections[0].ensemble, [each.counts for each in self.sections]
        p99 = ensemble_percentile(counts, self.still_s / ensemble.step_s, ensemble.safety)
        self.percentiles.append((self.acceleration, p99))
        return p99

    def _forecast_percentile(self) -> float:
        """Return the forecast that is exceeded as long as it may be, times the bound: in proportion to `verify`."""
        error = np.concatenate([each.forecast for each in self.sections])
        samples = len(error) + self.still_s / self.sections[0].model.sensitivity.row_s
        beyond = min(int(EXCEEDANCE * samples), len(error) - 1)
        return float(np.partition(error, len(error) - 1 - beyond)[len(error) - 1 - beyond])


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
