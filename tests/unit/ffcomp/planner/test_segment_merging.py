"""Which points of a command become the ends of segments."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from ffcomp.planner.segment_merging import (
    FIRST_KNOTS_AHEAD,
    MOST_KNOTS_AHEAD,
    MOST_KNOTS_BEHIND,
    WIDEST_TOLERANCE,
    MergeLimits,
    at_most,
    lengthen,
    merge,
    refit,
)
from tests.unit.ffcomp.planner.test_segment_timing import wave

FloatArray = NDArray[np.float64]

LIMITS = MergeLimits(1.5e-3, 4e-3, 2e-4, 64.0, 0.25, 0.0)


def unpinned(points: FloatArray) -> NDArray[np.bool_]:
    return np.zeros(len(points), dtype=np.bool_)


def missed(at: FloatArray, points: FloatArray, kept: NDArray[np.int64]) -> tuple[float, float]:
    """The most that the kept points miss the others by, across and along their segment."""
    across = along = 0.0
    for a, b in pairwise(kept.tolist()):
        direction = (points[b] - points[a]) / np.linalg.norm(points[b] - points[a])
        f = ((at[a:b] - at[a]) / (at[b] - at[a]))[:, None]
        error = points[a:b] - points[a] - f * (points[b] - points[a])
        along = max(along, np.abs(error @ direction).max())
        across = max(across, np.linalg.norm(error - np.outer(error @ direction, direction), axis=1).max())
    return across, along


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_segments_stay_within_the_tolerances(scale: float) -> None:
    vertices, e = wave(400)
    limits = replace(LIMITS, across_mm=1e-3 * scale, along_mm=4e-3 * scale, longest=25.0)
    pinned = unpinned(vertices)
    pinned[[57, 58, 211]] = True
    kept = merge(np.arange(401.0), vertices, e, pinned, limits)
    assert kept[0] == 0 and kept[-1] == 400 and {57, 58, 211} <= set(kept.tolist())
    assert 1 <= np.diff(kept).min() <= np.diff(kept).max() <= 25
    across, along = missed(np.arange(401.0), vertices, kept)
    assert 0.5 * limits.along_mm < along <= limits.along_mm + 1e-12 and across <= limits.across_mm + 1e-12
    assert np.abs(np.interp(np.arange(401), kept, e[kept]) - e).max() <= limits.filament_mm + 1e-12


cuts = st.lists(st.integers(1, 399), max_size=60, unique=True)


@given(cuts, st.integers(0, 3), st.floats(0.0, 1.0))
def test_no_second_has_more_segments_than_it_may(quarters: list[int], seed: int, roughness: float) -> None:
    """Lines of the file cut segments a quarter of a knot apart at the least; the knots beside them make room."""
    lines = np.array(sorted(quarters), dtype=float)
    lines = lines[np.diff(lines, prepend=-9.0) >= 6] / 4  # closer ones, all along, leave no choice
    at = np.unique(np.concatenate([np.arange(101.0), lines]))
    rng = np.random.default_rng(seed)
    points = np.cumsum(np.diff(at, prepend=0.0)[:, None] * (1 + roughness * rng.normal(0, 1, (len(at), 3))), axis=0)
    kept = at[merge(at, points, np.zeros(len(at)), np.isin(at, lines), LIMITS, 64)]
    assert set(lines) <= set(kept) and np.diff(kept).min() >= 0.25
    if not roughness:
        assert (
            max(np.searchsorted(kept, kept + 50.0) - np.arange(len(kept)))
            <= 50 + MOST_KNOTS_AHEAD + MOST_KNOTS_BEHIND + FIRST_KNOTS_AHEAD
        )
        assert len(kept) < 0.3 * len(at) + 2 * len(lines)


@given(cuts, st.integers(0, 3))
def test_no_turn_is_cut_off_for_the_number_of_segments(quarters: list[int], seed: int) -> None:
    """However many lines cut segments: what is missed is the tolerance, widened four times at the most."""
    lines = np.array(sorted(quarters), dtype=float) / 4
    at = np.unique(np.concatenate([np.arange(101.0), lines]))
    turn = 0.9 * np.cumsum(np.random.default_rng(seed).normal(0.0, 0.3, len(at)))
    steps = np.diff(at, prepend=0.0)[:, None] * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1) * 0.2
    points = np.cumsum(steps, axis=0)
    kept = merge(at, points, np.zeros(len(at)), np.isin(at, lines), replace(LIMITS, shortest_mm=0.01), 64)
    across, _ = missed(at, points, kept)
    assert across <= max(WIDEST_TOLERANCE * LIMITS.across_mm, 0.5 * 0.01) + 1e-9


def test_what_is_kept_after_a_cut_does_not_depend_on_what_came_before() -> None:
    vertices, e = wave(400)
    t = np.sort(np.append(np.arange(401.0), [3.5, 17.25, 63.75, 64.5, 150.5]))
    points, filament = (np.stack([np.interp(t, np.arange(401), c) for c in v.T], 1) for v in (vertices, e[:, None]))
    pinned = (t % 64 == 0) | (t % 1 != 0)
    limits = replace(LIMITS, shortest_mm=0.01)
    whole = merge(t, points, filament[:, 0], pinned, limits, 64)
    begin = int(np.searchsorted(t, 64.0))
    part = merge(t[begin:], points[begin:], filament[begin:, 0], pinned[begin:], limits, 64)
    assert (whole[whole >= begin] - begin).tolist() == part.tolist()


def test_the_first_segment_from_rest_is_made_long_enough() -> None:
    at, e = np.arange(6.0), np.linspace(0.0, 1.0, 6)
    points = np.array([[0, 0, 0], [0.002, 0, 0], [0.03, 0.04, 0], [0.06, 0.08, 0], [0.06, 0.083, 0], [0.06, 0.088, 0]])
    before = points.copy()
    lengthen(at, points, e, np.array([True, False, False, True, False, True]), 0.25, 0.01)
    assert np.linalg.norm(points[1]) == pytest.approx(0.01) and 1.0 < at[1] < 1.25
    for axis in range(3):
        assert points[1, axis] == pytest.approx(np.interp(at[1], np.arange(6), before[:, axis]))
    assert e[1] == pytest.approx(0.2 * at[1])
    assert (points[2:] == before[2:]).all()  # too little room between the last ones, which must stay


def test_refitted_segments_leave_less_of_what_a_slow_machine_follows() -> None:
    """Chords of a bend lie on its inner side; refitted ones miss it to both sides, and the mean error is gone."""
    at = np.arange(401.0)
    phase = 2 * np.pi * at / 400
    points = np.column_stack([20 * np.cos(phase), 20 * np.sin(phase), np.full(401, 0.2)])
    kept = np.arange(0, 401, 8)
    fixed = unpinned(kept)
    fixed[[0, 25, -1]] = True

    def mean_error_um(ends: FloatArray) -> float:
        played = np.column_stack([np.interp(at, at[kept], ends[:, i]) for i in range(3)])
        return abs(1e3 * float(np.mean(np.hypot(played[:, 0], played[:, 1]) - 20.0)))

    ends = refit(at, points, kept, fixed)
    assert mean_error_um(points[kept]) > 20.0 > 10 * mean_error_um(ends)
    np.testing.assert_array_equal(ends[fixed], points[kept][fixed])
    np.testing.assert_allclose(ends[:, 2], 0.2, atol=1e-15)


def test_a_refit_is_the_least_squares_over_time() -> None:
    """The miss is orthogonal to every hat whose top may move, whatever the steps between the points."""
    rng = np.random.default_rng(5)
    at = np.cumsum(rng.uniform(0.2, 1.0, 60))
    points = np.cumsum(rng.normal(size=(60, 3)), axis=0) + 1e3 * at[:, None]  # quick: nothing is short
    kept = np.array([0, 3, 4, 11, 20, 21, 40, 59])
    fixed = unpinned(kept)
    fixed[[0, 4, -1]] = True
    ends = refit(at, points, kept, fixed)
    fine = np.linspace(at[0], at[-1], 400_001)
    for i in range(3):
        miss = np.interp(fine, at, points[:, i]) - np.interp(fine, at[kept], ends[:, i])
        for j in np.flatnonzero(~fixed).tolist():
            hat = np.interp(fine, at[kept], np.eye(len(kept))[j])
            assert np.trapezoid(miss * hat, fine) == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("begins", [True, False])
def test_no_part_at_a_runs_end_has_more_segments_than_knots(begins: bool) -> None:
    """So that parts of several runs have no more together."""
    at = np.sort(np.concatenate([np.arange(60.0), [3.3, 3.7, 55.2, 56.4, 57.7]]))
    points = np.stack([0.4 * at, 1e-3 * at**2, np.zeros(len(at))], axis=1)
    pinned = at % 1.0 > 0.0
    pinned[[0, -1]] = True
    stays = at_most(at, points, np.arange(len(at)), pinned, 24, begins=begins, ends=not begins)
    since = at[stays] - at[0] if begins else (at[-1] - at[stays])[::-1]
    early, other = np.arange(1, 24), 59.0 - since[::-1]
    assert (since[early] >= early - 1e-9).all() and not (other[early] >= early - 1e-9).all()
    assert set(np.flatnonzero(pinned)) <= set(stays.tolist())


def test_a_segment_cut_short_by_a_line_keeps_its_speed() -> None:
    """291 mm/s became 180 in a segment of 0.3 ms: its end was moved beside one that must stay."""
    at = np.sort(np.append(np.arange(0.0, 13.0), 6.08))
    along = 1.16 * at + 2e-3 * at**2
    points = np.stack([along, np.zeros_like(at), np.zeros_like(at)], axis=1)
    kept = np.flatnonzero(np.isin(at, [0.0, 3.0, 6.0, 6.08, 9.0, 12.0]))
    fixed = np.isin(at[kept], [0.0, 6.08, 12.0])
    placed = refit(at, points, kept, fixed)
    speed = np.diff(placed[:, 0]) / np.diff(at[kept])
    assert np.abs(speed - np.diff(along[kept]) / np.diff(at[kept])).max() < 0.05 * 1.16
