"""Anderson's acceleration: exact where the answers are linear, place by place."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffcomp.inverse.nonlinear import BLENDED_KNOTS, JUDGED_KNOTS, around, mixed

N = 400
FAR = JUDGED_KNOTS + BLENDED_KNOTS  # knots that a place sees


@given(slope=st.floats(-3.0, 3.0).filter(lambda c: abs(c) > 0.05), seed=st.integers(0, 99))
def test_two_points_of_a_line_tell_where_it_crosses_zero(slope: float, seed: int) -> None:
    """f = c (x* − x): whatever c, even of the wrong sign, the secant lands on x*."""
    random = np.random.default_rng(seed)
    wanted, first = random.normal(size=(2, N, 3))
    tried = [(x, slope * (wanted - x)) for x in (first, first + 0.3 * (wanted - first))]
    assert np.abs(mixed(tried, 0.7) - wanted).max() < 0.05 * np.abs(first - wanted).max()


def test_every_place_has_its_own_weights() -> None:
    """Half of the path answers twice too strongly, half as weakly: one weight for all could not serve both."""
    random = np.random.default_rng(1)
    wanted, first = random.normal(size=(2, N, 3))
    slope = np.where(np.arange(N) < N // 2, 2.0, 0.5)[:, None]
    second = first + slope * (wanted - first)
    found = mixed([(x, slope * (wanted - x)) for x in (first, second)], 1.0)
    away = np.abs(np.arange(N) - N // 2) > FAR
    assert np.abs(found - wanted)[away].max() < 0.05
    assert np.abs(second - wanted)[away].max() > 1.0


def test_the_first_step_takes_its_share() -> None:
    x, f = np.ones((N, 3)), np.full((N, 3), 0.5)
    assert mixed([(x, f)], 0.7) == pytest.approx(1.35)


def test_what_rests_stays() -> None:
    still = np.zeros((N, 3))
    assert np.array_equal(mixed([(still, still)] * 4, 1.0), still)


def test_a_change_is_felt_no_further_than_the_windows() -> None:
    random = np.random.default_rng(2)
    tried = [tuple(random.normal(size=(2, N, 3))) for _ in range(3)]
    other = [(x.copy(), f.copy()) for x, f in tried]
    other[1][1][N // 2] += 1.0
    moved = np.abs(mixed(tried, 1.0) - mixed(other, 1.0)).max(axis=1) > 1e-9
    assert moved[N // 2]
    assert np.ptp(np.flatnonzero(moved)) <= 2 * FAR


def test_around_is_the_mean_of_what_is_there() -> None:
    values = np.arange(10.0)
    assert around(values, 2)[[0, 5, 9]] == pytest.approx([1.0, 5.0, 8.0])
    assert np.array_equal(around(np.stack([values, values], axis=1), 3)[:, 0], around(values, 3))
