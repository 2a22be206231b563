"""Time scaling: slow the plan down where, and only where, the machine cannot follow it within its limits.

A section whose command keeps all limits is unchanged. Otherwise, in a few rounds:

    the path itself demands more than a limit, and so does its command     → those moves become slower
    the command can be constrained, but the nozzle leaves the path         → those moves become slower
    segments that the firmware cannot execute in their time                → those moves become slower
    none of these                                                          → done

In later rounds the moves around join in, farther in each: whatever is slower has to be braked for.

Lifts, and the travel next to them, may be late instead: that costs less, and the print time counts it.

Speed follows a velocity limit in proportion. Acceleration and the speed of corners follow an acceleration limit in
proportion; where the nozzle keeps its speed, in curves and far from the middle, it is v² that does.

A section that is cut in motion (`ffcomp/compensation/chunks.py`) is scaled on either side of the cut by whoever writes
that side. Both must pass the cut in the same way: moves near it keep their speed, for `scale_around_cut` has scaled
them before, once for both. The result must be whole segments again: the rest is slowed by as little as
possible.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from ffcomp.errors import LimitsError
from ffcomp.inverse.command_limits import (
    ACCELERATION,
    NAMES,
    TOLERANCE,
    TRAVEL,
    VELOCITY,
    utilisation_from_rest,
)
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.reference import SLOWEST_RAMPS, WHOLE, Reference, context_s, ranges
from ffcomp.inverse.settings import CUT
from ffcomp.inverse.solve import Solution, held, solve
from ffcomp.planner.lifts import FLOWS_MM, even_wipes, join_lifts
from ffcomp.planner.limits import PlannerLimits, bounds_of, lines_of
from ffcomp.planner.segment_timing import segment_speeds
from ffcomp.planner.trajectory import Section, Trajectory
from gcode.program import Moves, Program
from gcode.slicing import some
from models.arrays import BoolArray, FloatArray, IntArray

Command = tuple[Reference, Solution]  # of one plan
LayerOf = Callable[[int], int | None]  # move of the program → its layer

ROUNDS, LOCAL_ROUNDS = 24, 8  # from the latter on, the moves around join in
EVENED = 3  # rounds; in each, more of the filament follows the command, before moves become slower
PHASES = 4  # of the knots, where a path is sampled
APART = 8  # moves: scaled ones that lie closer share a record
LATE_MM = 1e-3  # how far a segment may fall behind
LATE_TRAVEL_MM = 0.2  # and how far in XY where no filament flows, on a machine that joins lifts: slower ones cost more
KNOT = 1e-6  # of a segment: nearer is at a knot
STEADY = 0.02  # relative variation of a speed that counts as constant

TARGET_UTILISATION = 0.98  # of a limit, that a slowed move aims at
GENTLEST, SLOWEST = 0.95, 0.4  # factors of one round
BINDING_UTILISATION = 0.85  # utilisation of a command above which its path is slowed
COMMAND_REACH_KNOTS = 10  # knots between what a path demands and what its command demands because of it
TIMING = len(NAMES)  # the kind of violation that is none of the carriages' limits
SOLVER_ACCURACY = 1e-3  # over a limit
LATE_FACTOR = 0.8  # of one round, where segments cannot be executed in their time


class Violation(NamedTuple):
    """Segments of a command where the machine cannot follow within its limits."""

    first: int
    last: int
    limit: int  # index into NAMES, or TIMING
    carriage: int
    utilisation: float  # demand over the limit
    factor: float  # of acceleration or velocity, to bring it below

    @classmethod
    def of(cls, utilisation: FloatArray, first: int, last: int) -> Violation:
        """Return the worst of some segments, whose utilisation is (n, 3, 3) by limit and carriage."""
        _, limit, carriage = np.unravel_index(utilisation.argmax(), utilisation.shape)
        worst = float(utilisation.max())
        factor = float(np.clip(TARGET_UTILISATION / worst, SLOWEST, GENTLEST))
        return cls(first, last, int(limit), int(carriage), worst, factor)


def path_violations(path: FloatArray, command: FloatArray) -> Iterator[Violation]:
    """Yield where the path demands more than a limit, and its command as well; utilisations (n, 3, 3) of both."""
    over = widened(np.any(command > BINDING_UTILISATION, axis=(1, 2)), COMMAND_REACH_KNOTS)
    for limit in (VELOCITY, ACCELERATION, TRAVEL):
        beyond = 1.0 if limit == TRAVEL else TOLERANCE
        for first, after in ranges(over & (path[:, limit] > beyond).any(axis=1)):
            found = Violation.of(path[first:after, limit : limit + 1], first, after - 1)
            yield found._replace(limit=limit, factor=np.nan if limit == TRAVEL else found.factor)


def solution_violations(solution: Solution, free: FloatArray, tolerance_mm: float) -> Iterator[Violation]:
    """Yield where limits are kept at the cost of the path, or not kept.

    free : (n, 3, 3), the utilisation by the command without limits
    """
    left = solution.demand[1:-1]
    for window in solution.limited:
        inside = slice(window.first, window.last + 1)
        if not window.error_mm <= tolerance_mm or (left[inside] > 1.0 + SOLVER_ACCURACY).any():
            demand = np.maximum(free[inside], left[inside])
            for first, after in ranges(widened(np.any(demand > 1.0, axis=(1, 2)), 2)):
                yield Violation.of(demand[first:after], window.first + first, window.first + after - 1)


def widened(marked: BoolArray, by: int) -> BoolArray:
    """Mark the neighbours of marked segments too."""
    return np.asarray(np.convolve(marked, np.ones(2 * by + 1))[by : by + len(marked)] > 0.5)


@dataclass(frozen=True, slots=True)
class Replanner:
    """Plans the moves of a section again, as the firmware does."""

    limits: PlannerLimits
    plan: Callable[[Moves, float], Trajectory]  # moves, and when they begin, s
    layer_of: LayerOf


@dataclass(frozen=True, slots=True)
class TimeScaling:
    """Record of moves that had to become slower, and why."""

    first_line: int  # of the input, from 1: moves that had to become slower
    last_line: int
    layer: int | None  # from 0; null if the file names no layers
    factor: float  # mean speed, as a share of what was planned
    seconds: float  # number [s]: lost there
    carriage: str  # A, B or C; empty: no carriage's limit
    limit: str  # velocity, acceleration or travel; empty: the firmware's own acceleration
    asked: float  # times the limit, at first

    def sentence(self) -> str:
        """Say where moves would have to become slower, by how much and why."""
        lines = f"{self.first_line}" + (f"-{self.last_line}" if self.last_line != self.first_line else "")
        layer = "" if self.layer is None else f" (layer {self.layer})"
        if self.limit:
            why = f"carriage {self.carriage} needs {self.asked:.2f} times its {self.limit} limit"
        else:
            why = "the firmware's own acceleration limit leaves too little for its segments"
        percent = f"{100 * self.factor:.0f}" if self.factor < 0.995 else f"{100 * self.factor:.2f}"  # never to 100 %
        return f"line {lines}{layer}: would have to be slowed to {percent} %, {self.seconds:.2g} s longer: {why}."


@dataclass(frozen=True, slots=True)
class PlannedSection:
    """A section to be solved within the machine's limits."""

    program: Program  # whose moves the trajectory plans
    trajectory: Trajectory
    section: Section
    reference: Reference  # the section's, by this plan
    state: FloatArray  # (18,) of the plant at the section's first knot
    replanner: Replanner  # plans as the trajectory was planned


