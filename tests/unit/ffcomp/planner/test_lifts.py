"""Lifts are written as one segment, and filament that is pulled back while the nozzle moves is shared out evenly."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.planner.lifts import even_wipes
from ffcomp.planner.segment_timing import SegmentLimits, segment_speeds
from models.arrays import FloatArray

S = 0.004


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
