"""Which points of a command become the ends of segments."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from ffcomp.planner.segment_merging import (
    MergeLimits,
    at_most,
    merge,
    refit,
)
from models.arrays import FloatArray
from tests.unit.ffcomp.planner.test_trajectory import wave

LIMITS = MergeLimits(1.5e-3, 4e-3, 2e-4, 64.0)


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
    limits = LIMITS._replace(across_mm=1e-3 * scale, along_mm=4e-3 * scale, longest=25.0)
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
    pinned = np.isin(at, lines)
    kept = at[at_most(at, points, merge(at, points, np.zeros(len(at)), pinned, LIMITS), pinned, 49)]
    assert set(lines) <= set(kept)
    assert max(np.searchsorted(kept, kept + 50.0) - np.arange(len(kept))) <= 50
    if not roughness:
        assert len(kept) < 0.3 * len(at) + 2 * len(lines)


def test_what_is_kept_after_a_cut_does_not_depend_on_what_came_before() -> None:
    vertices, e = wave(400)
    t = np.sort(np.append(np.arange(401.0), [3.5, 17.25, 63.75, 64.5, 150.5]))
    points, filament = (np.stack([np.interp(t, np.arange(401), c) for c in v.T], 1) for v in (vertices, e[:, None]))
    pinned = (t % 64 == 0) | (t % 1 != 0)
    whole = merge(t, points, filament[:, 0], pinned, LIMITS)
    begin = int(np.searchsorted(t, 64.0))
    part = merge(t[begin:], points[begin:], filament[begin:, 0], pinned[begin:], LIMITS)
    assert (whole[whole >= begin] - begin).tolist() == part.tolist()


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
