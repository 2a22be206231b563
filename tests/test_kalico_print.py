"""The compensated file through the real Kalico host: planned again by it, played on the independent plant."""

from __future__ import annotations

import numpy as np
import pytest

from tests import judge

pytestmark = pytest.mark.kalico

FREQUENCIES_HZ = np.arange(36.0, 54.0, 2.0)
TUNING_STEP_S = 1 / 6400
STANDS_STILL_MM_PER_S = 1e-3


@pytest.mark.parametrize("name", judge.PRINTS)
def test_the_host_plays_a_far_better_print(name: str) -> None:
    """25 times less contour error than the original through the host, half that of the best shaper there."""
    case = judge.case(name)
    plain = judge.original_through_kalico(case.original).motion
    ours = judge.judge(case.original, judge.ours_through_kalico(case.original, case.ours, case.segments).motion)
    best = min(
        judge.best_shaper(case.original, plain, kind, FREQUENCIES_HZ, step_s=TUNING_STEP_S).score.contour_rms_um
        for kind in ("mzv", "ei")
    )
    assert ours.contour_rms_um * 25 < judge.judge(case.original, plain).contour_rms_um
    assert ours.contour_rms_um * 2 < best


@pytest.mark.parametrize("name", judge.PRINTS)
def test_the_host_keeps_the_pace(name: str) -> None:
    """No more than 300 segments a second, print time within 1 %, and every move when our own planner has it."""
    case = judge.case(name)
    theirs = judge.ours_through_kalico(case.original, case.ours, case.segments).trajectory
    before = judge.original_through_kalico(case.original).trajectory
    print_s = theirs.end_t - theirs.start_t[0]
    assert len(theirs) / print_s <= 300
    assert print_s == pytest.approx(before.end_t - before.start_t[0], rel=0.01)
    assert np.ptp(theirs.start_t - case.segments.trajectory.start_t) < 1e-6


@pytest.mark.parametrize("name", judge.PRINTS)
def test_the_host_stops_nowhere_but_at_the_end_of_a_run(name: str) -> None:
    case = judge.case(name)
    theirs = judge.ours_through_kalico(case.original, case.ours, case.segments).trajectory
    stops = np.flatnonzero(theirs.end_v < STANDS_STILL_MM_PER_S)
    ends = np.append(case.segments.first[1:], len(theirs)) - 1
    assert set(stops.tolist()) <= set(ends.tolist())
