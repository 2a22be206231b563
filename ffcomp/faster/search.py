"""Come down from above: make those moves slower at which the predicted error or a limit binds, until none does.

The moves of one section begin with the highest limits there are. Each round plans them, solves the inverse and predicts
the response. Where the error is above the bound, or a carriage is asked for more than its limit, the moves under way
get less acceleration and slower corners, or speed; where a move was made slower and has room again, it gets some of it
back. What is above the bound in the end keeps the slicer's motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ffcomp.faster.opened import Opened, chosen
from ffcomp.faster.response import Printers
from ffcomp.inverse.command_limits import ACCELERATION, TRAVEL, VELOCITY, utilisation_from_rest
from ffcomp.inverse.extent import WHOLE, WrittenReference
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.solve import solve
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.program import plan_section
from ffcomp.planner.sections import Section
from ffcomp.planner.trajectory import Trajectory
from gcode.program import Moves
from models.arrays import BoolArray, FloatArray

ROUNDS = 18
ONLY_DOWN = 9  # rounds at the end that give nothing back
NEARLY = 1.1  # demand that is let pass after them
TRIES = 6  # to give some moves the slicer's motion, before all get it
FELT_S = (0.012, 0.03)  # around a moment, within which moves are held responsible for it: at first, and
WIDER = 6  # from this round on
PEAKS = 1.0  # times the bound, that single spots may have; with 1.2, p99 of 3 in 6 printers was above it
AIM = 0.97  # of the bound and of the limits
ROOM = 0.8  # of the aim, below which a move that was made slower gets some of it back
SLOWEST, FASTEST = 0.6, 1.08  # factors of one round
SLOWEST_SPEED = 0.8


@dataclass(frozen=True, slots=True)
class Found:
    """A section's moves as they are to be played."""

    moves: Moves
    given_up: BoolArray  # (n,) moves that keep the slicer's motion because nothing quicker keeps the bound
    held: bool  # whether the bound holds


@dataclass(frozen=True, slots=True)
class _Demand:
    """What each move asks for, as a share of what it may, (n,)."""

    acceleration: FloatArray  # the error, acceleration and timing
    speed: FloatArray


