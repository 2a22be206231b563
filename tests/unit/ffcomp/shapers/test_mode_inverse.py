"""A smooth shaper with the inverse of one mode: an axis that is that mode follows the smoothed plan."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import StateSpace, lsim

from ffcomp import shapers
from ffcomp.shapers.smooth import KERNELS

FloatArray = NDArray[np.float64]

MODE_HZ, ZETA, STEP_S = 45.0, 0.08, 5e-5
OMEGA = 2 * np.pi * MODE_HZ


def there_and_stop(t: FloatArray) -> FloatArray:
    """10 m/s² up to 100 mm/s, 20 mm along x, and down: with jumps of the acceleration, and a jump of 5 mm/s."""
    since = np.clip(t, 0.0, 0.21)
    up, down = np.minimum(since, 0.01), np.maximum(since - 0.2, 0.0)
    x = 5000 * up**2 + 100 * np.maximum(since - 0.01, 0.0) - 5000 * down**2 + 5 * since
    return np.column_stack([x, 0 * t, 0 * t])


def answer(command: FloatArray, t: FloatArray) -> FloatArray:
    """Return what ẍ + 2ζω ẋ + ω² x = ω² u does."""
    mode = StateSpace([[0, 1], [-(OMEGA**2), -2 * ZETA * OMEGA]], [[0], [OMEGA**2]], [[1, 0]], [[0]])
    return np.asarray(lsim(mode, command, t - t[0])[1])


@pytest.mark.parametrize("name", KERNELS)
def test_an_axis_that_is_this_mode_follows_the_smoothed_plan(name: str) -> None:
    """To a micrometre of 20 mm, where the shaper alone leaves the axis tens of micrometres behind."""
    t = np.arange(-0.1, 0.4, STEP_S)
    wanted = shapers.shape(there_and_stop, t, shapers.SHAPERS[name](90.0, 0.1))[:, 0]
    inverted = shapers.shape(there_and_stop, t, shapers.mode_inverse(name, 90.0, MODE_HZ, ZETA))[:, 0]
    assert np.abs(answer(inverted, t) - wanted).max() < 1e-3
    assert np.abs(answer(wanted, t) - wanted).max() > 0.05


@pytest.mark.parametrize("name", KERNELS)
def test_it_runs_ahead_by_what_the_mode_lags(name: str) -> None:
    inverse = shapers.mode_inverse(name, 70.0, MODE_HZ, ZETA)
    assert inverse.amplitude.sum() == pytest.approx(1.0, abs=1e-9)
    assert inverse.amplitude @ inverse.time == pytest.approx(-2 * ZETA / OMEGA, rel=1e-9)
    assert np.all(np.diff(inverse.time) > 0)


def test_a_mode_without_a_frequency_is_refused() -> None:
    with pytest.raises(ValueError, match="above zero, not 0"):
        shapers.mode_inverse("smooth_mzv", 70.0, 0.0, ZETA)
