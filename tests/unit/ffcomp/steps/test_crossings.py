"""Exact steps: closed forms, and on random paths the rule itself, with inverse kinematics as the judge."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ffcomp.steps.crossings import STATE_SIZE, SWALLOWED, Knots, last_step, step_times
from models.arrays import FloatArray
from models.file import load_machine

IntArray = NDArray[np.int64]

GEOMETRY = load_machine("mp-delta-pro").kinematics
CLOCK_HZ = 16e6
STEP_MM = 0.0125
NO_FILTER = (1, 1, 1)
TURN_S = 750e-6


def path(start: FloatArray, *legs: tuple[FloatArray, float, float], pieces: int = 1) -> list[Knots]:
    """Legs one after the other: (direction (4,), speed, duration), each in so many pieces."""
    begin_t, made = 0.0, []
    for direction, speed, lasts in legs:
        way = direction * speed * lasts
        made.append(Knots(begin_t, lasts / pieces, start + way * np.linspace(0.0, 1.0, pieces + 1)[:, None]))
        start, begin_t = start + way, begin_t + lasts
    return made


def steps(
    path_: list[Knots], motor: int = 0, rules: tuple[int, int, int] = NO_FILTER, at_once: int = 10_000
) -> tuple[IntArray, IntArray, IntArray]:
    """One motor's ticks and directions; motor 3 is the filament. And its memory."""
    row = tuple([*GEOMETRY.motor_rows.tolist(), [0.0] * 7 + [1.0]][motor])
    grid, state = (float(heights(path_[0].places[:1], motor)[0]), STEP_MM), np.zeros(STATE_SIZE, dtype=np.int64)
    found = []
    for knots in path_:
        for k in range(0, len(knots.places) - 1, at_once):
            part = k, min(k + at_once, len(knots.places) - 1)
            times = knots.start_t, knots.spacing_s
            found.append(step_times(knots.places, times, part, row, grid, CLOCK_HZ, rules, state))
    tick, way = zip(*found, last_step(rules, state), strict=True)
    return np.concatenate(tick), np.concatenate(way).astype(np.int64), state


def heights(places: FloatArray, motor: int) -> FloatArray:
    """(k,) mm, of places (k, 4) mm."""
    return GEOMETRY.inverse(places[:, :3])[:, motor] if motor < 3 else places[:, 3]


UP = np.array([0.0, 0.0, 1.0, 0.0])
ORIGIN = np.array([3.0, -5.0, 20.0, 0.0])


def test_at_rest_nothing_steps() -> None:
    """Standing for 10 s delays what comes after it, and standing on a border never flutters."""
    half_step = STEP_MM / 2
    still = (UP, 0.0, 10.0)
    tick, way, _ = steps(path(ORIGIN, (UP, half_step, 1.0), still, (UP, half_step, 1.0), still))
    assert len(tick) == 1 and way[0] == 1
    rounding = np.array([0.0, *(half_step + 1e-10 * (-1.0) ** np.arange(20))])
    on_border = Knots(0.0, 1.0, ORIGIN + UP * rounding[:, None])
    assert len(steps([on_border])[0]) == 1
    flat = np.array([1.0, 0.0, 0.0, 0.0])
    level = path(ORIGIN, still, (flat, 10.0, 1.0), still)
    assert len(steps(level, motor=3)[0]) == 0


@pytest.mark.parametrize(("peak", "time_s", "left"), [(0.7, 0.5 * TURN_S, 0), (0.7, 5 * TURN_S, 2), (1.2, TURN_S, 2)])
def test_a_step_that_turns_back_at_once_is_left_out(peak: float, time_s: float, left: int) -> None:
    """Up and down by `peak` microsteps: unless it takes longer, or the microstep itself is reached, nothing steps."""
    speed = 2 * peak * STEP_MM / time_s
    rules = (round(TURN_S * CLOCK_HZ), 1, 1)
    tick, way, state = steps(path(ORIGIN, (UP, speed, time_s / 2), (-UP, speed, time_s / 2)), rules=rules)
    assert way.tolist() == [1, -1][:left]
    assert state[SWALLOWED] == 2 - left
    assert len(tick) == left


