"""Pitches at which a ripple would explain what the simulation of an axis leaves, from a periodogram over its place.

A ripple repeats every pitch along the way: a cos(2π u/p) in the order, or in the force. The axis answers it linearly,
so that for every pitch the two numbers of amplitude and phase follow from one 2 × 2 system (Lomb 1976, for the place
in place of the time). From one try to the next the ripple shifts by a quarter of a turn over the whole travel, or a
short pitch falls between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from ffcomp.identification.axis_shots import Shots
from models.arrays import ComplexArray, FloatArray
from models.machine import Machine
from models.printer.one_axis import simulate_axis

A_TURN = 4  # tries for each turn over the travel
FASTEST = 2.0  # times the usual speed over the highest frequency compared: the shortest pitch is passed in no less
MOST_TRIES = 1500
SMOOTH = 31  # lines of a spectrum over which its level is taken
PULSE = 64  # samples before a pulse


@dataclass(frozen=True, eq=False)
class _Part:
    """One motion: its place, and what is left of its acceleration."""

    place: FloatArray  # (n,) mm
    left: ComplexArray  # (lines,) inside the band, weighted
    answer: ComplexArray  # (lines,) of the acceleration to the input, weighted
    taper: FloatArray  # (n,)
    lines: slice  # of the band


def likely_pitches(machine: Machine, shots: Sequence[Shots], band_hz: tuple[float, float], most: int) -> list[float]:
    """Return the pitches, mm, at which a ripple explains most of what the file leaves, the best first.

    Parameters
    ----------
    shots : runs that are simulated from beginning to end; each motion once.
    """
    parts = [part for one in shots if (part := _part(machine, one, band_hz)) is not None]
    if not parts:
        return []
    travel = max(float(np.ptp(part.place)) for part in parts)
    speed = float(np.sqrt(np.mean(np.concatenate([one.speed for one in shots]) ** 2)))
    if min(travel, speed) <= 0.0:
        return []
    first, last = 2.0 / travel, FASTEST * band_hz[1] / speed
    count = min(max(int((last - first) * travel * A_TURN), 0), MOST_TRIES)
    turns = first + np.arange(count) / (A_TURN * travel)
    return [float(1.0 / turns[i]) for i in _peaks(_gains(parts, turns), most)]


def _part(machine: Machine, one: Shots, band_hz: tuple[float, float]) -> _Part | None:
    try:
        motion = one.simulate(machine).sensed(machine)
    except ValueError:
        return None
    run, n, rate = one.run, len(one.run.drive), one.run.sample_rate_hz
    name = next((s for s in ("acc_q", *run.signals) if s in run.signals and np.isfinite(run.signals[s]).all()), None)
    if name is None:
        return None
    frequency, taper = np.fft.rfftfreq(2 * n, 1 / rate), np.hanning(n)
    error = np.fft.rfft(taper * (run.signals[name] - motion[name]), 2 * n)
    if name != "acc_q":  # mm, to m/s²
        error = -1e-3 * (2 * np.pi * frequency) ** 2 * error
    lines = slice(*np.searchsorted(frequency, band_hz).tolist())
    weight = 1 / np.maximum(np.sqrt(uniform_filter1d(np.abs(error) ** 2, SMOOTH)), 1e-12)[lines]
    place = run.drive if not run.by_force else np.asarray(run.signals[next(s for s in run.signals if "pos" in s)])
    return _Part(place, weight * error[lines], weight * _answer(machine, rate, n)[lines], taper, lines)


def _answer(machine: Machine, rate_hz: float, n: int) -> ComplexArray:
    """Return the response of the last mass' acceleration to the input, (lines,), by that to a smooth pulse."""
    k = np.arange(2 * n)
    pulse = np.exp(-0.5 * ((k - PULSE) / 1.5) ** 2)
    felt = simulate_axis(machine, pulse, 1 / rate_hz).sensed(machine)["acc_q"]
    driven = np.fft.rfft(pulse)
    small = np.abs(driven) < 1e-6 * np.abs(driven[0])
    return np.asarray(np.where(small, 0.0, np.fft.rfft(felt) / np.where(small, 1.0, driven)))


def _gains(parts: Sequence[_Part], turns: FloatArray) -> FloatArray:
    """Return for each number of turns a millimetre what a ripple of any amplitude and phase explains."""
    waves = [part.taper * np.exp(2j * np.pi * turns[0] * part.place) for part in parts]
    steps = [np.exp(2j * np.pi * (turns[1] - turns[0]) * part.place) if len(turns) > 1 else None for part in parts]
    gains = np.zeros(len(turns))
    for k in range(len(turns)):
        normal, slope = np.zeros((2, 2)), np.zeros(2)
        for i, part in enumerate(parts):
            both = _spectra(waves[i], part.lines) * part.answer
            normal += (both.conj() @ both.T).real
            slope += (both.conj() @ part.left).real
            if k + 1 < len(turns):
                waves[i] = waves[i] * steps[i]
        gains[k] = slope @ np.linalg.lstsq(normal, slope, rcond=1e-9)[0]
    return gains


def _spectra(wave: ComplexArray, lines: slice) -> ComplexArray:
    """Return the spectra of the cosine and the sine, (2, lines), of one complex wave."""
    whole = np.fft.fft(wave, 2 * len(wave))
    here, mirrored = whole[lines], np.conj(np.roll(whole[::-1], 1)[lines])
    return np.stack([(here + mirrored) / 2, (here - mirrored) / 2j])


def _peaks(gains: FloatArray, most: int) -> list[int]:
    """Return the highest points that are not on the slope of a higher one."""
    found: list[int] = []
    for i in np.argsort(-gains).tolist():
        if all(abs(i - j) > A_TURN for j in found):
            found.append(i)
        if len(found) == most:
            break
    return found
