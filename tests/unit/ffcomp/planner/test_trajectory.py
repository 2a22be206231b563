"""Sampling the plan: position, speed and acceleration agree, at any times in any order."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.planner.lifts import even_wipes
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.segment_timing import SegmentLimits, sample_segments, segment_speeds
from ffcomp.planner.trajectory import Trajectory
from gcode.program import Moves
from gcode.reader import read_program
from models.arrays import FloatArray
from tests.support.programs import moves_through, random_program


@pytest.fixture(scope="module")
def motion() -> Trajectory:
    program = read_program(random_program(11, 20), start=(0.0, 0.0, 10.0))
    stops, waits = stops_and_waits(program)
    return plan_moves(program.moves, PlannerLimits(300.0, 3000.0), stop_before=stops, wait_before=waits, start_t=2.0)


def simple(waits: list[float]) -> Trajectory:
    """1 mm along x at 10 mm/s and 100 mm/s², 1 mm along y."""
    moves = moves_through([[0, 0], [1, 0], [1, 1]], 10.0)
    limits = PlannerLimits(300.0, 100.0, minimum_cruise_ratio=0.0)
    return plan_moves(moves, limits, stop_before=np.ones(2, dtype=bool), wait_before=np.array(waits))


def boundaries(motion: Trajectory) -> np.ndarray:
    steps = [motion.start_t, motion.accel_t, motion.cruise_t, motion.decel_t]
    return np.cumsum(steps, axis=0).ravel()


def test_the_closed_form_of_one_trapezoid() -> None:
    line = simple([0.0, 0.0])
    t = np.array([0.0, 0.05, 0.1, 0.15])
    assert line.duration.tolist() == pytest.approx([0.2, 0.2])
    assert line.position(t)[:, 0] == pytest.approx([0.0, 0.125, 0.5, 0.875])
    assert line.velocity(t)[:, 0] == pytest.approx([0.0, 5.0, 10.0, 5.0])
    assert line.acceleration_at(t + 0.01)[:, 0] == pytest.approx([100.0, 100.0, -100.0, -100.0])
    assert line.position(t + 0.2)[:, 1] == pytest.approx(line.position(t)[:, 0])


def test_velocity_is_the_slope_of_position(motion: Trajectory) -> None:
    t, h = np.linspace(0.0, motion.end_t + 1.0, 50_001), 1e-6
    inside = np.min(np.abs(np.subtract.outer(t[::50], boundaries(motion))), axis=1) > 2 * h
    t = t[::50][inside]
    slope = (motion.position(t + h) - motion.position(t - h)) / (2 * h)
    assert motion.velocity(t) == pytest.approx(slope, abs=1e-6 * 300)
    bend = (motion.velocity(t + h) - motion.velocity(t - h)) / (2 * h)
    assert motion.acceleration_at(t) == pytest.approx(bend, rel=1e-6, abs=1e-3)


# ---- segment timing ----


S = 0.004


def wave(n: int = 200, seed: int = 3) -> tuple[FloatArray, FloatArray]:
    """A smooth path from rest to rest at up to 150 mm/s and 12 m/s², and filament to go with it."""
    t = np.linspace(0, 1, n + 1)
    rng = np.random.default_rng(seed)
    swell = np.sin(np.pi * t) ** 2
    xyz = np.stack([20 * swell, 15 * swell * np.sin(7 * t), 0.3 + 0.002 * np.sin(40 * t)], axis=1)
    return np.round(xyz, 4), 0.03 * np.concatenate([[0], np.cumsum(np.abs(rng.normal(0.1, 0.001, n)))])


def plan(vertices: FloatArray, e: FloatArray, speed: FloatArray, limits: SegmentLimits):  # type: ignore[no-untyped-def]
    n = len(speed)
    ends = np.column_stack([vertices, e])
    moves = Moves(
        np.arange(n), ends[:-1], ends[1:], speed, np.zeros(n, dtype=np.int64), *(np.full(n, np.nan) for _ in range(4))
    )
    firmware = PlannerLimits(
        velocity_mm_per_s=limits.velocity_mm_per_s,
        acceleration_mm_per_s2=limits.acceleration_mm_per_s2,
        square_corner_velocity_mm_per_s=limits.square_corner_velocity_mm_per_s,
        minimum_cruise_ratio=0.0,
        z_acceleration_mm_per_s2=limits.z_acceleration_mm_per_s2,
        extruder_acceleration_mm_per_s2=limits.retract_acceleration_mm_per_s2,
    )
    return plan_moves(moves, firmware, stop_before=np.zeros(n, dtype=np.bool_), wait_before=np.zeros(n))


@pytest.mark.parametrize("acceleration", [50_000.0, 100_000.0, 400_000.0])
def test_durations_come_out_exact_under_the_planner(acceleration: float) -> None:
    limits = SegmentLimits(acceleration_mm_per_s2=acceleration)
    vertices, e = wave()
    speeds = segment_speeds(vertices, np.diff(e), np.full(200, S), limits)
    trajectory = plan(vertices, e, speeds.cruise, limits)
    np.testing.assert_allclose(trajectory.duration, S, atol=2e-9)
    t = np.arange(200 * 8) * S / 8
    ours = sample_segments(vertices, speeds, 8)
    np.testing.assert_allclose(trajectory.position(t)[:, :3], ours[:-1], atol=1e-6)


@pytest.mark.parametrize("rough", [0.0, 0.01, 0.1])
def test_speeds_and_junctions_agree_with_each_other(rough: float) -> None:
    """What the sweeps come to rest at: each speed follows from its junctions, and each junction from both speeds."""
    limits = SegmentLimits(acceleration_mm_per_s2=50_000.0, square_corner_velocity_mm_per_s=1e6)
    vertices, _ = wave()
    vertices[1:-1] += np.random.default_rng(1).normal(0, rough, (199, 3))
    speeds = segment_speeds(vertices, np.zeros(200), np.full(200, S), limits)
    d = np.linalg.norm(np.diff(vertices, axis=0), axis=1)
    c, v0, v1 = speeds.cruise, speeds.junction[:-1], speeds.junction[1:]
    asked = c * S - ((c - v0) ** 2 + (c - v1) ** 2) / (2 * speeds.acceleration)
    in_time = speeds.duration < S + 1e-9
    assert in_time.mean() > 0.5
    np.testing.assert_allclose(asked[in_time], d[in_time], atol=S * 1e-9)
    assert (speeds.junction[1:-1] <= np.minimum(c[:-1], c[1:]) + 1e-9).all()


# ---- lifts ----


def hop(n: int = 12, height: float = 0.2) -> FloatArray:
    """Travel along X, a lift that speeds up and slows down, travel along Y, (·, 3) mm."""
    t = np.linspace(0.0, 1.0, n + 1)
    z = height * np.where(t < 0.5, 2 * t**2, 1 - 2 * (1 - t) ** 2)
    before = np.stack([np.linspace(-2.0, 0.0, 11), np.zeros(11), np.zeros(11)], axis=1)
    lift = np.stack([np.zeros(n + 1), np.zeros(n + 1), z], axis=1)
    after = np.stack([np.zeros(10), np.linspace(0.2, 2.0, 10), np.full(10, height)], axis=1)
    return np.concatenate([before, lift[1:], after])


def test_one_segment_takes_the_time_of_the_plan_where_many_cannot() -> None:
    """0.2 mm at the screw's own 350 mm/s²: what the plan takes, which in segments of 4 ms is out of reach."""
    n = 12
    points = hop(n)[10 : 10 + n + 1]
    least_s = 2 * (0.2 / 350.0) ** 0.5
    assert least_s < n * S < least_s + S
    limits = SegmentLimits(z_acceleration_mm_per_s2=350.0)
    many = segment_speeds(points, np.zeros(n), np.full(n, S), limits)
    one = segment_speeds(points[[0, -1]], np.zeros(1), np.array([n * S]), limits)
    assert many.duration.sum() > n * S + 1e-4
    assert one.duration.sum() == pytest.approx(n * S, rel=1e-9)


NOWHERE = np.zeros(5, dtype=np.bool_)
POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [4, 0, 0], [6, 0, 0]])


def test_a_wipe_pulls_by_the_way() -> None:
    e = np.array([0.0, -0.5, -0.6, -0.7, -1.2])
    even_wipes(e, POINTS, NOWHERE)
    np.testing.assert_allclose(e, -1.2 * POINTS[:, 0] / 6.0)
