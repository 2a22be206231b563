"""The main job: how closely the nozzle follows, with the command that the compensated file really plays."""

from __future__ import annotations

from functools import cache

import pytest

from ffcomp.comparison.methods import segments_motion
from ffcomp.simulation.command import SectionClock, motion_of
from validation import judge

FAR_MM = 100.0  # the star's arms reach 110 mm, 81 % of the bed's radius
TIMES_BETTER = 30  # segments are joined as far as 1 µm across the path and 3 µm along it allow
MACHINE_LIMIT_M_PER_S2 = 30.0

# The vase is taken whole: how much there is to win differs between its base and its spiral.
CASES = {name: judge.PARTS_S[name] for name in ("ringing_tower", "far_star")}


def case_of(name: str) -> judge.Case:
    return judge.case(name, CASES[name])


@cache
def both(name: str) -> tuple[judge.Answer, judge.Answer]:
    """The plant's answers to the plan itself and to the compensated file."""
    case = case_of(name)
    plain = judge.answer(case.original, case.original.motion)
    return plain, judge.answer(case.original, segments_motion(case.segments))


@pytest.mark.parametrize("name", CASES)
def test_the_nozzle_follows_thirty_times_better(name: str) -> None:
    original = case_of(name).original
    none, ours = (judge.score(original, answer) for answer in both(name))
    assert ours.tracking_rms_no_delay_um * TIMES_BETTER < none.tracking_rms_no_delay_um
    assert ours.contour_rms_um * TIMES_BETTER < none.contour_rms_um
    assert abs(ours.delay_s) < 2e-5 and ours.contour_max_um < 15.0
    assert ours.tracking_rms_um < 1.15 * ours.tracking_rms_no_delay_um, "no delay is left to be removed"


def test_so_it_does_at_eighty_percent_of_the_bed_radius() -> None:
    original = case_of("far_star").original
    none, ours = (judge.score(original, answer, FAR_MM) for answer in both("far_star"))
    assert ours.tracking_rms_no_delay_um * TIMES_BETTER < none.tracking_rms_no_delay_um
    assert ours.contour_rms_um * TIMES_BETTER < none.contour_rms_um


@pytest.mark.parametrize("name", CASES)
def test_the_command_is_one_that_motors_follow(name: str) -> None:
    none, ours = both(name)
    assert ours.peak_m_per_s2 <= MACHINE_LIMIT_M_PER_S2
    assert ours.peak_m_per_s2 <= 2 * none.peak_m_per_s2


def test_a_wrong_clock_would_be_seen() -> None:
    """The judge itself: the same command, said to be 1 ms later, has a delay of 1 ms and is told off for it."""
    case = case_of("ringing_tower")
    motion = segments_motion(case.segments)
    right = judge.judge(case.original, motion)
    clock = motion.clock
    late = SectionClock(clock.executed_t, clock.plan_t + 1e-3, clock.begin_t, clock.end_t)
    wrong = judge.judge(case.original, motion_of(case.segments.trajectory, late))
    assert wrong.delay_s == pytest.approx(right.delay_s + 1e-3, abs=2e-5)
    assert wrong.tracking_rms_um > 20 * right.tracking_rms_um
