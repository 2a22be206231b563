"""Exact steps: closed forms, and on random paths the rule itself, with inverse kinematics as the judge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ffcomp.steps.crossings import STATE_SIZE, SWALLOWED, Pieces, knot_pieces, last_step, step_times
from models.arrays import FloatArray
from models.file import load_machine

IntArray = NDArray[np.int64]

GEOMETRY = load_machine("mp-delta-pro").kinematics
CLOCK_HZ = 16e6
STEP_MM = 0.0125
NO_FILTER = (1, 1, 1)
TURN_S = 750e-6


def path(start: FloatArray, *legs: tuple[FloatArray, float, float, float]) -> Pieces:
    """Legs one after the other: (direction (4,), start speed, acceleration, duration)."""
    begins = np.cumsum([0.0, *(leg[3] for leg in legs)])[:-1]
    length = np.array([(v + 0.5 * a * lasts) * lasts for _, v, a, lasts in legs])
    direction = np.array([leg[0] for leg in legs])
    ends = start + np.cumsum(direction * length[:, None], axis=0)
    columns = [np.array([leg[k] for leg in legs]) for k in (3, 1, 2)]
    return Pieces(begins, columns[0], np.vstack([start, ends[:-1]]), direction, columns[1], columns[2])


def steps(
    pieces: Pieces, motor: int = 0, rules: tuple[int, int, int] = NO_FILTER, at_once: int = 10_000
) -> tuple[IntArray, IntArray, IntArray]:
    """One motor's ticks and directions; motor 3 is the filament. And its memory."""
    row = tuple([*GEOMETRY.motor_rows.tolist(), [0.0] * 7 + [1.0]][motor])
    start = GEOMETRY.inverse(pieces.origin[:1, :3])[0, motor] if motor < 3 else pieces.origin[0, 3]
    state = np.zeros(STATE_SIZE, dtype=np.int64)
    found = [
        step_times(
            tuple(map(np.ascontiguousarray, pieces[k : k + at_once].columns)),
            row,
            (float(start), STEP_MM),
            CLOCK_HZ,
            rules,
            state,
        )
        for k in range(0, len(pieces), at_once)
    ]
    tick, way = zip(*found, last_step(rules, state), strict=True)
    return np.concatenate(tick), np.concatenate(way).astype(np.int64), state


UP = np.array([0.0, 0.0, 1.0, 0.0])
ORIGIN = np.array([3.0, -5.0, 20.0, 0.0])


def test_at_rest_nothing_steps() -> None:
    """Standing for 10 s delays what comes after it, and standing on a border never flutters."""
    half_step = STEP_MM / 2
    still = (UP, 0.0, 0.0, 10.0)
    tick, way, _ = steps(path(ORIGIN, (UP, half_step, 0.0, 1.0), still, (UP, half_step, 0.0, 1.0), still))
    assert len(tick) == 1 and way[0] == 1
    rounding = np.array([0.0, *(half_step + 1e-10 * (-1.0) ** np.arange(20))])
    on_border = knot_pieces(0.0, 1.0, ORIGIN[:3] + UP[:3] * rounding[:, None], np.zeros(21))
    assert len(steps(on_border)[0]) == 1
    flat = np.array([1.0, 0.0, 0.0, 0.0])
    level = path(ORIGIN, still, (flat, 10.0, 0.0, 1.0), still)
    assert len(steps(level, motor=3)[0]) == 0


@pytest.mark.parametrize(("peak", "time_s", "left"), [(0.7, 0.5 * TURN_S, 0), (0.7, 5 * TURN_S, 2), (1.2, TURN_S, 2)])
def test_a_step_that_turns_back_at_once_is_left_out(peak: float, time_s: float, left: int) -> None:
    """Up and down by `peak` microsteps: unless it takes longer, or the microstep itself is reached, nothing steps."""
    speed = 2 * peak * STEP_MM / time_s
    rules = (round(TURN_S * CLOCK_HZ), 1, 1)
    tick, way, state = steps(path(ORIGIN, (UP, speed, 0.0, time_s / 2), (-UP, speed, 0.0, time_s / 2)), rules=rules)
    assert way.tolist() == [1, -1][:left]
    assert state[SWALLOWED] == 2 - left
    assert len(tick) == left


