"""Filament that is pulled back while the nozzle moves."""

from __future__ import annotations

import numpy as np

from ffcomp.planner.lifts import even_wipes

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [4, 0, 0], [6, 0, 0]])


def test_a_wipe_pulls_by_the_way() -> None:
    e = np.array([0.0, -0.5, -0.6, -0.7, -1.2])
    even_wipes(e, POINTS, 0, 256)
    np.testing.assert_allclose(e, -1.2 * POINTS[:, 0] / 6.0)


def test_filament_that_is_pushed_stays() -> None:
    e = np.array([0.0, 0.5, 0.6, 0.7, 1.2])
    before = e.copy()
    even_wipes(e, POINTS, 0, 256)
    np.testing.assert_array_equal(e, before)


def test_nothing_is_shared_across_a_cut() -> None:
    e = np.array([0.0, -0.5, -0.6, -0.7, -1.2])
    even_wipes(e, POINTS, 254, 256)
    assert e[2] == -0.6
    np.testing.assert_allclose(e, [0.0, -0.2, -0.6, -0.8, -1.2])
