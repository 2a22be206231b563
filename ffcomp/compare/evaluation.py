"""Evaluate the executed nozzle: tracking and contour error, residual ringing, by layer and by feature.

Every motion is evaluated on the reference plan's clock. The first SETTLE_S of every slice are left out: before them the
printer may have come from anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.compare.result import Error, Samples
from ffcomp.compare.sampling import SETTLE_S, PrintSlice
from ffcomp.errors import NothingToDo
from ffcomp.metrics import (
    Track,
    Tracking,
    build_track,
    contour_error,
    contour_statistics,
    end_to_end,
    rms,
    tracking,
)
from ffcomp.simulate.motion import Motion
from ffcomp.simulate.playback import SAMPLE_S
from models.arrays import BoolArray, FloatArray, IntArray

STEADY_S = 0.03  # a straight cruise or a rest must last this long to show residual ringing
STEADY_MM_PER_S = 1e-3  # change of the reference speed from sample to sample that counts as none


@dataclass(frozen=True, eq=False)
class MethodEvaluation:
    """One method, evaluated at m samples of all slices."""

    samples: Samples
    late: FloatArray  # (m, 3) mm, where the nozzle should have been `delay_s` earlier
    delay_s: float  # the constant delay that explains most of the tracking error
    residual_rms_um: float


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
    return np.concatenate([_contour(each) for each in executions])


def _contour(execution: Execution) -> FloatArray:
    due = execution.motion.clock.plan_time(execution.t[execution.counted])
    return contour_error(*execution.print_slice.corners, due, execution.nozzle[execution.counted])


def weights(executions: Sequence[Execution]) -> FloatArray | None:
    """Return how often each counted sample counts, (m,); None where all count alike."""
    if all(each.print_slice.weight is None for each in executions):
        return None
    return np.concatenate([_weights(each) for each in executions])


def _weights(execution: Execution) -> FloatArray:
    due = execution.motion.clock.plan_time(execution.t[execution.counted])
    weight = execution.print_slice.weight
    return np.ones(len(due)) if weight is None else weight[execution.print_slice.trajectory.move_at(due)]


def evaluate(executions: Sequence[Execution]) -> MethodEvaluation:
    """Evaluate one method over all slices.

    Raises
    ------
    NothingToDo
        If every slice is shorter than SETTLE_S.
    """
    executions = [each for each in executions if each.counted.any()]
    if not executions:
        raise NothingToDo(
            f"The part of the print that was asked for lasts less than {SETTLE_S} s: nothing to evaluate."
        )
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
        weight=np.concatenate([_weights(each) for each in executions]),
    )
    residual = _residual_um([n - w for n, w in zip(nozzle, reference, strict=True)], reference)
    return MethodEvaluation(samples, np.concatenate(late), delay, residual)


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
    return build_track(at_equal_times, s.contour[which], print_time_s, peak_acceleration, s.weight[which])


def contour_numbers(samples: Samples, which: BoolArray) -> Error:
    """Return the contour error of some of the samples: which : (m,)."""
    weight = samples.weight[which]
    found = contour_statistics(samples.contour[which], weight)
    share = float(weight.sum() / samples.weight.sum()) if weight.size else 0.0
    return Error(found.rms_um, found.p99_um, found.max_um, share)


def by(labels: IntArray, samples: Samples) -> dict[int, Error]:
    """Return the contour error of the samples that share a label, by label."""
    return {int(k): contour_numbers(samples, labels == k) for k in np.unique(labels)}


def _residual_um(errors: Sequence[FloatArray], reference: Sequence[FloatArray]) -> float:
    """Return the rms of the error about its mean where the reference is steady: residual ringing."""
    ringing = [part for e, r in zip(errors, reference, strict=True) for part in _steady(e, r)]
    return rms(np.linalg.norm(np.concatenate(ringing), axis=1)) * 1e3 if ringing else float("nan")


def _steady(error: FloatArray, reference: FloatArray) -> list[FloatArray]:
    bend = np.linalg.norm(np.diff(reference, 2, axis=0), axis=1) / SAMPLE_S
    edge = np.flatnonzero(np.diff(np.concatenate([[0], (bend < STEADY_MM_PER_S).astype(np.int8), [0]])))
    long_enough = round(STEADY_S / SAMPLE_S)
    parts = [error[a + 1 : b + 1] for a, b in edge.reshape(-1, 2) if b - a >= long_enough]
    return [part - part.mean(axis=0) for part in parts]