def test_pulses_keep_their_distance() -> None:
    """Twice too fast for ten steps, and the electronics catch up afterwards."""
    spacing = 1000
    fast, slow = 2 * STEP_MM * CLOCK_HZ / spacing, 0.5 * STEP_MM * CLOCK_HZ / spacing
    pieces = path(ORIGIN, (UP, slow, 0.0, 0.01), (UP, fast, 0.0, 10 * STEP_MM / fast), (UP, slow, 0.0, 0.01))
    exact, (tick, _, _) = steps(pieces)[0], steps(pieces, rules=(1, spacing, spacing))
    assert np.diff(exact).min() == spacing // 2
    assert np.diff(tick).min() == spacing
    assert np.all(tick >= exact) and tick[-1] == exact[-1]


# ---- random paths --------------------------------------------------------------------------------

speeds, angles = st.floats(0.0, 400.0), st.floats(0.0, 2 * np.pi)


@st.composite
def random_path(draw: st.DrawFn) -> Pieces:
    """Straight lines in any direction, with any acceleration that does not turn them round; some at rest."""
    legs = []
    for _ in range(draw(st.integers(1, 4))):
        turned, climb = draw(angles), draw(st.sampled_from([0.0, 0.0, 1e-7, 0.3, -0.8, 1.0, -1.0]))
        flat = np.sqrt(max(1 - climb**2, 0.0))
        start, end = draw(speeds), draw(speeds)
        lasts = 40.0 / (start + end + 400.0) * draw(st.floats(0.01, 1.0))
        direction = np.array([flat * np.cos(turned), flat * np.sin(turned), climb, draw(st.floats(-0.1, 0.1))])
        legs.append((direction, start, (end - start) / lasts, lasts))
    return path(np.array([draw(st.floats(-40, 40)), draw(st.floats(-40, 40)), 60.0, 5.0]), *legs)


def place_at(pieces: Pieces, t: FloatArray, motor: int) -> FloatArray:
    """(k,) mm"""
    at = np.clip(np.searchsorted(pieces.start_t, t, side="right") - 1, 0, None)
    since = np.minimum(t - pieces.start_t[at], pieces.duration[at])
    along = (pieces.start_v[at] + 0.5 * pieces.acceleration[at] * since) * since
    places = pieces.origin[at] + pieces.direction[at] * along[:, None]
    return GEOMETRY.inverse(places[:, :3])[:, motor] if motor < 3 else places[:, 3]


def halved(pieces: Pieces, share: float) -> Pieces:
    """The same path, each piece in two."""
    first = pieces.duration * share
    later_v = np.maximum(pieces.start_v + pieces.acceleration * first, 0.0)
    before = replace(pieces, duration=first)
    begins, rest = pieces.start_t + first, pieces.duration - first
    after = Pieces(begins, rest, before.end, pieces.direction, later_v, pieces.acceleration)
    both = [np.stack(pair, axis=1) for pair in zip(before.columns, after.columns, strict=True)]
    return Pieces(*(column.reshape(-1, *column.shape[2:]) for column in both))


@settings(max_examples=60, deadline=None)
@given(random_path(), st.integers(0, 3), st.floats(0.05, 0.95))
def test_steps_come_just_when_the_command_is_half_way(pieces: Pieces, motor: int, share: float) -> None:
    """At a step the command is on the border; between steps it is never more than half a microstep away."""
    for path_ in (pieces, halved(pieces, share)):
        tick, way, _ = steps(path_, motor)
        end_t = float(pieces.start_t[-1] + pieces.duration[-1])
        level = place_at(pieces, np.zeros(1), motor)[0] + STEP_MM * np.concatenate([[0], np.cumsum(way)])
        t, border = tick / CLOCK_HZ, (level[1:] + level[:-1]) / 2
        per_tick_mm = 2 * 900.0 / CLOCK_HZ  # carriages move less than twice as fast as the nozzle here
        assert np.all(np.diff(tick) > 0)
        assert np.abs(place_at(pieces, t, motor) - border).max(initial=0.0) < per_tick_mm
        dense = np.linspace(0.0, end_t, 20_001)
        held = level[np.searchsorted(t, dense, side="right")]
        assert np.abs(place_at(pieces, dense, motor) - held).max() < STEP_MM / 2 + per_tick_mm


@settings(max_examples=30, deadline=None)
@given(random_path(), st.integers(1, 3))
def test_chunks_change_nothing(pieces: Pieces, at_once: int) -> None:
    rules = (round(TURN_S * CLOCK_HZ), 32, 80)
    whole, cut = steps(pieces, 1, rules), steps(pieces, 1, rules, at_once)
    for one, other in zip(whole, cut, strict=True):
        np.testing.assert_array_equal(one, other)
