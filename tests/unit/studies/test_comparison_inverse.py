"""The inverse of a mode after a smooth shaper: exact on an axis of one mode, and within a carriage's limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from ffcomp import shapers
from ffcomp.comparison.baselines import Shaping
from ffcomp.comparison.sampling import Print, Sampling
from models.arrays import FloatArray
from models.file import load_machine
from studies.comparison_rivals import InversePrinter, ModeInverse, mode_inverse
from tests.support.prints import squares

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


@pytest.mark.parametrize("name", ["smooth_zv", "smooth_mzv"])
def test_an_axis_that_is_this_mode_follows_the_smoothed_plan(name: str) -> None:
    """To a micrometre of 20 mm, where the shaper alone leaves the axis tens of micrometres behind."""
    t = np.arange(-0.1, 0.4, STEP_S)
    inverse = mode_inverse(name, 90.0, MODE_HZ, ZETA)
    wanted = shapers.shape(there_and_stop, t, shapers.SHAPERS[name](90.0, 0.1))[:, 0]
    assert np.abs(answer(shapers.shape(there_and_stop, t, inverse)[:, 0], t) - wanted).max() < 1e-3
    assert np.abs(answer(wanted, t) - wanted).max() > 0.05
    assert inverse.amplitude @ inverse.time == pytest.approx(-2 * ZETA / OMEGA, rel=1e-9)


def test_one_clean_mode_is_inverted_within_the_limits() -> None:
    """On a cartesian whose axes are one mode each, nothing but the kernel's own smoothing is left."""
    machine = load_machine("ender-3")
    slices, _ = Print(squares(), "squares.gcode", machine, (100.0, 100.0)).slices(Sampling(0, 0))
    linear = InversePrinter(machine, slices)
    inverse, settings = ModeInverse("smooth_mzv"), np.array([140.0, 140.0, 45.0, 35.0, 0.1])
    assert linear.cost(inverse, settings) < 0.3 * linear.best(Shaping("mzv")).cost
    weak = replace(machine, limits=replace(machine.limits, carriage_acceleration_mm_per_s2=1000.0))
    assert InversePrinter(weak, slices).cost(inverse, settings) == float("inf")
