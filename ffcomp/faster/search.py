"""Come down from above: make those moves slower at which the predicted error or a limit binds, until none does.

The moves of all sections begin quick. Each round plans them, solves the inverse and predicts the response. Where the
error is above a level, or a carriage is asked for more than its limit, the moves under way get less acceleration and
slower corners, or speed; where there is room, they get some of it back. The level is a multiple of the bound, the same
one for all sections: such that 99 % of the time the error is below the bound. What is above the level in the end keeps
the slicer's motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ffcomp.faster.opened import Opened, chosen
from ffcomp.faster.response import Printers
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

ROUGH, ROUNDS = 4, 8  # rounds with the plain inverse, and all
ROBUST = 0.6  # of the plain inverse's error by what is not known is left by the robust one
BEGINS = 0.4  # of the highest accelerations and corners
BEYOND = 0.01  # share of the time that the error may be above the bound,
SPOTS = (0.5, 2.5)  # times the bound, that single spots may have: at least and at most
FIRST_LEVEL = 1.15
AIM = 0.97  # of the bound and of the limits
ROOM = 0.85  # of the aim, below which a move gets something back
SLOWEST, FASTEST = 0.55, (1.6, 1.15)  # factors of one round: at first, and later
WIDE = 3  # rounds with the former, at the first level
NEARLY = 1.04  # demand that is let pass: the time scaling of the solution slows down what is a little beyond a limit
TRIES = 4  # to give some moves the slicer's motion, before all get it


class SectionSearch:
    """The search for one section's quickest motion, from rest to rest."""

    def __init__(
        self, model: InverseModel, printers: Printers, limits: PlannerLimits, slicers: Moves, opened: Opened
    ) -> None:
        self.model, self.printers, self.limits = model, printers, limits
        self.slicers, self.opened, self.free = slicers, opened, ~opened.kept
        self.given_up = np.zeros(len(slicers), dtype=np.bool_)
        self.state = model.machine.equilibrium(slicers.start[0, :3])
        self.moves, self.rough = _begin(opened), model.settings.robust
        self.trial = self.tried(self.moves)

    def refine(self) -> None:
        """Predict with the model's own inverse from now on, not with the plain one."""
        self.rough = False
        self.trial = self.tried(self.moves)

    def tried(self, moves: Moves) -> Trial:
        """Plan, solve and predict.

        NOTE: segments that the firmware cannot execute in their time are left to the time scaling of the solution.
        """
        model, s = self.model.plain if self.rough else self.model, self.model.settings
        plan = plan_section(self.limits, moves, 0.0)
        written = WHOLE.written(plan, Section(0, len(moves), True, 0.0, plan.end_t), s)
        solution = solve(model, written.reference, self.state, keep_response=True, enforce_limits=False)
        path = np.append(plan.start_t, plan.end_t), np.vstack([moves.start[:, :3], moves.end[-1:, :3]])
        error = self.printers.error(written, solution, path)
        utilisation = utilisation_from_rest(solution.vertices, model.limits)[1:-1]
        step_s, t0 = s.segment_s / s.substeps, written.reference.t0
        t = t0 + (1 + np.arange(len(error), dtype=np.float64)) * step_s
        return Trial(
            plan,
            t0,
            step_s,
            s.segment_s,
            (ROBUST if self.rough else 1.0) * error / self.opened.bound_mm[plan.move_at(t)],
            utilisation[:, [ACCELERATION, TRAVEL]].max(axis=(1, 2)),
            utilisation[:, VELOCITY].max(axis=1),
        )

    def next(self, level: float, most: float) -> bool:
        """Try the moves of the next round; say whether anything has changed.

        level : times the bound, that the error may have;  most : factor by which something may become quicker
        """
        faster = self._next(self.trial.demand(level), most)
        if faster is not None:
            self.moves, self.trial = faster, self.tried(faster)
        return faster is not None

    def settle(self, level: float) -> None:
        """Give the slicer's motion back to what is beyond the level or a limit; to all if that is not enough."""
        if not self._beyond(self.trial.demand(level)).any():
            return
        moves = self.moves
        for _ in range(TRIES):
            self.given_up |= self._beyond(self.trial.demand(level))
            self.moves = chosen(self.slicers, moves, self.given_up)
            self.trial = self.tried(self.moves)
            if not (self._beyond(self.trial.demand(level)) & ~self.given_up).any():
                return
        self.given_up, self.moves = self.free.copy(), chosen(self.slicers, moves, self.free)
        self.trial = self.tried(self.moves)

    def _beyond(self, demand: Demand) -> BoolArray:
        return self.free & ((demand.acceleration > NEARLY) | (demand.speed > NEARLY))

    def _next(self, demand: Demand, most: float) -> Moves | None:
        """Return the moves of the next round; None: nothing would change."""
        moves, top, free = self.moves, self.opened.moves, self.free
        by_acceleration = _factor(demand.acceleration, 0.8, SLOWEST, most)
        by_speed = _factor(demand.speed, 1.0, 0.8, most)
        acceleration = np.minimum(moves.acceleration * by_acceleration, top.acceleration)
        corner = np.minimum(moves.square_corner_velocity * by_acceleration, top.square_corner_velocity)
        speed = np.minimum(moves.speed * by_speed, top.speed)
        if np.array_equal(acceleration[free], moves.acceleration[free]) and np.array_equal(
            speed[free], moves.speed[free]
        ):
            return None
        return replace(
            moves,
            acceleration=np.where(free, acceleration, moves.acceleration),
            square_corner_velocity=np.where(free, corner, moves.square_corner_velocity),
            speed=np.where(free, speed, moves.speed),
        )


