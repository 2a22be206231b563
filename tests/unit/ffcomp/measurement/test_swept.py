"""The band of a sweep, and what its end is taken for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import chirp, lfilter

from ffcomp.errors import MeasurementError
from ffcomp.identification.axis_spectra import Spectrum
from ffcomp.identification.modal_fit import AxisFit, fit_axis
from ffcomp.identification.resonance_tests import spectrum_of
from ffcomp.measurement.capture import Capture
from ffcomp.measurement.swept import swept_band

RATE = 800.0


def felt(high_hz: float, mode_hz: float, *, zeta: float = 0.06, rest_s: float = 2.0) -> np.ndarray:
    """A sweep from 5 Hz at 1 Hz/s, its third harmonic, rests around it, noise: (n,) m/s²."""
    t = np.arange(int((high_hz - 5) * RATE)) / RATE
    command = 0.08 * (5 + t) * (chirp(t, 5, t[-1], high_hz) + 0.3 * chirp(t, 15, t[-1], 3 * high_hz))
    command = np.pad(command, int(rest_s * RATE))
    radius = np.exp(-zeta * 2 * np.pi * mode_hz / RATE)
    denominator = [1.0, -2 * radius * np.cos(2 * np.pi * mode_hz / RATE), radius**2]
    answer = lfilter([sum(denominator)], denominator, command)
    return np.asarray(answer + np.random.default_rng(1).normal(0, 0.1, len(command)))


def capture(record: np.ndarray) -> Capture:
    rows = np.column_stack([record, 0.2 * record, np.full(len(record), 9.81)])
    return Capture("made.csv", np.arange(len(record)) / RATE, rows)


def write(path: Path, record: np.ndarray) -> Path:
    rows = np.column_stack([np.arange(len(record)) / RATE, 1e3 * record, 200 * record, 9810 + 300 * record])
    np.savetxt(path, rows, fmt="%.5f", delimiter=",", header="#time,accel_x,accel_y,accel_z", comments="")
    return path


@pytest.mark.parametrize(("high", "rest"), [(50.0, 2.0), (133.0, 0.0), (133.0, 6.0)])
def test_the_band_of_a_sweep(high: float, rest: float) -> None:
    found = swept_band(capture(felt(high, 70.0, rest_s=rest)))
    assert found is not None
    assert found.high_hz == pytest.approx(high, abs=2.5) and found.low_hz < 16


def test_what_is_no_sweep_has_none() -> None:
    noise = np.random.default_rng(0).normal(0, 1.0, int(30 * RATE))
    tone = np.sin(2 * np.pi * 60 * np.arange(len(noise)) / RATE)
    assert swept_band(capture(noise)) is None
    assert swept_band(capture(noise + 5 * tone)) is None
    assert swept_band(capture(felt(133.0, 70.0)[:900])) is None


def fitted(path: Path) -> AxisFit:
    spectrum = spectrum_of(path, None, (2.0, 400.0))
    assert isinstance(spectrum, Spectrum)
    return fit_axis("x", [spectrum])


def test_the_end_of_a_sweep_is_no_resonance(tmp_path: Path) -> None:
    """14 of 14 captures that stopped at 50 Hz once got modes at 41 to 44 Hz."""
    with pytest.raises(MeasurementError, match="sweep to 133 Hz"):
        fitted(write(tmp_path / "raw_data_x_a.csv", felt(50.0, 70.0)))
    below = fitted(write(tmp_path / "raw_data_x_b.csv", felt(50.0, 30.0)))
    assert below.modes[0].frequency_hz.value == pytest.approx(30.0, rel=0.01)
