"""What we say the firmware plays is what the planner (equal to Kalico's) plans."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import plan_moves
from ffcomp.planner.segment_timing import SegmentLimits, sample_segments, segment_speeds
from gcode.program import Moves

FloatArray = NDArray[np.float64]

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
    ours = sample_segments(vertices, speeds.cruise, speeds.junction, speeds.acceleration, speeds.duration, 8)
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
