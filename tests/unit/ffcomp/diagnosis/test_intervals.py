"""Intervals of fitted numbers, on fits that need no simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ffcomp.diagnosis.fit import Fit, student_share
from ffcomp.diagnosis.problem import Parameter


def test_few_motions_that_disagree_make_an_interval_wider() -> None:
    """What a wrong shape leaves is the same in repeats, and all through an experiment."""
    rng = np.random.default_rng(3)
    rows = [slice(500 * i, 500 * (i + 1)) for i in range(8)]
    column = rng.standard_normal(4000)
    frequency = np.tile(np.linspace(1.0, 100.0, 500), 8)
    slopes = np.repeat([0.3, -0.3, 0.2, -0.2], 1000)  # two repeats each
    of_shape = Fit(
        (Parameter("a", 0.0, 1.0),), np.zeros(1), rng.standard_normal(4000) + slopes * column, column[:, None]
    )
    of_noise = replace(of_shape, residual=rng.standard_normal(4000))
    repeats = [i // 2 for i in range(8)]
    scatter = float(of_shape.scatter(rows, repeats)[0])
    assert scatter == pytest.approx(student_share(3) * 0.29 / np.sqrt(4), rel=0.25)  # 0.29: of the four slopes
    assert float(of_noise.scatter(rows, repeats)[0]) < 0.3 * scatter
    assert of_shape.scatter(rows, [0] * 8)[0] == 0.0  # one motion scatters about nothing
    sd, apart = (float(np.sqrt(of_shape.covariance(frequency, rows, same)[0, 0])) for same in (repeats, range(8)))
    assert sd == pytest.approx(np.sqrt(2) * apart, rel=0.15) and sd < scatter
