"""The reference motion of one section, sampled on the inverse's own knots."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffcomp.inverse.settings import CUT, Settings
from ffcomp.planner.trajectory import PathPosition, Section, Trajectory
from gcode.program import Moves
from models.arrays import FloatArray

LEAST_S = 0.003  # least time of a command beyond a section that extrudes
ALL_ROOM_FROM_S = 5.0  # of motion
ROUNDING = 1e-6  # of a segment
SHORTEST_S = 1e-3  # between lines of the file that cut segments
FLOW_KNOTS = 6  # on either side of late segments, where the filament follows the command
CALM_KNOTS = 10  # inverted plainly on either side of segments where the robust command exceeds a limit
STANDS_MM = 1e-9
LEAST_CONTEXT_S = 3.0  # of motion on either side of a cut: to plan, to settle and to look ahead
SLOWEST_RAMPS = 3.0  # times the duration of the slowest ramp, at least
CRUISE_RATIO = 0.5  # where the file says nothing


def rooms_of(section: Section, settings: Settings, flows: bool) -> Iterator[float]:
    """Yield increasing time on either side of a section, in whole segments, below the most that the settings allow, s.

    A command that begins with its path must jump by what the machine gives way, and the less time it has, the harder it
    does. A travel may begin without any: nothing shows where it is late. A long section gets all of the time: it costs
    nothing, and where a motion is cut, both sides must find the same knots.
    """
    duration_s = section.end_t - section.begin_t
    if duration_s <= ALL_ROOM_FROM_S:
        fewest = _segments_of(duration_s + (LEAST_S if flows else 0.0), settings.segment_s)
        most = _segments_of(duration_s + (settings.lead_s + settings.tail_s), settings.segment_s)
        for segments in range(fewest, most):
            yield 0.5 * (segments * settings.segment_s - duration_s)


def _segments_of(duration_s: float, segment_s: float) -> int:
    """Return how many segments a section of this duration has."""
    return math.ceil(duration_s / segment_s - ROUNDING)


class Extent(NamedTuple):
    """Which part of a section is written."""

    begin: PathPosition | None = None  # None: from the section's beginning
    end: PathPosition | None = None  # None: to the section's end

    def written_s(self, plan: Trajectory, begin_t: float) -> float:
        """Return the duration of the written part, s, as far as it ends in motion; begin_t : of the first knot, s."""
        begin, end = self
        return (plan.end_t if end is None else end.time_in(plan)) - (begin_t if begin is None else begin.time_in(plan))

    def near(self, plan: Trajectory, within_s: float) -> list[slice]:
        """Find the moves that are executed within a time of the cuts."""
        cuts = [each.time_in(plan) for each in self if each is not None]
        return [slice(int(plan.move_at(t - within_s)), int(plan.move_at(t + within_s)) + 1) for t in cuts]


WHOLE = Extent()


class Reference:
    """The reference motion of one section on its own knots, S seconds apart; sampled on demand.

    Knot 0 lies before the section begins, because the plant lags and the command may have to start before the path;
    the last knot lies after its end. Outside the section the nozzle rests.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        section: Section,
        settings: Settings,
        extent: Extent = WHOLE,
        room_s: float | None = None,
    ) -> None:
        """Lay the knots.

        trajectory, section, settings : input and its sampling
        extent : the part that is written; where it begins in motion, there is a knot, whose number divides by CUT
        room_s : time of the command on either side of its path; None: all that the settings allow
        """
        begin_t, end_t = (None if cut is None else cut.time_in(trajectory) for cut in extent)
        # by rounding, the next section may begin just before this one ends, and elsewhere
        trajectory = trajectory.part(slice(section.first, section.last))
        lead_s, tail_s = (settings.lead_s, settings.tail_s) if room_s is None else (room_s, room_s)
        self.robust_offset: FloatArray | None = None  # (rows, 3) mm, where it is known already
        self._evened_mm: FloatArray | None = None  # (n + 1,) the filament ahead of the plan's at the knots: `even_flow`
        self.t0 = section.begin_t - lead_s  # s on the plan's clock
        if begin_t is not None:
            cuts = int(np.ceil((begin_t - self.t0) / settings.segment_s / CUT))
            self.t0 = begin_t - CUT * cuts * settings.segment_s
        length = section.end_t - self.t0 + tail_s
        self.knots = _segments_of(length, settings.segment_s)
        self.shortest_knots = min(SHORTEST_S / settings.segment_s, 1.0)
        self._trajectory, self._section = trajectory, section
        self._segment_s, self._substep_s = settings.segment_s, settings.segment_s / settings.substeps
        self._substeps = settings.substeps
        self.extent = extent
        # the command is written between these knots
        first = 0 if begin_t is None else round(self.knot_of(begin_t))
        self.written = first, self.knots if end_t is None else round(self.knot_of(end_t))

    def substeps(self, last: int) -> tuple[FloatArray, FloatArray]:
        """Return nozzle (m, 3) mm and velocity (m, 3) mm/s at every substep until a knot, included."""
        t = self.t0 + np.arange(last * self._substeps + 1, dtype=np.float64) * self._substep_s
        return self._trajectory.motion_within(t, self._section.begin_t, self._section.end_t)

    def nozzle(self, t: FloatArray) -> FloatArray:
        """Return the nozzle (m, 3) mm at times (m,) s of the plan's clock."""
        return np.ascontiguousarray(self._position(t)[:, :3])

    def path(self) -> tuple[FloatArray, FloatArray]:
        """Return when each corner of the section's path is due, (n + 1,) s, and where it is, (n + 1, 3) mm."""
        plan, end_t = self._trajectory, self._section.end_t
        due = np.maximum.accumulate(np.append(plan.start_t, end_t))  # by rounding they may fall
        return due, np.vstack([plan.origin[:, :3], self.nozzle(np.array([end_t]))])

    @property
    def acceleration_mm_per_s2(self) -> float:
        """The largest acceleration of the path."""
        return float(self._trajectory.acceleration.max())

    def moving(self, t: FloatArray) -> NDArray[np.bool_]:
        """Return whether the section is under way at times (m,) s of the plan's clock."""
        return np.asarray((t > self._section.begin_t) & (t < self._section.end_t))

    def at_knots(self, knots: NDArray[np.int64]) -> FloatArray:
        """Return the nozzle at these knots, (m, 3) mm; there are knots before the first and after the last, at rest."""
        return self.nozzle(self.t0 + knots.astype(np.float64) * self._segment_s)

    def knot_of(self, t: float) -> float:
        """Return where a time of the plan's clock lies among the knots."""
        return (t - self.t0) / self._segment_s

    def extrusion(self, first: int = 0, last: int | None = None) -> FloatArray:
        """Return the filament at the knots first … last (all of them), (n,) mm."""
        last = self.knots if last is None else last
        filament = self._filament + (0.0 if self._evened_mm is None else self._evened_mm)  # callers change it
        return filament[first : last + 1]

    @cached_property
    def _filament(self) -> FloatArray:
        """The filament at all knots, (n + 1,) mm; needed to solve, time and write a section."""
        return self._position(self._knots_t)[:, 3]

    @property
    def _knots_t(self) -> FloatArray:
        return self.t0 + np.arange(self.knots + 1, dtype=np.float64) * self._segment_s

    def even_flow(self, vertices: FloatArray, around: NDArray[np.bool_] | None, fixed: Iterable[float] = ()) -> None:
        """Let the filament follow the command's travel around some segments, instead of the plan's.

        A firmware slows down where the filament per mm changes. Near a hard corner the command runs ahead of its path
        or behind it, so the plan's filament per mm of the command changes. Here each line keeps its filament per mm.
        The sum around the segments stays the same, nothing flows where nothing did, and a retraction stays that of the
        plan: in one sum with it, the flow before would grow. Without this a pressure advance pattern was 4.4 % longer,
        not 1.5 %.

        vertices : (n + 1, 3) mm, the command at the knots
        around : (n,) the segments; None: the filament follows the plan again
        fixed : times on the plan's clock where the filament stays that of the plan, s
        """
        self._evened_mm = None
        if around is None:
            return
        position = self._position(self._knots_t)
        planned = np.diff(position[:, 3])
        way = np.sqrt((np.diff(vertices, axis=0) ** 2).sum(axis=1))
        by_plan = np.diff(self._travelled(position[:, :3]))
        fed = planned >= 0.0
        goes = np.flatnonzero(fed & (by_plan > STANDS_MM))
        if not len(goes):
            return
        nearest = goes[np.minimum(np.searchsorted(goes, np.arange(self.knots)), len(goes) - 1)]
        by_way = planned[nearest] / by_plan[nearest] * way
        weight, change = _near(around, FLOW_KNOTS) * fed, np.zeros(self.knots)
        at = [self.knot_of(t) for t in fixed]  # the knots before and after each; both the same where it is at one
        knots = sorted({math.floor(k + ROUNDING) for k in at} | {math.ceil(k - ROUNDING) for k in at})
        for part in _stretches(weight > 0.0, knots):
            by_way_mm = float(weight[part] @ by_way[part])
            if by_way_mm > 0.0:
                scale = float(weight[part] @ planned[part]) / by_way_mm
                change[part] = weight[part] * (scale * by_way[part] - planned[part])
        self._evened_mm = np.concatenate([[0.0], np.cumsum(change)])

    def _travelled(self, nozzle: FloatArray) -> FloatArray:
        """Return how far the nozzle has come along its path where it is at the knots, (n + 1,) mm."""
        times, corners = self.path()
        move = np.clip(np.searchsorted(times, self._knots_t, side="right") - 1, 0, len(corners) - 1)
        until = np.concatenate([[0.0], np.cumsum(np.sqrt((np.diff(corners, axis=0) ** 2).sum(axis=1)))])
        return until[move] + np.sqrt(((nozzle - corners[move]) ** 2).sum(axis=1))

    def take_offset_of(self, other: Reference) -> None:
        """Take the robust offset of the same section on other knots: it is smooth."""
        if other.robust_offset is None or not len(other.robust_offset):
            self.robust_offset = other.robust_offset
            return
        rows = len(other.robust_offset) // other.knots
        mine, theirs = (
            each.t0 + each._segment_s / rows * np.arange(1, each.knots * rows + 1, dtype=np.float64)
            for each in (self, other)
        )
        offset = np.column_stack([np.interp(mine, theirs, axis) for axis in other.robust_offset.T])
        self.robust_offset = np.where(self.moving(mine)[:, None], offset, 0.0)

    def calm(self, segments: NDArray[np.bool_]) -> None:
        """Take the robust offset away around some of the segments (n,)."""
        assert self.robust_offset is not None
        left = 1.0 - _near(segments, CALM_KNOTS)
        self.robust_offset = self.robust_offset * np.repeat(left, len(self.robust_offset) // self.knots)[:, None]

    def _position(self, t: FloatArray) -> FloatArray:
        # at end_t itself the next section may have begun, somewhere else
        last = math.nextafter(self._section.end_t, -math.inf)
        return self._trajectory.position(np.minimum(np.maximum(t, self._section.begin_t), last))


def _near(segments: NDArray[np.bool_], knots: int) -> FloatArray:
    """Return weights (n,): 1 at some of the segments, 0 where none of them is near, smooth between."""
    window = np.hanning(2 * knots + 1)
    near = np.convolve(segments, np.ones(2 * knots + 1), mode="full")[knots:-knots] > 0.5
    padded = np.pad(near.astype(np.float64), knots, mode="edge")
    return np.convolve(padded, window / window.sum(), mode="valid")


def ranges(marked: NDArray[np.bool_]) -> list[list[int]]:
    """Return the first of each range of marked segments (n,), and the one after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    return list(edges.reshape(-1, 2).tolist())


def _stretches(marked: NDArray[np.bool_], cuts: list[int]) -> Iterator[slice]:
    """Yield the ranges of marked segments, split at the cuts; cuts : rising knots."""
    for first, after in ranges(marked):
        inner = [cut for cut in cuts if first < cut < after]
        yield from (slice(*ends) for ends in pairwise([first, *inner, after]))


def context_s(moves: Moves, plan: Trajectory) -> float:
    """Return how much motion a cut needs on either side, s: a third of it must be longer than any ramp."""
    moving = plan.duration > 0.0
    ratio = np.nan_to_num(moves.minimum_cruise_ratio[moving], nan=CRUISE_RATIO)
    ramps = plan.cruise_v[moving] / (plan.acceleration[moving] * (1.0 - ratio))
    return max(LEAST_CONTEXT_S, SLOWEST_RAMPS * float(ramps.max(initial=0.0)))
