"""Modes from spectra: known ones are found again, with true uncertainties; real files end in a verdict."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import chirp, lfilter

from ffcomp.measurement.capture import Capture
from ffcomp.measurement.modes import ModeFit, fit_modes, modes_in
from ffcomp.measurement.swept import swept_band
from ffcomp.measurement.vibration import read_vibration

RATE = 1600.0


def mode(frequency: float, zeta: float) -> tuple[list[float], list[float]]:
    """A digital mode with unit gain at rest: numerator and denominator."""
    radius = np.exp(-zeta * 2 * np.pi * frequency / RATE)
    angle = 2 * np.pi * frequency * np.sqrt(1 - zeta**2) / RATE
    denominator = [1.0, -2 * radius * np.cos(angle), radius**2]
    return [sum(denominator)], denominator


def swept(modes: list[tuple[float, float]], noise: float, seed: int, length_s: float = 128.0) -> np.ndarray:
    """What a sweep at 1 Hz/s with acceleration proportional to frequency makes of modes side by side, m/s²."""
    t = np.arange(int(length_s * RATE)) / RATE
    command = 0.06 * (5 + t) * chirp(t, 5.0, length_s, 5.0 + length_s)
    answer = np.sum([lfilter(*mode(*one), command) for one in modes], axis=0)
    return answer + noise * np.random.default_rng(seed).standard_normal(len(t))


def spectrum(record: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As Klipper makes it: segments of 1024, Kaiser window of β = 6, half overlapping."""
    taper = np.kaiser(1024, 6.0)
    cuts = np.array([record[k : k + 1024] for k in range(0, len(record) - 1023, 512)])
    power = 2 * (np.abs(np.fft.rfft((cuts - cuts.mean(axis=1, keepdims=True)) * taper)) ** 2).mean(axis=0)
    return np.arange(513) * RATE / 1024, power / (RATE * taper @ taper)


@pytest.mark.parametrize("truth", [[(43.0, 0.05)], [(30.0, 0.02)], [(38.0, 0.06), (82.0, 0.04)]])
def test_known_modes_are_found_again(truth: list[tuple[float, float]]) -> None:
    found = fit_modes(*spectrum(swept(truth, 0.5, 1)))
    clear = sorted(one.frequency_hz for one in found.modes if one.clear and one.power > 0.05)
    np.testing.assert_allclose(clear, [frequency for frequency, _ in truth], rtol=0.002)
    for frequency, zeta in truth:
        one = min(found.modes, key=lambda m: abs(m.frequency_hz - frequency))
        assert one.damping_ratio == pytest.approx(zeta, rel=0.05)  # the window alone is as wide as a mode of 0.04 here
    assert found.verdict.startswith("Clear: ")


@pytest.mark.slow
def test_the_uncertainty_of_a_noisy_spectrum_is_true() -> None:
    scores = []
    generator = np.random.default_rng(0)
    frequency = np.arange(1, 90) * 1.5625
    ratio = frequency / 45.0
    smooth = (frequency / 50) ** 2 * (1 / ((1 - ratio**2) ** 2 + (0.2 * ratio) ** 2) + 0.2)
    for _ in range(8):
        found = fit_modes(frequency, smooth * generator.gamma(30, 1 / 30, len(frequency)))
        one = found.modes[0]
        scores.append((one.frequency_hz - 45.0) / one.frequency_sd_hz)
    assert 0.5 < np.std(scores) < 1.6


def test_a_motors_tone_is_told_from_a_mode() -> None:
    t = np.arange(int(40 * RATE)) / RATE
    noise = np.random.default_rng(2).standard_normal(len(t))
    record = lfilter(*mode(45.0, 0.06), noise) + 0.5 * np.sin(2 * np.pi * 90.0 * t)
    found = fit_modes(*spectrum(record), excitation_exponent=0.0)
    near = {round(one.frequency_hz / 45): one.tone for one in found.modes if one.power > 0.05}
    assert near[1] is False and near[2] is True


