"""Choose the part of a print that is evaluated: all of it, some layers, or short slices that stand for the whole.

For slices a print is partitioned three times: by kind of line (the slicer's feature, extruding or not), by height and
by place. Of all slices that could be taken, those are chosen whose shares together come nearest to the print's, outer
walls counting double. Remaining imbalance is corrected by weights (post-stratification by kind of line; W. G.
Cochran, Sampling Techniques, 3rd ed. 1977, 5A.9).
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ffcomp.errors import NothingToDo
from ffcomp.firmware.program import PlannedProgram, known_to_the_firmware, plan_program
from ffcomp.planner.reach import within_reach
from ffcomp.planner.trajectory import Trajectory
from ffcomp.simulation.command import Motion, path_corners, planned_motion
from gcode.dialects import detect_flavor
from gcode.layers import Labels, labels, outer_walls
from gcode.program import Program
from gcode.reader import read_program
from gcode.slicing import part, preamble
from models.arrays import BoolArray, FloatArray, IntArray
from models.machine import Machine

HEIGHTS = 3  # bands of layers
OUTER_WALLS_COUNT = 2.0  # they are what shows
EXCHANGED_UP_TO = 100  # slices; among more of them a single one matters little


@dataclass(frozen=True, eq=False)
class Strata:
    """The stratum of each of n moves in every partition of a print, and the time that it takes."""

    kind: IntArray  # (n,) twice the feature, and 1 where the move extrudes
    partitions: tuple[IntArray, ...]  # each (n,), from 0; the first is `kind`
    seconds: FloatArray  # (n,)
    outer: BoolArray  # (n,) is an outer wall

    @classmethod
    def of(
        cls,
        feature: IntArray,
        layer: IntArray,
        middle_mm: FloatArray,
        seconds: FloatArray,
        extrudes: BoolArray,
        outer: BoolArray,
    ) -> Strata:
        """Partition n moves, which lie at (n, 2) mm, extrude or not, and are outer walls or not."""
        kind = 2 * feature + extrudes
        low, high = int(layer.min()), int(layer.max())
        height = (HEIGHTS * (layer - low)) // (high - low + 1)
        where = extrudes if extrudes.any() else np.ones(len(extrudes), dtype=np.bool_)
        east, north = (middle_mm > np.median(middle_mm[where], axis=0)).T
        return cls(kind, (kind, height, 2 * east + north), seconds, outer & extrudes)

    def amounts(self, begin: IntArray, end: IntArray) -> FloatArray:
        """Return the seconds (j, s) that each of j slices begin ≤ move < end spends in each of all s strata."""
        counted = self.seconds * np.where(self.outer, OUTER_WALLS_COUNT, 1.0)
        columns = []
        for partition in self.partitions:
            for stratum in range(int(partition.max()) + 1):
                until = np.concatenate([[0.0], np.cumsum(np.where(partition == stratum, counted, 0.0))])
                columns.append(until[end] - until[begin])
        return np.stack(columns, axis=1)

    def weights(self, chosen: FloatArray) -> FloatArray:
        """Return the weight (n,) of each move's samples, on average 1 over the seconds (n,) that are evaluated."""
        whole = np.bincount(self.kind, self.seconds)
        taken = np.bincount(self.kind, chosen, len(whole))
        share = np.divide(whole, taken, out=np.zeros(len(whole)), where=taken > 0.0)
        return np.asarray(share[self.kind] * taken.sum() / max(whole[taken > 0.0].sum(), 1e-12))


def choose(amounts: FloatArray, target: FloatArray, begin_t: FloatArray, end_t: FloatArray, count: int) -> IntArray:
    """Return `count` of j slices (fewer if no more fit without overlap), in the order of time.

    Parameters
    ----------
    amounts : (j, s), seconds that each slice spends in each stratum
    target : (s,), seconds of the whole print
    begin_t, end_t : (j,), where each begins and ends, s; `begin_t` never falls
    """
    choice = _Choice(amounts, target / target.sum(), begin_t, end_t)
    chosen: list[int] = []
    while len(chosen) < count and (best := choice.nearest(chosen)) is not None:
        chosen.append(best)
    if len(chosen) <= EXCHANGED_UP_TO:  # now that the others are known
        for k in range(len(chosen)):
            best = choice.nearest(chosen[:k] + chosen[k + 1 :])
            chosen[k] = chosen[k] if best is None else best
    return np.array(sorted(chosen), dtype=np.int64)


