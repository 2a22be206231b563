"""Find the acceleration that the bound allows, the same one for all sections, then make slower where a limit binds.

The error goes with acceleration, and with the speed of corners; both go together. A forecast (`forecast.py`) finds
where the error would be the bound; the inverse is solved there and the response predicted (`response.py`) for a third
of the sections, then for all, until at the wanted quantile over printers the error is below the bound for 99 % of the
time and hardly more. What is beyond a limit of the carriages, or a spot's bound, then becomes slower by itself.

One acceleration for all gave shorter prints than one for each move by its own peak of the error: for what is above the
bound for a hundredth of the time may be far above, and a peak has many moves that might be at fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffcomp.faster.forecast import forecast
from ffcomp.faster.opened import Opened, chosen
from ffcomp.faster.response import Printers
from ffcomp.faster.spread import BEYOND, at_quantile, counted, percentile
from ffcomp.faster.trial import Demand, Trial
from ffcomp.inverse.command_limits import ACCELERATION, TRAVEL, VELOCITY, utilisation_from_rest
from ffcomp.inverse.extent import WHOLE
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.solve import solve
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.program import plan_section
from ffcomp.planner.sections import Section
from gcode.program import Moves
from models.arrays import BoolArray, FloatArray

SAMPLE = 3  # one section of so many is predicted first, to see how wrong forecasts are,
LEAST_SAMPLE = 16  # if there are so many
PREDICTED = 3  # times all of it, at most, if
ENOUGH = 0.94  # of the bound is not reached
STEPS = 6  # of the search for an acceleration, with forecasts
CLOSE = 0.01  # between the forecast and the bound: no more steps
FIRST = 8000.0  # mm/s²
RANGE = (50.0, 1e6)  # mm/s²
FORECAST_POWER, POWER = 0.8, 1.2  # of the acceleration, that the forecast and the error go with: usual,
POWERS = (0.5, 2.5)  # and at least and at most
APART = 0.02  # in the acceleration's logarithm: what is nearer tells nothing of its power
WRONG = 0.62  # of the forecast is there
CORNER_S = 1.6e-3  # square corner velocity for an acceleration: so much rings as little of the one as of the other
SPOTS = 2.5  # times the bound, that single spots may have
AIM = 0.98  # of the bound and of the limits
SETTLED, SLOWEST = 0.92, 0.55  # of a limit, that a move comes down to which is beyond it; and the factor of one round
NEARLY = 1.04  # demand that is let pass: the time scaling of the solution slows down what is a little beyond a limit
MORE = 8  # rounds in which a section alone becomes slower where it is beyond a limit or a spot's bound
TRIES = 4  # to give some moves the slicer's motion


class SectionSearch:
    """The search for one section's quickest motion, from rest to rest."""

    def __init__(
        self, model: InverseModel, printers: Printers, limits: PlannerLimits, slicers: Moves, opened: Opened
    ) -> None:
        self.model, self.printers, self.limits = model, printers, limits
        self.slicers, self.opened, self.free = slicers, opened, ~opened.kept
        self.top = opened.moves.acceleration  # of each move, as far as it is known
        self.given_up = np.zeros(len(slicers), dtype=np.bool_)
        self.state = model.machine.equilibrium(slicers.start[0, :3])
        self.predicted: Trial | None = None  # the last one; of the same moves once all is done
        self.accelerate(FIRST, float(opened.bound_mm.max()))

    def accelerate(self, acceleration: float, bound_mm: float) -> None:
        """Give the moves an acceleration, as far as they may have it, and foretell the error.

        acceleration : mm/s², of what has this bound; more or less for another one
        """
        top, free, own = self.opened.moves, self.free, acceleration * self.opened.bound_mm / bound_mm
        corner = np.minimum(CORNER_S * own, top.square_corner_velocity)
        self.moves = replace(
            top,
            acceleration=np.where(free, np.minimum(own, self.top), top.acceleration),
            square_corner_velocity=np.where(free, corner, top.square_corner_velocity),
        )
        self.trial = self.foretold(self.moves)

    def foretold(self, moves: Moves) -> Trial:
        """Plan, and foretell the error."""
        plan = plan_section(self.limits, moves, 0.0)
        t, nominal, changes = forecast(self.model.sensitivity, plan, 0.0, plan.end_t)
        at = plan.move_at(t)
        error = at_quantile(nominal, changes, 1.0 / self.opened.bound_mm[at], self.printers.far)
        return Trial(plan, t[0], self.model.sensitivity.row_s, error)

    def predict(self, moves: Moves) -> Trial:
        """Plan, solve and predict.

        NOTE: segments that the firmware cannot execute in their time are left to the time scaling of the solution.
        """
        model, s = self.model, self.model.settings
        plan = plan_section(self.limits, moves, 0.0)
        written = WHOLE.written(plan, Section(0, len(moves), True, 0.0, plan.end_t), s)
        solution = solve(model, written.reference, self.state, keep_response=True, enforce_limits=False)
        path = np.append(plan.start_t, plan.end_t), np.vstack([moves.start[:, :3], moves.end[-1:, :3]])
        t = self.printers.moments(written, solution)
        found = *self.printers.errors(written, solution, path), 1.0 / self.opened.bound_mm[plan.move_at(t)]
        utilisation = utilisation_from_rest(solution.vertices, model.limits)[1:-1]
        demands = utilisation[:, [ACCELERATION, TRAVEL]].max(axis=(1, 2)), utilisation[:, VELOCITY].max(axis=1)
        errors = at_quantile(*found, self.printers.far), counted(*found)
        return Trial(plan, t[0], t[1] - t[0], *errors, written.reference.t0, s.segment_s, *demands)

    def prove(self) -> None:
        """Predict, and learn what the carriages allow."""
        self.predicted = self.predict(self.moves)
        demand = self.predicted.acceleration_limits
        self.top = np.where(demand > AIM, np.minimum(self.top, self.moves.acceleration * (AIM / demand)), self.top)

    def settle(self, level: float) -> None:
        """Slow down what is beyond the level or a limit; give the slicer's motion back where a spot stays above it.

        What is beyond a limit still, the solution's own time scaling slows down.
        """
        for _ in range(MORE):
            demand = self._proven.demand(level)
            if not self._beyond(demand).any():
                return
            self.moves = self._slower(demand)
            self.predicted = self.predict(self.moves)
        moves = self.moves
        for _ in range(TRIES):
            spots = self.free & ~self.given_up & (self._proven.errors > NEARLY * level)
            if not spots.any():
                return
            self.given_up |= spots
            self.moves = chosen(self.slicers, moves, self.given_up)
            self.predicted = self.predict(self.moves)

    @property
    def _proven(self) -> Trial:
        if self.predicted is None:
            self.predicted = self.predict(self.moves)
        return self.predicted

    def _beyond(self, demand: Demand) -> BoolArray:
        return self.free & ((demand.acceleration > NEARLY) | (demand.speed > NEARLY))

    def _slower(self, demand: Demand) -> Moves:
        """Return the moves of the next round."""
        moves, free = self.moves, self.free
        by_acceleration = _factor(demand.acceleration, SLOWEST)
        by_speed = _factor(demand.speed, 0.8)
        return replace(
            moves,
            acceleration=np.where(free, moves.acceleration * by_acceleration, moves.acceleration),
            square_corner_velocity=np.where(
                free, moves.square_corner_velocity * by_acceleration, moves.square_corner_velocity
            ),
            speed=np.where(free, moves.speed * by_speed, moves.speed),
        )


