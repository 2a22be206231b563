"""A print at other speeds, as firmware takes them, feeds times a factor and one acceleration, and the quickest of them.

Every method keeps the same rules: the nozzle's flow, the shortest layer time, and the slicer's speed where it is kept
(bridges, overhangs, the first layer); what is kept may only become slower.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ffcomp.comparison.equal_quality import HIGHEST, LOWEST, p99_um
from ffcomp.comparison.methods import TunedMethod
from ffcomp.comparison.sampling import Print, PrintSlice
from ffcomp.faster.bound import FIRST_LAYER, SHORTEST_LAYER_S, Bound, RaisedLimits, raised_limits, with_slicer_settings
from ffcomp.faster.program import FasterProgram, actuator_limit_s, faster_program
from ffcomp.inverse.model import InverseModel
from ffcomp.planner.limits import planner_limits
from ffcomp.planner.lookahead import stops_and_waits
from ffcomp.planner.program import PlannedProgram, plan_program
from ffcomp.planner.trajectory import Trajectory
from gcode.layers import Labels
from models.arrays import BoolArray, FloatArray, IntArray
from models.machine import Machine

TRAVEL = "travel"  # what does not extrude, in times by feature


@dataclass(frozen=True, eq=False)
class BoundedSlice:
    """n moves of a print, and how fast each may become."""

    print_slice: PrintSlice
    features: tuple[str, ...]
    ceiling: RaisedLimits

    @classmethod
    def of(cls, print_slice: PrintSlice, features: tuple[str, ...], bound: Bound) -> BoundedSlice:
        """Open the limits of a slice's moves as far as the bound's other limits allow."""
        machine, moves = print_slice.machine, print_slice.planned.program.moves
        named = Labels(print_slice.layer, print_slice.feature, features)
        kept = (print_slice.layer == 0) & bound.keeps_first_layer
        return cls(print_slice, features, raised_limits(moves, named, kept, bound, machine, planner_limits(machine)))

    @cached_property
    def seconds(self) -> FloatArray:
        """(n,) s that each move takes as sliced; a wait counts to the move before."""
        return seconds_of(self.print_slice.trajectory)

    @property
    def free(self) -> BoolArray:
        """(n,) moves that need not keep the slicer's motion."""
        return ~self.ceiling.kept

    @property
    def kind(self) -> IntArray:
        """(n,) twice the feature, and 1 where the move extrudes."""
        return 2 * self.print_slice.feature + self.print_slice.extrudes

    def at(self, feed: float, acceleration: float) -> PrintSlice:
        """Plan with feeds times a factor and with this acceleration, mm/s²."""
        part, free, top = self.print_slice, self.free, self.ceiling.moves
        moves = part.planned.program.moves
        travels = np.any(moves.end[:, :3] != moves.start[:, :3], axis=1)
        quickest = np.minimum(moves.speed * feed, top.speed)
        kept = np.where(travels, moves.speed * min(feed, 1.0), moves.speed)
        gentler = np.where(travels, np.fmin(moves.acceleration, acceleration), moves.acceleration)
        faster = np.fmax(moves.velocity_limit, top.velocity_limit)
        changed = replace(
            moves,
            speed=np.where(free, quickest, kept),
            velocity_limit=np.where(free, faster, moves.velocity_limit),
            acceleration=np.where(free, acceleration, gentler),
        )
        return replace(part, planned=plan_program(replace(part.planned.program, moves=changed), part.machine))

    def faster(self, model: InverseModel, bound: Bound) -> tuple[FasterProgram, PlannedProgram]:
        """Make the moves as quick as the bound allows, however short their layers become."""
        part = self.print_slice
        alone = replace(bound, min_layer_time_s=0.0, change_speed=(*bound.change_speed, FIRST_LAYER))
        kept = (part.layer == 0) & bound.keeps_first_layer
        feature = self.features[part.feature[0]]
        faster = faster_program(part.planned.program, model, alone, 1, feature, kept)
        return faster, plan_program(faster.program, part.machine)


def seconds_of(plan: Trajectory) -> FloatArray:
    """Return what each move of a plan takes, (n,) s; a wait counts to the move before."""
    return np.diff(np.append(plan.start_t, plan.end_t))


