"""Recordings prepared for comparison: thinned to the band, cut to a quick length, in excerpts where these suffice.

What a search compares are shares of the discrepancy, and evidence in proportion to the data. With a discrepancy
thousands of times its own uncertainty, a second of each motion decides between effects as well as all of it does; the
winner is then fitted to everything. Of many motions a few do, too, if they are of all places and of all kinds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from ffcomp.diagnosis.problem import Observation
from ffcomp.errors import MeasurementError
from ffcomp.measurement.clock import fill_gaps
from ffcomp.measurement.recording import Recording
from ffcomp.measurement.sensors import command_unit, misplaced, wrong_scale
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.machine import Machine
from models.printer.playback import START_S, gentle_start

LEAST_RATE_HZ = 1500.0  # more than seven times the band's end; faster recordings are thinned to at least this
PLACES_APART_MM = 20.0  # two places at least so far apart count as two
EXCERPT_S = 1.2  # of each motion in an excerpt
EXCERPT_LEAD_S = 0.4  # simulated before, from a gentle start: vibrations decay
MANY_MOTIONS = 8  # with so many, an excerpt holds only some, each recorded once
EXCERPT_MOTIONS = 6  # that it then holds
MARGIN_MM = 25.0  # around the print volume: a nozzle may still be commanded there


Position = tuple[float, ...]


def every_row(recording: Recording) -> int:
    """Return how many rows of a recording make one that is compared."""
    return max(1, int(recording.sample_rate_hz / LEAST_RATE_HZ * (1 + 1e-6)))


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

    command : (n, 3) mm, carriages, thinned and cut as the recording is.
    """
    signals = (*recording.acceleration, *recording.position)
    every = every_row(recording)
    sensors = (*recording.acceleration.values(), *recording.position.values())
    values = [_thinned(x, every)[: len(command)] for x in sensors]
    moving, rate = parts_of(machine, command), recording.sample_rate_hz / every
    middle = ((np.min(moving[axis]) + np.max(moving[axis])) / 2 for axis in "xy")
    position = tuple(float(5 * round(x / 5)) for x in middle)
    speed = np.stack([np.gradient(moving[s[4:]], 1 / rate) for s in signals], axis=1)
    measured, clocks = np.stack(values, axis=1), recording.clocks_of(signals)
    return Observation(recording.source, recording.repeat_of, position, rate, signals, measured, speed, clocks)


def parts_of(machine: Machine, command: FloatArray) -> dict[str, FloatArray]:
    """Return where a command (n, 3) mm has each carriage, A B C, and the nozzle, x y z: (n,) mm each."""
    return dict(zip("ABCxyz", np.hstack([command, machine.kinematics.forward(command)]).T, strict=True))


def _thinned(x: FloatArray, every: int) -> FloatArray:
    """Keep every so many rows after a zero-phase low-pass; missing samples stay missing."""
    if every == 1:
        return x
    from scipy.signal import resample_poly

    missing = ~np.isfinite(x)
    gaps = np.convolve(missing, np.ones(2 * every + 1), "same")[::every] > 0
    smooth = resample_poly(fill_gaps(x), 1, every, padtype="line")
    return np.where(gaps, np.nan, smooth)


def clustered(positions: Sequence[Position]) -> list[Position]:
    """Return the place that each position (x, y) belongs to: the first of those less than 20 mm apart, in a chain.

    A position of one number is a window of time: it stands by itself.
    """
    label = list(range(len(positions)))
    for i, a in enumerate(positions):
        for k in range(i):
            near = a == positions[k] if len(a) == 1 else math.dist(a, positions[k]) < PLACES_APART_MM
            if near and label[i] != label[k]:
                old, new = max(label[i], label[k]), min(label[i], label[k])
                label = [new if x == old else x for x in label]
    return [positions[x] for x in label]


# ---- commands ------------------------------------------------------------------------------------


def carriages_of(machine: Machine, recording: Recording) -> FloatArray:
    """Return the carriages' command, (n, 3) mm; a nozzle command goes through the file's kinematics, as in firmware.

    Raises MeasurementError if this machine cannot execute the command, or the sensors move otherwise than they are
    named.
    """
    try:
        carriages = (
            recording.command
            if recording.command_space == "carriage"
            else machine.kinematics.inverse(recording.command)
        )
        nozzle = machine.kinematics.forward(carriages)
        problem = _outside(machine, recording, nozzle)
    except UnreachableError as error:
        problem = f"{error} {_another(machine)}"
    if problem:
        raise MeasurementError(recording.source, command_unit(recording.command, recording.inputs) or [problem])
    problems = misplaced(
        {**recording.acceleration, **recording.position},
        _expected(parts_of(machine, carriages), recording.sample_rate_hz),
        recording.sample_rate_hz,
    )
    if recording.command_space == "carriage":  # else the reader has checked the nozzle's sensors against its path
        of_nozzle = {name: x for name, x in recording.acceleration.items() if name[-1] in "xyz"}
        problems = wrong_scale(nozzle, ("cmd_x", "cmd_y", "cmd_z"), of_nozzle, recording.sample_rate_hz) or problems
    if problems:
        raise MeasurementError(recording.source, problems)
    return carriages


