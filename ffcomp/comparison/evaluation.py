"""Execute motions on the plant, in parallel, and evaluate the nozzle: tracking and contour errors.

Motions of many methods and slices go side by side in the lanes of the processor's vectors. Every motion is evaluated on
the reference plan's clock. The first SETTLE_S of every slice are left out: before them the printer may have come from
anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from ffcomp.comparison.result import Error, Samples
from ffcomp.comparison.sampling import SETTLE_S, PrintSlice
from ffcomp.errors import NothingToDo
from ffcomp.metrics import Track, Tracking, build_track, contour_error, contour_statistics, end_to_end, rms, tracking
from ffcomp.simulation.command import Motion
from ffcomp.simulation.playback import JOBS, SAMPLE_S, side_by_side, simulate_nozzles
from models.arrays import BoolArray, FloatArray, IntArray
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
class MethodEvaluation:
    """One method, evaluated at m samples of all slices."""

    samples: Samples
    late: FloatArray  # (m, 3) mm, where the nozzle should have been `delay_s` earlier
    delay_s: float  # the constant delay that explains most of the tracking error


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

    def reference(self, t: FloatArray) -> FloatArray:
        """Return where the nozzle should be at times (k,) s of the motion's clock, (k, 3) mm."""
        return np.ascontiguousarray(self.print_slice.trajectory.position(self.motion.clock.plan_time(t))[:, :3])


def contour(executions: Sequence[Execution]) -> FloatArray:
    """Return the contour error of the counted samples, (m,) mm."""
    dues = [each.motion.clock.plan_time(each.t[each.counted]) for each in executions]
    pairs = zip(executions, dues, strict=True)
    return np.concatenate([contour_error(*e.print_slice.corners, due, e.nozzle[e.counted]) for e, due in pairs])


def evaluate(executions: Sequence[Execution]) -> MethodEvaluation:
    """Evaluate one method over all slices; NothingToDo if every slice is shorter than SETTLE_S."""
    executions = [each for each in executions if each.counted.any()]
    if not executions:
        raise NothingToDo(f"The requested part of the print lasts less than {SETTLE_S} s: nothing to evaluate.")
    times = [each.t[each.counted] for each in executions]
    nozzle = [each.nozzle[each.counted] for each in executions]
    reference = [each.reference(t) for each, t in zip(executions, times, strict=True)]
    delay = tracking(*end_to_end(reference, nozzle), SAMPLE_S).delay_s
    late = [each.reference(t - delay) for each, t in zip(executions, times, strict=True)]
    due = [each.motion.clock.plan_time(t) for each, t in zip(executions, times, strict=True)]
    moves = [each.print_slice.trajectory.move_at(d) for each, d in zip(executions, due, strict=True)]
    origin = [each.print_slice.begin_t - float(each.print_slice.trajectory.start_t[0]) for each in executions]
    samples = Samples(
        due=np.concatenate([d + o for d, o in zip(due, origin, strict=True)]),
        reference=np.concatenate(reference),
        nozzle=np.concatenate(nozzle),
        contour=contour(executions),
        layer=np.concatenate([each.print_slice.layer[m] for each, m in zip(executions, moves, strict=True)]),
        feature=np.concatenate([each.print_slice.feature[m] for each, m in zip(executions, moves, strict=True)]),
        extruding=np.concatenate([each.print_slice.extrudes[m] for each, m in zip(executions, moves, strict=True)]),
    )
    return MethodEvaluation(samples, np.concatenate(late), delay)


def track(evaluation: MethodEvaluation, which: BoolArray, print_time_s: float, peak_acceleration: float) -> Track:
    """Build the TRACK of some of the samples: which : (m,)."""
    s = evaluation.samples
    distance = np.linalg.norm((s.nozzle - s.reference)[which], axis=1)
    at_equal_times = Tracking(
        rms(distance),
        float(distance.max(initial=0.0)),
        evaluation.delay_s,
        rms(np.linalg.norm((s.nozzle - evaluation.late)[which], axis=1)),
    )
    return build_track(at_equal_times, s.contour[which], print_time_s, peak_acceleration)


def contour_numbers(samples: Samples, which: BoolArray) -> Error:
    """Return the contour error of some of the samples: which : (m,)."""
    error = contour_statistics(samples.contour[which])
    share = float(np.count_nonzero(which)) / max(len(which), 1)
    return Error(error.rms_um, error.p99_um, error.max_um, share)


def by(labels: IntArray, samples: Samples) -> dict[int, Error]:
    """Return the contour error by label of the samples where plastic flows, or of all if it flows nowhere."""
    shows = samples.extruding if samples.extruding.any() else np.ones(len(labels), dtype=np.bool_)
    errors = {int(k): contour_numbers(samples, shows & (labels == k)) for k in np.unique(labels[shows])}
    total = max(sum(each.share for each in errors.values()), 1e-12)
    return {k: replace(each, share=each.share / total) for k, each in errors.items()}


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
