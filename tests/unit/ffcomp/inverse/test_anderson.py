"""Anderson's acceleration: exact where the answers are linear, place by place."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from ffcomp.inverse.nonlinear import mixed

N = 400


@given(slope=st.floats(-3.0, 3.0).filter(lambda c: abs(c) > 0.05), seed=st.integers(0, 99))
def test_two_points_of_a_line_tell_where_it_crosses_zero(slope: float, seed: int) -> None:
    """f = c (x* − x): whatever c, even of the wrong sign, the secant lands on x*."""
    random = np.random.default_rng(seed)
    wanted, first = random.normal(size=(2, N, 3))
    tried = [(x, slope * (wanted - x)) for x in (first, first + 0.3 * (wanted - first))]
    assert np.abs(mixed(tried, 0.7) - wanted).max() < 0.05 * np.abs(first - wanted).max()
