"""The sensor's signals in a check's experiments: the mean of their repeats with its noise.

Motion is compared with motion. So all checks of one plan have their rows at the same times of the experiment, between
2 and 150 Hz, and each repeat is moved by its lag before the mean is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from ffcomp.errors import MeasurementError
from ffcomp.measurement.faults import fault
from ffcomp.record.clock import without_gaps
from ffcomp.record.plan import Plan
from ffcomp.record.result import Joined
from models.arrays import FloatArray

BAND_HZ = (2.0, 150.0)
RATE_HZ = 400.0
DEPENDENT = RATE_HZ / (2.0 * (BAND_HZ[1] - BAND_HZ[0]))  # rows for one that is independent
BEFORE_S = 0.15  # kept of the rest before the motion
REST_S = 0.05  # before the motion: no filter rings earlier
LEAST_NOISE_M_PER_S2 = 0.01  # of chips that round
FROM_DAY_TO_DAY = 0.01  # of the signal: no printer repeats better after homing
SURE_CLOCK_S = 5e-5


@dataclass(frozen=True, eq=False)
class SensorSignal:
    """One experiment of a check."""

    name: str
    acceleration: FloatArray  # (n, 3) m/s² at `rows_of` the experiment, the mean of its repeats
    noise: FloatArray  # (3,) m/s², standard deviations of that mean
    clock_sd_s: float  # all of it may be early or late by so much

    @property
    def size(self) -> float:
        """Root mean square, m/s², of all axes together."""
        return float(np.sqrt(np.mean(self.acceleration**2)))


def share_apart(felt: SensorSignal, other: FloatArray) -> float:
    """Return what differs from (n, 3) m/s² without a delay, as a share of the signal."""
    slope = np.gradient(felt.acceleration, 1.0 / RATE_HZ, axis=0)
    apart = felt.acceleration - other
    apart = apart - slope * (np.sum(slope * apart) / max(float(np.sum(slope**2)), 1e-300))
    return float(np.sqrt(np.mean(apart**2))) / felt.size


def rows_of(duration_s: float) -> FloatArray:
    """Return the times (n,) s of an experiment whose motion lasts from 0 to `duration_s`."""
    return np.arange(-round(BEFORE_S * RATE_HZ), np.floor(duration_s * RATE_HZ) + 1) / RATE_HZ


def in_band(rows: FloatArray, rate_hz: float) -> FloatArray:
    """Filter (n, m) without delay."""
    band = butter(4, (BAND_HZ[0], min(BAND_HZ[1], 0.45 * rate_hz)), "bandpass", fs=rate_hz, output="sos")
    return np.asarray(sosfiltfilt(band, rows, axis=0))


def signals_of(joined: Sequence[Joined], plan: Plan) -> list[SensorSignal]:
    """Thin joined captures, in the order of the plan; an experiment without any recording is missing."""
    signals = []
    for experiment in plan.experiments:
        repeats = [each for each in joined if each.experiment == experiment.name]
        if repeats:
            signals.append(_of_repeats(repeats, rows_of(experiment.duration_s)))
    return signals


def _of_repeats(repeats: Sequence[Joined], rows: FloatArray) -> SensorSignal:
    filtered = [_filtered(each) for each in repeats]
    each = np.array([CubicSpline(t, signal)(rows) for t, signal in filtered])
    slope = np.gradient(each.mean(axis=0), 1.0 / RATE_HZ, axis=0)
    lags = -np.einsum("nk,rnk->r", slope, each - each.mean(axis=0)) / max(float(np.sum(slope**2)), 1e-300)
    each = each + lags[:, None, None] * slope
    if len(repeats) > 1:
        noise = np.sqrt(np.var(each, axis=0, ddof=1).mean(axis=0) / len(repeats))
    else:
        t, signal = filtered[0]
        noise = np.sqrt(np.mean(signal[t < -REST_S] ** 2, axis=0))
    clock = float(np.sqrt(np.mean([one.clock.offset_sd_s**2 for one in repeats])))
    noise = np.maximum(noise, LEAST_NOISE_M_PER_S2)
    return SensorSignal(repeats[0].experiment, each.mean(axis=0), noise, max(clock, SURE_CLOCK_S))


def _filtered(each: Joined) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) s of the experiment and the record (n, 3) in the band."""
    recording = each.recording
    if missing := {f"acc_{axis}" for axis in "xyz"} - set(recording.acceleration):
        raise MeasurementError(each.source, [fault("deaf check", axis=min(missing)[-1])])
    rows = np.column_stack([recording.acceleration[f"acc_{axis}"] for axis in "xyz"])
    whole = without_gaps(recording.time_s, rows)
    return each.begin_s + recording.time_s, in_band(whole, recording.sample_rate_hz)