class ScaledSection:
    """The moves of one section, while they become slower."""

    def __init__(self, model: InverseModel, request: PlannedSection, fixed: BoolArray | None = None) -> None:
        """Plan the section; fixed : (n,) the moves that keep their speed; None: those near the section's cuts."""
        self.model, self.request, self.program, self.extent = model, request, request.program, request.reference.extent
        self.reasons: dict[int, Violation] = {}  # move → why it became slower at first
        first, last = request.section.first, request.section.last
        self.moves = some(self.program.moves, slice(first, last))
        self._after_events = after_events(self.program, first, last) - first
        self._plan_again()
        self._fixed = np.zeros(len(self.moves), dtype=np.bool_) if fixed is None else fixed
        if fixed is None and self.extent != WHOLE:
            for part in self.extent.near(self.plan, context_s(self.moves, self.plan) / SLOWEST_RAMPS):
                self._fixed[part] = True

    def _plan_again(self) -> None:
        self.plan = self.request.replanner.plan(self.moves, self.request.section.begin_t)
        self.section = Section(0, len(self.moves), True, self.request.section.begin_t, self.plan.end_t)

    def solve(self, tolerance_mm: float, first: Command) -> Command:
        """Return the first feasible plan of a few rounds, and its command. first : of the original plan."""
        moves, plan = self.moves, self.plan
        reference, solution = self.scale(tolerance_mm, first)
        if self.reasons and self.extent.end is not None:
            if not self._fit():
                self.moves, self.plan, self.reasons = moves, plan, {}
            reference, solution, violations = self._attempt(tolerance_mm, self._free())
            solution = self._held(reference, solution) if violations else solution
        return reference, solution

    def scale(self, tolerance_mm: float, first: Command | None = None) -> Command:
        """Do the same without regard to where the written part ends."""
        for number in range(ROUNDS):
            reference, solution, violations = self._attempt(tolerance_mm, first or self._free())
            first = None
            if not violations:
                return reference, solution
            self._refuse_travel(reference, violations)
            reach = max(number - LOCAL_ROUNDS, 0)
            if not self._slow(reference, violations, reach):
                # the rest is near a cut: constrained, off the path; a warning states where a limit is still exceeded
                return reference, self._held(reference, solution)
            self._plan_again()
        reference, solution, violations = self._attempt(tolerance_mm, self._free())
        solution = self._held(reference, solution)
        if self.extent == WHOLE and solution.utilisation > 1.0 + SOLVER_ACCURACY:
            line = self._line_of(reference, violations[0])
            raise LimitsError(
                f"{line}: cannot be slowed enough: the command still needs {solution.utilisation:.2f}× a limit."
            )
        return reference, solution

    def _fit(self) -> bool:
        """Make the written part a whole number of segments by moves that are not near a cut; say whether they can."""
        settings, moves, plan = self.model.settings, self.moves, self.plan

        def written_s(factor: float) -> float:
            self.moves, self.plan = moves, plan
            by = np.where(self._fixed, 1.0, factor)
            self.moves = self._slower(by, by**2, by**2)
            self._plan_again()
            return self.extent.written_s(self.plan, self.section.begin_t - settings.lead_s)

        factor = whole_segments(written_s, settings.segment_s, SLOWEST)
        if factor is not None:
            written_s(factor)
        return factor is not None

    def _free(self) -> Command:
        """Solve on the plan as it stands, without limits."""
        reference = Reference(self.plan, self.section, self.model.settings, self.extent)
        (offset,) = self.model.robust_offsets([reference])
        reference.robust_offset = offset
        if len(offset) and self.reasons and self.extent == WHOLE:
            reference.calm(self._slower_segments(reference))
        return reference, solve(self.model, reference, self.request.state)

    def _held(self, reference: Reference, solution: Solution) -> Solution:
        return held(self.model, reference, self.request.state, solution)

    def _slower_segments(self, reference: Reference) -> BoolArray:
        """Find the segments (n,) of moves that became slower."""
        t = reference.t0 + (np.arange(reference.knots, dtype=np.float64) + 0.5) * self.model.settings.segment_s
        within = np.clip(t, self.section.begin_t, self.section.end_t - 1e-9)
        return np.isin(self.plan.move_at(within), list(self.reasons))

    def _attempt(self, tolerance_mm: float, command: Command) -> tuple[Reference, Solution, list[Violation]]:
        """List the violations in the written part of a command; where its limits alone are exceeded, with them kept."""
        model, (reference, solution) = self.model, command
        begin, end = reference.written
        asked = solution.demand

        def among(violations: Iterable[Violation]) -> list[Violation]:
            return [each for each in violations if each.last >= begin and each.first < end]

        violations = among(path_violations(self._path_utilisation(reference), asked[1:-1]))
        if violations:
            return reference, solution, violations
        whole = (begin, end) == (0, reference.knots)
        if not (asked if whole else asked[1:-1][begin:end]).max() <= 1.0:  # nor if not a number
            solution = self._held(reference, solution)
            violations = among(solution_violations(solution, asked[1:-1], tolerance_mm))
        late = late_segments(model, reference, solution.vertices, self.plan.start_t[self._after_events])
        timing = (Violation(a, b - 1, TIMING, 0, 1.0, LATE_FACTOR) for a, b in ranges(widened(late, 1)))
        return reference, solution, violations + among(timing)

    def _path_utilisation(self, reference: Reference) -> FloatArray:
        """Return the path's own utilisation (n, 3, 3), the largest for any phase of the knots.

        A slower beginning shifts all knots that follow.
        """
        s, limits = self.model.settings, self.model.limits
        knots = reference.t0 + np.arange(reference.knots + 1, dtype=np.float64) * s.segment_s
        paths = (reference.nozzle(knots + s.segment_s * part / PHASES) for part in range(PHASES))
        return np.asarray(np.max([utilisation_from_rest(path, limits)[1:-1] for path in paths], axis=0))

    def _refuse_travel(self, reference: Reference, violations: list[Violation]) -> None:
        low, high = self.model.limits.travel_mm
        for violation in violations:
            if violation.limit == TRAVEL and np.isnan(violation.factor):
                knots = np.arange(violation.first, violation.last + 2)
                height = self.model.kinematics.inverse(reference.at_knots(knots))
                worst = height[np.argmax(np.abs(height[:, violation.carriage] - 0.5 * (low + high)))]
                raise LimitsError(
                    f"{self._line_of(reference, violation)}: the path needs carriage {'ABC'[violation.carriage]} "
                    f"at {worst[violation.carriage]:.2f} mm; it travels from {low:g} to {high:g} mm."
                )

    def _line_of(self, reference: Reference, violation: Violation) -> str:
        return f"line {self.program.first_line + int(self.moves.line[self._touched(reference, violation)[0]]) + 1}"

    def _touched(self, reference: Reference, violation: Violation, reach: int = 0) -> IntArray:
        """Return the moves under way from a segment before the violation to one after it; at least one.

        reach : in segments, farther around it
        """
        segment_s = self.model.settings.segment_s
        begin = reference.t0 + (violation.first - 1 - reach) * segment_s
        end = reference.t0 + (violation.last + 2 + reach) * segment_s
        within = np.clip([begin, end], self.section.begin_t, self.section.end_t - 1e-9)
        first, last = self.plan.move_at(within)
        under_way = np.arange(first, last + 1)
        return under_way[self.plan.duration[under_way] > 0.0]

    def _slow(self, reference: Reference, violations: list[Violation], reach: int) -> bool:
        """Make the moves of the violations slower, by the smallest of several factors; False if all keep their speed.

        reach : in segments around the violations: what is slower has to be braked for, on the moves before it
        """
        by_speed, by_acceleration, by_corner = np.ones((3, len(self.moves)))
        for violation in violations:
            around = touched = self._touched(reference, violation, reach)
            if violation.limit == TIMING:  # no G-code file can raise the acceleration of a lift or a retraction
                direction = self.plan.direction[touched]
                separate = (direction[:, 2] != 0.0) | (direction[:, 3] < 0.0)
                touched = touched[separate] if separate.any() else touched
            touched = touched[~self._fixed[touched]]
            around = around[~self._fixed[around]] if touched.size else touched
            for move in touched:
                self.reasons.setdefault(int(move), violation)
            if violation.limit == VELOCITY:
                by_speed[touched] = np.minimum(by_speed[touched], violation.factor)
                continue
            by_acceleration[touched] = np.minimum(by_acceleration[touched], violation.factor)
            by_corner[around] = np.minimum(by_corner[around], violation.factor)  # Marlin's: of the move after it
            if self._steady(reference, violation):
                by_speed[touched] = np.minimum(by_speed[touched], np.sqrt(violation.factor))
        self.moves = self._slower(by_speed, by_acceleration, by_corner)
        return bool((np.minimum(by_speed, by_acceleration) < 1.0).any())

    def _slower(self, by_speed: FloatArray, by_acceleration: FloatArray, by_corner: FloatArray) -> Moves:
        """Scale the moves' top speeds, accelerations and corners by factors (n,)."""
        moves, limits = self.moves, self.request.replanner.limits
        bounds = bounds_of(moves, lines_of(moves), limits)
        set_corner, set_acceleration, gentler = moves.square_corner_velocity, moves.acceleration, by_acceleration < 1.0
        corner = np.where(np.isnan(set_corner), limits.square_corner_velocity_mm_per_s, set_corner)
        asked = np.where(np.isnan(set_acceleration), limits.acceleration_mm_per_s2, set_acceleration)
        # where Z allows less than is set, Klipper's corners and cruising follow the one that is set
        by_corner = by_corner * np.where(gentler, np.sqrt(np.minimum(bounds.acceleration / asked, 1.0)), 1.0)
        ratio = np.where(gentler, 1.0 - bounds.smooth_acceleration / bounds.acceleration, moves.minimum_cruise_ratio)
        plan = self.plan  # its moves are fastest in the middle of their cruising
        within = np.nextafter(plan.start_t + plan.duration, -np.inf)
        velocity = plan.velocity(np.minimum(plan.start_t + plan.accel_t + 0.5 * plan.cruise_t, within))[:, :3]
        top = np.asarray(np.sqrt((velocity**2).sum(axis=1))) * by_speed
        return replace(
            moves,
            speed=np.where(by_speed < 1.0, np.minimum(moves.speed, top), moves.speed),
            acceleration=np.where(gentler, bounds.acceleration * by_acceleration, set_acceleration),
            square_corner_velocity=np.where(by_corner < 1.0, corner * by_corner, set_corner),
            minimum_cruise_ratio=ratio,
        )

    def _steady(self, reference: Reference, violation: Violation) -> bool:
        """Return whether the nozzle keeps its speed throughout: then it is speed that demands acceleration."""
        t = reference.t0 + np.arange(violation.first - 1, violation.last + 3) * self.model.settings.segment_s
        speed = np.sqrt((self.plan.velocity(t)[:, :3] ** 2).sum(axis=1))
        return bool(np.ptp(speed) <= STEADY * speed.max())

    def records(self) -> tuple[TimeScaling, ...]:
        """Return a record for each group of slower moves that lie close together; LimitsError when `strict`."""
        found = tuple(self._records()) if self.reasons else ()
        if found and self.model.settings.slowing.strict:
            raise LimitsError(" ".join(record.sentence() for record in found))
        return found

    def _records(self) -> Iterator[TimeScaling]:
        section, scaled = self.request.section, np.array(sorted(self.reasons))
        planned_s = self.request.trajectory.duration[section.first : section.last]
        for group in np.split(scaled, np.flatnonzero(np.diff(scaled) > APART) + 1):
            worst = max((self.reasons[int(move)] for move in group), key=lambda violation: violation.utilisation)
            all_moves = slice(group[0], group[-1] + 1)
            before, after = planned_s[all_moves].sum(), self.plan.duration[all_moves].sum()
            yield TimeScaling(
                self.program.first_line + int(self.moves.line[group[0]]) + 1,
                self.program.first_line + int(self.moves.line[group[-1]]) + 1,
                self.request.replanner.layer_of(section.first + int(group[0])),
                min(float(before / after), 1.0),
                float(after - before),
                "" if worst.limit == TIMING else "ABC"[worst.carriage],
                "" if worst.limit == TIMING else NAMES[worst.limit],
                worst.utilisation,
            )


