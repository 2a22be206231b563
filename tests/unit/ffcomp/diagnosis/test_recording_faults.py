"""A shaper left on, a clipped sensor and one signal that holds the gap, on made signals: nothing is simulated."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from ffcomp.diagnosis.fit import EstimationProblem, Fit
from ffcomp.diagnosis.noise import REPEATS, NoiseFloor, whitener
from ffcomp.diagnosis.problem import Observation
from ffcomp.diagnosis.recording_faults import clipped_sensor, fault_of_recordings, odd_signal, shaper_on
from ffcomp.measurement.faults import BadSensor, ShaperOn
from ffcomp.numerics.delay import delayed
from ffcomp.shapers.pulses import SHAPERS

RATE_HZ, N, NOISE = 1600.0, 2400, 0.05
SIGNALS = ("acc_x", "acc_y", "acc_z")


def motion(seed: int = 1) -> np.ndarray:
    """Shaken below 150 Hz, at rest at both ends, (n, 3) m/s²."""
    rng = np.random.default_rng(seed)
    shaken = sosfilt(butter(2, 150, fs=RATE_HZ, output="sos"), rng.standard_normal((N, 3)), axis=0)
    return 8 * shaken * np.clip(np.minimum(np.arange(N), N - np.arange(N)) / 300 - 0.4, 0, 1)[:, None]


def problem(*measured: np.ndarray) -> EstimationProblem:
    rng = np.random.default_rng(3)
    noisy = [x + NOISE * rng.standard_normal(x.shape) for x in measured]
    seen = [
        Observation(f"x-{i}.csv", "x", (0.0, 0.0), RATE_HZ, SIGNALS, x, np.ones(x.shape)) for i, x in enumerate(noisy)
    ]
    grid = np.array([0.0, RATE_HZ / 2])
    floor = NoiseFloor(grid, {s: np.full(2, 2 * NOISE**2 / RATE_HZ) for s in SIGNALS}, REPEATS)
    whiten = whitener(seen, floor, (1.0, 200.0))
    by_position: Any = SimpleNamespace(commanded=True)
    return EstimationProblem(by_position, whiten, whiten(noisy))


def left(estimation: EstimationProblem, simulated: list[np.ndarray]) -> Fit:
    """A fit that could retune nothing."""
    residual = estimation.measured - estimation.whiten(simulated)
    return Fit((), np.zeros(0), residual, np.zeros((len(residual), 0)))


def shaped(x: np.ndarray, kind: str, frequency_hz: float) -> np.ndarray:
    pulses = SHAPERS[kind](frequency_hz, 0.1)
    return np.sum(
        [a * delayed(x, float(t), RATE_HZ) for a, t in zip(pulses.amplitude, pulses.time, strict=True)], axis=0
    )


@pytest.mark.parametrize(("kind", "frequency_hz"), [("zv", 61.0), ("2hump_ei", 35.0)])
def test_a_shaper_is_named_with_its_type_and_frequency(kind: str, frequency_hz: float) -> None:
    true = [motion()]
    estimation = problem(shaped(true[0], kind, frequency_hz))
    found = fault_of_recordings(estimation, true, left(estimation, true))
    assert found is not None and kind.upper() in found.sentence() and "record again" in found.sentence()
    shaper = shaper_on(estimation, true, left(estimation, true))
    assert shaper is not None
    assert shaper.shapers == (ShaperOn(kind, pytest.approx(frequency_hz, abs=1.0)),)


def test_a_clipped_sensor_is_named_with_its_files_and_a_smaller_motion_is_none() -> None:
    true = [motion(), 0.2 * motion(2)]
    clipped = true[0].copy()
    clipped[:, 1] = np.clip(clipped[:, 1], -2.5, 2.5)
    found = clipped_sensor(problem(clipped, true[1]), true)
    assert found == BadSensor("acc_y", "clipped", 1.0, ("x-0.csv",))
    assert clipped_sensor(problem(0.4 * true[0], true[1]), true) is None


@pytest.mark.parametrize("resonance", [0.5, 0.62])
def test_a_resonance_that_is_damped_better_than_filed_is_no_clipped_sensor(resonance: float) -> None:
    """Its crests are where the simulation's are, and nowhere else: a sensor that stands at its range looks like it."""
    t = np.arange(N) / RATE_HZ
    swept = np.sin(2 * np.pi * 46 * t) * (1 + 0.4 * np.sin(2 * np.pi * 1.3 * t))
    true = motion()
    true[:, 1] = 10 * swept
    steady = true.copy()
    steady[:, 1] = 10 * np.sin(2 * np.pi * 46 * t)
    for simulated in (true, steady):
        measured = simulated * np.array([1.0, resonance, 1.0])
        assert clipped_sensor(problem(measured), [simulated]) is None


def test_the_signal_that_holds_the_gap_is_named() -> None:
    true = [motion()]
    loose = true[0].copy()
    loose[:, 2] += 3 * np.sin(2 * np.pi * 62 * np.arange(N) / RATE_HZ)
    bad, good = problem(loose), problem(true[0] * 1.3)
    found = odd_signal(bad, [left(bad, true)])
    assert found is not None and found.signal == "acc_z" and found.share > 0.95
    assert odd_signal(good, [left(good, true)]) is None
    assert odd_signal(bad, []) is None  # an effect explains the gap: no fit is looked at
