"""The plan against closed forms, a linear programme, and what must hold for any file."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.optimize import linprog

from ffcomp.planner.limits import DeltaSlowZones, PlannerLimits, bounds_of, lines_of
from ffcomp.planner.lookahead import plan_moves, stops_and_waits
from ffcomp.planner.trajectory import Trajectory
from gcode.program import Moves
from gcode.reader import read_program
from models.arrays import FloatArray
from tests.support.programs import moves_through, random_program

LIMITS = PlannerLimits(
    velocity_mm_per_s=300.0,
    acceleration_mm_per_s2=3000.0,
    square_corner_velocity_mm_per_s=5.0,
    minimum_cruise_ratio=0.0,
)
DELTA = dataclasses.replace(LIMITS, minimum_cruise_ratio=0.5, delta=DeltaSlowZones(140.0, 280.0, 0.00625))
points = st.lists(
    st.tuples(*(st.integers(-200, 200).map(lambda tenth: 0.1 * tenth) for _ in range(2))), min_size=2, max_size=12
)
speeds = st.lists(st.floats(1.0, 400.0), min_size=11, max_size=11)


def plan(moves: Moves, limits: PlannerLimits = LIMITS, stops: ArrayLike = False, waits: ArrayLike = 0.0) -> Trajectory:
    n = len(moves)
    return plan_moves(
        moves, limits, stop_before=np.array(np.broadcast_to(stops, n)), wait_before=np.array(np.broadcast_to(waits, n))
    )


def through(points: ArrayLike, speed: float = 100.0, limits: PlannerLimits = LIMITS) -> Trajectory:
    return plan(moves_through(points, speed), limits)


# One move


def test_a_long_move_is_a_trapezoid() -> None:
    line = through([[0, 0], [30, 40]])
    assert line.accel_t[0] == line.decel_t[0] == pytest.approx(100 / 3000)
    assert line.cruise_v[0] == 100.0
    assert line.end_t == pytest.approx(50 / 100 + 100 / 3000)
    assert line.direction[0] == pytest.approx([0.6, 0.8, 0, 0])


@pytest.mark.parametrize("ratio", [0.0, 0.2, 0.5, 0.9])
def test_the_cruise_ratio_is_the_share_of_a_short_move_that_cruises(ratio: float) -> None:
    line = plan(moves_through([[0, 0], [0, 0.3]], minimum_cruise_ratio=ratio))
    assert line.cruise_v[0] == pytest.approx(math.sqrt(3000 * (1 - ratio) * 0.3))
    assert line.cruise_t[0] * line.cruise_v[0] == pytest.approx(ratio * 0.3, abs=1e-12)


# Corners


@given(st.floats(0.1, 3.0))
@settings(deadline=None)
def test_the_angle_sets_the_speed_of_a_corner(turn: float) -> None:
    """The circle that stays as near the corner as at a right angle: v² = a δ s/(1 - s), s = sin(theta/2)."""
    corner = through([[0, 0], [50, 0], [50 + 50 * math.cos(turn), 50 * math.sin(turn)]], 300.0)
    sine = math.cos(turn / 2)
    free = 5.0**2 * (math.sqrt(2) - 1) * sine / (1 - sine)
    tangent = 0.5 * 50 * 3000 / math.tan(turn / 2)
    assert corner.start_v[1] ** 2 == pytest.approx(min(free, tangent, 300**2), rel=1e-9)


def test_many_short_chords_of_a_circle_keep_to_its_centripetal_acceleration() -> None:
    angle = np.linspace(0, 4 * math.pi, 401)
    radius = 20 / math.cos(2 * math.pi / 400)  # a polygon around a circle of 20 mm
    round_trip = through(radius * np.column_stack([np.cos(angle), np.sin(angle)]), 300.0)
    assert round_trip.start_v[150:250] ** 2 / 20 == pytest.approx(3000, rel=1e-6)


@given(st.lists(st.floats(0.01, 20.0), min_size=1, max_size=8), st.floats(20.0, 300.0), st.floats(0.0, 0.9))
@example([0.1, 0.1], 300.0, 0.5)  # the top exactly at a cut
@settings(deadline=None, max_examples=50)
def test_cutting_a_straight_line_changes_nothing(lengths: list[float], speed: float, ratio: float) -> None:
    ends = np.column_stack([np.cumsum([0.0, *lengths]), np.zeros(len(lengths) + 1)])
    limits = dataclasses.replace(LIMITS, minimum_cruise_ratio=ratio)
    cut, whole = through(ends, speed, limits), through(ends[[0, -1]], speed, limits)
    t = np.linspace(-0.01, whole.end_t + 0.01, 500)
    assert cut.end_t == pytest.approx(whole.end_t, rel=1e-9)
    assert np.abs(cut.position(t) - whole.position(t)).max() < 1e-7


# A second solver


def junction_limits(moves: Moves, limits: PlannerLimits) -> tuple[FloatArray, FloatArray]:
    """v² at inner junctions (n-1,) and each move's change of it (n,); by angles, one junction at a time."""
    lines = lines_of(moves)
    bounds = bounds_of(moves, lines, limits)
    gain = 2 * lines.length * bounds.acceleration
    corner = np.zeros(len(moves) - 1)
    for i in range(len(corner)):
        turn = math.acos(np.clip(lines.direction[i, :3] @ lines.direction[i + 1, :3], -1, 1))
        sine, pair = math.cos(turn / 2), slice(i, i + 2)
        circle = limits.square_corner_velocity_mm_per_s**2 * (math.sqrt(2) - 1)
        circle *= sine / (1 - sine) if sine < 1 - 1e-14 else math.inf
        tangent = gain[pair].min() / 4 / math.tan(turn / 2) if turn > 1e-7 else math.inf
        corner[i] = min(circle, tangent, (bounds.speed[pair] ** 2).min())
    return corner, gain