class SectionSearch:
    """The search for one section's quickest motion, from rest to rest."""

    def __init__(
        self, model: InverseModel, printers: Printers, limits: PlannerLimits, slicers: Moves, opened: Opened
    ) -> None:
        self.model, self.printers, self.limits = model, printers, limits
        self.slicers, self.opened = slicers, opened
        self.state = model.machine.equilibrium(slicers.start[0, :3])

    def find(self) -> Found:
        """Return the quickest motion found that keeps the bound."""
        moves, free = self.opened.moves, ~self.opened.kept
        best: Moves | None = None
        shortest_s = np.inf
        for number in range(ROUNDS):
            demand, took_s = self._demand(moves, FELT_S[number >= WIDER])
            if not self._beyond(demand, free).any():
                if took_s < shortest_s:
                    best, shortest_s = moves, took_s
                if number >= ROUNDS - ONLY_DOWN:
                    break
            faster = self._next(moves, demand, free, only_down=number >= ROUNDS - ONLY_DOWN)
            if faster is None:
                break
            moves = faster
        if best is not None:
            return Found(best, np.zeros(len(free), dtype=np.bool_), True)
        return self._given_up(moves, free)

    def _given_up(self, moves: Moves, free: BoolArray) -> Found:
        """Give the slicer's motion back to what is beyond the bound and around it; to all if that is not enough."""
        kept = self._beyond(self._demand(moves, FELT_S[1])[0], free, NEARLY)
        for _ in range(TRIES):
            mixed = chosen(self.slicers, moves, kept)
            beyond = self._beyond(self._demand(mixed, FELT_S[1])[0], free & ~kept, NEARLY)
            if not beyond.any():
                return Found(mixed, kept, not kept.any())
            kept = kept | beyond
        return Found(self.slicers, free.copy(), False)

    @staticmethod
    def _beyond(demand: _Demand, free: BoolArray, most: float = 1.0) -> BoolArray:
        return free & ((demand.acceleration > most) | (demand.speed > 1.0))

    def _next(self, moves: Moves, demand: _Demand, free: BoolArray, only_down: bool) -> Moves | None:
        """Return the moves of the next round; None: nothing would change."""
        most = 1.0 if only_down else FASTEST
        by_acceleration = np.clip((AIM / np.maximum(demand.acceleration, 1e-3)) ** 0.8, SLOWEST, most)
        by_acceleration[(demand.acceleration <= 1.0) & (demand.acceleration >= ROOM)] = 1.0
        by_speed = np.clip(AIM / np.maximum(demand.speed, 1e-3), SLOWEST_SPEED, most)
        by_speed[(demand.speed <= 1.0) & (demand.speed >= ROOM)] = 1.0
        top, was = self.opened.moves, (moves.acceleration, moves.speed)
        acceleration = np.where(
            free, np.minimum(moves.acceleration * by_acceleration, top.acceleration), moves.acceleration
        )
        corner = np.where(
            free,
            np.minimum(moves.square_corner_velocity * by_acceleration, top.square_corner_velocity),
            moves.square_corner_velocity,
        )
        speed = np.where(free, np.minimum(moves.speed * by_speed, top.speed), moves.speed)
        if np.array_equal(acceleration[free], was[0][free]) and np.array_equal(speed[free], was[1][free]):
            return None
        return replace(moves, acceleration=acceleration, square_corner_velocity=corner, speed=speed)

    def _demand(self, moves: Moves, felt_s: float = FELT_S[0]) -> tuple[_Demand, float]:
        """Plan, solve and predict; return what each move demands, and how long the section takes, s.

        NOTE: segments that the firmware cannot execute in their time are left to the time scaling of the solution.
        """
        model, s = self.model, self.model.settings
        plan = plan_section(self.limits, moves, 0.0)
        section = Section(0, len(moves), True, 0.0, plan.end_t)
        written = WHOLE.written(plan, section, s)
        solution = solve(model, written.reference, self.state, keep_response=True, enforce_limits=False)
        path = np.append(plan.start_t, plan.end_t), np.vstack([moves.start[:, :3], moves.end[-1:, :3]])
        error = self.printers.error(written, solution, path)
        utilisation = utilisation_from_rest(solution.vertices, model.limits)[1:-1]
        by_knot = utilisation[:, [ACCELERATION, TRAVEL]].max(axis=(1, 2))
        step_s = s.segment_s / s.substeps
        t = written.reference.t0 + (1 + np.arange(len(error), dtype=np.float64)) * step_s
        missed = error / (PEAKS * self.opened.bound_mm[plan.move_at(t)])
        of_moves = _Moves(plan, written, felt_s)
        acceleration = np.maximum(of_moves.largest(missed, step_s), of_moves.largest(by_knot, s.segment_s))
        speed = of_moves.largest(utilisation[:, VELOCITY].max(axis=1), s.segment_s)
        return _Demand(acceleration, speed), plan.end_t


class _Moves:
    """Which samples of a section each of its moves is responsible for."""

    def __init__(self, plan: Trajectory, written: WrittenReference, felt_s: float) -> None:
        self.begin = plan.start_t - felt_s - written.reference.t0
        self.end = plan.start_t + plan.duration + felt_s - written.reference.t0

    def largest(self, samples: FloatArray, step_s: float) -> FloatArray:
        """Return the largest of the samples (m,), a step apart, of each move, (n,)."""
        first = np.clip(np.floor(self.begin / step_s).astype(np.int64), 0, len(samples) - 1)
        last = np.clip(np.ceil(self.end / step_s).astype(np.int64), first + 1, len(samples))
        padded = np.append(samples, -np.inf)
        return np.asarray(np.maximum.reduceat(padded, np.column_stack([first, last]).ravel())[::2])
