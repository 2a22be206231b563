"""Split a print of any length into chunks of some minutes that can be planned and compensated independently.

Chunks are cut where the nozzle rests. A long motion without a rest, such as a vase in one spiral, is cut in motion, at
a knot. Both chunks then hold the path around the cut, and each writes its own side of it.

A chunk also holds the limits in effect. So chunks can be compensated in parallel, and the result does not depend on how
many are. Each begins as if the printer had come to rest.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import attrgetter

import numpy as np

from ffcomp.inverse.reference import LEAST_CONTEXT_S, WHOLE, Extent, context_s
from ffcomp.inverse.settings import CUT
from ffcomp.inverse.time_scaling import TimeScaling
from ffcomp.planner.limits import lines_of
from ffcomp.planner.lookahead import stops_and_waits
from ffcomp.planner.trajectory import PathPosition, Trajectory
from gcode.layers import UNNAMED, last_feature, layer_starts
from gcode.program import LimitCommand, Moves, Program, limits_in_effect
from gcode.slicing import excerpt, join, shortened, split
from models.arrays import FloatArray, IntArray

PlanOf = Callable[[Program], Trajectory]
Ease = Callable[[Program, PathPosition, int], tuple[Moves, tuple[TimeScaling, ...]]]  # around a cut; layers before

LONGEST_S = 300.0  # of motion in a chunk
MOST_MOVES = 50_000  # moves without a rest, before they are cut in motion
CUT_CLEARANCE = 0.25  # knots around such a cut without a line of the file
SHORTEST_S = 1.0  # of a move that is left when one is cut
KNOT_ROUNDING = 1e-6  # of a segment


@dataclass(frozen=True, slots=True)
class Chunk:
    """A program from rest to rest, or what is written of it."""

    program: Program
    to_return: bool = False  # a macro that comes back has run since the last move before it
    limits: Mapping[str, LimitCommand] = field(default_factory=dict)  # in effect where it begins (`gcode.program`)
    layers: int = 0  # that have begun before it
    extent: Extent = WHOLE  # the part of it that is written
    slowed: tuple[TimeScaling, ...] = ()  # moves that were slowed down so that its end could be cut
    cuts: int = 0  # in motion, before it
    feature: str = UNNAMED  # printed at its beginning, by the last comment before it


@dataclass(frozen=True, slots=True)
class Splitting:
    """How a print is split."""

    segment_s: float  # length of a segment
    lead_s: float  # from a section's first knot to the beginning of its path
    plan_of: PlanOf  # the firmware's plan for a program
    longest_s: float = LONGEST_S  # motion without a rest, before it is cut; inf: never
    ease: Ease | None = None  # slows a motion down around a cut, where limits require it


def split_chunks(parts: Iterable[Program], splitting: Splitting) -> Iterator[Chunk]:
    """Split a file's consecutive programs at other places; the remainder of one is joined to the next."""
    ahead: Chunk | None = None
    for program in parts:
        ahead = Chunk(program) if ahead is None else replace(ahead, program=join(ahead.program, program))
        if not len(ahead.program.moves):
            continue
        known = _Known.of(ahead, splitting)
        while (cut := known.first()) is not None:
            chunk, known = cut
            yield chunk
        ahead = known.ahead
    if ahead is not None:
        yield ahead


