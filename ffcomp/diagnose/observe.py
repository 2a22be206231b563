"""Recordings as they are compared: thinned to the band, cut to a length that is transformed quickly."""

from __future__ import annotations

import math

import numpy as np

from ffcomp.diagnose.noise import fill_gaps
from ffcomp.diagnose.problem import Observation
from ffcomp.measurement.recording import Recording
from models.arrays import FloatArray
from models.machine import Machine

ENOUGH_HZ = 1500.0  # more than seven times the band's end; faster recordings are thinned to at least this


def every_row(recording: Recording) -> int:
    """Return how many rows of a recording make one that is compared."""
    return max(1, int(recording.sample_rate_hz / ENOUGH_HZ * (1 + 1e-6)))


def compared(rows: FloatArray, every: int) -> FloatArray:
    """Keep every so many rows, and of these the most whose number has small factors only: the transform is quick."""
    return rows[::every][: quick_length(math.ceil(len(rows) / every))]


def quick_length(rows: int) -> int:
    """Return the largest number up to `rows` with no prime factor above 31."""
    return next(n for n in range(rows, 0, -1) if _is_smooth(n))


def _is_smooth(n: int) -> bool:
    for prime in (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31):
        while n % prime == 0:
            n //= prime
    return n == 1


def observation_of(machine: Machine, recording: Recording, command: FloatArray) -> Observation:
    """Thin a recording and put its signals in one array.

    Parameters
    ----------
    command : (n, 3) mm, carriages, thinned and cut as the recording is.
    """
    signals = (*recording.acceleration, *recording.position)
    every = every_row(recording)
    sensors = (*recording.acceleration.values(), *recording.position.values())
    values = [_thinned(x, every)[: len(command)] for x in sensors]
    nozzle = machine.kinematics.forward(command)
    position = tuple(float(5 * round(x / 5)) for x in (np.min(nozzle, axis=0) + np.max(nozzle, axis=0))[:2] / 2)
    rate = recording.sample_rate_hz / every
    moving = {**dict(zip("ABC", command.T, strict=True)), **dict(zip("xyz", nozzle.T, strict=True))}
    speed = np.stack([np.gradient(moving[s[4:]], 1 / rate) for s in signals], axis=1)
    measured, clocks = np.stack(values, axis=1), recording.clocks_of(signals)
    return Observation(recording.source, recording.repeat_of, position, rate, signals, measured, speed, clocks)


def _thinned(x: FloatArray, every: int) -> FloatArray:
    """Keep every so many rows after a zero-phase low-pass; missing samples stay missing."""
    if every == 1:
        return x
    from scipy.signal import resample_poly

    missing = ~np.isfinite(x)
    gaps = np.convolve(missing, np.ones(2 * every + 1), "same")[::every] > 0
    smooth = resample_poly(fill_gaps(x), 1, every, padtype="line")
    return np.where(gaps, np.nan, smooth)