def search(sections: Sequence[SectionSearch], still_s: float) -> float:
    """Make the moves of all sections as quick as the bound allows; return the error's 99th percentile, times the bound.

    still_s : of the print, besides
    """
    if not sections:
        return 0.0
    level, best = FIRST_LEVEL, _Best()
    for number in range(ROUNDS + 1):
        if number == ROUGH and sections[0].rough:
            for each in sections:
                each.refine()
        p99 = _percentile(sections, still_s)
        if number >= ROUGH:
            best.look(sections, p99)
        if number == ROUNDS:
            break
        if number >= WIDE:
            level = float(np.clip(level * (AIM / p99), *SPOTS))
        for each in sections:
            each.next(level, FASTEST[number >= WIDE])
    best.restore(sections)
    for each in sections:
        each.settle(SPOTS[1])
    return _percentile(sections, still_s)


class _Best:
    """The quickest motion so far that keeps the bound; if none does, the one that is nearest to it."""

    def __init__(self) -> None:
        self.rank, self.kept = (np.inf, np.inf), list[tuple[Moves, Trial]]()

    def look(self, sections: Sequence[SectionSearch], p99: float) -> None:
        """Compare the sections as they are."""
        rank = max(p99, 1.0), sum(each.trial.plan.end_t for each in sections)
        if rank < self.rank:
            self.rank, self.kept = rank, [(each.moves, each.trial) for each in sections]

    def restore(self, sections: Sequence[SectionSearch]) -> None:
        """Give the sections their best moves again."""
        for each, (moves, trial) in zip(sections, self.kept, strict=True):
            each.moves, each.trial = moves, trial


def _percentile(sections: Sequence[SectionSearch], still_s: float) -> float:
    """Return the error that is exceeded for as long as it may be, times the bound."""
    error = np.concatenate([each.trial.error for each in sections])
    samples = len(error) + still_s / sections[0].trial.step_s
    beyond = min(int(BEYOND * samples), len(error) - 1)
    return float(np.partition(error, len(error) - 1 - beyond)[len(error) - 1 - beyond])


def _begin(opened: Opened) -> Moves:
    moves, free = opened.moves, ~opened.kept
    return replace(
        moves,
        acceleration=np.where(free, BEGINS * moves.acceleration, moves.acceleration),
        square_corner_velocity=np.where(free, BEGINS * moves.square_corner_velocity, moves.square_corner_velocity),
    )


def _factor(demand: FloatArray, power: float, least: float, most: float) -> FloatArray:
    """Return by how much moves become slower or quicker, (n,)."""
    factor = np.clip((AIM / np.maximum(demand, 1e-3)) ** power, least, most)
    factor[(demand <= 1.0) & (demand >= ROOM)] = 1.0
    return np.asarray(factor)
