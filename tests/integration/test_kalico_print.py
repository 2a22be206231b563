"""The compensated file through the real Kalico host: planned again by it, played on the independent plant."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from validation import judge

pytestmark = pytest.mark.kalico
NAME = "ringing_tower"

FREQUENCIES_HZ = {"mzv": np.arange(36.0, 43.0, 2.0), "ei": np.arange(44.0, 53.0, 2.0)}  # the best is not the last
TUNING_STEP_S = 1 / 6400
STANDS_STILL_MM_PER_S = 1e-3


@cache
def through_kalico() -> tuple[judge.Replanned, judge.Replanned]:
    """The original and the compensated file."""
    case = judge.part(NAME)
    before = judge.original_through_kalico(case.original)
    return before, judge.ours_through_kalico(case.original, case.ours, case.segments)


def test_the_host_plays_a_far_better_print() -> None:
    """25 times less contour error than the original through the host, half that of the best shaper there."""
    original = judge.part(NAME).original
    before, after = through_kalico()
    none, ours = (judge.judge(original, each.motion).contour_rms_um for each in (before, after))
    best = [
        judge.best_shaper(original, before.motion, kind, hz, step_s=TUNING_STEP_S)
        for kind, hz in FREQUENCIES_HZ.items()
    ]
    for each, hz in zip(best, FREQUENCIES_HZ.values(), strict=True):
        assert hz[0] < each.frequency_hz < hz[-1]
    assert ours * 25 < none
    assert ours * 2 < min(each.score.contour_rms_um for each in best)


def test_the_host_keeps_the_pace() -> None:
    """No more than 300 segments a second, print time within 1 %, and every move when our own planner has it."""
    before, after = (each.trajectory for each in through_kalico())
    print_s = after.end_t - after.start_t[0]
    assert len(after) / print_s <= 300
    assert print_s == pytest.approx(before.end_t - before.start_t[0], rel=0.01)
    assert np.ptp(after.start_t - judge.part(NAME).segments.trajectory.start_t) < 1e-6


def test_the_host_stops_nowhere_but_at_the_end_of_a_run() -> None:
    after = through_kalico()[1].trajectory
    stops = np.flatnonzero(after.end_v < STANDS_STILL_MM_PER_S)
    ends = np.append(judge.part(NAME).segments.starts.move[1:], len(after)) - 1
    assert set(stops.tolist()) <= set(ends.tolist())
