"""The compensated file through the real Kalico host: planned again by it, played on the independent plant."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from validation import judge

pytestmark = pytest.mark.kalico

FREQUENCIES_HZ = {"mzv": np.arange(36.0, 43.0, 2.0), "ei": np.arange(44.0, 53.0, 2.0)}  # the best is not the last
TUNING_STEP_S = 1 / 6400
STANDS_STILL_MM_PER_S = 1e-3


@cache
def through_kalico(name: str) -> tuple[judge.Replanned, judge.Replanned]:
    """The original and the compensated file."""
    case = judge.part(name)
    before = judge.original_through_kalico(case.original)
    return before, judge.ours_through_kalico(case.original, case.ours, case.segments)


@pytest.mark.parametrize("name", ["ringing_tower"])
def test_the_host_plays_a_far_better_print(name: str) -> None:
    """25 times less contour error than the original through the host, half that of the best shaper there."""
    original = judge.part(name).original
    before, after = through_kalico(name)
    none, ours = (judge.judge(original, each.motion).contour_rms_um for each in (before, after))
    best = [
        judge.best_shaper(original, before.motion, kind, hz, step_s=TUNING_STEP_S)
        for kind, hz in FREQUENCIES_HZ.items()
    ]
    for each, hz in zip(best, FREQUENCIES_HZ.values(), strict=True):
        assert hz[0] < each.frequency_hz < hz[-1]
    assert ours * 25 < none
    assert ours * 2 < min(each.score.contour_rms_um for each in best)


@pytest.mark.parametrize("name", ["ringing_tower"])
def test_the_host_keeps_the_pace(name: str) -> None:
    """No more than 300 segments a second, print time within 1 %, and every move when our own planner has it."""
    before, after = (each.trajectory for each in through_kalico(name))
    print_s = after.end_t - after.start_t[0]
    assert len(after) / print_s <= 300
    assert print_s == pytest.approx(before.end_t - before.start_t[0], rel=0.01)
    assert np.ptp(after.start_t - judge.part(name).segments.trajectory.start_t) < 1e-6


@pytest.mark.parametrize("name", ["ringing_tower"])
def test_the_host_stops_nowhere_but_at_the_end_of_a_run(name: str) -> None:
    after = through_kalico(name)[1].trajectory
    stops = np.flatnonzero(after.end_v < STANDS_STILL_MM_PER_S)
    ends = np.append(judge.part(name).segments.starts.move[1:], len(after)) - 1
    assert set(stops.tolist()) <= set(ends.tolist())
