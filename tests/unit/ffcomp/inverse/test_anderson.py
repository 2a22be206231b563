"""Anderson's acceleration: exact where the answers are linear, place by place."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ffcomp.inverse.nonlinear import BLENDED_KNOTS, JUDGED_KNOTS, mixed

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
