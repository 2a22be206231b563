"""What each move may do by itself."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

from ffcomp.planner.limits import DeltaSlowZones, PlannerLimits, bounds_of, lines_of
from tests.support.programs import moves_through

LIMITS = PlannerLimits(velocity_mm_per_s=300.0, acceleration_mm_per_s2=3000.0)
FILAMENT = 16.0 * 0.4**2 / (math.pi * 1.75**2)  # of the firmware's speed, what it lets the filament do by default


def bounds(points: ArrayLike, limits: PlannerLimits = LIMITS, speed: float = 1000.0) -> tuple[list[float], list[float]]:
    moves = moves_through(points, speed)
    found = bounds_of(moves, lines_of(moves), limits)
    return found.speed.tolist(), found.acceleration.tolist()


@pytest.mark.parametrize(
    ("to", "slower"),
    [
        ([30.0, 40.0, 0.0, 2.0], 1.0),  # printing: the extruder follows
        ([30.0, 40.0, 0.0, -5.0], 50.0 / 5.0 * FILAMENT),  # retracting on the way, slowly enough
        ([30.0, 40.0, 0.0, -25.0], 50.0 / 25.0 * FILAMENT),  # retracting on the way, too fast for the extruder
        ([0.0, 0.0, 0.0, 7.0], FILAMENT),
        ([0.0, 0.0, 4.0, 2.0], 2.0 * FILAMENT),  # Z and filament together count as the extruder's
    ],
)
def test_the_extruder_limits_moves_that_it_leads(to: list[float], slower: float) -> None:
    speed, acceleration = bounds([[0.0] * 4, to])
    assert speed == pytest.approx([300.0 * min(slower, 1.0)])
    assert acceleration == pytest.approx([3000.0 * min(slower, 1.0)])


def test_z_keeps_its_own_limits_on_slanted_moves() -> None:
    limits = PlannerLimits(300.0, 3000.0, z_velocity_mm_per_s=10.0, z_acceleration_mm_per_s2=100.0)
    speed, acceleration = bounds([[0, 0, 0], [3, 0, 4], [3, 0, 0], [100, 0, 0]], limits)
    assert speed == pytest.approx([12.5, 10.0, 300.0])
    assert acceleration == pytest.approx([125.0, 100.0, 3000.0])


@pytest.mark.parametrize("ratio", [3.0, 6.0])
def test_at_the_radius_of_a_ratio_a_carriage_is_that_much_faster_than_the_nozzle(ratio: float) -> None:
    reach = DeltaSlowZones(radius_mm=140.0, arm_length_mm=280.0, half_step_mm=0.0)
    lean = reach.radius_of_ratio(ratio) + reach.radius_mm  # opposite the tower
    heights = np.sqrt(reach.arm_length_mm**2 - (lean + np.array([-1e-4, 1e-4])) ** 2)
    assert (heights[0] - heights[1]) / 2e-4 == pytest.approx(ratio, rel=1e-6)