@given(points, speeds)
@settings(deadline=None, max_examples=40)
def test_junctions_are_passed_as_fast_as_a_linear_programme_allows(
    path: list[tuple[float, float]], v: list[float]
) -> None:
    path = [p for i, p in enumerate(path) if i == 0 or math.dist(p, path[i - 1]) > 0.05]
    if len(path) < 3:
        return
    moves = moves_through(path, v[: len(path) - 1])
    corner, gain = junction_limits(moves, LIMITS)
    steps = np.diff(np.eye(len(corner) + 2), axis=0)[:, 1:-1]  # change of v² over each move; rest at both ends
    best = linprog(-np.ones(len(corner)), np.vstack([steps, -steps]), [*gain, *gain], bounds=[(0, c) for c in corner])
    assert best.status == 0, best.message
    assert plan(moves).start_v[1:] ** 2 == pytest.approx(best.x, rel=1e-6, abs=1e-5)


# Whatever the file


@pytest.fixture(scope="module", params=range(4))
def planned(request: pytest.FixtureRequest) -> tuple[Moves, Trajectory]:
    program = read_program(random_program(request.param, 60), start=(0.0, 0.0, 10.0))
    stops, waits = stops_and_waits(program)
    return program.moves, plan_moves(program.moves, DELTA, stop_before=stops, wait_before=waits, start_t=3.0)


def test_no_move_exceeds_its_limits(planned: tuple[Moves, Trajectory]) -> None:
    moves, plan = planned
    bounds = bounds_of(moves, lines_of(moves), DELTA)
    assert (plan.cruise_v <= bounds.speed * (1 + 1e-12)).all()
    assert (plan.start_v <= plan.cruise_v).all() and (plan.end_v <= plan.cruise_v).all()
    assert (plan.acceleration <= bounds.acceleration).all()


def test_every_move_arrives(planned: tuple[Moves, Trajectory]) -> None:
    moves, plan = planned
    covered = 0.5 * (plan.start_v + plan.cruise_v) * plan.accel_t + plan.cruise_v * plan.cruise_t
    covered += 0.5 * (plan.cruise_v + plan.end_v) * plan.decel_t
    assert plan.origin + plan.direction * covered[:, None] == pytest.approx(moves.end, abs=1e-9)
