"""The sensor's signals in a check's experiments, the mean of their repeats with its noise, and what differs.

Motion is compared with motion. So all checks of one plan have their rows at the same times of the experiment, between
2 and 150 Hz, and what a repeat is late by is taken out before the mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from ffcomp.errors import MeasurementError
from ffcomp.measurement.faults import deaf_to
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
SURE_CLOCK_S = 5e-5


@dataclass(frozen=True, eq=False)
class SensorSignal:
    """One experiment of a check."""

    name: str
    acceleration: FloatArray  # (n, 3) m/s² at `rows_of` the experiment, the mean of its repeats
    noise: FloatArray  # (3,) m/s², standard deviations of that mean
    clock_sd_s: float  # all of it may be early or late by so much
    repeats: int

    @property
    def size(self) -> float:
        """Root mean square, m/s², of all axes together."""
        return float(np.sqrt(np.mean(self.acceleration**2)))

    def replaced(self, acceleration: FloatArray) -> SensorSignal:
        """Return the same experiment with another motion and no noise, as a simulation has it."""
        return replace(self, acceleration=acceleration, noise=np.zeros(3))


def rows_of(duration_s: float) -> FloatArray:
    """Return the times (n,) s of an experiment whose motion lasts from 0 to `duration_s`."""
    return np.arange(-round(BEFORE_S * RATE_HZ), np.floor(duration_s * RATE_HZ) + 1) / RATE_HZ


def in_band(rows: FloatArray, rate_hz: float) -> FloatArray:
    """Filter (n, m) without delay."""
    band = butter(4, (BAND_HZ[0], min(BAND_HZ[1], 0.45 * rate_hz)), "bandpass", fs=rate_hz, output="sos")
    return np.asarray(sosfiltfilt(band, rows, axis=0))


def signals_of(joined: Sequence[Joined], plan: Plan) -> list[SensorSignal]:
    """Thin what was joined, in the order of the plan; an experiment without any recording is missing."""
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
    floor = LEAST_NOISE_M_PER_S2
    return SensorSignal(
        repeats[0].experiment, each.mean(axis=0), np.maximum(noise, floor), max(clock, SURE_CLOCK_S), len(repeats)
    )


def _filtered(each: Joined) -> tuple[FloatArray, FloatArray]:
    """Return times (n,) s of the experiment and the record (n, 3) in the band."""
    recording = each.recording
    if missing := {f"acc_{axis}" for axis in "xyz"} - set(recording.acceleration):
        raise MeasurementError(each.source, [deaf_to(min(missing)[-1], all_needed=True)])
    rows = np.column_stack([recording.acceleration[f"acc_{axis}"] for axis in "xyz"])
    whole = without_gaps(recording.time_s, rows)
    return each.begin_s + recording.time_s, in_band(whole, recording.sample_rate_hz)


FROM_DAY_TO_DAY = 0.01  # of the signal: no printer repeats better after homing

ByExperiment = Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Solution:
    """Columns fitted to a difference."""

    values: FloatArray  # (k,)
    sd: FloatArray  # (k,)
    left: float  # sum of squares


@dataclass(frozen=True, eq=False)
class Weighed:
    """Differences (N + e,), each by its noise, with the priors of the delays below; independent rows count once."""

    difference: FloatArray
    delays: FloatArray  # (N + e, e)
    sigma: Mapping[str, FloatArray]  # (3,) m/s² by experiment

    @property
    def rows(self) -> float:
        """Count the independent rows."""
        return (len(self.difference) - len(self.sigma)) / DEPENDENT

    def column(self, of: ByExperiment) -> FloatArray:
        """Return a signature (N + e,) in the same weights."""
        parts = [(of[name] / sigma).ravel() for name, sigma in self.sigma.items()]
        return np.concatenate([*parts, np.zeros(len(self.sigma))]) / np.sqrt(DEPENDENT)

    def fit(
        self, columns: Sequence[FloatArray], usual: Sequence[float] = (), without: FloatArray | None = None
    ) -> Solution:
        """Fit columns (N + e,) each.

        Parameters
        ----------
        usual : standard deviations of their priors around zero; none: no priors
        without : (N + e,) is taken from the difference before
        """
        k, wanted = len(columns), self.difference if without is None else self.difference - without
        matrix = np.column_stack([*columns, self.delays])
        if usual:
            below = np.hstack([np.diag(1.0 / np.asarray(usual)), np.zeros((k, self.delays.shape[1]))])
            matrix, wanted = np.vstack([matrix, below]), np.concatenate([wanted, np.zeros(k)])
        normal = matrix.T @ matrix
        covariance = np.linalg.pinv(normal, hermitian=True)
        values = np.asarray(np.linalg.lstsq(matrix, wanted, rcond=None)[0], dtype=np.float64)
        left = float(np.sum((wanted - matrix @ values) ** 2))
        return Solution(values[:k], np.asarray(np.sqrt(np.diag(covariance)[:k]), dtype=np.float64), left)


def weighed(pairs: Sequence[tuple[SensorSignal, SensorSignal]]) -> Weighed:
    """Weigh what differs between today and then, in pairs of one experiment."""
    sigma: dict[str, FloatArray] = {}
    differences, slopes, priors = [], [], []
    for today, then in pairs:
        floor = FROM_DAY_TO_DAY * today.size
        weights = sigma[today.name] = np.sqrt(today.noise**2 + then.noise**2 + floor**2)
        differences.append(((today.acceleration - then.acceleration) / weights).ravel())
        slopes.append((np.gradient(then.acceleration, 1.0 / RATE_HZ, axis=0) / weights).ravel())
        priors.append(float(np.hypot(today.clock_sd_s, then.clock_sd_s)))
    count, total = len(pairs), sum(map(len, differences))
    delays, first = np.zeros((total + count, count)), 0
    for k, slope in enumerate(slopes):
        delays[first : first + len(slope), k] = slope / np.sqrt(DEPENDENT)
        delays[total + k, k] = 1.0 / priors[k]
        first += len(slope)
    difference = np.concatenate([*differences, np.zeros(count)]) / np.sqrt(DEPENDENT)
    return Weighed(difference, delays, sigma)
