"""A print at other speeds, as a firmware can be told: feeds times a factor, and one acceleration; and what that takes.

Every method keeps the same rules: the nozzle's flow, the shortest layer time, and the slicer's speed where it is kept
(bridges, overhangs, the first layer); what is kept may only become slower.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ffcomp.compare.sampling import Print, PrintSlice
from ffcomp.faster.bound import SHORTEST_LAYER_S, Bound
from ffcomp.faster.program import actuator_limit_s
from ffcomp.faster.raised_limits import RaisedLimits, raised_limits
from ffcomp.planner.lookahead import stops_and_waits
from ffcomp.planner.machine_limits import planner_limits
from ffcomp.planner.program import plan_program
from ffcomp.planner.trajectory import PlannedMotion
from gcode.layers import Labels
from gcode.program import Moves
from models.arrays import BoolArray, FloatArray, IntArray

TRAVEL = "travel"  # what does not extrude, in times by feature


@dataclass(frozen=True, eq=False)
class Stretch:
    """n moves of a print, and how fast each may become."""

    print_slice: PrintSlice
    features: tuple[str, ...]
    top: RaisedLimits

    @classmethod
    def of(cls, print_slice: PrintSlice, features: tuple[str, ...], bound: Bound) -> Stretch:
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
        return ~self.top.kept

    @property
    def kind(self) -> IntArray:
        """(n,) twice the feature, and 1 where the move extrudes."""
        return 2 * self.print_slice.feature + self.print_slice.extrudes

    def at(self, feed: float, acceleration: float) -> PrintSlice:
        """Plan with feeds times a factor and with this acceleration, mm/s²."""
        own = self.print_slice
        changed = _at(own.planned.program.moves, self.top, feed, acceleration)
        return replace(own, planned=plan_program(replace(own.planned.program, moves=changed), own.machine))


def _at(moves: Moves, top: RaisedLimits, feed: float, acceleration: float) -> Moves:
    free, travels = ~top.kept, np.any(moves.end[:, :3] != moves.start[:, :3], axis=1)
    quickest = np.minimum(moves.speed * feed, top.moves.speed)
    kept = np.where(travels, moves.speed * min(feed, 1.0), moves.speed)
    gentler = np.where(travels, np.fmin(moves.acceleration, acceleration), moves.acceleration)
    return replace(
        moves,
        speed=np.where(free, quickest, kept),
        velocity_limit=np.where(free, np.fmax(moves.velocity_limit, top.moves.velocity_limit), moves.velocity_limit),
        acceleration=np.where(free, acceleration, gentler),
    )


def seconds_of(plan: PlannedMotion) -> FloatArray:
    """Return what each move of a plan takes, (n,) s; a wait counts to the move before."""
    return np.diff(np.append(plan.start_t, plan.end_t))


class WholePrint:
    """What the whole print takes."""

    def __init__(self, printed: Print, bound: Bound) -> None:
        self.stretch = Stretch.of(printed.whole(), printed.labels.features, bound)
        self.shortest_s = SHORTEST_LAYER_S if bound.min_layer_time_s is None else bound.min_layer_time_s

    def at(self, feed: float, acceleration: float) -> FloatArray:
        """Return what each move takes with other feeds and acceleration, layers not too short, (n,) s."""
        return self.cooled(seconds_of(self.stretch.at(feed, acceleration).trajectory))

    def from_slices(self, slices: Sequence[Stretch], now_s: Sequence[FloatArray]) -> FloatArray:
        """Return what each move takes if every kind of line becomes quicker as in the slices, (n,) s.

        now_s : for each slice, what each of its moves takes
        """
        whole = self.stretch
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
        layer, free = self.stretch.print_slice.layer, self.stretch.free
        was_s, now_s = (np.bincount(layer, each) for each in (self.stretch.seconds, seconds))
        lacking_s = np.maximum(np.minimum(was_s, self.shortest_s) - now_s, 0.0)
        free_s = np.bincount(layer, seconds * free, len(now_s))
        longer = np.divide(lacking_s, free_s, out=np.zeros(len(now_s)), where=free_s > 0.0)
        return np.asarray(seconds * (1.0 + np.where(free, longer[layer], 0.0)))

    def actuator_limit_s(self) -> float:
        """Return a time that no plan of these moves can be quicker than, s."""
        program, machine = self.stretch.print_slice.planned.program, self.stretch.print_slice.machine
        return actuator_limit_s(self.stretch.top, machine, planner_limits(machine), *stops_and_waits(program))

    def by_feature(self, seconds: FloatArray) -> dict[str, float]:
        """Return where the time goes, s: what extrudes by its feature, and travel."""
        whole = self.stretch
        extrudes = whole.print_slice.extrudes
        sums = np.bincount(whole.print_slice.feature, seconds * extrudes, len(whole.features))
        found = {name: float(s) for name, s in zip(whole.features, sums, strict=True) if s > 0.0}
        return {**found, TRAVEL: float(seconds[~extrudes].sum())}