def test_pulses_keep_their_distance() -> None:
    """Twice too fast for ten steps, and the electronics catch up afterwards."""
    spacing = 1000
    fast, slow = 2 * STEP_MM * CLOCK_HZ / spacing, 0.5 * STEP_MM * CLOCK_HZ / spacing
    path_ = path(ORIGIN, (UP, slow, 0.01), (UP, fast, 10 * STEP_MM / fast), (UP, slow, 0.01))
    exact, (tick, _, _) = steps(path_)[0], steps(path_, rules=(1, spacing, spacing))
    assert np.diff(exact).min() == spacing // 2
    assert np.diff(tick).min() == spacing
    assert np.all(tick >= exact) and tick[-1] == exact[-1]


# ---- random paths --------------------------------------------------------------------------------

speeds, angles = st.floats(0.0, 400.0), st.floats(0.0, 2 * np.pi)


@st.composite
def random_path(draw: st.DrawFn) -> list[Knots]:
    """Straight lines in any direction, in several pieces each; some at rest."""
    legs = []
    for _ in range(draw(st.integers(1, 4))):
        turned, climb = draw(angles), draw(st.sampled_from([0.0, 0.0, 1e-7, 0.3, -0.8, 1.0, -1.0]))
        flat, speed = np.sqrt(max(1 - climb**2, 0.0)), draw(speeds)
        direction = np.array([flat * np.cos(turned), flat * np.sin(turned), climb, draw(st.floats(-0.1, 0.1))])
        legs.append((direction, speed, 20.0 / (speed + 200.0) * draw(st.floats(0.01, 1.0))))
    start = np.array([draw(st.floats(-40, 40)), draw(st.floats(-40, 40)), 60.0, 5.0])
    return path(start, *legs, pieces=draw(st.integers(1, 5)))


def place_at(path_: list[Knots], t: FloatArray, motor: int) -> FloatArray:
    """(k,) mm"""
    times = np.concatenate([k.start_t + k.spacing_s * np.arange(len(k.places)) for k in path_])
    corners = np.concatenate([k.places for k in path_])
    return heights(np.column_stack([np.interp(t, times, axis) for axis in corners.T]), motor)


@settings(max_examples=60, deadline=None)
@given(random_path(), st.integers(0, 3))
def test_steps_come_just_when_the_command_is_half_way(path_: list[Knots], motor: int) -> None:
    """At a step the command is on the border; between steps it is never more than half a microstep away."""
    tick, way, _ = steps(path_, motor)
    level = place_at(path_, np.zeros(1), motor)[0] + STEP_MM * np.concatenate([[0], np.cumsum(way)])
    t, border = tick / CLOCK_HZ, (level[1:] + level[:-1]) / 2
    per_tick_mm = 2 * 900.0 / CLOCK_HZ  # carriages move less than twice as fast as the nozzle here
    assert np.all(np.diff(tick) > 0)
    assert np.abs(place_at(path_, t, motor) - border).max(initial=0.0) < per_tick_mm
    dense = np.linspace(0.0, path_[-1].end_t, 20_001)
    held = level[np.searchsorted(t, dense, side="right")]
    assert np.abs(place_at(path_, dense, motor) - held).max() < STEP_MM / 2 + per_tick_mm


@settings(max_examples=30, deadline=None)
@given(random_path(), st.integers(1, 3))
def test_chunks_change_nothing(path_: list[Knots], at_once: int) -> None:
    rules = (round(TURN_S * CLOCK_HZ), 32, 80)
    whole, cut = steps(path_, 1, rules), steps(path_, 1, rules, at_once)
    for one, other in zip(whole, cut, strict=True):
        np.testing.assert_array_equal(one, other)