@dataclass(frozen=True, eq=False)
class _Choice:
    """The candidates."""

    amounts: FloatArray  # (j, s) s
    target: FloatArray  # (s,) shares
    begin_t: FloatArray  # (j,) s
    end_t: FloatArray  # (j,) s

    def nearest(self, chosen: list[int]) -> int | None:
        """Return the slice that brings the shares nearest to the target's; None if none is free."""
        free = self._free(chosen)
        if not free.any():
            return None
        together = self.amounts + self.amounts[chosen].sum(axis=0)
        seconds = np.maximum(together.sum(axis=1, keepdims=True), np.finfo(float).tiny)
        off = np.abs(together / seconds - self.target).sum(axis=1)
        return int(np.argmin(np.where(free, off, np.inf)))

    def _free(self, chosen: list[int]) -> BoolArray:
        """Return which slices are not empty and overlap with none that is chosen: (j,)."""
        order = sorted(chosen, key=lambda k: self.begin_t[k])
        at = np.searchsorted(self.begin_t[order], self.begin_t)
        ends, begins = np.append(-np.inf, self.end_t[order]), np.append(self.begin_t[order], np.inf)
        free: BoolArray = (ends[at] <= self.begin_t) & (self.end_t <= begins[at]) & (self.amounts.sum(axis=1) > 0.0)
        return free & ~np.isin(np.arange(len(free)), chosen)


LONGEST_S = 120.0  # of print time that is evaluated unless more is requested
SLICE_S = 4.0  # length of one slice of a sampled print
SETTLE_S = 0.5  # at the beginning of a slice, not evaluated: the printer may have come from anywhere
SHORTEST_S = 3 * SETTLE_S  # of the longest slice


@dataclass(frozen=True, slots=True)
class Sampling:
    """The layers, and the share of their time, that are evaluated."""

    first_layer: int = 0
    last_layer: int | None = None  # the last one evaluated
    share: float | None = None  # of these layers' time; None: all, but no more than LONGEST_S


WHOLE_PRINT = Sampling()


@dataclass(frozen=True, eq=False)
class PrintSlice:
    """n moves of a print, planned from rest to rest."""

    machine: Machine
    planned: PlannedProgram
    flavor: str
    offset: tuple[float, float]
    layer: IntArray  # (n,) of each move
    feature: IntArray  # (n,) of each move
    begin_t: float = 0.0  # s, on the whole print's clock
    before: bytes = b""  # lines that restore the state at its beginning
    start: tuple[float, float, float] | None = None  # mm, the nozzle's position there; None: from the file
    weight: FloatArray | None = None  # (n,) of each move's samples, if the slices represent a print; None: 1

    @property
    def trajectory(self) -> Trajectory:
        """The plan of its moves."""
        return self.planned.trajectory

    @cached_property
    def corners(self) -> tuple[FloatArray, FloatArray]:
        """Due times (n + 1,) s of the path's corners, and the corners (n + 1, 3) mm."""
        return path_corners(self.trajectory)

    @cached_property
    def motion(self) -> Motion:
        """The plan as it stands."""
        return planned_motion(self.trajectory)

    @property
    def extrudes(self) -> NDArray[np.bool_]:
        """(n,) moves that extrude along a path."""
        return _extrudes(self.trajectory)

    def with_acceleration(self, acceleration: float) -> PrintSlice:
        """Plan the same moves with another acceleration, mm/s²."""
        return replace(self, planned=accelerated(self.planned, self.machine, acceleration))


def _extrudes(trajectory: Trajectory) -> NDArray[np.bool_]:
    direction = trajectory.direction
    return np.asarray((direction[:, 3] > 0.0) & np.any(direction[:, :3] != 0.0, axis=1))


def accelerated(planned: PlannedProgram, machine: Machine, acceleration: float) -> PlannedProgram:
    """Plan the same moves with one acceleration (mm/s²) for all that travel."""
    program = planned.program
    moves = program.moves
    travels = np.any(moves.end[:, :3] != moves.start[:, :3], axis=1)
    changed = replace(moves, acceleration=np.where(travels, acceleration, moves.acceleration))
    return plan_program(replace(program, moves=changed), machine)