@cache
def modes_in_file(path: Path) -> ModeFit:
    return modes_in(read_vibration(path))


PEAKS = {  # Hz: the highest line of the shaken axis, by eye
    "ender3__resonances_y_20210630_230110": 39.0,
    "v24__calibration_data_x_20230306_225431": 52.0,
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "peak"), PEAKS.items())
def test_real_spectra_have_their_main_mode(data: Path, name: str, peak: float) -> None:
    found = modes_in_file(data / "vibration" / "klipper_resonances_bassco" / f"{name}.csv")
    assert found.modes[0].frequency_hz == pytest.approx(peak, rel=0.05)
    assert found.modes[0].clear


# ---- swept ----


RATE_SWEPT = 800.0


def felt(high_hz: float, mode_hz: float, *, zeta: float = 0.06, rest_s: float = 2.0) -> np.ndarray:
    """A sweep from 5 Hz at 1 Hz/s, its third harmonic, rests around it, noise: (n,) m/s²."""
    t = np.arange(int((high_hz - 5) * RATE_SWEPT)) / RATE_SWEPT
    command = 0.08 * (5 + t) * (chirp(t, 5, t[-1], high_hz) + 0.3 * chirp(t, 15, t[-1], 3 * high_hz))
    command = np.pad(command, int(rest_s * RATE_SWEPT))
    radius = np.exp(-zeta * 2 * np.pi * mode_hz / RATE_SWEPT)
    denominator = [1.0, -2 * radius * np.cos(2 * np.pi * mode_hz / RATE_SWEPT), radius**2]
    answer = lfilter([sum(denominator)], denominator, command)
    return np.asarray(answer + np.random.default_rng(1).normal(0, 0.1, len(command)))


def capture(record: np.ndarray) -> Capture:
    rows = np.column_stack([record, 0.2 * record, np.full(len(record), 9.81)])
    return Capture("made.csv", np.arange(len(record)) / RATE_SWEPT, rows)


def write(path: Path, record: np.ndarray) -> Path:
    rows = np.column_stack([np.arange(len(record)) / RATE_SWEPT, 1e3 * record, 200 * record, 9810 + 300 * record])
    np.savetxt(path, rows, fmt="%.5f", delimiter=",", header="#time,accel_x,accel_y,accel_z", comments="")
    return path


@pytest.mark.parametrize(("high", "rest"), [(50.0, 2.0), (133.0, 0.0), (133.0, 6.0)])
def test_the_band_of_a_sweep(high: float, rest: float) -> None:
    found = swept_band(capture(felt(high, 70.0, rest_s=rest)))
    assert found is not None
    assert found.high_hz == pytest.approx(high, abs=2.5) and found.low_hz < 16


def test_what_is_no_sweep_has_none() -> None:
    noise = np.random.default_rng(0).normal(0, 1.0, int(30 * RATE_SWEPT))
    tone = np.sin(2 * np.pi * 60 * np.arange(len(noise)) / RATE_SWEPT)
    assert swept_band(capture(noise)) is None
    assert swept_band(capture(noise + 5 * tone)) is None
    assert swept_band(capture(felt(133.0, 70.0)[:900])) is None


def test_the_end_of_a_sweep_is_no_resonance(tmp_path: Path) -> None:
    """14 of 14 captures that stopped at 50 Hz once got modes at 41 to 44 Hz."""
    found = modes_in(read_vibration(write(tmp_path / "raw_data_x_a.csv", felt(50.0, 70.0))))
    assert found.modes == () and "No mode lies within the swept band" in found.verdict
    assert "sweep to 133 Hz" in found.verdict
    below = modes_in(read_vibration(write(tmp_path / "raw_data_x_b.csv", felt(50.0, 30.0))))
    assert below.modes[0].frequency_hz == pytest.approx(30.0, rel=0.01)