def _expected(parts: Mapping[str, FloatArray], rate_hz: float) -> dict[str, FloatArray]:
    """Compute every sensor signal of a printer that follows its command exactly; m/s² and mm."""
    accelerations = {f"acc_{name}": np.pad(np.diff(x * 1e-3, 2) * rate_hz**2, 1) for name, x in parts.items()}
    return accelerations | {f"pos_{name}": x for name, x in parts.items()}


def _outside(machine: Machine, recording: Recording, nozzle: FloatArray) -> str:
    """Say where the nozzle leaves the print volume, in a sentence; '' if nowhere."""
    beyond = ~machine.kinematics.contains(nozzle, MARGIN_MM)
    if not beyond.any():
        return ""
    i = int(np.argmax(beyond))
    x, y, z = nozzle[i]
    return (
        f"{recording.time_s[i] - recording.time_s[0]:.4g} s after the beginning the command means a nozzle at "
        f"({x:.0f}, {y:.0f}, {z:.0f}) mm; the print volume of {machine.name} "
        f"{machine.kinematics.volume_text()}. {_another(machine)}"
    )


def _another(machine: Machine) -> str:
    return f"Was the recording made on another machine than {machine.name}, or does its file hold another geometry?"


# ---- excerpts ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    """Some rows of a recording."""

    first: int
    last: int  # the row after them
    lead: int  # rows before them that are simulated too

    def of(self, observation: Observation) -> Observation:
        """Cut an observation."""
        rows = slice(self.first, self.last)
        return replace(observation, measured=observation.measured[rows], speed=observation.speed[rows])


def informative_recordings(observations: Sequence[Observation], same_command: Sequence[int]) -> list[int]:
    """Choose the recordings to search in, by index: all, or a few of many motions, without their repeats.

    A plan makes the same motions in the same order at each of its places. So places take turns, and each begins with a
    later motion than the one before: that covers every place and every kind of motion soonest.
    """
    distinct = sorted(set(same_command))
    if len(distinct) < MANY_MOTIONS:
        return list(range(len(observations)))
    by_place: dict[tuple[float, ...], list[int]] = {}
    for i, place in zip(distinct, clustered([observations[i].position for i in distinct]), strict=True):
        by_place.setdefault(place, []).append(i)
    rotated = [runs[n % len(runs) :] + runs[: n % len(runs)] for n, runs in enumerate(by_place.values())]
    turns = [i for turn in zip_longest(*rotated) for i in turn if i is not None][:EXCERPT_MOTIONS]
    chosen: dict[tuple[int, tuple[str, ...]], int] = {}
    for i, first in enumerate(same_command):
        if first in turns:
            chosen.setdefault((first, observations[i].signals), i)
    return sorted(chosen.values())


def excerpt_parts(observations: Sequence[Observation], same_command: Sequence[int]) -> list[Part] | None:
    """Choose a part of each observation, repeats alike; None where too little would be saved.

    They are taken from the first and the second half of the recordings in turn, so that what drifts is seen.
    """
    distinct = sorted(set(same_command))
    parts = {i: _part(observations[i], late=n % 2 == 1) for n, i in enumerate(distinct)}
    rows = sum(len(observations[i].measured) for i in distinct)
    if sum(part.last - part.first + part.lead for part in parts.values()) > 0.6 * rows:  # it would save too little
        return None
    return [parts[i] for i in same_command]


def first_seconds(observation: Observation, command: FloatArray, seconds: float) -> Part:
    """Return so much of a recording from where its command (n, 3) begins to move, and all that is before."""
    moves = np.flatnonzero(np.any(np.abs(command - command[0]) > 1e-3, axis=1))
    last = (int(moves[0]) if len(moves) else 0) + round(seconds * observation.rate_hz)
    return Part(0, len(command) if last >= len(command) else quick_length(last), 0)


def _part(observation: Observation, late: bool) -> Part:
    rows = quick_length(round(EXCERPT_S * observation.rate_hz))
    lead = round(EXCERPT_LEAD_S * observation.rate_hz)
    starts = len(observation.measured) - rows
    if starts <= 2 * lead:
        return Part(0, len(observation.measured), 0)
    loudness = _loudness(observation, rows)
    half = slice(starts // 2, starts) if late else slice(0, starts // 2)
    usual = np.abs(loudness[half] - np.quantile(loudness[half], 0.75))  # the loudest part may be an accident
    first = half.start + int(np.argmin(usual))
    return Part(first, first + rows, lead) if first > lead else Part(first, first + rows, first)


def _loudness(observation: Observation, rows: int) -> FloatArray:
    """Return the mean square of all signals, each in units of its own, over so many rows from each row on."""
    squares = np.nan_to_num(observation.measured - np.nanmean(observation.measured, axis=0)) ** 2
    each = np.sum(squares / np.maximum(np.mean(squares, axis=0), 1e-300), axis=1)
    sums = np.concatenate([[0.0], np.cumsum(each)])
    return np.asarray(sums[rows:] - sums[:-rows])


def led_in(command: FloatArray, part: Part, rate_hz: float) -> FloatArray:
    """Return the rows (n, 3) to simulate for a part: with its lead, which begins gently unless it begins at rest."""
    rows = command[part.first - part.lead : part.last]
    return rows if part.first == part.lead else gentle_start(rows, round(START_S * rate_hz))
