"""The compiled step of a recursion against numpy's products."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from models.vibration.recursion import recursion


@pytest.mark.parametrize(("kind", "rounding"), [(np.float64, 1e-14), (np.float32, 1e-5)])
@pytest.mark.parametrize(("rows", "of_state", "of_input"), [(12, 12, 15), (32, 24, 9), (5, 3, 1)])
def test_a_step_is_the_product(kind: type, rounding: float, rows: int, of_state: int, of_input: int) -> None:
    step = recursion(rows, of_state, of_input)

    @njit
    def steps(matrices, at, state, given):  # type: ignore[no-untyped-def]
        for k in range(len(given)):
            step(matrices, at[k], state, given, k)

    rng = np.random.default_rng(rows)
    matrices = 0.2 * rng.normal(size=(4, of_state + of_input, rows)).astype(kind)
    given, at = rng.normal(size=(50, of_input)).astype(kind), rng.integers(0, 4, 50)
    state = rng.normal(size=rows).astype(kind)
    expected = state.astype(np.float64)
    steps(matrices, at, state, given)
    for k in range(50):
        expected = np.concatenate([expected[:of_state], given[k]]) @ matrices[at[k]].astype(np.float64)
    np.testing.assert_allclose(state, expected, rtol=0.0, atol=rounding * np.abs(expected).max())
