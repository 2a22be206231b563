"""Slow the plan down where, and only where, the machine cannot follow it within its limits.

A run whose command keeps all limits is taken as it is. Otherwise, in a few rounds:

    the path itself asks for more than a limit, where its command does too   → those moves become slower
    the command can be held, but the nozzle leaves the path                  → those moves become slower
    segments that the firmware cannot play in their time                     → those moves become slower
    none of these                                                            → done

Speed follows a velocity limit in proportion. Acceleration and the speed of corners follow an acceleration limit in
proportion; where the nozzle keeps its speed, in curves and far from the middle, it is v² that does.

A run that is cut in motion (`ffcomp/compensate/chunks.py`) is slowed down on either side of the cut by whoever
writes that side.
Both must pass the cut in the same way: moves near it keep their speed, for they have been `eased` before, once for
both. And what is written must be whole segments again: the rest of it is made slower by as little as that takes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import TypeVar, cast

import numpy as np

from ffcomp.errors import LimitsError, SolverError
from ffcomp.inverse.command_limits import NAMES, TRAVEL, VELOCITY, utilisation_from_rest
from ffcomp.inverse.extent import SETTLED, WHOLE, Extent, around_s
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import Reference
from ffcomp.inverse.solve import Solution, solve
from ffcomp.inverse.violations import (
    ENOUGH,
    PLAYABLE,
    SLOWEST,
    Trouble,
    of_playing,
    of_the_answer,
    of_the_command,
    of_the_path,
)
from ffcomp.planner.limits import PlannerLimits, bounds_of, lines_of
from ffcomp.planner.lookahead import plan_moves
from ffcomp.planner.path_position import PathPosition
from ffcomp.planner.sections import Section
from ffcomp.planner.segment_timing import segment_speeds
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from gcode.program import Moves
from models.arrays import BoolArray, FloatArray, IntArray
from models.vibration.scheduled import rest_state

Replan = Callable[[Moves, float], PlannedMotion]  # the moves of a run, when it begins (s) → its plan
Motion = TypeVar("Motion", bound=PlannedMotion)

TOLERANCE_UM = 25.0
ROUNDS = 8
PHASES = 4  # of the knots, at which a path is looked at
APART = 8  # moves: slowed ones that lie closer are told of together
LATE_MM = 1e-3  # how far a segment may fall behind
NOT_HELD_MM = 0.0  # tolerance around a cut: where no limit is held, both sides find the same command
KNOT = 1e-6  # of a segment: nearer is at a knot
EASED = 0.75  # of what is planned around a cut, how much may become slower before it is cut
STEADY = 0.02  # by which share a speed may change that is called constant


@dataclass(frozen=True, slots=True)
class TimeScaling:
    """Moves that had to become slower, and why."""

    first_line: int  # counted from 1
    last_line: int
    layer: int | None
    factor: float  # mean speed, as a share of what was planned
    seconds: float  # lost in them
    carriage: str  # A, B or C; empty: not a carriage's limit
    limit: str  # velocity, acceleration, travel; empty: the firmware's own acceleration
    asked: float  # times the limit, at first

    def sentence(self, verb: str = "slowed") -> str:
        """What happened, where and why."""
        lines = f"{self.first_line}" + (f"-{self.last_line}" if self.last_line != self.first_line else "")
        layer = "" if self.layer is None else f" (layer {self.layer})"
        if self.limit:
            why = f"carriage {self.carriage} was asked for {self.asked:.2f} times its {self.limit} limit"
        else:
            why = "the firmware's own acceleration limit leaves too little for its segments"
        percent = f"{100 * self.factor:.0f}" if self.factor < 0.995 else f"{100 * self.factor:.2f}"  # never to 100 %
        return f"line {lines}{layer}: {verb} to {percent} %, {self.seconds:.2g} s longer: {why}."


@dataclass(frozen=True, slots=True)
class FeasibleSection:
    """A run that can be followed."""

    trajectory: PlannedMotion  # the whole plan; what comes after the run is later by `lost_s`
    run: Section
    wanted: Reference
    result: Solution
    records: tuple[TimeScaling, ...]
    lost_s: float


def feasible_run(
    model: InverseModel,
    moves: Moves,
    limits: PlannerLimits,
    trajectory: PlannedMotion,
    run: Section,
    state: FloatArray,
    *,
    tolerance_um: float = TOLERANCE_UM,
    strict: bool = False,
    keep_response: bool = False,
    first_line: int = 0,
    layer_of: Callable[[int], int | None] = lambda move: None,
    replan: Replan | None = None,
    ends: Extent = WHOLE,
) -> FeasibleSection:
    """Solve a run; where its limits cannot be held within the tolerance, on a plan that is slower there.

    Parameters
    ----------
    moves, trajectory : of the program, of which `run` is a part
    limits : what the firmware allows, as the trajectory was planned
    state : (18,) of the plant at the run's first knot
    tolerance_um : how far the nozzle may leave the path where a limit is held, by the design model
    strict : refuse instead of slowing down
    first_line : number in the file, from 0, of the program's first line
    layer_of : move → its layer
    replan : how the trajectory was planned, if not by `plan_moves`
    ends : what is written of the run, if it is the program's first one and cut in motion

    Raises
    ------
    LimitsError
        Where the path itself lies beyond a carriage's travel, where no slower plan is found, or when `strict`.
    """
    wanted = ends.reference(trajectory, run, model.settings)
    result = solve(model, wanted, state, keep_response=keep_response, enforce_limits=False)
    if not _exceeds(model, wanted, result, ends.knots(wanted, trajectory)):
        return FeasibleSection(trajectory, run, wanted, result, (), 0.0)
    part = _Part(model, _slice(moves, run), limits, replan or _planner(limits), run, ends)
    wanted, result = part.solved(state, tolerance_um * 1e-3, keep_response, first_line)
    if not part.reasons:
        return FeasibleSection(trajectory, run, wanted, result, (), 0.0)
    spliced, lost = _spliced(trajectory, run, part.plan)
    records = tuple(part.records(trajectory.duration[run.first : run.last], first_line, layer_of))
    if strict:
        _refuse(records)
    return FeasibleSection(spliced, replace(run, end_t=part.run.end_t), wanted, result, records, lost)


def eased(
    model: InverseModel,
    moves: Moves,
    limits: PlannerLimits,
    cut: PathPosition,
    *,
    first_line: int = 0,
    layer_of: Callable[[int], int | None] = lambda move: None,
) -> tuple[Moves, tuple[TimeScaling, ...]]:
    """Moves around a place where a motion is to be cut, slower where they have to be, and what was slowed down.

    moves : planned from rest to rest; those near their ends stay as they are
    Other parameters, and errors, are those of `feasible_run`.
    """
    settings, plan = model.settings, cast(Trajectory, _planner(limits)(moves, 0.0))
    reach_s = EASED * around_s(moves, plan)
    t = cut.on(plan)
    inner = (plan.start_t >= t - reach_s) & (plan.start_t + plan.duration <= t + reach_s)
    if not inner.any():
        return moves, ()
    first, last = np.flatnonzero(inner)[[0, -1]].tolist()
    middle = Extent(PathPosition(first, 0.0), PathPosition(last, float(lines_of(moves).length[last])))
    run = Section(0, len(moves), True, 0.0, plan.end_t)
    part = _Part(model, moves, limits, _planner(limits), run, middle, ~inner)
    state = rest_state(model.machine, moves.start[0, :3])
    part.slowed(state, NOT_HELD_MM, False, first_line)
    records = tuple(part.records(plan.duration, first_line, layer_of)) if part.reasons else ()
    if records and settings.strict:
        _refuse(records)
    return part.moves, records


def _refuse(records: tuple[TimeScaling, ...]) -> None:
    raise LimitsError(" ".join(record.sentence("would have to be slowed") for record in records))


def _exceeds(model: InverseModel, wanted: Reference, result: Solution, between: tuple[int, int]) -> bool:
    # what is not finite is out of reach, which is nothing that speed could help
    written = slice(*between)
    return excess_of(model, result, between) > 1.0 or bool(_late(model, wanted, result.vertices)[written].any())


def excess_of(model: InverseModel, result: Solution, between: tuple[int, int]) -> float:
    """How many times its limit a carriage is asked for from one knot to another."""
    if between == (0, len(result.vertices) - 1):
        return result.utilisation
    return float(utilisation_from_rest(result.vertices, model.limits)[1:-1][slice(*between)].max())


def _late(model: InverseModel, wanted: Reference, vertices: FloatArray) -> BoolArray:
    """Segments (n,) that the firmware cannot play in their time."""
    s = model.settings
    lasting = np.full(len(vertices) - 1, s.segment_s)
    speeds = segment_speeds(vertices, np.diff(wanted.extrusion()), lasting, s.output)
    return np.asarray((speeds.duration - lasting) * speeds.cruise > LATE_MM)


def _planner(limits: PlannerLimits) -> Replan:
    def plan(moves: Moves, start_t: float) -> PlannedMotion:
        n = len(moves)
        return plan_moves(moves, limits, stop_before=np.zeros(n, bool), wait_before=np.zeros(n), start_t=start_t)

    return plan


class _Part:
    """The moves of one run, while they become slower."""

    def __init__(
        self,
        model: InverseModel,
        moves: Moves,
        limits: PlannerLimits,
        replan: Replan,
        run: Section,
        ends: Extent,
        kept: BoolArray | None = None,
    ) -> None:
        """kept : (n,) the moves that keep their speed; None: those near the run's ends in motion"""
        self.model, self.moves, self._limits, self._replan = model, moves, limits, replan
        self._begin_t, self._ends = run.begin_t, ends
        self.reasons: dict[int, Trouble] = {}  # move → why it was slowed down at first
        self._plan_again()
        self._kept = self._near_cuts() if kept is None else kept

    def _near_cuts(self) -> BoolArray:
        near = np.zeros(len(self.moves), dtype=np.bool_)
        if self._ends != WHOLE:
            plan = cast(Trajectory, self.plan)
            for part in self._ends.near(plan, around_s(self.moves, plan) / SETTLED):
                near[part] = True
        return near

    def _plan_again(self) -> None:
        self.plan = self._replan(self.moves, self._begin_t)
        self.run = Section(0, len(self.moves), True, self._begin_t, self.plan.end_t)

    def solved(
        self, state: FloatArray, tolerance_mm: float, keep_response: bool, first_line: int
    ) -> tuple[Reference, Solution]:
        """The first plan in a few rounds that can be followed, and its command."""
        moves, plan = self.moves, self.plan
        wanted, result = self.slowed(state, tolerance_mm, keep_response, first_line)
        if self.reasons and self._ends.end is not None:
            if not self._fit():
                self.moves, self.plan, self.reasons = moves, plan, {}
            wanted, result, troubles = self._attempt(state, tolerance_mm, keep_response)
            result = self._held(wanted, result, state, keep_response) if troubles else result
        return wanted, result

    def slowed(
        self, state: FloatArray, tolerance_mm: float, keep_response: bool, first_line: int
    ) -> tuple[Reference, Solution]:
        """The same, without a care for where it ends."""
        for _ in range(ROUNDS):
            wanted, result, troubles = self._attempt(state, tolerance_mm, keep_response)
            if not troubles:
                return wanted, result
            self._refuse_travel(wanted, troubles, first_line)
            if not self._slow(wanted, troubles):  # what is left is near a cut: held, at the cost of the path
                return wanted, self._held(wanted, result, state, keep_response)
            self._plan_again()
        wanted, free, troubles = self._attempt(state, tolerance_mm, keep_response)
        if self._ends != WHOLE:
            return wanted, self._held(wanted, free, state, keep_response)
        result = solve(self.model, wanted, state, keep_response=keep_response)
        if result.utilisation > 1.0 + ENOUGH:
            place = self._place(wanted, troubles[0], first_line)
            raise LimitsError(
                f"{place}: however slow this is made, {result.utilisation:.2f} times a limit is asked for."
            )
        return wanted, result

    def _held(self, wanted: Reference, free: Solution, state: FloatArray, keep_response: bool) -> Solution:
        try:
            return solve(self.model, wanted, state, keep_response=keep_response)
        except SolverError:  # a warning will say where a limit is exceeded, and by how much
            return free

    def _fit(self) -> bool:
        """Make what is written last a whole number of segments, by moves that are not near a cut; if they can."""
        from scipy.optimize import brentq

        moves, plan = self.moves, self.plan
        segment_s = self.model.settings.segment_s
        whole_s = segment_s * float(np.ceil(self._lasting_s() / segment_s - KNOT))

        def longer_s(factor: float) -> float:
            self.moves, self.plan = moves, plan
            by = np.where(self._kept, 1.0, factor)
            self.moves = self._slower(by, by**2)
            self._plan_again()
            return self._lasting_s() - whole_s

        if longer_s(SLOWEST) < 0.0:
            return False
        if longer_s(1.0) < 0.0:
            longer_s(float(brentq(longer_s, SLOWEST, 1.0, xtol=1e-15, rtol=1e-14)))
        return True

    def _lasting_s(self) -> float:
        """How long what is written lasts, as far as it ends in motion."""
        plan, (begin, end) = cast(Trajectory, self.plan), self._ends
        first_t = self._begin_t - self.model.settings.lead_s if begin is None else begin.on(plan)
        return (self.plan.end_t if end is None else end.on(plan)) - first_t

    def _attempt(
        self, state: FloatArray, tolerance_mm: float, keep_response: bool
    ) -> tuple[Reference, Solution, list[Trouble]]:
        model = self.model
        wanted = self._ends.reference(self.plan, self.run, model.settings)
        between = self._ends.knots(wanted, self.plan)
        free = solve(model, wanted, state, keep_response=keep_response, enforce_limits=False)
        excess = excess_of(model, free, between)
        shares = utilisation_from_rest(free.vertices, model.limits)[1:-1]
        troubles = _among(of_the_path(self._asked_by_the_path(wanted), shares), between)
        if not troubles and excess <= 1.0:
            troubles = _among(of_playing(_late(model, wanted, free.vertices)), between)
        if troubles or excess <= 1.0:
            return wanted, free, troubles
        try:
            result = solve(model, wanted, state, keep_response=keep_response)
        except SolverError:  # no command keeps the limits
            return wanted, free, _among(of_the_command(shares), between)
        troubles = _among(of_the_answer(result, shares, tolerance_mm, model), between)
        troubles += _among(of_playing(_late(model, wanted, result.vertices)), between)
        return wanted, result, troubles

    def _asked_by_the_path(self, wanted: Reference) -> FloatArray:
        """Shares (n, 3, 3), the largest for any place of the knots: a slower beginning shifts all that follow."""
        s, limits = self.model.settings, self.model.limits
        knots = wanted.t0 + np.arange(wanted.knots + 1, dtype=np.float64) * s.segment_s
        paths = (wanted.nozzle(knots + s.segment_s * part / PHASES) for part in range(PHASES))
        return np.asarray(np.max([utilisation_from_rest(path, limits)[1:-1] for path in paths], axis=0))

    def _refuse_travel(self, wanted: Reference, troubles: list[Trouble], first_line: int) -> None:
        low, high = self.model.limits.travel_mm
        for trouble in troubles:
            if trouble.limit == TRAVEL and np.isnan(trouble.factor):
                height = self.model.kinematics.inverse(wanted.at_knots(np.arange(trouble.first, trouble.last + 2)))
                worst = height[np.argmax(np.abs(height[:, trouble.carriage] - 0.5 * (low + high))), trouble.carriage]
                raise LimitsError(
                    f"{self._place(wanted, trouble, first_line)}: the path needs carriage {'ABC'[trouble.carriage]} "
                    f"at {worst:.2f} mm; it travels from {low:g} to {high:g} mm."
                )

    def _place(self, wanted: Reference, trouble: Trouble, first_line: int) -> str:
        touched = self._touched(wanted, trouble)
        return f"line {first_line + int(self.moves.line[touched[0]]) + 1}"

    def _touched(self, wanted: Reference, trouble: Trouble) -> IntArray:
        """The moves under way from a segment before the trouble to a segment after it; at least one."""
        segment_s = self.model.settings.segment_s
        begin = wanted.t0 + (trouble.first - 1) * segment_s
        end = wanted.t0 + (trouble.last + 2) * segment_s
        within = np.clip([begin, end], self.run.begin_t, self.run.end_t - 1e-9)
        first, last = self.plan.move_at(within)
        under_way = np.arange(first, last + 1)
        return under_way[self.plan.duration[under_way] > 0.0]

    def _slow(self, wanted: Reference, troubles: list[Trouble]) -> bool:
        """Make the moves that troubles come from slower; of several factors, a move gets the smallest.

        False: all of them have to keep their speed
        """
        by_speed, by_acceleration = np.ones(len(self.moves)), np.ones(len(self.moves))
        for trouble in troubles:
            touched = self._touched(wanted, trouble)
            if trouble.limit == PLAYABLE:
                touched = self._with_own_limits(touched)
            touched = touched[~self._kept[touched]]
            for move in touched:
                self.reasons.setdefault(int(move), trouble)
            if trouble.limit == VELOCITY:
                by_speed[touched] = np.minimum(by_speed[touched], trouble.factor)
                continue
            by_acceleration[touched] = np.minimum(by_acceleration[touched], trouble.factor)
            if self._steady(wanted, trouble):
                by_speed[touched] = np.minimum(by_speed[touched], np.sqrt(trouble.factor))
        self.moves = self._slower(by_speed, by_acceleration)
        return bool((np.minimum(by_speed, by_acceleration) < 1.0).any())

    def _with_own_limits(self, moves: IntArray) -> IntArray:
        """Those that lift the nozzle or pull filament back: their acceleration no G-code file can raise."""
        direction = self.plan.direction[moves]
        own = (direction[:, 2] != 0.0) | (direction[:, 3] < 0.0)
        return moves[own] if own.any() else moves

    def _slower(self, by_speed: FloatArray, by_acceleration: FloatArray) -> Moves:
        """The moves with their top speeds times one factor (n,), acceleration and corners times another."""
        moves, limits = self.moves, self._limits
        bounds = bounds_of(moves, lines_of(moves), limits)
        set_corner = moves.square_corner_velocity
        corner = np.where(np.isnan(set_corner), limits.square_corner_velocity_mm_per_s, set_corner)
        top = self._speeds(np.arange(len(moves))) * by_speed
        return replace(
            moves,
            speed=np.where(by_speed < 1.0, np.minimum(moves.speed, top), moves.speed),
            acceleration=np.where(by_acceleration < 1.0, bounds.acceleration * by_acceleration, moves.acceleration),
            square_corner_velocity=np.where(by_acceleration < 1.0, corner * by_acceleration, set_corner),
        )

    def _speeds(self, moves: IntArray) -> FloatArray:
        """The highest speed of moves (n,) in the plan, mm/s: in the middle of their cruising."""
        plan = self.plan
        at = plan.start_t[moves] + plan.accel_t[moves] + 0.5 * plan.cruise_t[moves]
        within = np.nextafter(plan.start_t[moves] + plan.duration[moves], -np.inf)
        return np.asarray(np.sqrt((plan.velocity(np.minimum(at, within))[:, :3] ** 2).sum(axis=1)))

    def _steady(self, wanted: Reference, trouble: Trouble) -> bool:
        """Whether the nozzle keeps its speed throughout the trouble: then it is speed that asks for acceleration."""
        knots = np.arange(trouble.first - 1, trouble.last + 3)
        t = wanted.t0 + knots * self.model.settings.segment_s
        speed = np.sqrt((self.plan.velocity(t)[:, :3] ** 2).sum(axis=1))
        return bool(np.ptp(speed) <= STEADY * speed.max())

    def records(
        self, planned_s: FloatArray, first_line: int, layer_of: Callable[[int], int | None]
    ) -> Iterator[TimeScaling]:
        """One for each group of moves that lie close together. planned_s : (n,) how long they took at first."""
        slowed = np.array(sorted(self.reasons))
        for group in np.split(slowed, np.flatnonzero(np.diff(slowed) > APART) + 1):
            worst = max((self.reasons[int(move)] for move in group), key=lambda trouble: trouble.asked)
            all_moves = slice(group[0], group[-1] + 1)
            before, after = planned_s[all_moves].sum(), self.plan.duration[all_moves].sum()
            yield TimeScaling(
                first_line + int(self.moves.line[group[0]]) + 1,
                first_line + int(self.moves.line[group[-1]]) + 1,
                layer_of(int(group[0])),
                min(float(before / after), 1.0),
                float(after - before),
                "" if worst.limit == PLAYABLE else "ABC"[worst.carriage],
                "" if worst.limit == PLAYABLE else NAMES[worst.limit],
                worst.asked,
            )


def _among(troubles: Iterator[Trouble], between: tuple[int, int]) -> list[Trouble]:
    """Those that touch what is written from one knot to another."""
    return [each for each in troubles if each.last >= between[0] and each.first < between[1]]


def _slice(moves: Moves, run: Section) -> Moves:
    return Moves(*(getattr(moves, field.name)[run.first : run.last] for field in fields(moves)))


def _spliced(trajectory: Motion, run: Section, part: PlannedMotion) -> tuple[Motion, float]:
    """The whole plan with another one for a run, and by how much later what follows begins, s."""
    lost = part.end_t - run.end_t
    columns = {}
    for field in fields(trajectory):  # type: ignore[arg-type]  # every planned motion is a dataclass of columns
        whole = getattr(trajectory, field.name).copy()
        whole[run.first : run.last] = getattr(part, field.name)
        columns[field.name] = whole
    columns["start_t"][run.last :] += lost
    return replace(trajectory, **columns), lost  # type: ignore[type-var]