@dataclass(frozen=True, slots=True)
class _Known:
    """The program that is not cut off yet, with its plan."""

    ahead: Chunk  # not cut off yet, with the state that the chunks before it leave
    plan: Trajectory  # of its moves; one that is cut begins as if it were whole
    begin_t: float  # s, when the next chunk begins
    splitting: Splitting

    @staticmethod
    def of(ahead: Chunk, splitting: Splitting) -> _Known:
        plan = splitting.plan_of(ahead.program)
        begin = ahead.extent.begin
        begin_t = float(plan.start_t[0]) - splitting.lead_s if begin is None else begin.time_in(plan)
        return _Known(ahead, plan, begin_t, splitting)

    def first(self) -> tuple[Chunk, _Known] | None:
        """Return the next chunk and the remainder; None: the program that follows must be known."""
        rests = rests_of(self.ahead.program)
        near = rests[self.plan.start_t[rests] <= self.begin_t + LONGEST_S]
        if near.size:
            return self._at_rest(int(near[-1]))
        rest = int(rests[0]) if rests.size else None
        latest_t = self._latest_t(rest)
        if latest_t is not None and (knots := self._clear_cut(latest_t)):
            return self._in_motion(knots, rest)
        return None if rest is None else self._at_rest(rest)

    def _latest_t(self, rest: int | None) -> float | None:
        """Return when a motion that is too long for a chunk has to be cut, s; None: it is not.

        rest : the move before which it ends; None: not in sight
        """
        longest_s, begin_t = self.splitting.longest_s, self.begin_t
        known_t = self.plan.end_t if rest is None else float(self.plan.start_t[rest - 1] + self.plan.duration[rest - 1])
        many = rest is None and len(self.plan) > MOST_MOVES and longest_s < np.inf
        if known_t <= begin_t + longest_s and not many:
            return None
        latest_t = 0.5 * (begin_t + known_t) if rest is not None else known_t - self._around_s
        return min(begin_t + LONGEST_S, latest_t)

    @property
    def _around_s(self) -> float:
        return context_s(self.ahead.program.moves, self.plan)

    def _clear_cut(self, latest_t: float) -> int:
        """Return after how many segments to cut, not later: far from the last cut and any line, in no wipe; 0: nowhere.

        Filament that is pulled back is shared out over its whole way (`ffcomp/compensation/gcode_layout.py`).
        """
        segment_s, wipes = self.splitting.segment_s, self.plan.direction[:, 3] < 0.0
        at = (self.plan.start_t - self.begin_t) / segment_s
        last = int((latest_t - self.begin_t) / segment_s + KNOT_ROUNDING) // CUT * CUT
        for knots in range(last, int(2.0 * self._around_s / segment_s), -CUT):
            i = int(np.searchsorted(at, knots))
            if np.abs(at[max(i - 1, 0) : i + 1] - knots).min() > CUT_CLEARANCE and not wipes[max(i - 1, 0)]:
                return knots
        return 0

    def _at_rest(self, move: int) -> tuple[Chunk, _Known]:
        ahead, plan = self.ahead, self.plan.part(slice(move, None))
        head, tail = split(ahead.program, move)
        limits, layers = limits_in_effect(head, ahead.limits), ahead.layers + len(layer_starts(head))
        feature = last_feature(head) or ahead.feature
        left = Chunk(tail, _to_return(head), limits, layers, cuts=ahead.cuts, feature=feature)
        begin_t = float(plan.start_t[0]) - self.splitting.lead_s
        return replace(ahead, program=head), _Known(left, plan, begin_t, self.splitting)

    def _in_motion(self, knots: int, rest: int | None) -> tuple[Chunk, _Known]:
        """Cut after about so many segments; `rest` is the move before which the motion ends, if that is known."""
        slowed = self._slowed(knots, rest)
        if slowed is not None:
            t = self._position(knots).time_in(slowed.plan)
            if another := slowed._clear_cut(t) or slowed._clear_cut(slowed.plan.end_t - self._around_s):
                return slowed._in_motion(another, rest)
        return self._cut(knots, rest)

    def _t(self, knots: int) -> float:
        return self.begin_t + knots * self.splitting.segment_s

    def _position(self, knots: int) -> PathPosition:
        t = self._t(knots)
        move = int(self.plan.move_at(t))
        return PathPosition(move, _far(self.plan.position([t])[0], self.ahead.program.moves.start[move]))

    def _cut(self, knots: int, rest: int | None) -> tuple[Chunk, _Known]:
        ahead, plan, t = self.ahead, self.plan, self._t(knots)
        place, (first, tail, begin, layers) = self._position(knots), self._from_before(knots)
        limits = limits_in_effect(excerpt(ahead.program, 0, place.move + 1), ahead.limits)
        tail = replace(tail, warnings=[])
        feature = (last_feature(excerpt(ahead.program, 0, first)) if first else "") or ahead.feature
        left = Chunk(tail, False, limits, layers, Extent(begin), cuts=ahead.cuts + 1, feature=feature)
        written = _until(ahead.program, plan, t + self._around_s, rest)
        chunk = replace(ahead, program=written, extent=Extent(ahead.extent.begin, place))
        return chunk, _Known(left, plan.part(slice(first, None)), t, self.splitting)

    def _from_before(self, knots: int) -> tuple[int, Program, PathPosition, int]:
        """Return the first move that must be known around a cut, the program from it, the cut there, layers before."""
        ahead, plan, t = self.ahead, self.plan, self._t(knots)
        first, tail = _from(ahead.program, plan, t - self._around_s)
        move = self._position(knots).move - first
        passed = layer_starts(excerpt(ahead.program, 0, first)) if first else []
        cut = PathPosition(move, _far(plan.position([t])[0], tail.moves.start[move]))
        return first, tail, cut, ahead.layers + len(passed)

    def _slowed(self, knots: int, rest: int | None) -> _Known | None:
        """Slow it down around the position of the cut; None: the limits allow its speed."""
        ease, ahead, plan, t = self.splitting.ease, self.ahead, self.plan, self._t(knots)
        if ease is None:
            return None
        first, tail, cut, layers = self._from_before(knots)
        last = None if rest is None else rest - first
        around = _until(tail, plan.part(slice(first, None)), t + self._around_s, last)
        slower, records = ease(around, cut, layers)
        if not records:
            return None
        program = replace(ahead.program, moves=_with(ahead.program.moves, first, slower))
        return _Known.of(replace(ahead, program=program, slowed=ahead.slowed + records), self.splitting)


