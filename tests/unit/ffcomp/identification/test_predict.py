"""Eqs. 70-72 and the log error, in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from ffcomp.identification.predict import (
    log_error_db,
    mean_absolute_percentage_accuracy,
    phases_deg,
)
from models.file import load_machine

FREQUENCIES = np.arange(2.0, 125.1, 0.5)  # the paper's 247 lines
LAG = np.exp(-1j * np.radians(np.linspace(20.0, 320.0, 247)))


def test_a_fifth_too_large_is_80_percent() -> None:
    magnitude, phase = mean_absolute_percentage_accuracy(3.0 * LAG, 3.6 * LAG)
    assert (magnitude, phase) == pytest.approx((80.0, 100.0))
    assert log_error_db(3.0 * LAG, 3.6 * LAG) == pytest.approx(20 * np.log10(1.2))


def test_noise_in_an_antiresonance_does_not_wind_the_phase_up() -> None:
    machine = load_machine("mp-delta-pro")
    model = machine.vibration.frequency_response(np.zeros(2), FREQUENCIES)[:, 0, 0]
    generator = np.random.default_rng(4)
    noisy = model + 0.3 * (generator.normal(size=247) + 1j * generator.normal(size=247))
    measured, predicted = phases_deg(noisy, model)
    assert np.abs(measured - predicted).max() <= 180.0
    assert np.abs(np.diff(predicted)).max() < 30.0 and predicted[-1] < -360.0
