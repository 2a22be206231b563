"""Unknown start and clock of a record: found, with uncertainties that are true, or refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

from ffcomp.errors import MeasurementError
from ffcomp.measurement.alignment import align

RATE = 1000.0
EXPECTED_T = np.arange(12_000) / RATE
BAND = butter(2, [12, 60], "bandpass", fs=RATE, output="sos")
EXPECTED = sosfilt(BAND, np.random.default_rng(0).standard_normal((12_000, 3)), axis=0)
MOTION = CubicSpline(EXPECTED_T, EXPECTED)


def record(
    offset: float, ratio: float, noise: float, seed: int, length_s: float = 8.0
) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    t = 3127.5 + np.arange(12_800) / 1600
    clean = MOTION(offset + ratio * (t - t[0])) * [1.0, 0.9, 1.1]  # gains of the sensor
    return t, clean + noise * EXPECTED.std() * generator.standard_normal(clean.shape) + [0.0, 0.1, 9.8]


def test_without_noise_it_is_exact() -> None:
    t, measured = record(2.34567, 1.0123, 0.0, 0)
    found = align(t, measured, EXPECTED_T, EXPECTED)
    assert found.offset_s == pytest.approx(2.34567, abs=1e-5)
    assert found.clock_ratio == pytest.approx(1.0123, abs=2e-6)
    assert found.correlation > 0.995
    np.testing.assert_allclose(
        found.expected_time(t)[[0, -1]], 2.34567 + 1.0123 * np.array([0, t[-1] - t[0]]), atol=5e-6
    )


@pytest.mark.slow
def test_the_uncertainties_are_true() -> None:
    scores = []
    for seed in range(16):
        offset, ratio = 1.0 + 0.1 * np.random.default_rng(seed).random(), 1 + 0.02 * np.sin(seed)
        t, measured = record(offset, ratio, 1.0, seed)
        found = align(t, measured, EXPECTED_T, EXPECTED)
        scores.append(
            [(found.offset_s - offset) / found.offset_sd_s, (found.clock_ratio - ratio) / found.clock_ratio_sd]
        )
        assert found.offset_sd_s < 1e-4
    assert np.abs(scores).max() < 4.5
    assert np.sqrt((np.array(scores) ** 2).mean()) == pytest.approx(1.0, abs=0.35)


def test_an_expectation_that_is_only_roughly_right() -> None:
    """The machine answers late and rings: the time found is near the true one, and says how sure it is."""
    t, measured = record(1.5, 1.001, 0.3, 3)
    ringing = measured + 0.5 * np.roll(measured, 40, axis=0)
    found = align(t, ringing, EXPECTED_T, EXPECTED)
    assert abs(found.offset_s - 1.5) < 2e-3
    assert found.offset_sd_s > align(t, measured, EXPECTED_T, EXPECTED).offset_sd_s


def test_shifting_the_clock_shifts_the_offset() -> None:
    t, measured = record(2.0, 1.0, 0.2, 4)
    plain, shifted = align(t, measured, EXPECTED_T, EXPECTED), align(t + 77.0, measured, EXPECTED_T + 5.0, EXPECTED)
    assert shifted.offset_s - plain.offset_s == pytest.approx(5.0, abs=1e-7)
    assert shifted.clock_ratio == pytest.approx(plain.clock_ratio, abs=1e-9)


def test_another_motion_is_no_match() -> None:
    t, measured = record(2.0, 1.0, 0.0, 5)
    other = sosfilt(BAND, np.random.default_rng(99).standard_normal((12_000, 3)), axis=0)
    with pytest.raises(MeasurementError, match=r"capture\.csv: The record does not match"):
        align(t, measured, EXPECTED_T, other, "capture.csv")


def test_a_motion_that_repeats_is_ambiguous() -> None:
    tone = np.sin(2 * np.pi * 20 * EXPECTED_T)[:, None]
    t = np.arange(5000) / 1600
    with pytest.raises(MeasurementError, match="a motion that does not repeat is needed"):
        align(t, np.sin(2 * np.pi * 20 * t)[:, None], EXPECTED_T, tone)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t, m: (t, m[:, :2]), "2 axes were measured, but 3 are expected"),
        (lambda t, m: (t[:500], m[:500]), "shorter than 0.5 s"),
        (lambda t, m: (t, np.where(np.arange(len(m))[:, None] == 7, np.nan, m)), "The record has gaps"),
        (lambda t, m: (t, 0 * m), "Nothing moves"),
    ],
)
def test_records_that_cannot_be_aligned(change: object, words: str) -> None:
    with pytest.raises(MeasurementError, match=words):
        align(*change(*record(1.0, 1.0, 0.1, 6)), EXPECTED_T, EXPECTED)  # type: ignore[operator]
