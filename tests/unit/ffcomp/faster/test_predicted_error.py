"""Drawn printers: the 99th percentile of each over time, and the quantile over them, against the same with numpy."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.faster.predicted_error import deviates_in, ensemble_percentile, error_at_quantile, histogram


def test_the_percentile_is_that_of_printers_and_not_of_moments() -> None:
    """Two directions that are felt at different times: no printer is far off in both."""
    rng = np.random.default_rng(0)
    changes = np.zeros((2, 4000, 3), dtype=np.float32)
    changes[0, :2000, 0] = 0.01 * rng.random(2000)
    changes[1, 2000:, 1] = 0.01 * rng.random(2000)
    nominal, scale = 0.002 * rng.random(4000), np.full(4000, 1.0 / 0.025)
    moved = np.einsum("jk,kmc->jmc", deviates_in(2), changes)
    each = np.percentile(scale * np.sqrt(nominal**2 + (moved**2).sum(axis=2)), 99, axis=1)
    found = ensemble_percentile([histogram(nominal, changes, scale)], 0.0, 0.05)
    assert found == pytest.approx(np.quantile(each, 0.95), abs=0.02)
    moments = np.percentile(error_at_quantile(nominal, changes, scale, 1.96), 99)
    assert 0.7 * moments < found < 1.2 * moments
