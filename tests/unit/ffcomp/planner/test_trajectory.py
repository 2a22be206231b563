"""Sampling the plan: position, speed and acceleration agree, at any times in any order."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.trajectory import Trajectory
from gcode.reader import read_program
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
