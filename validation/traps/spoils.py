"""What goes wrong between a printer and its files: each takes recorded runs and returns them spoiled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from ffcomp.shapers.pulses import ei, mzv, two_hump_ei, zv
from validation.blind.delta.numbers import FloatArray
from validation.traps.bench import RATE_HZ, Recorded, Spoil


def moved_signal(x: FloatArray, late_s: float) -> FloatArray:
    """Return a signal (n,) that comes later."""
    t = np.arange(len(x)) / RATE_HZ
    return np.asarray(CubicSpline(t, x)(np.clip(t - late_s, 0.0, t[-1])))


def joined_by_eye(most_s: float) -> Spoil:
    """Shift the signals of each file by up to so much, against its command."""

    def spoil(runs: list[Recorded], rng: np.random.Generator) -> list[Recorded]:
        return [shifted(run, float(rng.uniform(-most_s, most_s))) for run in runs]

    return spoil


def shifted(run: Recorded, late_s: float) -> Recorded:
    """Return a run whose signals come later."""
    return replace(run, signals={c: moved_signal(x, late_s) for c, x in run.signals.items()})


def one_channel(channel: str, change: str) -> Spoil:
    """Make one channel dead, loose on its mount, or clipped."""

    def spoil(runs: list[Recorded], rng: np.random.Generator) -> list[Recorded]:
        return [
            replace(run, signals={**run.signals, channel: CHANGES[change](run.signals[channel], rng)}) for run in runs
        ]

    return spoil


def _dead(x: FloatArray, rng: np.random.Generator) -> FloatArray:
    return np.asarray(0.05 * rng.standard_normal(len(x)))


def _loose(x: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A mount with a resonance of its own at 62 Hz that rattles."""
    w, dt = 2 * np.pi * 62.0, 1 / RATE_HZ
    a1, a2 = -2 * np.exp(-0.04 * w * dt) * np.cos(w * dt), np.exp(-0.08 * w * dt)
    return np.asarray(lfilter([1 + a1 + a2], [1, a1, a2], x))


def _clipped(x: FloatArray, rng: np.random.Generator) -> FloatArray:
    """At a quarter of its largest value, softly, as a range that an amplifier ends."""
    limit = 0.25 * float(np.abs(x).max())
    return np.asarray(np.clip(x, -limit, limit) + 0.01 * limit * rng.standard_normal(len(x)))


CHANGES = {"dead": _dead, "loose": _loose, "clipped": _clipped}


PULSES = {"zv": zv, "mzv": mzv, "ei": ei, "2hump_ei": two_hump_ei}


@dataclass(frozen=True)
class Shaped:
    """An order: the firmware's input shaper on the nozzle's path, left on while it was recorded."""

    kind: str
    frequency_hz: float

    def __call__(self, t: FloatArray, command: FloatArray) -> FloatArray:
        """Shape the carriages' command (n, 3): every carriage alike, for all axes have one shaper."""
        shaper = PULSES[self.kind](self.frequency_hz, 0.1)
        found = np.zeros_like(command)
        for a, late in zip(shaper.amplitude, shaper.time, strict=True):
            at = np.clip(t - late, t[0], t[-1])
            found += a * np.column_stack([np.interp(at, t, column) for column in command.T])
        return found