def search(sections: Sequence[SectionSearch], still_s: float) -> float:
    """Make the moves of all sections as quick as the bound allows; return the error's 99th percentile, times the bound.

    still_s : of the print, besides
    """
    if not sections:
        return 0.0
    rounds, best = _Rounds(sections, still_s), _Best()
    rounds.accelerate()
    if len(sections) >= LEAST_SAMPLE:
        some = sections[SAMPLE // 2 :: SAMPLE]
        rounds.prove(some, still_s * _lasting(some) / _lasting(sections))
        rounds.nearer()
        rounds.proven.clear()  # of some sections, not of all
    for number in range(PREDICTED):
        if number:
            rounds.nearer()
        p99 = rounds.prove(sections, still_s)
        best.look(sections, p99)
        if ENOUGH <= p99 <= 1.0 or (p99 < 1.0 and rounds.at_the_top):
            break
    best.restore(sections)
    for each in sections:
        each.settle(SPOTS)
    return _percentile(sections, still_s)


class _Rounds:
    """All sections, and the acceleration that is the same for all of them."""

    def __init__(self, sections: Sequence[SectionSearch], still_s: float) -> None:
        self.sections, self.still_s = sections, still_s
        self.acceleration = FIRST
        self.proven: list[tuple[float, float]] = []  # accelerations, and their percentiles
        self.bound_mm = max(float(each.opened.bound_mm.max()) for each in sections)

    def accelerate(self) -> None:
        """Find the acceleration at which the forecast of the percentile is the bound."""
        known: list[tuple[float, float]] = []
        for step in range(STEPS):
            for each in self.sections:
                each.accelerate(self.acceleration, self.bound_mm)
            p99 = max(WRONG * _foretold(self.sections, self.still_s), 1e-3)
            known.append((self.acceleration, p99))
            if abs(p99 / AIM - 1.0) < CLOSE or (p99 < AIM and self.at_the_top) or step == STEPS - 1:
                return
            self.acceleration = _nearer(known, FORECAST_POWER)

    def nearer(self) -> None:
        """Take the acceleration at which the percentile would be the bound."""
        self.acceleration = _nearer(self.proven, POWER)
        for each in self.sections:
            each.accelerate(self.acceleration, self.bound_mm)

    @property
    def at_the_top(self) -> bool:
        """Whether no move would become quicker."""
        share = min(float(each.opened.bound_mm.min()) for each in self.sections) / self.bound_mm
        return self.acceleration * share >= max(float(each.top[each.free].max()) for each in self.sections)

    def prove(self, some: Sequence[SectionSearch], still_s: float) -> float:
        """Predict the error of some sections; return its percentile."""
        for each in some:
            each.prove()
        p99 = _percentile(some, still_s)
        self.proven.append((self.acceleration, p99))
        return p99


def _nearer(known: Sequence[tuple[float, float]], usual: float) -> float:
    """Return the acceleration at which the percentile would be the bound.

    known : accelerations and percentiles; the last two tell with which power of the one the other goes, if they can
    """
    now, p99 = known[-1]
    power = usual
    if len(known) > 1 and abs(np.log(now / known[-2][0])) > APART:
        power = float(np.clip(np.log(p99 / known[-2][1]) / np.log(now / known[-2][0]), *POWERS))
    return float(np.clip(now * (AIM / p99) ** (1.0 / power), *RANGE))


def _lasting(sections: Sequence[SectionSearch]) -> float:
    return sum(each.trial.plan.end_t for each in sections)


class _Best:
    """The quickest motion so far that keeps the bound; if none does, the one that is nearest to it."""

    def __init__(self) -> None:
        self.rank, self.kept = (np.inf, np.inf), list[tuple[Moves, Trial | None]]()

    def look(self, sections: Sequence[SectionSearch], p99: float) -> None:
        """Compare the sections as they are, predicted."""
        rank = max(p99, 1.0), _lasting(sections)
        if rank < self.rank:
            self.rank, self.kept = rank, [(each.moves, each.predicted) for each in sections]

    def restore(self, sections: Sequence[SectionSearch]) -> None:
        """Give the sections their best moves again."""
        for each, (moves, predicted) in zip(sections, self.kept, strict=True):
            each.moves, each.predicted = moves, predicted


def _percentile(sections: Sequence[SectionSearch], still_s: float) -> float:
    """Return the error that a printer at the quantile has for as long as it may, times the bound."""
    trials = [each.predicted for each in sections if each.predicted is not None]
    return percentile([each.counts for each in trials], still_s / trials[0].step_s, sections[0].printers.safety)


def _foretold(sections: Sequence[SectionSearch], still_s: float) -> float:
    """Return the forecast that is exceeded as long as it may be, times the bound: in proportion to `_percentile`."""
    error = np.concatenate([each.trial.error for each in sections])
    samples = len(error) + still_s / sections[0].trial.step_s
    beyond = min(int(BEYOND * samples), len(error) - 1)
    return float(np.partition(error, len(error) - 1 - beyond)[len(error) - 1 - beyond])


def _factor(demand: FloatArray, least: float) -> FloatArray:
    """Return by how much moves become slower, (n,)."""
    return np.where(demand > 1.0, np.clip(SETTLED / np.maximum(demand, 1e-3), least, 1.0), 1.0)
