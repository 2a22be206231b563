"""What keeps a machine from following a path within its limits: where, how much, and how much slower will do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ffcomp.inverse.command_limits import A_LITTLE, ACCELERATION, NAMES, TRAVEL, VELOCITY, utilisation_from_rest
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.solve import Solution
from models.arrays import BoolArray, FloatArray

ROOM = 0.98  # of a limit, what a slowed move aims at
GENTLEST, SLOWEST = 0.95, 0.4  # factors of one round
NEARLY = 0.85  # times a limit, that a command asks for where its path is made slower
NEAR = 10  # knots between what a path asks for and what its command asks for because of it
PLAYABLE = len(NAMES)  # the kind of trouble that is none of the carriages' limits
ENOUGH = 1e-3  # over a limit: within the accuracy of a solver


class Trouble(NamedTuple):
    first: int  # segments of the command
    last: int
    limit: int  # index into NAMES, or PLAYABLE
    carriage: int
    asked: float  # times the limit
    factor: float  # of acceleration or velocity, to bring it below


def _factor(asked: float) -> float:
    return float(np.clip(ROOM / asked, SLOWEST, GENTLEST))


def of_the_path(path: FloatArray, command: FloatArray) -> Iterator[Trouble]:
    """Where the path asks for more than a limit, and its command as well. Both shares (n, 3, 3)."""
    over = widened(np.any(command > NEARLY, axis=(1, 2)), NEAR)
    for limit in (VELOCITY, ACCELERATION, TRAVEL):
        beyond = 1.0 if limit == TRAVEL else A_LITTLE
        for first, last in _stretches(over & (path[:, limit] > beyond).any(axis=1)):
            asked = path[first : last + 1, limit].max(axis=0)
            worst = float(asked.max())
            factor = float("nan") if limit == TRAVEL else _factor(worst)
            yield Trouble(first, last, limit, int(asked.argmax()), worst, factor)


def of_the_answer(result: Solution, free: FloatArray, tolerance_mm: float, model: InverseModel) -> Iterator[Trouble]:
    """Where limits are held at the cost of the path, or not held.

    free : shares (n, 3, 3) of the answer without limits
    """
    left = utilisation_from_rest(result.vertices, model.limits)[1:-1]
    for held in result.constrained:
        inside = slice(held.first, held.last + 1)
        if held.error_mm <= tolerance_mm and not (left[inside] > 1.0 + ENOUGH).any():
            continue
        yield from of_the_command(np.maximum(free[inside], left[inside]), held.first)


def of_the_command(asked: FloatArray, first_segment: int = 0) -> Iterator[Trouble]:
    """Where a command asks for more than a limit: shares (n, 3, 3) of the segments from one on."""
    for first, last in _stretches(widened(np.any(asked > 1.0, axis=(1, 2)), 2)):
        worst = asked[first : last + 1]
        _, limit, carriage = np.unravel_index(worst.argmax(), worst.shape)
        times = float(worst.max())
        place = first_segment + first, first_segment + last
        yield Trouble(*place, int(limit), int(carriage), times, _factor(times))


def of_playing(late: BoolArray) -> Iterator[Trouble]:
    for first, last in _stretches(widened(late, 1)):
        yield Trouble(first, last, PLAYABLE, 0, 1.0, 0.8)


def widened(marked: BoolArray, by: int) -> BoolArray:
    return np.asarray(np.convolve(marked, np.ones(2 * by + 1))[by : by + len(marked)] > 0.5)


def _stretches(marked: BoolArray) -> Iterator[tuple[int, int]]:
    """First and last of each stretch of marked segments."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    for first, after in edges.reshape(-1, 2):
        yield int(first), int(after) - 1
