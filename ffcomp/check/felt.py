"""What a check's experiments made the sensor feel: the mean of the repeats, thinned, and its noise.

Motion is compared with motion. So all checks of one plan have their rows at the same times of the experiment, between
2 and 150 Hz, and what a repeat is late by is taken out before the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from ffcomp.errors import MeasurementError
from ffcomp.record.clock import without_gaps
from ffcomp.record.plan import Plan
from ffcomp.record.result import Joined
from models.arrays import FloatArray

BAND_HZ = (2.0, 150.0)
RATE_HZ = 400.0
DEPENDENT = RATE_HZ / (2.0 * (BAND_HZ[1] - BAND_HZ[0]))  # rows for one that is independent
BEFORE_S = 0.15  # kept of the rest before the motion
REST_S = 0.05  # before the motion, in which no filter rings yet
LEAST_NOISE_M_PER_S2 = 0.01  # of chips that round what they say
SURE_CLOCK_S = 5e-5


@dataclass(frozen=True, eq=False)
class Felt:
    """One experiment of a check."""

    name: str
    acceleration: FloatArray  # (n, 3) m/s² at `rows_of` the experiment, the mean of its repeats
    noise: FloatArray  # (3,) m/s², standard deviations of that mean
    clock_sd_s: float  # by which all of it may be early or late
    repeats: int

    @property
    def size(self) -> float:
        """Root mean square, m/s², of all axes together."""
        return float(np.sqrt(np.mean(self.acceleration**2)))

    def replaced(self, acceleration: FloatArray) -> Felt:
        """Return the same experiment with another motion and no noise, as a simulation has it."""
        return replace(self, acceleration=acceleration, noise=np.zeros(3))


def rows_of(duration_s: float) -> FloatArray:
    """Return the times (n,) s of an experiment whose motion lasts from 0 to `duration_s`."""
    return np.arange(-round(BEFORE_S * RATE_HZ), np.floor(duration_s * RATE_HZ) + 1) / RATE_HZ


def in_band(rows: FloatArray, rate_hz: float) -> FloatArray:
    """Filter (n, m) without delay."""
    band = butter(4, (BAND_HZ[0], min(BAND_HZ[1], 0.45 * rate_hz)), "bandpass", fs=rate_hz, output="sos")
    return np.asarray(sosfiltfilt(band, rows, axis=0))


def felt_of(joined: Sequence[Joined], plan: Plan) -> list[Felt]:
    """Thin what was joined, in the order of the plan; an experiment without any recording is missing."""
    found = []
    for experiment in plan.experiments:
        own = [each for each in joined if each.experiment == experiment.name]
        if own:
            found.append(_of_repeats(own, rows_of(experiment.duration_s)))
    return found


def _of_repeats(own: Sequence[Joined], rows: FloatArray) -> Felt:
    filtered = [_filtered(each) for each in own]
    each = np.array([CubicSpline(t, felt)(rows) for t, felt in filtered])
    slope = np.gradient(each.mean(axis=0), 1.0 / RATE_HZ, axis=0)
    lags = -np.einsum("nk,rnk->r", slope, each - each.mean(axis=0)) / max(float(np.sum(slope**2)), 1e-300)
    each = each + lags[:, None, None] * slope
    if len(own) > 1:
        noise = np.sqrt(np.var(each, axis=0, ddof=1).mean(axis=0) / len(own))
    else:
        t, felt = filtered[0]
        noise = np.sqrt(np.mean(felt[t < -REST_S] ** 2, axis=0))
    clock = float(np.sqrt(np.mean([one.clock.offset_sd_s**2 for one in own])))
    floor = LEAST_NOISE_M_PER_S2
    return Felt(own[0].experiment, each.mean(axis=0), np.maximum(noise, floor), max(clock, SURE_CLOCK_S), len(own))


def _filtered(each: Joined) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) s of the experiment and the record (n, 3) in the band."""
    recording = each.recording
    if missing := {f"acc_{axis}" for axis in "xyz"} - set(recording.acceleration):
        raise MeasurementError(
            each.source,
            [
                f"No chip feels the motion along {min(missing)[-1]}, and a check compares all axes: give the captures "
                "of both chips, on the toolhead and on the bed."
            ],
        )
    rows = np.column_stack([recording.acceleration[f"acc_{axis}"] for axis in "xyz"])
    whole = without_gaps(recording.time_s, rows)
    return each.begin_s + recording.time_s, in_band(whole, recording.sample_rate_hz)
