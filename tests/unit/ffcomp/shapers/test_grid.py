"""Shapers on an even grid, settings by search, and a shaper for each carriage."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ffcomp import shapers
from ffcomp.shapers.grid import on_grid, shape_samples
from ffcomp.shapers.pattern import Scan, search
from models.file import load_machine

FloatArray = NDArray[np.float64]

STEP_S, MARGIN = 5e-4, 200
MAKERS = {
    "mzv": shapers.mzv(41.3, 0.07),
    "3hump_ei": shapers.three_hump_ei(57.0),
    "smooth_si": shapers.SHAPERS["smooth_si"](44.0, 0.1),
    "inverse": shapers.mode_inverse("smooth_mzv", 110.0, 47.0, 0.1),
}


def corner(t: FloatArray) -> FloatArray:
    """100 mm/s along x, then along y, each from rest to rest at 5 m/s²; z climbs a little."""
    x, y = (_ramped(t - begin) for begin in (0.05, 0.25))
    return np.column_stack([x, y, 0.3 * x])


def _ramped(t: FloatArray) -> FloatArray:
    since = np.clip(t, 0.0, 0.2)
    up, down = np.minimum(since, 0.02), np.maximum(since - 0.18, 0.0)
    return 2500 * up**2 + 100 * np.maximum(since - 0.02, 0.0) - 2500 * down**2


@pytest.mark.parametrize("name", MAKERS)
def test_samples_are_shaped_as_the_motion_is(name: str) -> None:
    """To 0.3 µm (an inverse: 2), where shaping moves the nozzle by 90 µm and more."""
    t = STEP_S * np.arange(-MARGIN, 1201 + MARGIN)
    shaper = MAKERS[name]
    exact = shapers.shape(corner, t[MARGIN:-MARGIN], shaper, None, shaper)
    found = shape_samples(corner(t), (shaper, None, shaper), STEP_S, MARGIN)
    assert np.abs(found - exact).max() < (2e-3 if name == "inverse" else 3e-4)
    assert np.abs(exact - corner(t[MARGIN:-MARGIN])).max() > 0.08
    assert np.array_equal(found[:, 1], corner(t[MARGIN:-MARGIN])[:, 1])


def test_a_margin_that_is_too_short_holds_the_ends() -> None:
    t = STEP_S * np.arange(1201)
    found = shape_samples(corner(t), (shapers.zv(20.0), None, None), STEP_S, 0)
    assert found.shape == (1201, 3)
    assert found[-1] == pytest.approx(corner(t[-1:])[0])


def test_a_parabola_is_shaped_exactly() -> None:
    shaper = shapers.ei(37.7)
    first, weights = on_grid(shaper, STEP_S)
    delay = STEP_S * (first + np.arange(len(weights)))
    for power in (0, 1, 2):
        assert weights @ delay**power == pytest.approx(shaper.amplitude @ shaper.time**power, abs=1e-15)


# ---- each carriage -------------------------------------------------------------------------------


def test_on_straight_axes_carriages_are_axes() -> None:
    t = np.linspace(-0.05, 0.6, 300)
    each = shapers.mzv(40.0), shapers.zv(50.0), shapers.ei(60.0)
    middle = np.array([100.0, 100.0, 10.0])

    def position(at: FloatArray) -> FloatArray:
        return corner(at) + middle

    compiled = load_machine("ender-3").kinematics.compiled()
    assert shapers.shape_carriages(position, t, compiled, each) == pytest.approx(shapers.shape(position, t, *each))


def test_on_a_delta_each_tower_is_shaped_by_itself() -> None:
    """A climb moves all carriages alike; with three different shapers it leaves the vertical, and comes back to it."""
    t = np.linspace(0.0, 0.6, 300)
    compiled = load_machine("mp-delta-pro").kinematics.compiled()

    def climb(at: FloatArray) -> FloatArray:
        return corner(at)[:, [1, 1, 0]] * [0.0, 0.0, 1.0]

    same = shapers.shape_carriages(climb, t, compiled, (shapers.zv(40.0),) * 3)
    assert same == pytest.approx(shapers.shape(climb, t, z=shapers.zv(40.0)), abs=1e-9)
    apart = shapers.shape_carriages(climb, t, compiled, (shapers.zv(40.0), shapers.zv(30.0), shapers.zv(50.0)))
    assert np.abs(apart[:, :2]).max() > 0.005
    assert apart[-1] == pytest.approx(climb(t[-1:])[0], abs=1e-9)


# ---- settings ------------------------------------------------------------------------------------


def bowl(settings: FloatArray) -> float:
    """Least at 47, 62 and 0.13; forbidden above 90."""
    if settings.max() > 90.0:
        return float("inf")
    return float(np.sum(np.log(settings / [47.0, 62.0, 0.13]) ** 2 * [1.0, 3.0, 0.1]))


def test_the_search_finds_the_least() -> None:
    scans = (Scan((0, 1), (0.7, 1.4, 2.0)), Scan((2,), (0.5, 2.0)))
    found = search(bowl, np.array([30.0, 30.0, 0.1]), scans)
    assert found.settings == pytest.approx([47.0, 62.0, 0.13], rel=0.02)
    assert found.cost == bowl(found.settings)


def test_what_is_not_free_stays() -> None:
    found = search(bowl, np.array([30.0, 30.0, 0.1]), free=[1])
    assert found.settings[[0, 2]].tolist() == [30.0, 0.1] and found.settings[1] == pytest.approx(62.0, rel=0.02)
