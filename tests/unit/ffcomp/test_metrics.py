"""Distances, delays and efforts whose answers are known in closed form."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from ffcomp import metrics
from tests.support.contour import contour_error_in_order

FloatArray = NDArray[np.float64]

CORNER_T = np.array([0.0, 0.1, 0.2])
CORNER = np.array([[0.0, 0.0, 0.2], [10.0, 0.0, 0.2], [10.0, 10.0, 0.2]])  # 100 mm/s, a right angle


def straight(t: FloatArray, corners_t: FloatArray, corners: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(t, corners_t, corners[:, j]) for j in range(3)])


def wave(t: FloatArray) -> FloatArray:
    """A smooth motion from rest to rest in 1 s."""
    swing = np.sin(np.pi * np.clip(t, 0, 1)) ** 4
    return np.column_stack([30 * swing * np.sin(40 * t), 20 * swing * np.cos(31 * t), 5 * swing])


# ---- contour -------------------------------------------------------------------------------------


def test_on_the_path_there_is_no_contour_error_however_it_is_sampled() -> None:
    """Sampled vertices would leave up to half their spacing; segments leave rounding."""
    t = np.linspace(0, 0.2, 777)
    assert np.max(metrics.contour_error(CORNER_T, CORNER, t, straight(t, CORNER_T, CORNER))) < 1e-12


def test_a_rounded_corner_is_off_by_its_sagitta() -> None:
    """An arc of radius r in a right angle is r(1 - cos φ) off the nearer leg, at most r(1 - 1/√2)."""
    r, phi = 0.5, np.linspace(0, np.pi / 2, 91)
    arc = np.column_stack([10 - r + r * np.sin(phi), r - r * np.cos(phi), np.full_like(phi, 0.2)])
    t = 0.1 + (phi - np.pi / 4) * 1e-3
    error = metrics.contour_error(CORNER_T, CORNER, t, arc)
    assert error == pytest.approx(r - r * np.maximum(np.cos(phi), np.sin(phi)))
    assert np.max(error) == pytest.approx(r * (1 - np.sqrt(0.5)))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_no_closer_point_of_the_window_exists(seed: int) -> None:
    """Against 2000 points on every segment: never farther than the nearest of them, and hardly closer."""
    rng = np.random.default_rng(seed)
    corners, t = rng.normal(size=(6, 3)), np.arange(6.0)
    point = rng.normal(size=(1, 3))
    dense = straight(np.linspace(1.0, 4.0, 6001), t, corners)
    nearest = np.min(np.linalg.norm(dense - point, axis=1))
    error = metrics.contour_error(t, corners, np.array([2.5]), point, window_s=1.2)[0]
    assert nearest - 0.01 < error <= nearest + 1e-12


# ---- tracking ------------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0.0015, -0.00037, 0.0123456])
def test_a_constant_delay_is_found_and_leaves_nothing(delay: float) -> None:
    t = np.arange(-1000, 9000) / 8000
    found = metrics.tracking(wave(t), wave(t - delay), 1 / 8000)
    assert found.delay_s == pytest.approx(delay, abs=1e-9)
    assert found.rms_no_delay_mm < 1e-6 < found.rms_mm


def test_a_periodic_motion_does_not_trap_the_search() -> None:
    """8 ms late on a 40 Hz wiggle (period 25 ms) upon a slow move: one valley of several is right."""
    t = np.arange(4000) / 4000

    def wiggle(t: FloatArray) -> FloatArray:
        t = np.clip(t, 0, 0.9)
        return np.column_stack([20 * np.sin(np.pi * t / 1.8) ** 2 + np.sin(80 * np.pi * t), 0 * t, 0 * t])

    assert metrics.tracking(wiggle(t), wiggle(t - 0.008), 1 / 4000).delay_s == pytest.approx(0.008, abs=1e-5)


# ---- effort and the whole ------------------------------------------------------------------------


def test_peak_acceleration_of_a_parabola() -> None:
    t = np.linspace(0, 1, 1001)
    command = np.column_stack([-3500 * t**2, 0 * t, 100 * t])
    assert metrics.peak_acceleration(command, 1e-3) == pytest.approx(7000)


@pytest.mark.parametrize("rate", [1000, 4000, 16000])
def test_a_jump_of_speed_counts_alike_at_every_sampling_rate(rate: int) -> None:
    """20 mm/s within the span of 4 ms: 5000 mm/s²."""
    t = np.arange(-rate // 10, rate // 10 + 1) / rate
    command = np.column_stack([20 * np.maximum(t, 0), 0 * t, 0 * t])
    assert metrics.peak_acceleration(command, 1 / rate) == pytest.approx(5000)


# ---- contour error whatever the clock


def walked(corners: list[tuple[float, ...]], step_mm: float) -> FloatArray:
    """Points every so many mm along a polygon."""
    at = np.array([(*c, 0.0)[:3] for c in corners], dtype=float)
    parts = [
        a + (b - a) * np.linspace(0, 1, int(np.linalg.norm(b - a) / step_mm), endpoint=False)[:, None]
        for a, b in pairwise(at)
    ]
    return np.concatenate([*parts, at[-1:]])


def polygon(corners: list[tuple[float, ...]]) -> FloatArray:
    return np.array([(*c, 0.0)[:3] for c in corners], dtype=float)


def test_in_order_a_line_beside_another_is_not_taken_for_it() -> None:
    """There and back 0.4 mm apart, nozzle 0.3 mm towards the way back: nearest is 0.1 mm, its own line is 0.3 mm."""
    path = [(0.0, 0.0), (50.0, 0.0), (50.0, 0.4), (0.0, 0.4)]
    nozzle = walked([(0.0, 0.3), (49.0, 0.3), (50.0, 0.0), (50.0, 0.4), (0.0, 0.4)], 0.2)
    error = contour_error_in_order(polygon(path), nozzle)
    assert error[10:200] == pytest.approx(0.3, abs=1e-9)
    assert error[-200:] == pytest.approx(0.0, abs=1e-9)


def test_track_puts_everything_in_its_units() -> None:
    t = np.linspace(0, 0.2, 2001)
    wanted = straight(t, CORNER_T, CORNER)
    lifted = wanted + np.array([0.0, 0.0, 0.01])
    contour = metrics.contour_error(CORNER_T, CORNER, t, lifted)
    judged = metrics.build_track(metrics.tracking(wanted, lifted, t[1]), contour, 0.2, 400.0)
    assert judged.contour_rms_um == judged.contour_p99_um == pytest.approx(10)
    assert judged.contour_max_um == judged.tracking_max_um == pytest.approx(10)
    assert judged.tracking_rms_um == pytest.approx(10)
    assert judged.tracking_rms_no_delay_um <= judged.tracking_rms_um
    assert judged.print_time_s == pytest.approx(0.2)
    assert judged.peak_command_acceleration_mm_per_s2 == pytest.approx(400)
