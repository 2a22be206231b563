"""Runs to responses: inputs that move, repeats, units, gaps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import freqz, lfilter

from ffcomp.errors import MeasurementError
from ffcomp.measurement.recording import Recording, read_recording
from ffcomp.measurement.recording_frfs import frfs_from_recordings
from models.file import load_machine

RATE = 1600.0
B, A = [0.02, 0.01], [1.0, -1.9, 0.93]


def recording(command_mm: np.ndarray, noise: float = 0.0, seed: int = 0, **comments: str) -> Recording:
    """All carriages commanded; the first one's acceleration and position measured."""
    n = len(command_mm)
    answer = lfilter(B, A, command_mm[:, 0])
    noisy = answer * 1e-3 + noise * np.random.default_rng(seed).standard_normal(n)
    sensors = {"acc_A": noisy}, {"pos_A": answer}
    t = np.arange(n) / RATE
    return Recording(f"r-{seed}.csv", t, command_mm, "carriage", *sensors, dict(comments))


def multisine(seed: int, periods: int = 4) -> np.ndarray:
    """(n, 3) mm: A, or A and B, moves; periods of one second."""
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 100)
    t = np.arange(1600) / RATE
    one = np.cos(2 * np.pi * np.outer(t, np.arange(10, 110)) + phase).sum(axis=1)
    return np.column_stack([np.tile(one, periods), np.zeros((1600 * periods, 2))])


def exact(frequency: np.ndarray) -> np.ndarray:
    return freqz(B, A, worN=2 * np.pi * frequency / RATE)[1]


def test_small_gaps_are_bridged_and_large_ones_refused() -> None:
    whole = recording(multisine(0), period_s="1.0")
    holed = whole.acceleration["acc_A"].copy()
    holed[1000:1002] = np.nan
    small = frfs_from_recordings([replace(whole, acceleration={"acc_A": holed})], 20, 100)[0]
    np.testing.assert_allclose(small.value, exact(small.frequency_hz), rtol=1e-2)
    holed[1000:1100] = np.nan
    with pytest.raises(MeasurementError, match=r"r-0.csv: Sensor acc_A is missing for 0.0625 s after t = 0.624375 s"):
        frfs_from_recordings([replace(whole, acceleration={"acc_A": holed})], 20, 100)


def test_three_carriages_at_once_in_measured_runs(data: Path) -> None:
    """Two different commands of all carriages, four seconds from rest, against the machine file they were made with."""
    folder = data / "runs" / "nothing-hidden"
    names = ("centre-1", "centre-2", "centre-3", "centre-4", "centre-large")
    recordings = [read_recording(folder / "runs" / f"multisine-{name}.csv") for name in names]
    found = frfs_from_recordings(recordings, 10, 130, half_width_hz=2.0)
    truth = load_machine(folder / "machine.toml").vibration.frequency_response(np.zeros(2), found[0].frequency_hz)
    errors, stated = [], []
    for one in found[:9]:  # of acc_A, acc_B, acc_C
        position, variance = one.value / one.s**2, one.variance / np.abs(one.s) ** 4
        sure = variance < 0.2**2
        assert sure.mean() > 0.9
        reference = truth[sure, "ABC".index(one.output[-1]), "ABC".index(one.input[-1])]
        errors.append((np.abs(position[sure] - reference) ** 2).mean())
        stated.append(variance[sure].mean())
    assert np.sqrt(np.mean(errors)) < 0.06  # the highest peak is near 3
    assert np.mean(errors) == pytest.approx(np.mean(stated), rel=0.4)
