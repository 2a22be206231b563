"""Execute motions on the plant, in parallel, and evaluate the nozzle: tracking and contour errors.

Motions of many methods and slices go side by side in the lanes of the processor's vectors. Every motion is evaluated on
the reference plan's clock. The first SETTLE_S of every slice are left out: before them the printer may have come from
anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import partial
from typing import TypeVar

import numpy as np

from ffcomp.comparison.result import Samples
from ffcomp.comparison.sampling import SETTLE_S, PrintSlice
from ffcomp.errors import NothingToDo
from ffcomp.metrics import contour_error, end_to_end, tracking
from ffcomp.simulation.command import Motion
from ffcomp.simulation.playback import JOBS, SAMPLE_S, side_by_side, simulate_nozzles
from models.arrays import BoolArray, FloatArray
from models.machine import Machine

T = TypeVar("T")
Progress = Callable[[str, float], None]  # the present stage, and the fraction done (0 to 1)


class Stages:
    """Turn the progress of one stage after the other into that of the whole."""

    def __init__(self, progress: Progress, shares: Mapping[str, float]) -> None:
        self._progress, self._shares = progress, shares

    def __call__(self, what: str, share: float) -> None:
        """Report the stage, its number, and the share of all work that is done."""
        names = list(self._shares)
        number = names.index(what)
        before = sum(self._shares[name] for name in names[:number])
        done = (before + share * self._shares[what]) / sum(self._shares.values())
        self._progress(f"[{number + 1}/{len(names)}] {what}", done)


def in_parallel(tasks: Sequence[Callable[[], T]], what: str, progress: Progress) -> list[T]:
    """Do the tasks in parallel; an interruption waits only for those that are running."""
    progress(what, 0.0)
    pool = ThreadPoolExecutor(JOBS)
    try:
        futures = [pool.submit(task) for task in tasks]
        results = []
        for k, future in enumerate(futures):
            results.append(future.result())
            progress(what, (k + 1) / len(tasks))
        return results
    finally:
        pool.shutdown(cancel_futures=True)


@dataclass(frozen=True, eq=False)
class Execution:
    """One motion, executed on one slice."""

    print_slice: PrintSlice
    motion: Motion
    t: FloatArray  # (m,) s, on the motion's clock
    nozzle: FloatArray  # (m, 3) mm

    @property
    def counted(self) -> BoolArray:
        """(m,) samples that are evaluated."""
        return self.t >= self.motion.clock.executed_t[0] + SETTLE_S

    @property
    def due(self) -> FloatArray:
        """When the counted samples are due on the plan's clock, (k,) s."""
        return self.motion.clock.plan_time(self.t[self.counted])

    def reference(self, delay_s: float = 0.0) -> FloatArray:
        """Return where the nozzle should have been a delay before the counted samples, (k, 3) mm."""
        due = self.motion.clock.plan_time(self.t[self.counted] - delay_s)
        return np.ascontiguousarray(self.print_slice.trajectory.position(due)[:, :3])

    @property
    def contour(self) -> FloatArray:
        """The contour error of the counted samples, (k,) mm."""
        return contour_error(*self.print_slice.corners, self.due, self.nozzle[self.counted])

    def samples(self, delay_s: float) -> Samples:
        """Return what is counted."""
        part = self.print_slice
        moves = part.trajectory.move_at(self.due)
        return Samples(
            due=self.due + (part.begin_t - float(part.trajectory.start_t[0])),
            reference=self.reference(),
            late=self.reference(delay_s),
            nozzle=self.nozzle[self.counted],
            contour=self.contour,
            layer=part.layer[moves],
            feature=part.feature[moves],
            extruding=part.trajectory.extrudes[moves],
        )


def contour(executions: Sequence[Execution]) -> FloatArray:
    """Return the contour error of the counted samples, (m,) mm."""
    return np.concatenate([each.contour for each in executions])


def evaluate(executions: Sequence[Execution]) -> Samples:
    """Evaluate one method over all slices; NothingToDo if every slice is shorter than SETTLE_S."""
    executions = [each for each in executions if each.counted.any()]
    if not executions:
        raise NothingToDo(f"The requested part of the print lasts less than {SETTLE_S} s: nothing to evaluate.")
    nozzles = [each.nozzle[each.counted] for each in executions]
    delay = tracking(*end_to_end([each.reference() for each in executions], nozzles), SAMPLE_S).delay_s
    parts = [each.samples(delay) for each in executions]
    names = [each.name for each in fields(Samples) if each.name != "delay_s"]
    return Samples(**{name: np.concatenate([getattr(each, name) for each in parts]) for name in names}, delay_s=delay)


Piece = tuple[PrintSlice, Motion]


def execute(
    plant: Machine, pieces: Sequence[Piece], what: str, progress: Progress, *, coarse: bool = False
) -> list[Execution]:
    """Execute every piece from rest, in the order of the pieces; coarse as `simulate_nozzles` is."""
    groups = side_by_side([motion for _, motion in pieces])
    tasks = [partial(_together, plant, [pieces[k] for k in group], coarse) for group in groups]
    executed: dict[int, Execution] = {}
    for group, executions in zip(groups, in_parallel(tasks, what, progress), strict=True):
        executed |= zip(group, executions, strict=True)
    return [executed[k] for k in range(len(pieces))]


def _together(plant: Machine, pieces: Sequence[Piece], coarse: bool) -> list[Execution]:
    believed = pieces[0][0].machine
    played = simulate_nozzles([plant], [motion for _, motion in pieces], believed, coarse=coarse)
    return [Execution(*piece, t, nozzle) for piece, (t, nozzle) in zip(pieces, played, strict=True)]
