"""Estimators of frequency responses against closed forms: the response itself, its bias, its stated variance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import chirp, freqz, lfilter

from ffcomp.errors import MeasurementError
from ffcomp.measurement.estimators import periodic_frf, sweep_frf

RATE = 1000.0
B, A = [0.0, 0.02, 0.01], [1.0, -1.9, 0.93]  # a mode at 27 Hz, ζ = 0.2


def exact(frequency_hz: np.ndarray) -> np.ndarray:
    return freqz(B, A, worN=2 * np.pi * frequency_hz / RATE)[1]


def multisine(lines: np.ndarray, period: int, periods: int, seed: int) -> np.ndarray:
    generator = np.random.default_rng(seed)
    phase = generator.uniform(0, 2 * np.pi, len(lines))
    one = np.cos(2 * np.pi * np.outer(np.arange(period), lines) / period + phase).sum(axis=1)
    return np.tile(one, periods)


LINES = np.arange(5, 100)


def test_periodic_excitation_is_exact_without_noise() -> None:
    u = multisine(LINES, 1000, 4, 0)
    found = periodic_frf(u[:, None], lfilter(B, A, u)[:, None], RATE, 1000)
    np.testing.assert_allclose(found.frequency_hz, LINES)  # the lines that are excited, and no others
    np.testing.assert_allclose(found.value[:, 0, 0], exact(found.frequency_hz), rtol=1e-9)


def test_periodic_variance_is_what_repeating_shows() -> None:
    u = multisine(LINES, 1000, 6, 1)
    y = lfilter(B, A, u)
    generator = np.random.default_rng(2)
    errors, stated = [], []
    for _ in range(150):
        noisy_u, noisy_y = (x + s * generator.standard_normal(6000) for x, s in ((u, 0.2), (y, 0.5)))
        found = periodic_frf(noisy_u[:, None], noisy_y[:, None], RATE, 1000)
        excited = np.isin(np.rint(found.frequency_hz), LINES[4:-4])  # beyond them noise on the input passes for lines
        errors.append(np.abs(found.value[excited, 0, 0] - exact(found.frequency_hz[excited])) ** 2)
        stated.append(found.variance[excited, 0, 0])
    measured, said = np.mean(errors, axis=0), np.mean(stated, axis=0)
    assert measured.sum() == pytest.approx(said.sum(), rel=0.05)
    np.testing.assert_allclose(measured / said, 1.0, atol=0.45)
    assert np.std(np.log(stated)) < 0.6  # smoothed over neighbouring lines: few periods alone would scatter by 0.5 each


MIX = np.array([[1.0, 0.3, 0.0], [0.2, -0.8, 0.1]])  # two outputs of three inputs


def test_a_sweep_leaks_nothing() -> None:
    """Where spectral division errs, for the record ends ringing, the transient is estimated."""
    t = np.arange(20_000) / RATE
    u = np.concatenate([np.zeros(1000), chirp(t, 2.0, 20.0, 120.0, phi=-90)])
    y = lfilter(B, A, u)
    found = sweep_frf(u[:, None], y[:, None], RATE, 5, 110, degree=4)
    reference = exact(found.frequency_hz)
    local = np.abs(found.value[:, 0, 0] / reference - 1).max()
    divided = np.fft.rfft(y) / np.fft.rfft(u)
    lines = np.rint(found.frequency_hz * 21).astype(int)
    assert local < 1e-6
    assert np.abs(divided[lines] / reference - 1).max() > 1000 * local


def test_a_narrower_window_converges_at_the_polynomials_order() -> None:
    u = np.random.default_rng(8).standard_normal((40_000, 1))
    y = lfilter(B, A, u, axis=0)
    errors = []
    for half_width_hz in (8.0, 4.0):
        found = sweep_frf(u, y, RATE, 15, 40, half_width_hz=half_width_hz, degree=2)
        errors.append(np.sqrt((np.abs(found.value[:, 0, 0] - exact(found.frequency_hz)) ** 2).mean()))
    assert 2.7 < np.log2(errors[0] / errors[1]) < 4.3  # a degree of 2 leaves the cube of the width


@pytest.mark.parametrize("inputs", [1, 3])
def test_the_variance_of_a_sweep_is_what_repeating_shows(inputs: int) -> None:
    generator = np.random.default_rng(9)
    u = generator.standard_normal((8000, inputs))
    clean = lfilter(B, A, u, axis=0) @ MIX[:, :inputs].T
    ratios = []
    for _ in range(40):
        found = sweep_frf(u, clean + 0.3 * generator.standard_normal((8000, 2)), RATE, 5, 100)
        error = np.abs(found.value - exact(found.frequency_hz)[:, None, None] * MIX[:, :inputs]) ** 2
        ratios.append((error.sum(), found.variance.sum()))
    measured, said = np.sum(ratios, axis=0)
    assert measured == pytest.approx(said, rel=0.1)


@pytest.mark.parametrize(
    ("samples", "inputs", "experiments", "words"),
    [
        (500, 1, 1, "1 whole periods of 200 samples are left after one for settling"),
        (1000, 2, 1, "2 inputs need at least 2 experiments with different commands"),
        (1000, 2, 2, "No line is excited in all inputs"),
    ],
)
def test_too_little_for_a_response_is_refused(samples: int, inputs: int, experiments: int, words: str) -> None:
    u = np.tile(np.random.default_rng(1).standard_normal((samples, 1)), (experiments, 1, inputs))
    with pytest.raises(MeasurementError, match=words):
        periodic_frf(u, u, RATE, 200)
