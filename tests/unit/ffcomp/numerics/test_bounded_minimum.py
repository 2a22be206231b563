from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from ffcomp.numerics.bounded_minimum import bounded_minimum


@pytest.mark.parametrize("seed", range(20))
def test_every_digit_is_scipys(seed: int) -> None:
    a, b, c, low, width = np.random.default_rng(seed).normal(size=5).tolist()

    def cost(x: float) -> float:
        return (x - a) ** 2 if seed % 2 else float(np.cos(b * x + c)) + 0.1 * abs(x - a)

    high = low + 1.0 + 3.0 * abs(width)
    expected = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-10})
    assert bounded_minimum(cost, low, high, 1e-10) == expected.x
