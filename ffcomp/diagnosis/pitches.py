"""Pitches at which a ripple would explain what an axis leaves, from a periodogram over its place.

Where a simulation begins anew all the time, it leaves too little of a ripple. There the force is known, and what of it
inertia and friction do not explain is searched line by line (matching pursuit; Mallat and Zhang 1993).

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
from models.kinds import driven_axis
from models.machine import Machine
from models.printer.one_axis import simulate_axis
from models.vibration.driven_axis import DrivenAxis

A_TURN = 4  # tries for each turn over the travel
FASTEST = 2.0  # times the usual speed over the highest frequency compared: the shortest pitch is passed in no less
MOST_TRIES = 1500
SMOOTH = 31  # lines of a spectrum over which its level is taken
PULSE = 64  # samples before a pulse
MOST_ROWS = 2500  # of a run, of which a force's lines are found
SHORTEST_SHARE, MOST_LINES_A_TURN = 0.005, 400  # of the travel, a pitch; lines a turn
APART, LEAST_LINE = 0.04, 0.1  # relative, lines; of the first line's size, what counts as another
LEAST_SHARE = 0.15  # of what is left, that a line explains


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


def pitches_of_force(machine: Machine, shots: Sequence[Shots], most: int) -> list[float]:
    """Return the pitches, mm, whose lines together explain most of the measured force, the strongest first.

    None where no line stands out.

    Parameters
    ----------
    shots : runs whose force and place are known; each motion once.
    """
    axis = driven_axis(machine)
    columns, forces, places = list[FloatArray](), list[FloatArray](), list[FloatArray]()
    for one in shots:
        place = one.run.position.get("pos_q", one.run.position.get("pos_motor"))
        if place is None or not np.isfinite(place).all():
            return []
        v = one.speed / 1e3
        change = np.gradient(v, 1 / one.run.sample_rate_hz)
        thin = slice(None, None, max(len(v) // MOST_ROWS, 1))
        columns.append(np.column_stack([change, v, np.sign(v), np.ones(len(v))])[thin])
        forces.append(axis.force_of(one.run.drive, one.run.supply_v)[thin])
        places.append(np.asarray(place)[thin])
    place, force, known = np.concatenate(places), np.concatenate(forces), np.concatenate(columns)
    turns, first = _tries(axis, places), 0.0
    found: list[int] = []
    while len(found) < min(most, len(turns)):
        left = force - known @ np.linalg.lstsq(known, force, rcond=1e-9)[0]
        gains = np.array([abs(np.exp(2j * np.pi * turn * place) @ left) for turn in turns])
        gains[[i for i in range(len(turns)) if any(abs(turns[i] / turns[j] - 1) < APART for j in found)]] = 0.0
        best = int(np.argmax(gains))
        if gains[best] <= LEAST_LINE * first or gains[best] ** 2 < LEAST_SHARE * len(left) * (left @ left) / 2:
            break
        first = max(first, float(gains[best]))
        found.append(best)
        angle = 2 * np.pi * turns[best] * place
        known = np.column_stack([known, np.sin(angle), np.cos(angle)])
    return [float(1.0 / turns[i]) for i in found]


def _tries(axis: DrivenAxis, places: Sequence[FloatArray]) -> FloatArray:
    """Return how often a millimetre lines may repeat: of what turns, a whole number of times a turn."""
    travel = float(np.ptp(np.concatenate(places)))
    if axis.quantities.turns:
        turn = 2e3 * np.pi
        return np.arange(max(int(np.ceil(2 * turn / max(travel, 1e-9))), 1), MOST_LINES_A_TURN + 1) / turn
    count = min(int((1 / SHORTEST_SHARE - 2) * A_TURN), MOST_TRIES)
    return np.asarray((2 + np.arange(count) / A_TURN) / max(travel, 1e-9))


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