class WholePrint:
    """What the whole print takes."""

    def __init__(self, printed: Print, bound: Bound) -> None:
        self.bounded = BoundedSlice.of(printed.whole(), printed.labels.features, bound)
        self.shortest_s = SHORTEST_LAYER_S if bound.min_layer_time_s is None else bound.min_layer_time_s

    def at(self, feed: float, acceleration: float) -> FloatArray:
        """Return what each move takes with other feeds and acceleration, layers not too short, (n,) s."""
        return self.cooled(seconds_of(self.bounded.at(feed, acceleration).trajectory))

    def from_slices(self, slices: Sequence[BoundedSlice], now_s: Sequence[FloatArray]) -> FloatArray:
        """Return what each move takes if every kind of line becomes quicker as in the slices, (n,) s.

        now_s : for each slice, what each of its moves takes
        """
        whole = self.bounded
        kinds = 2 * len(whole.features)
        was, now = np.zeros(kinds), np.zeros(kinds)
        for each, seconds in zip(slices, now_s, strict=True):
            was += np.bincount(each.kind, each.seconds * each.free, kinds)
            now += np.bincount(each.kind, seconds * each.free, kinds)
        of_all = now.sum() / was.sum() if was.any() else 1.0
        ratio = np.divide(now, was, out=np.full(kinds, of_all), where=was > 0.0)
        return np.asarray(whole.seconds * np.where(whole.free, ratio[whole.kind], 1.0))

    def cooled(self, seconds: FloatArray) -> FloatArray:
        """Slow layers down that would be shorter than they may be, and than the slicer's, (n,) s."""
        layer, free = self.bounded.print_slice.layer, self.bounded.free
        was_s, now_s = (np.bincount(layer, each) for each in (self.bounded.seconds, seconds))
        lacking_s = np.maximum(np.minimum(was_s, self.shortest_s) - now_s, 0.0)
        free_s = np.bincount(layer, seconds * free, len(now_s))
        longer = np.divide(lacking_s, free_s, out=np.zeros(len(now_s)), where=free_s > 0.0)
        return np.asarray(seconds * (1.0 + np.where(free, longer[layer], 0.0)))

    def actuator_limit_s(self) -> float:
        """Return a time that no plan of these moves can be quicker than, s."""
        program, machine = self.bounded.print_slice.planned.program, self.bounded.print_slice.machine
        return actuator_limit_s(self.bounded.ceiling, machine, planner_limits(machine), *stops_and_waits(program))

    def by_feature(self, seconds: FloatArray) -> dict[str, float]:
        """Return where the time goes, s: what extrudes by its feature, and travel."""
        whole = self.bounded
        extrudes = whole.print_slice.extrudes
        sums = np.bincount(whole.print_slice.feature, seconds * extrudes, len(whole.features))
        by_feature = {name: float(s) for name, s in zip(whole.features, sums, strict=True) if s > 0.0}
        return {**by_feature, TRAVEL: float(seconds[~extrudes].sum())}


FEEDS = (1.0, 1.5, 2.25, 3.5, 0.7, 0.5, 0.35)  # times the slicer's, in the order in which they are tried
HALVINGS = 7  # of the ratio between the lowest and the highest acceleration: 4 % at the end


@dataclass(frozen=True, slots=True)
class Setting:
    """What a firmware is told."""

    feed: float
    acceleration_mm_per_s2: float
    reached: bool = True  # False: above the bound even here, the slowest that was tried


class SettingSearch:
    """Seeks one method's setting on some slices; error grows and time falls with acceleration."""

    def __init__(
        self, method: TunedMethod, bounded_slices: Sequence[BoundedSlice], plant: Machine, bound_um: float
    ) -> None:
        self.method, self.bounded_slices, self.plant, self.bound_um = method, bounded_slices, plant, bound_um

    def setting(self, feeds: Sequence[float] = FEEDS) -> Setting:
        """Return the quickest setting that keeps the bound."""
        best: Setting | None = None
        best_s = np.inf
        for feed in feeds:
            lowest = self._quicker_than(best_s, feed)
            if lowest is None or not self._keeps(feed, lowest):
                continue
            acceleration = self._highest(feed, lowest)
            seconds = self._seconds(feed, acceleration)
            if seconds < best_s:
                best, best_s = Setting(feed, acceleration), seconds
        return best or Setting(min(feeds), LOWEST, reached=False)

    def _quicker_than(self, seconds: float, feed: float) -> float | None:
        """Return the lowest acceleration that is quicker than this; None: none is."""
        if self._seconds(feed, LOWEST) < seconds:
            return LOWEST
        if self._seconds(feed, HIGHEST) >= seconds:
            return None
        low, high = np.log(LOWEST), np.log(HIGHEST)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if self._seconds(feed, float(np.exp(middle))) < seconds else (middle, high)
        return float(np.exp(high))

    def _highest(self, feed: float, lowest: float) -> float:
        """Return the highest acceleration that keeps the bound; the lowest one does."""
        if self._keeps(feed, HIGHEST):
            return HIGHEST
        low, high = np.log(lowest), np.log(HIGHEST)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if self._keeps(feed, float(np.exp(middle))) else (low, middle)
        return float(np.exp(low))

    def _keeps(self, feed: float, acceleration: float) -> bool:
        slices = [each.at(feed, acceleration) for each in self.bounded_slices]
        return p99_um(self.method, slices, self.plant) <= self.bound_um

    def _seconds(self, feed: float, acceleration: float) -> float:
        """Return the time of all slices, each kind of line as often as it is in the print, s."""
        total = 0.0
        for each in self.bounded_slices:
            planned = each.at(feed, acceleration)
            seconds = seconds_of(planned.trajectory)
            total += float(seconds.sum() if planned.weight is None else seconds @ planned.weight)
        return total


SLICE_S, EVALUATED_S = 8.0, 24.0  # length of a slice, and of all of them
ENDS = 1 << 16  # bytes at both ends of a file, in which slicers say their settings


def bound_of(printed: Print, bound: Bound) -> Bound:
    """Fill in what the user left open from the slicer's settings in the file."""
    return with_slicer_settings(bound, printed.data[:ENDS], printed.data[-ENDS:])
