"""Rows of steps: every step inside its window, the protocol's limits, rows as long as can be."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ffcomp.steps.compress import FAR_TICKS, Compressor, Rows

IntArray = NDArray[np.int64]

SLACK, SPACING = 200, 32


def rows_of(tick: IntArray, way: IntArray, at_once: int = 1 << 30, slack: int = SLACK) -> Rows:
    compressor = Compressor(slack, SPACING)
    cuts = range(0, len(tick), at_once)
    found = [compressor.add(tick[k : k + at_once], way[k : k + at_once].astype(np.int8)) for k in cuts]
    found.append(compressor.finish())
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))  # type: ignore[return-value]


def written_out(rows: Rows) -> tuple[IntArray, IntArray]:
    """Step by step as a board counts: the interval grows by `add` after each."""
    now, tick, way = 0, [], []
    for interval, count, add, direction in zip(*(column.tolist() for column in rows), strict=True):
        for _ in range(count):
            now += interval
            interval += add
            tick.append(now)
            way.append(direction)
    return np.array(tick, dtype=np.int64), np.array(way, dtype=np.int64)


@st.composite
def streams(draw: st.DrawFn) -> tuple[IntArray, IntArray]:
    """Stretches of steady, growing, shrinking and random gaps, one way or the other, with rests between."""
    gaps, ways = [np.array([draw(st.integers(SPACING, 10**6))])], [np.ones(1)]
    for _ in range(draw(st.integers(1, 6))):
        n, gap = draw(st.integers(1, 300)), draw(st.sampled_from([SPACING, 50, 400, 3001, 40_000, FAR_TICKS - 9]))
        noise = draw(st.sampled_from([0, 1, gap // 3]))
        random = np.random.default_rng(draw(st.integers(0, 99))).integers(-noise, noise + 1, n)
        growth = draw(st.floats(0.0, 2.0)) * gap / n
        gaps.append(np.maximum(gap + random + (growth * np.arange(n)).astype(np.int64), SPACING))
        ways.append(np.full(n, draw(st.sampled_from([-1, 1]))))
    return np.cumsum(np.concatenate(gaps)), np.concatenate(ways).astype(np.int64)


def assert_faithful(tick: IntArray, way: IntArray, rows: Rows, slack: int) -> None:
    interval, count, add, _ = (column.astype(np.int64) for column in rows)
    again, ways = written_out(rows)
    np.testing.assert_array_equal(ways, way)
    gap, new_gap = np.diff(tick, prepend=0), np.diff(again, prepend=0)
    early, late = tick - again, again - tick
    assert np.abs(late).max() <= slack
    assert np.all(early * 4 <= gap) and np.all(late[:-1] * 4 <= gap[1:]) and late[-1] * 4 <= gap[-1]
    assert np.all(new_gap * 2 >= gap)
    assert new_gap.min() >= SPACING
    assert np.all((interval > 0) & (count > 0) & (interval + add * (count - 1) > 0))
    assert np.all((interval < FAR_TICKS + slack) | (count == 1))


@settings(max_examples=80, deadline=None)
@given(streams(), st.sampled_from([0, 3, SLACK]))
def test_every_step_is_within_its_window(stream: tuple[IntArray, IntArray], slack: int) -> None:
    assert_faithful(*stream, rows_of(*stream, slack=slack), slack)


def test_no_row_is_longer_than_16_bits_can_count() -> None:
    """100 000 steps at one speed; and faster braking than 16 bits can say takes many rows."""
    steady = 1000 * np.arange(1, 100_001)
    assert rows_of(steady, np.ones(100_000, dtype=np.int64))[1].tolist() == [65_535, 34_465]
    braking = np.cumsum(10**6 + 10**5 * np.arange(50))
    rows = rows_of(braking, np.ones(50, dtype=np.int64))
    assert_faithful(braking, np.ones(50, dtype=np.int64), rows, SLACK)
    assert len(rows[0]) > 20


def longest_row(tick: IntArray, first: int, last: int, slack: int) -> int:
    """The most steps, up to 250, that any row with |add| ≤ 1000 could hold, sought by trying all."""
    tick = tick[: first + 250]
    gap = np.diff(tick, prepend=0)
    room = np.minimum(slack, np.minimum(gap // 4, (gap - SPACING) // 2))
    low, high = tick - room, tick + np.append(room[1:], room[-1])
    k = np.arange(1, len(tick) - first + 1)
    bent = last + np.arange(-1000, 1001)[:, None] * (k * (k - 1) // 2)
    least = np.maximum.accumulate(-(-(low[first:] - bent) // k), axis=1)
    most = np.minimum.accumulate((high[first:] - bent) // k, axis=1)
    return int((least <= most).sum(axis=1).max())


@pytest.mark.parametrize("seed", range(4))
def test_rows_are_as_long_as_they_can_be(seed: int) -> None:
    """Speeding up, cruising and braking, with a disturbance: against a search of all rows: 2 % of steps at most."""
    t = np.linspace(0.0, 0.06, 200_001)
    x = np.cumsum(np.interp(t, [0, 0.02, 0.04, 0.06], [40, 150, 150, 40])) * t[1]
    x += 0.02 * (np.sin(2 * np.pi * 45 * t + seed) - np.sin(seed))
    tick = np.rint(np.interp(np.arange(int(x[-1] / 0.0125)) * 0.0125 + 0.00625, x, t) * 16e6).astype(np.int64)
    rows = rows_of(tick, np.ones(len(tick), dtype=np.int64))
    assert_faithful(tick, np.ones(len(tick), dtype=np.int64), rows, SLACK)
    again, _ = written_out(rows)
    ends = np.cumsum(rows[1].astype(np.int64)).tolist()  # but for the first row: half a microstep, then whole ones
    missed = sum(
        longest_row(tick, first, int(again[first - 1]), SLACK) - (end - first) for first, end in pairwise(ends)
    )
    assert 0 <= missed <= 0.02 * len(tick)