def _with(moves: Moves, first: int, slower: Moves) -> Moves:
    changed = {}
    for name in ("speed", "acceleration", "square_corner_velocity", "minimum_cruise_ratio"):
        column = getattr(moves, name).copy()
        column[first : first + len(slower)] = getattr(slower, name)
        changed[name] = column
    return replace(moves, **changed)


def _far(place: FloatArray, start: FloatArray) -> float:
    """Return the distance from one position to another, both (4,) mm, along the nozzle's path."""
    return float(np.sqrt(((place - start)[:3] ** 2).sum()))


def _from(program: Program, plan: Trajectory, t: float) -> tuple[int, Program]:
    """Return the first move under way from a time on, and the program from it: what began long before begins then."""
    move = int(plan.move_at(t))
    start_t, duration = float(plan.start_t[move]), float(plan.duration[move])
    tail = excerpt(program, move)
    at = min(t, start_t + duration - SHORTEST_S)
    return move, shortened(tail, plan.position([at])[0], None) if at - start_t > LEAST_CONTEXT_S else tail


def _until(program: Program, plan: Trajectory, t: float, rest: int | None) -> Program:
    """Return what is under way up to a time, or to the rest before a move: what goes on long after it ends then."""
    if rest is not None and t >= plan.start_t[rest - 1] + plan.duration[rest - 1]:
        return excerpt(program, 0, rest)
    move = int(plan.move_at(t))
    start_t, duration = float(plan.start_t[move]), float(plan.duration[move])
    head = excerpt(program, 0, move + 1)
    at = max(t, start_t + SHORTEST_S)
    return shortened(head, None, plan.position([at])[0]) if start_t + duration - at > LEAST_CONTEXT_S else head


def rests_of(program: Program) -> IntArray:
    """Return the moves before whose lines the nozzle rests, but for the first."""
    moves = program.moves
    stops, _ = stops_and_waits(program)
    lines = lines_of(moves)
    extrudes = ~lines.travels & (lines.length > 0.0)
    rests = stops | extrudes
    rests[1:] |= extrudes[:-1]
    rests[1:] &= moves.line[1:] != moves.line[:-1]
    rests[:1] = False
    return np.flatnonzero(rests)


def _to_return(chunk: Program) -> bool:
    """Return whether a macro that comes back is the last to have moved the nozzle after a chunk's last move."""
    travelling = np.flatnonzero(lines_of(chunk.moves).travels)
    last = int(travelling[-1]) if len(travelling) else -1
    returns = False
    for event in chunk.events[bisect_right(chunk.events, last, key=attrgetter("move")) :]:
        returns = event.to_return(returns)
    return returns