def whole_segments(written_s: Callable[[float], float], segment_s: float, least: float) -> float | None:
    """Return the share of their speed that moves keep for a whole number of segments; None: too little.

    written_s : returns the duration of the written part, s, at a share;  least : share
    """
    from scipy.optimize import brentq

    now_s = written_s(1.0)
    whole_s = segment_s * float(np.ceil(now_s / segment_s - KNOT))
    if written_s(least) < whole_s:
        return None
    if now_s >= whole_s:
        return 1.0
    return float(brentq(lambda share: written_s(share) - whole_s, least, 1.0, xtol=1e-15, rtol=1e-14))


def after_events(program: Program, first: int, last: int) -> IntArray:
    """Return the moves between two of a program before which a line of the file stands, (k,)."""
    events, key = program.events, attrgetter("move")
    inside = events[bisect_left(events, first + 1, key=key) : bisect_left(events, last, key=key)]
    return np.unique(np.array([event.move for event in inside], dtype=np.int64))


def late_segments(
    model: InverseModel, reference: Reference, vertices: FloatArray, events: Iterable[float] = ()
) -> BoolArray:
    """Find the segments (n,) that the firmware cannot execute in their time, where that matters.

    Where they are late with the plan's filament, the reference's filament follows the command instead.

    events : times of the file's lines on the plan's clock, s: there the filament is that of the plan
    """
    around = np.zeros(len(vertices) - 1, dtype=np.bool_)
    reference.even_flow(vertices, None)
    late = _late_segments(model, reference, vertices)
    fixed = [*events, *(reference.t0 + knot * model.settings.segment_s for knot in reference.written)]
    for _ in range(EVENED):
        if not late.any():
            return late
        around = around | late
        reference.even_flow(vertices, around, fixed)
        late = _late_segments(model, reference, vertices)
    return late


def _late_segments(model: InverseModel, reference: Reference, vertices: FloatArray) -> BoolArray:
    s = model.settings
    e, stay = reference.extrusion(), np.arange(len(vertices))
    even_wipes(e, vertices, stay % CUT == 0)
    if s.joins_lifts:
        stay = join_lifts(vertices, e, stay % CUT == 0).stay
    step, filament, lasting = np.diff(vertices[stay], axis=0), np.diff(e[stay]), np.diff(stay) * s.segment_s
    speeds = segment_speeds(vertices[stay], filament, lasting, s.output)
    behind_s = np.maximum(speeds.duration - lasting, 0.0)
    late = behind_s * speeds.cruise > LATE_MM
    if s.joins_lifts and late.any():
        waits = late & (filament <= FLOWS_MM)
        waits &= np.minimum(behind_s / lasting, 1.0) * np.hypot(step[:, 0], step[:, 1]) <= LATE_TRAVEL_MM
        late &= ~waits
    return np.repeat(late, np.diff(stay))
