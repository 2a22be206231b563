"""Excerpts: the part of each recording in which effects are searched, where they stand out that clearly.

What a search compares are shares of the discrepancy, and evidence in proportion to the data. With a discrepancy
thousands of times its own uncertainty, a second of each motion decides between effects as well as all of it does; the
winner is then fitted to everything. Of many motions a few do, too, if they are of all places and of all kinds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from ffcomp.diagnose.held_out import clustered
from ffcomp.diagnose.observe import quick_length
from ffcomp.diagnose.problem import Observation
from models.arrays import FloatArray
from models.printer.batch import START_S, gentle_start

EXCERPT_S = 1.2
LEAD_S = 0.4  # simulated before, from a gentle start: a belt's vibration has decayed by then
WORTHWHILE = 0.6  # of the rows: with more to simulate, an excerpt saves too little
MANY_MOTIONS, MOTIONS = 8, 6  # from the one on, only so many are searched in, each recorded once
RESTS_MM = 1e-3  # within which a command has not begun to move
USUAL = 0.75  # quantile of the loudness: the loudest part may be an accident


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

    def compared(self, simulated: int) -> slice:
        """Return the rows of this part among those that were simulated: the last ones."""
        return slice(simulated - (self.last - self.first), simulated)


def telling_recordings(observations: Sequence[Observation], same_command: Sequence[int]) -> list[int]:
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
    rotated = [own[n % len(own) :] + own[: n % len(own)] for n, own in enumerate(by_place.values())]
    turns = [i for turn in zip_longest(*rotated) for i in turn if i is not None][:MOTIONS]
    seen: dict[tuple[int, tuple[str, ...]], int] = {}
    for i, first in enumerate(same_command):
        if first in turns:
            seen.setdefault((first, observations[i].signals), i)
    return sorted(seen.values())


def excerpt_parts(observations: Sequence[Observation], same_command: Sequence[int]) -> list[Part] | None:
    """Choose a part of each observation, repeats alike; None where too little would be saved.

    They are taken from the first and the second half of the recordings in turn, so that what drifts is seen.
    """
    distinct = sorted(set(same_command))
    parts = {i: _part(observations[i], late=n % 2 == 1) for n, i in enumerate(distinct)}
    rows = sum(len(observations[i].measured) for i in distinct)
    if sum(part.last - part.first + part.lead for part in parts.values()) > WORTHWHILE * rows:
        return None
    return [parts[i] for i in same_command]


def beginning(observation: Observation, command: FloatArray, seconds: float) -> Part:
    """Return so much of a recording from where its command (n, 3) begins to move, and all that is before."""
    moves = np.flatnonzero(np.any(np.abs(command - command[0]) > RESTS_MM, axis=1))
    last = (int(moves[0]) if len(moves) else 0) + round(seconds * observation.rate_hz)
    return Part(0, len(command) if last >= len(command) else quick_length(last), 0)


def _part(observation: Observation, late: bool) -> Part:
    rows, lead = quick_length(round(EXCERPT_S * observation.rate_hz)), round(LEAD_S * observation.rate_hz)
    starts = len(observation.measured) - rows
    if starts <= 2 * lead:
        return Part(0, len(observation.measured), 0)
    loudness = _loudness(observation, rows)
    half = slice(starts // 2, starts) if late else slice(0, starts // 2)
    usual = np.abs(loudness[half] - np.quantile(loudness[half], USUAL))
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
