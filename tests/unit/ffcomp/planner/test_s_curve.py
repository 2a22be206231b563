"""S-curves: one ramp in closed form; path, limits, time and smoothness of random programs; what they are for."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import junction_limits, plan_moves, stops_and_waits
from ffcomp.planner.s_curve import SCurve, s_curve
from ffcomp.planner.smooth import SmoothTrajectory
from ffcomp.planner.trajectory import Trajectory
from gcode.reader import read_program
from models.file import load_machine
from tests.support.programs import moves_through, random_program

FloatArray = NDArray[np.float64]

ROOT = Path(__file__).parents[4]
DATA = Path(os.environ.get("FFCOMP_DATA", ROOT / "../shared/data"))
MACHINE = load_machine(ROOT / "models/library/mp-delta-pro.toml")
PRINTS = (
    ROOT / "sample_prints/ringing_tower.gcode",
    ROOT / "sample_prints/lobed_vase.gcode",
    ROOT / "sample_prints/far_star.gcode",
    DATA / "gcode/kossel_mks-pwc.gcode",
    DATA / "gcode/flsun_v400_retract-tower.gcode",
)
SAMPLE_S = 1e-3


def carriages(xyz: FloatArray) -> FloatArray:
    return MACHINE.kinematics.compiled().inverse(xyz)


def planned(data: bytes) -> tuple[Trajectory, FloatArray]:
    """A plan, and how fast each of its moves may begin."""
    program = read_program(data, start=(0.0, 0.0, 10.0))
    stops, waits = stops_and_waits(program)
    limits = PlannerLimits(300.0, 3000.0)
    plan = plan_moves(program.moves, limits, stop_before=stops, wait_before=waits, start_t=2.0)
    return plan, junction_limits(program.moves, limits, stops | (waits > 0.0))


def one_line(mm: float = 10.0, speed: float = 100.0) -> Trajectory:
    """A straight move along x from rest to rest, at 1000 mm/s²."""
    limits = PlannerLimits(300.0, 1000.0, minimum_cruise_ratio=0.0)
    moves = moves_through(np.array([[0.0, 0.0], [mm, 0.0]]), speed)
    return plan_moves(moves, limits, stop_before=np.zeros(1, bool), wait_before=np.zeros(1))


def print_plan(path: Path) -> tuple[Trajectory, FloatArray]:
    if not path.exists():
        pytest.skip(f"{path.name} is not there; FFCOMP_DATA can say where it is.")
    own = MACHINE.limits
    program = read_program(path.read_bytes(), path.name)
    stops, waits = stops_and_waits(program)
    limits = PlannerLimits(own.velocity_mm_per_s, own.acceleration_mm_per_s2, own.square_corner_velocity_mm_per_s)
    plan = plan_moves(program.moves, limits, stop_before=stops, wait_before=waits)
    return plan, junction_limits(program.moves, limits, stops | (waits > 0.0))


def ends_of(motion: Trajectory | SmoothTrajectory) -> FloatArray:
    """Where each move has come to, a rounding before its end, (n, 4) mm."""
    lasting = motion.duration > 0.0
    return motion.position(motion.start_t[lasting] + motion.duration[lasting] * (1.0 - 1e-13))


# One ramp


def test_one_ramp_in_closed_form() -> None:
    """0 to 100 mm/s at 1000 mm/s² on average takes 0.1 s; a fifth of that for each edge makes the plateau 1250."""
    line = s_curve(one_line(20.0), settings=SCurve(slower=0.0, edge=0.2, limit_mm_per_s2=1e4))
    t = np.array([0.0, 0.01, 0.02, 0.05, 0.08, 0.09, 0.0999999999])
    assert line.duration.tolist() == pytest.approx([0.3])
    assert line.acceleration_at(t)[:, 0] == pytest.approx([0, 625, 1250, 1250, 1250, 625, 0], abs=1e-3)
    assert line.velocity(t)[:, 0] == pytest.approx([0, 3.125, 12.5, 50, 87.5, 96.875, 100], abs=1e-6)
    jerk = 1250.0 / 0.02
    assert line.position([0.02])[0, 0] == pytest.approx(jerk * 0.02**3 / 6.0)
    assert line.position([0.1, 0.2, 0.3])[:, 0] == pytest.approx([5.0, 15.0, 20.0])


def test_braking_mirrors_speeding_up() -> None:
    line = s_curve(one_line(), settings=SCurve(slower=0.0, edge=0.25, limit_mm_per_s2=1e4))
    t = np.linspace(0.0, line.end_t, 101)
    assert line.position(t)[:, 0] == pytest.approx(10.0 - line.position(line.end_t - t)[:, 0])
    assert line.velocity(t)[:, 0] == pytest.approx(line.velocity(line.end_t - t)[:, 0], abs=1e-9)


def test_a_ramp_over_many_moves_is_one_ramp() -> None:
    limits = PlannerLimits(300.0, 1000.0, minimum_cruise_ratio=0.0)
    through = np.array([0.0, 0.3, 0.31, 2.0, 4.4, 7.0, 20.0])
    moves = moves_through(np.column_stack([through, 0.0 * through]), 100.0)
    cut = plan_moves(moves, limits, stop_before=np.zeros(6, bool), wait_before=np.zeros(6))
    allowed_v = junction_limits(moves, limits, np.zeros(6, bool))
    wide = SCurve(slower=0.0, limit_mm_per_s2=1e4)
    many, one = s_curve(cut, settings=wide, allowed_v=allowed_v), s_curve(one_line(20.0), settings=wide)
    t = np.linspace(0.0, one.end_t, 1001)
    assert many.position(t) == pytest.approx(one.position(t), abs=1e-9)
    assert many.acceleration_at(t[1:-1] + 1e-7) == pytest.approx(one.acceleration_at(t[1:-1] + 1e-7), abs=1e-2)


def test_the_level_is_what_the_time_buys() -> None:
    """From rest to rest over 10 mm without cruising takes 2 sqrt(d/a): 1 % more time, 2 % less acceleration."""
    plan = one_line(10.0, 300.0)
    slow = s_curve(plan, settings=SCurve(slower=0.01, edge=0.0))
    assert slow.end_t == pytest.approx(plan.end_t * 1.01, rel=2e-3)
    assert slow.end_t <= plan.end_t * 1.01
    assert np.abs(slow.acceleration_at(np.linspace(0, slow.end_t, 1000))).max() == pytest.approx(
        1000 / 1.01**2, rel=4e-3
    )


# Any program


@pytest.mark.parametrize("seed", range(3))
def test_infinite_jerk_and_no_more_time_is_the_given_plan(seed: int) -> None:
    plan, _ = planned(random_program(seed, 20))
    same = s_curve(plan, settings=SCurve(slower=0.0, edge=0.0))
    t = np.linspace(0.0, plan.end_t + 1.0, 20_001)
    assert same.start_t == pytest.approx(plan.start_t, abs=1e-6)
    assert same.position(t) == pytest.approx(plan.position(t), abs=1e-4)
    assert same.start_v == pytest.approx(plan.start_v, abs=1e-3)
    assert same.end_v == pytest.approx(plan.end_v, abs=1e-3)


programs = st.integers(0, 10_000)


@given(programs, st.sampled_from([0.0, 0.01, 0.1]), st.sampled_from([0.0, 0.1, 0.5]))
@settings(max_examples=25, deadline=None)
def test_the_path_is_the_same(seed: int, slower: float, edge: float) -> None:
    plan, allowed_v = planned(random_program(seed, 6))
    smooth = s_curve(plan, settings=SCurve(slower=slower, edge=edge), allowed_v=allowed_v)
    assert np.array_equal(smooth.position(smooth.start_t)[plan.duration > 0], plan.origin[plan.duration > 0])
    assert ends_of(smooth) == pytest.approx(ends_of(plan), abs=1e-8)
    along = smooth.position(np.linspace(2.0, smooth.end_t, 5001))
    on = smooth.move_at(np.linspace(2.0, smooth.end_t, 5001))
    gone = ((along - plan.origin[on]) * plan.direction[on])[:, :3].sum(axis=1)
    off = along - plan.origin[on] - gone[:, None] * plan.direction[on]
    travels = plan.direction[on, :3].any(axis=1)
    assert np.abs(off[travels]).max(initial=0.0) < 1e-9  # filament too is on the line


@given(programs, st.sampled_from([0.0, 0.01, 0.1]), st.sampled_from([0.0, 0.1, 0.5]))
@settings(max_examples=25, deadline=None)
def test_it_never_turns_back_nor_exceeds_speeds_and_accelerations(seed: int, slower: float, edge: float) -> None:
    plan, allowed_v = planned(random_program(seed, 6))
    smooth = s_curve(plan, settings=SCurve(slower=slower, edge=edge), allowed_v=allowed_v)
    t = np.linspace(0.0, smooth.end_t, 20_001)
    on = smooth.move_at(t)
    speed = (smooth.velocity(t) * plan.direction[on])[:, :3].sum(axis=1)
    assert speed.min() >= -1e-9
    ends_v = np.append(allowed_v[1:], 0.0)
    assert (speed <= np.maximum.reduce([plan.cruise_v, ends_v, allowed_v])[on] * (1.0 + 1e-8) + 1e-6).all()
    assert (smooth.start_v <= np.maximum(allowed_v, plan.start_v) * (1.0 + 1e-8) + 1e-6).all()
    plateaus = np.maximum(smooth.rise[:, 1], smooth.fall[:, 1])[plan.direction[:, :3].any(axis=1)]
    file = plan.acceleration[plan.direction[:, :3].any(axis=1)]
    assert (plateaus <= file / (1.0 - edge) * (1.0 + 1e-6)).all()
    assert plateaus.max() <= file.max() * (1.0 + 1e-6)


@given(programs, st.sampled_from([0.0, 0.003, 0.01, 0.1]))
@example(94, 0.0)  # one ramp over moves of 2656 and 11337 mm/s²: a single acceleration for it would cost time
@settings(max_examples=25, deadline=None)
def test_time_and_rests_are_kept(seed: int, slower: float) -> None:
    plan, allowed_v = planned(random_program(seed, 6))
    smooth = s_curve(plan, settings=SCurve(slower=slower), allowed_v=allowed_v)
    assert smooth.duration.sum() <= plan.duration.sum() * (1.0 + slower) * (1.0 + 1e-6)
    rests, before = (motion.start_t[1:] - (motion.start_t + motion.duration)[:-1] for motion in (smooth, plan))
    assert rests == pytest.approx(before, abs=1e-9)
    resting = before > 1e-6
    assert not smooth.velocity(smooth.start_t[1:][resting] - 0.5 * before[resting]).any()


@given(programs, st.sampled_from([0.1, 0.5]))
@settings(max_examples=25, deadline=None)
def test_speed_and_acceleration_are_continuous_inside_ramps(seed: int, edge: float) -> None:
    plan, allowed_v = planned(random_program(seed, 6))
    smooth = s_curve(plan, settings=SCurve(edge=edge), allowed_v=allowed_v)
    joined = (np.diff(smooth.start_t) - smooth.duration[:-1] < 1e-12) & (smooth.duration[1:] > 0.0)
    assert smooth.end_v[:-1][joined] == pytest.approx(smooth.start_v[1:][joined], rel=1e-6, abs=1e-6)
    same_ramp = joined & (smooth.rise[1:, 4] > 0.0) & (smooth.rise[:-1, :4] == smooth.rise[1:, :4]).all(axis=1)
    gone = (smooth.rise[:, 4] + smooth.accel_t)[:-1][same_ramp]
    assert gone == pytest.approx(smooth.rise[1:, 4][same_ramp], rel=1e-12)  # the ramp goes on where it was left
    begun = (smooth.accel_t > 0.0) & (smooth.rise[:, 4] == 0.0) & (smooth.rise[:, 2] > 1e-6)
    t, h = smooth.start_t[begun], 1e-9
    assert np.abs((smooth.acceleration_at(t + h) * smooth.direction[begun])[:, :3].sum(axis=1)).max(initial=0.0) < 10.0


def test_velocity_is_the_slope_of_position_and_acceleration_that_of_velocity() -> None:
    plan, allowed_v = planned(random_program(11, 20))
    smooth = s_curve(plan, settings=SCurve(edge=0.2, slower=0.1), allowed_v=allowed_v)
    t, h = np.linspace(0.0, smooth.end_t + 1.0, 3001), 1e-6
    edges = np.cumsum([smooth.start_t, smooth.accel_t, smooth.cruise_t, smooth.decel_t], axis=0).ravel()
    t = t[np.abs(np.subtract.outer(t, edges)).min(axis=1) > 2 * h]
    slope = (smooth.position(t + h) - smooth.position(t - h)) / (2 * h)
    assert smooth.velocity(t) == pytest.approx(slope, abs=1e-6 * 300)
    bend = (smooth.velocity(t + h) - smooth.velocity(t - h)) / (2 * h)
    jerk = (smooth.rise[:, 1] / np.maximum(smooth.rise[:, 2], 1e-6)).max()
    assert smooth.acceleration_at(t) == pytest.approx(bend, rel=1e-6, abs=h * jerk)


def test_no_junction_is_planned_faster_than_it_may_be_passed() -> None:
    plan, allowed_v = planned(random_program(5, 20))
    assert (plan.start_v <= allowed_v * (1.0 + 1e-12)).all()
    assert (plan.start_v > allowed_v * (1.0 - 1e-12))[1:].mean() > 0.1  # and many are passed just so fast


def test_nothing_planned_stays_nothing() -> None:
    plan = plan_moves(
        moves_through([[0, 0]]), PlannerLimits(300.0, 3000.0), stop_before=np.zeros(0, bool), wait_before=np.zeros(0)
    )
    assert len(s_curve(plan)) == 0


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match=r"from 0 to 0\.5"):
        SCurve(edge=0.6)
    with pytest.raises(ValueError, match="zero or more"):
        SCurve(slower=-0.1)


# What they are for


def peaks(motion: Trajectory | SmoothTrajectory) -> tuple[float, float]:
    """The carriages' greatest acceleration over 4 ms, and the 99.9th percentile, mm/s²."""
    t = np.arange(0.0, motion.end_t + 0.02, 0.004)
    q = carriages(np.ascontiguousarray(motion.position(t)[:, :3]))
    bends = np.abs(np.diff(q, 2, axis=0)).max(axis=1) / 0.004**2
    return float(bends.max()), float(np.percentile(bends, 99.9))


@pytest.mark.parametrize("path", PRINTS, ids=lambda path: path.stem)
def test_real_prints_ask_for_less_in_the_same_time(path: Path) -> None:
    plan, allowed_v = print_plan(path)
    limit = SCurve(limit_mm_per_s2=MACHINE.limits.acceleration_mm_per_s2)
    smooth = s_curve(plan, carriages, limit, allowed_v=allowed_v)
    assert smooth.end_t <= 1.01 * plan.end_t
    was, now = peaks(plan), peaks(smooth)
    assert now[0] < 0.8 * was[0]
    assert now[1] < was[1]
    assert np.array_equal(smooth.position(smooth.start_t)[plan.duration > 0], plan.origin[plan.duration > 0])
