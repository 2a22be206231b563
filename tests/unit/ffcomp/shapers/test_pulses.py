"""Shapers by their defining properties: unit sum, no mean delay, and the vibration they leave."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ffcomp import shapers
from ffcomp.shapers.pulses import PULSES
from models.arrays import FloatArray

names = st.sampled_from([*PULSES])
frequencies = st.floats(10.0, 200.0)
dampings = st.floats(0.0, 0.3)


@given(names, frequencies, dampings)
def test_amplitudes_sum_to_one_and_the_mean_delay_is_zero(name: str, hz: float, zeta: float) -> None:
    shaper = shapers.SHAPERS[name](hz, zeta)
    assert shaper.amplitude.sum() == pytest.approx(1.0, abs=1e-14)
    assert shaper.amplitude @ shaper.time == pytest.approx(0.0, abs=1e-15)
    assert np.all(shaper.amplitude > 0) and np.all(np.diff(shaper.time) > 0)


@given(st.sampled_from(["zv", "mzv", "zvd", "zvdd", "zvddd", "2hump_ei"]), frequencies, dampings)
def test_nothing_vibrates_at_the_design_frequency(name: str, hz: float, zeta: float) -> None:
    shaper = shapers.SHAPERS[name](hz, zeta)
    assert shapers.residual_vibration(shaper, np.array([hz]), zeta)[0] < 1e-12


@given(frequencies, dampings)
def test_ei_leaves_its_tolerance_at_the_design_frequency(hz: float, zeta: float) -> None:
    """v K²/Σ pulses in general, v = 5 % without damping."""
    shaper = shapers.SHAPERS["ei"](hz, zeta)
    decay = np.exp(-zeta * np.pi / np.sqrt(1 - zeta**2))
    expected = 0.05 * decay**2 / (0.2625 + 0.475 * decay + 0.2625 * decay**2)
    assert shapers.residual_vibration(shaper, np.array([hz]), zeta)[0] == pytest.approx(expected)
    assert shapers.residual_vibration(shapers.SHAPERS["ei"](hz, 0.0), np.array([hz]), 0.0)[0] == pytest.approx(0.05)


@pytest.mark.parametrize(("name", "power"), [("zv", 1), ("zvd", 2), ("zvdd", 3), ("zvddd", 4)])
def test_each_derivative_makes_the_vibration_grow_with_one_more_power_of_the_error(name: str, power: int) -> None:
    near = shapers.residual_vibration(shapers.SHAPERS[name](50.0, 0.0), 50.0 * np.array([1.002, 1.004]), 0.0)
    assert near[1] / near[0] == pytest.approx(2.0**power, rel=0.01)


@pytest.mark.parametrize(
    ("name", "band", "zeros"),
    [("ei", (0.81, 1.19), 2), ("2hump_ei", (0.65, 1.35), 3), ("3hump_ei", (0.56, 1.44), 4)],
)
def test_ei_humps_touch_the_tolerance_and_nowhere_pass_it(name: str, band: tuple[float, float], zeros: int) -> None:
    """Undamped, over nearly the documented ±20 % (EI), -40…+45 % (two humps) and -50…+60 % (three): at most 5 %."""
    hz = np.linspace(*band, 4001)
    left = shapers.residual_vibration(shapers.SHAPERS[name](1.0, 0.0), hz, 0.0)
    assert np.max(left) == pytest.approx(0.05, abs=2e-5)
    dips = np.flatnonzero((left[1:-1] < left[:-2]) & (left[1:-1] < left[2:]))
    assert len(dips) == zeros and np.all(left[dips + 1] < 1e-3)


def test_the_residual_is_that_of_a_simulated_oscillator() -> None:
    """ẍ + 2ζωẋ + ω²x = ω² u after shaped steps: superposed step responses after the last pulse."""
    zeta, hz = 0.06, 52.0
    shaper, omega = shapers.SHAPERS["ei"](45.0, zeta), 2 * np.pi * hz
    pole = omega * (-zeta + 1j * np.sqrt(1 - zeta**2))
    since = shaper.time[-1] - shaper.time
    # a unit step leaves x - 1 = Re(C e^{pole t}) with one C for all pulses
    left = abs(np.sum(shaper.amplitude * np.exp(pole * since)))
    t = np.linspace(0, 1 / hz, 2001)
    ringing = np.array(
        [sum(a * _step_error(s + x, zeta, omega) for a, s in zip(shaper.amplitude, since, strict=True)) for x in t]
    )
    plain = _step_error(t, zeta, omega)
    envelope = np.exp(-zeta * omega * t)
    assert np.max(np.abs(ringing / envelope)) == pytest.approx(left * np.max(np.abs(plain / envelope)), rel=1e-3)
    assert shapers.residual_vibration(shaper, np.array([hz]), zeta)[0] == pytest.approx(left)


def _step_error(t: FloatArray | float, zeta: float, omega: float) -> FloatArray:
    damped = omega * np.sqrt(1 - zeta**2)
    return -np.exp(-zeta * omega * t) * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t))


# ---- shaping a motion ----------------------------------------------------------------------------


def parabola(t: FloatArray) -> FloatArray:
    return np.column_stack([1500 * t**2, 40 * t, 0 * t])


T = np.linspace(0.0, 0.3, 301)


@pytest.mark.parametrize("name", shapers.SHAPERS)
def test_constant_acceleration_is_off_by_half_its_spread(name: str) -> None:
    """Σ A (t - T)² = t² + Σ A T²: an offset of ½ a Σ A T² on the shaped axis alone."""
    shaper = shapers.SHAPERS[name](40.0, 0.1)
    offset = shapers.shape(parabola, T, x=shaper) - parabola(T)
    assert offset[:, 0] == pytest.approx(1500 * shaper.amplitude @ shaper.time**2)
    assert np.max(np.abs(offset[:, 1:])) < 1e-12


def test_each_axis_has_its_own_shaper() -> None:
    x, y = shapers.SHAPERS["zv"](35.0), shapers.SHAPERS["ei"](60.0)
    both = shapers.shape(lambda t: parabola(t)[:, [0, 0, 0]], T, x=x, y=y)
    alone = [shapers.shape(parabola, T, x=s)[:, 0] for s in (x, y)]
    assert both == pytest.approx(np.column_stack([*alone, parabola(T)[:, 0]]))


@pytest.mark.parametrize(
    ("name", "hz", "zeta", "words"),
    [
        ("zv", 0.0, 0.1, "above zero, not 0.0 Hz"),
        ("zv", 50.0, 1.0, "not at 1.0"),
        ("smooth_zv", 0.0, 0.1, "above zero"),
    ],
)
def test_a_shaper_that_cannot_be_is_refused(name: str, hz: float, zeta: float, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        shapers.SHAPERS[name](hz, zeta)
