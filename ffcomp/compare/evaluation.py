"""How well what came out follows what was wanted: tracking, contour, what still rings, by layer and by feature.

Every motion is judged alike, on the wanted plan's clock. The first SETTLE_S of every stretch are left out: before them
the printer may have come from anywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ffcomp.compare.result import Error, Samples
from ffcomp.compare.sampling import Stretch
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

SETTLE_S = 0.5
STEADY_S = 0.03  # a straight cruise or a rest must last this long to show what still rings in it
STEADY_MM_PER_S = 1e-3  # change of the wanted speed from sample to sample that counts as none


@dataclass(frozen=True, eq=False)
class Judgement:
    samples: Samples
    late: FloatArray  # (m, 3) mm, where the nozzle should have been `delay_s` earlier
    delay_s: float  # the constant delay that explains most of the tracking error
    residual_rms_um: float


@dataclass(frozen=True, eq=False)
class Played:
    """What one motion came to on one stretch."""

    stretch: Stretch
    motion: Motion
    t: FloatArray  # (m,) s, on the motion's clock
    nozzle: FloatArray  # (m, 3) mm

    @property
    def counted(self) -> BoolArray:
        return self.t >= self.motion.clock.executed_t[0] + SETTLE_S

    def planned(self, t: FloatArray) -> FloatArray:
        """Where the nozzle should be at times (k,) s of the motion's clock, (k, 3) mm."""
        return np.ascontiguousarray(self.stretch.trajectory.position(self.motion.clock.plan_time(t))[:, :3])


def contour(played: Sequence[Played]) -> FloatArray:
    """(m,) mm: distance of the counted samples to the wanted path's segments."""
    return np.concatenate([_contour(each) for each in played])


def _contour(played: Played) -> FloatArray:
    due = played.motion.clock.plan_time(played.t[played.counted])
    return contour_error(*played.stretch.corners, due, played.nozzle[played.counted])


def judge(played: Sequence[Played]) -> Judgement:
    """One method, over all stretches."""
    played = [each for each in played if each.counted.any()]
    if not played:
        raise NothingToDo(f"The part of the print that was asked for lasts less than {SETTLE_S} s: nothing to judge.")
    times = [each.t[each.counted] for each in played]
    nozzle = [each.nozzle[each.counted] for each in played]
    wanted = [each.planned(t) for each, t in zip(played, times, strict=True)]
    delay = tracking(*end_to_end(wanted, nozzle), SAMPLE_S).delay_s
    late = [each.planned(t - delay) for each, t in zip(played, times, strict=True)]
    due = [each.motion.clock.plan_time(t) for each, t in zip(played, times, strict=True)]
    moves = [each.stretch.trajectory.move_at(d) for each, d in zip(played, due, strict=True)]
    origin = [each.stretch.begin_t - float(each.stretch.trajectory.start_t[0]) for each in played]
    samples = Samples(
        due=np.concatenate([d + o for d, o in zip(due, origin, strict=True)]),
        wanted=np.concatenate(wanted),
        nozzle=np.concatenate(nozzle),
        contour=contour(played),
        layer=np.concatenate([each.stretch.layer[m] for each, m in zip(played, moves, strict=True)]),
        feature=np.concatenate([each.stretch.feature[m] for each, m in zip(played, moves, strict=True)]),
        extruding=np.concatenate([each.stretch.extrudes[m] for each, m in zip(played, moves, strict=True)]),
    )
    residual = _residual_um([n - w for n, w in zip(nozzle, wanted, strict=True)], wanted)
    return Judgement(samples, np.concatenate(late), delay, residual)


def track(judged: Judgement, which: BoolArray, print_time_s: float, peak_acceleration: float) -> Track:
    """The TRACK of some of the samples, (m,) of them all."""
    s = judged.samples
    distance = np.linalg.norm((s.nozzle - s.wanted)[which], axis=1)
    at_equal_times = Tracking(
        rms(distance),
        float(distance.max(initial=0.0)),
        judged.delay_s,
        rms(np.linalg.norm((s.nozzle - judged.late)[which], axis=1)),
    )
    return build_track(at_equal_times, s.contour[which], print_time_s, peak_acceleration)


def contour_numbers(contour_mm: FloatArray, which: BoolArray) -> Error:
    """Of some of the samples; zeros if there are none."""
    chosen = contour_mm[which]
    found = contour_statistics(chosen)
    share = chosen.size / len(contour_mm) if chosen.size else 0.0
    return Error(found.rms_um, found.p99_um, found.max_um, share)


def by(labels: IntArray, contour_mm: FloatArray) -> dict[int, Error]:
    """Contour error of the samples that share a label."""
    return {int(k): contour_numbers(contour_mm, labels == k) for k in np.unique(labels)}


def _residual_um(errors: Sequence[FloatArray], wanted: Sequence[FloatArray]) -> float:
    """Rms of what still swings where the wanted motion is steady: about the mean error of each steady piece."""
    swinging = [piece for e, w in zip(errors, wanted, strict=True) for piece in _steady(e, w)]
    return rms(np.linalg.norm(np.concatenate(swinging), axis=1)) * 1e3 if swinging else float("nan")


def _steady(error: FloatArray, wanted: FloatArray) -> list[FloatArray]:
    bend = np.linalg.norm(np.diff(wanted, 2, axis=0), axis=1) / SAMPLE_S
    edge = np.flatnonzero(np.diff(np.concatenate([[0], (bend < STEADY_MM_PER_S).astype(np.int8), [0]])))
    long_enough = round(STEADY_S / SAMPLE_S)
    pieces = [error[a + 1 : b + 1] for a, b in edge.reshape(-1, 2) if b - a >= long_enough]
    return [piece - piece.mean(axis=0) for piece in pieces]