class Print:
    """A sliced print on a machine.

    Parameters
    ----------
    data, path : the G-code file and its name
    offset : added to every position, mm
    flavor : "" for what the machine file says, or else the file
    """

    def __init__(
        self, data: bytes, path: str, machine: Machine, offset: tuple[float, float] = (0.0, 0.0), flavor: str = ""
    ) -> None:
        self.data, self.path, self.machine, self.offset = data, path, machine, offset
        stated = flavor or machine.flavor
        program = read_program(data, path, offset_mm=offset, flavor=stated or None, **known_to_the_firmware(machine))
        self.flavor = stated or detect_flavor(program.lines)
        self.planned = plan_program(within_reach(program, machine.kinematics), machine)
        self.labels: Labels = labels(self.program)

    @property
    def program(self) -> Program:
        """The whole program."""
        return self.planned.program

    @property
    def sha256(self) -> str:
        """Of the file."""
        return hashlib.sha256(self.data).hexdigest()

    @property
    def print_time_s(self) -> float:
        """Of the whole print."""
        return self.planned.trajectory.end_t

    @cached_property
    def extrudes(self) -> NDArray[np.bool_]:
        """(n,) moves that extrude along a path."""
        return _extrudes(self.planned.trajectory)

    @cached_property
    def acceleration_mm_per_s2(self) -> float | None:
        """The acceleration of most of the outer walls' time, or of all that extrudes; None if the print names none."""
        walls = outer_walls(self.labels)
        seconds = np.where(self.extrudes, self.planned.trajectory.duration, 0.0)
        seconds = np.where(walls, seconds, 0.0) if seconds[walls].any() else seconds
        stated = self.program.moves.acceleration
        values = np.unique(stated[(seconds > 0.0) & np.isfinite(stated)])
        return float(max(values, key=lambda value: seconds[stated == value].sum())) if values.size else None

    def slices(
        self, sampling: Sampling, slice_s: float = SLICE_S, at_most_s: float = np.inf
    ) -> tuple[list[PrintSlice], str]:
        """Return the slices to be evaluated, so long each and at most so long together, and a sentence about them."""
        first, last = self._layers(sampling)
        start_t = np.append(self.planned.trajectory.start_t, self.print_time_s)
        seconds = float(start_t[last] - start_t[first])
        whole = first == 0 and last == len(self.program.moves)
        evaluated = min(LONGEST_S, seconds) if sampling.share is None else sampling.share * seconds
        evaluated = min(evaluated, at_most_s)
        last_layer = "the last" if sampling.last_layer is None else sampling.last_layer
        what = "the whole print" if whole else f"layers {sampling.first_layer} to {last_layer}"
        cuts = [] if evaluated >= seconds - slice_s / 2 else list(self._cuts(first, last, evaluated, slice_s))
        if not cuts:  # all is requested, or it is a single arc, which is not cut
            slices = [self.whole()] if whole else [self._part(first, last)]
            were = "was" if whole else "were"
            return slices, f"{what[0].upper()}{what[1:]} {were} evaluated, {seconds:.0f} s."
        strata = self._strata(first, last)
        slices = _weighted([self._part(a, b) for a, b in cuts], [a - first for a, _ in cuts], strata)
        covered = sum(each.trajectory.end_t for each in slices)
        chosen = f"{len(slices)} slices of about {covered / len(slices):.0f} s that stand for {what}"
        if len(slices) == 1:
            chosen = f"One slice of {what}"
        chosen = f"{chosen}: {covered:.0f} of {seconds:.0f} s ({covered / seconds:.0%}) were evaluated."
        return slices, chosen + self._left_out(slices, strata)

    def _layers(self, sampling: Sampling) -> tuple[int, int]:
        layer = self.labels.layer
        chosen = layer >= sampling.first_layer
        if sampling.last_layer is not None:
            chosen &= layer <= sampling.last_layer
        numbers = np.flatnonzero(chosen)
        if not numbers.size:
            raise NothingToDo(
                f"{self.path}: no move lies in the chosen layers; the print has {self.labels.layers} layers, "
                f"0 to {self.labels.layers - 1}."
            )
        return self._line_begins(int(numbers[0])), self._line_begins(int(numbers[-1]) + 1)

    def _line_begins(self, move: int) -> int:
        """Return this move, or the first one of the same line: arcs are not cut."""
        line = self.program.moves.line
        while 0 < move < len(line) and line[move] == line[move - 1]:
            move -= 1
        return move

    def _cuts(self, first: int, last: int, evaluated_s: float, slice_s: float) -> Iterator[tuple[int, int]]:
        """Yield slices from `first` to `last` that take `evaluated_s` together and stand for all between them."""
        start_t = np.append(self.planned.trajectory.start_t, self.print_time_s)
        count = max(1, round(evaluated_s / slice_s))
        length = evaluated_s / count
        cuts = np.array(list(self._candidates(first, last, length)), dtype=np.int64).reshape(-1, 2)
        if not len(cuts):
            return
        strata = self._strata(first, last)
        settled = np.minimum(np.searchsorted(start_t, start_t[cuts[:, 0]] + SETTLE_S), cuts[:, 1])
        amounts = strata.amounts(settled - first, cuts[:, 1] - first)
        whole = strata.amounts(np.array([0]), np.array([last - first]))[0]
        for k in choose(amounts, whole, start_t[cuts[:, 0]], start_t[cuts[:, 1]], count):
            yield int(cuts[k, 0]), int(cuts[k, 1])

    def _candidates(self, first: int, last: int, length: float) -> Iterator[tuple[int, int]]:
        """Yield slices of about this length; each begins and ends at rest if it can."""
        start_t = np.append(self.planned.trajectory.start_t, self.print_time_s)
        rests = np.array([run.first for run in self.planned.sections])

        def move_at(t: float) -> int:
            a = int(np.searchsorted(start_t, t))
            resting = rests[(rests >= a) & (start_t[rests] < t + length / 4)]
            return min(self._line_begins(int(resting[0]) if resting.size else a), last)

        for t in np.arange(float(start_t[first]), float(start_t[last]) - length / 2, length / 2):
            a, b = move_at(float(t)), move_at(float(t) + length)
            if b > a:
                yield a, b

    def _strata(self, first: int, last: int) -> Strata:
        """Partition the moves from `first` to `last`; a wait counts to the move before."""
        part, labels, moves = slice(first, last), self.labels, self.program.moves
        start_t = np.append(self.planned.trajectory.start_t, self.print_time_s)
        return Strata.of(
            labels.feature[part],
            labels.layer[part],
            (moves.start[part, :2] + moves.end[part, :2]) / 2,
            np.diff(start_t)[part],
            self.extrudes[part],
            outer_walls(labels)[part],
        )

    def _left_out(self, slices: list[PrintSlice], strata: Strata) -> str:
        names = self.labels.features
        seconds = np.bincount(strata.kind // 2, strata.seconds * (strata.kind % 2), len(names))
        seen = np.unique(np.concatenate([each.feature[each.extrudes] for each in slices]))
        left = [k for k in np.flatnonzero(seconds) if k not in seen]
        if not left:
            return ""
        names_left = ", ".join(f"{names[k]} ({seconds[k] / seconds.sum():.1%} of what extrudes)" for k in left)
        return f" Not among them: {names_left}."

    def whole(self) -> PrintSlice:
        """Return the whole print as one slice."""
        kinds = self.labels
        return PrintSlice(self.machine, self.planned, self.flavor, self.offset, kinds.layer, kinds.feature)

    def _part(self, first: int, last: int) -> PrintSlice:
        planned = plan_program(part(self.program, first, last), self.machine)
        x, y, z, _ = self.program.moves.start[first]
        return PrintSlice(
            machine=self.machine,
            planned=planned,
            flavor=self.flavor,
            offset=self.offset,
            layer=self.labels.layer[first:last],
            feature=self.labels.feature[first:last],
            begin_t=float(self.planned.trajectory.start_t[first]),
            before=preamble(self.program, first),
            start=(float(x), float(y), float(z)),
        )


def _weighted(slices: Sequence[PrintSlice], begins: Sequence[int], strata: Strata) -> list[PrintSlice]:
    """Weight each kind of line so that it counts as in the whole: begins are the slices' first moves in the strata."""
    evaluated = np.zeros(len(strata.kind))
    for each, begin in zip(slices, begins, strict=True):
        start_t, end_t = each.trajectory.start_t, np.append(each.trajectory.start_t[1:], each.trajectory.end_t)
        evaluated[begin : begin + len(start_t)] += np.maximum(end_t - np.maximum(start_t, SETTLE_S), 0.0)
    weight = strata.weights(evaluated)
    return [
        replace(each, weight=weight[begin : begin + len(each.trajectory)])
        for each, begin in zip(slices, begins, strict=True)
    ]


def check_long_enough(slices: Sequence[PrintSlice], path: str) -> None:
    """Raise NothingToDo if nothing is left of any slice but its beginning."""
    if max(each.trajectory.end_t for each in slices) < SHORTEST_S:
        raise NothingToDo(f"{path}: the part to be evaluated lasts less than {SHORTEST_S:g} s: nothing to compare.")
