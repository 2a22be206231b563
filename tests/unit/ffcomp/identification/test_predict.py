"""Eqs. 70-72 and the log error, in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.identification.predict import log_error_db, mean_absolute_percentage_accuracy

LAG = np.exp(-1j * np.radians(np.linspace(20.0, 320.0, 247)))


def test_a_fifth_too_large_is_80_percent() -> None:
    magnitude, phase = mean_absolute_percentage_accuracy(3.0 * LAG, 3.6 * LAG)
    assert (magnitude, phase) == pytest.approx((80.0, 100.0))
    assert log_error_db(3.0 * LAG, 3.6 * LAG) == pytest.approx(20 * np.log10(1.2))
