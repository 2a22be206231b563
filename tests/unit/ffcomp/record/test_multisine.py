"""The signals have the spectra they were designed for, as straight lines between their knots play them."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ffcomp.record.multisine import band, excitation, polyline_gain, scaled
from models.arrays import FloatArray

FINE = 64  # samples between two knots
WIDE = band(5.0, 110.0, 4.0)


def polyline(wave: FloatArray) -> FloatArray:
    """One period (knots,) with straight lines between the knots: (FINE · knots,)."""
    closed = np.append(wave, wave[0])
    return np.interp(np.arange(FINE * len(wave)) / FINE, np.arange(len(closed)), closed)


@given(st.integers(1, 112))
@settings(max_examples=20, deadline=None)
def test_straight_lines_pass_a_sine_on_by_sinc_squared(turns: int) -> None:
    """Amplitude at its own frequency, and at its first image 1/S − f: the closed forms."""
    n = 250
    spectrum = 2.0 / (n * FINE) * np.abs(np.fft.rfft(polyline(np.cos(2 * np.pi * turns * np.arange(n) / n + 0.3))))
    both = np.array([turns, n - turns])
    # what is left is the sampled spectrum's own aliasing, of images beyond FINE/2 segments' rates
    np.testing.assert_allclose(spectrum[both], polyline_gain(both / 1.0, 1.0 / n), rtol=3e-3, atol=1e-4)


def test_a_multisine_accelerates_evenly_at_its_lines_and_nowhere_else() -> None:
    """In the machine, not only at the knots: the polyline's own spectrum, line by line."""
    wave = scaled(WIDE, 4000.0, 500.0, seed=3)
    spectrum = 2.0 / (WIDE.knots * FINE) * np.fft.rfft(polyline(wave))
    acceleration = np.abs(spectrum[WIDE.lines]) * (2 * np.pi * WIDE.frequencies_hz) ** 2
    np.testing.assert_allclose(acceleration, acceleration.mean(), rtol=2e-3)
    others = np.setdiff1d(np.arange(WIDE.knots // 2), WIDE.lines)
    assert np.abs(spectrum[others]).max() < 1e-9 * np.abs(spectrum).max()


def test_an_excitation_rests_at_both_ends_and_repeats_between() -> None:
    (u, begin), n = excitation(WIDE, 3, 4000.0, 150.0, seed=1), WIDE.knots
    assert u[0] == u[-1] == 0.0
    assert np.abs(np.diff(u)[[0, -1]]).max() / WIDE.segment_s < 0.5
    first, second, third = (u[begin + k * n : begin + (k + 1) * n] for k in range(3))
    np.testing.assert_allclose(second[:-200], first[:-200], atol=1e-12)
    np.testing.assert_allclose(third[:-200], first[:-200], atol=1e-12)
    assert np.abs(np.diff(u, 2)).max() / WIDE.segment_s**2 < 1.01 * 4000.0
