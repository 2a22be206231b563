"""Violations: where a machine cannot follow a path within its limits, by how much, and how much slower will do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ffcomp.inverse.command_limits import (
    ACCELERATION,
    NAMES,
    TOLERANCE,
    TRAVEL,
    VELOCITY,
    CommandLimits,
    utilisation_from_rest,
)
from ffcomp.inverse.solve import Solution
from models.arrays import BoolArray, FloatArray

TARGET_UTILISATION = 0.98  # of a limit, that a slowed move aims at
GENTLEST, SLOWEST = 0.95, 0.4  # factors of one round
BINDING_UTILISATION = 0.85  # utilisation of a command above which its path is slowed
COMMAND_REACH_KNOTS = 10  # knots between what a path demands and what its command demands because of it
TIMING = len(NAMES)  # the kind of violation that is none of the carriages' limits
SOLVER_ACCURACY = 1e-3  # over a limit


class Violation(NamedTuple):
    """Segments of a command that violate a limit."""

    first: int
    last: int
    limit: int  # index into NAMES, or TIMING
    carriage: int
    utilisation: float  # demand over the limit
    factor: float  # of acceleration or velocity, to bring it below


def _factor(utilisation: float) -> float:
    return float(np.clip(TARGET_UTILISATION / utilisation, SLOWEST, GENTLEST))


def path_violations(path: FloatArray, command: FloatArray) -> Iterator[Violation]:
    """Yield where the path demands more than a limit, and its command as well; utilisations (n, 3, 3) of both."""
    over = widened(np.any(command > BINDING_UTILISATION, axis=(1, 2)), COMMAND_REACH_KNOTS)
    for limit in (VELOCITY, ACCELERATION, TRAVEL):
        beyond = 1.0 if limit == TRAVEL else TOLERANCE
        for first, last in _ranges(over & (path[:, limit] > beyond).any(axis=1)):
            of_carriages = path[first : last + 1, limit].max(axis=0)
            worst = float(of_carriages.max())
            factor = float("nan") if limit == TRAVEL else _factor(worst)
            yield Violation(first, last, limit, int(of_carriages.argmax()), worst, factor)


def solution_violations(
    solution: Solution, free: FloatArray, tolerance_mm: float, limits: CommandLimits
) -> Iterator[Violation]:
    """Yield where limits are kept at the cost of the path, or not kept.

    free : (n, 3, 3), the utilisation by the command without limits
    """
    left = utilisation_from_rest(solution.vertices, limits)[1:-1]
    for window in solution.limited:
        inside = slice(window.first, window.last + 1)
        if window.error_mm <= tolerance_mm and not (left[inside] > 1.0 + SOLVER_ACCURACY).any():
            continue
        yield from command_violations(np.maximum(free[inside], left[inside]), window.first)


def command_violations(utilisation: FloatArray, first_segment: int = 0) -> Iterator[Violation]:
    """Yield where a command demands more than a limit; utilisation (n, 3, 3) of the segments from one on."""
    for first, last in _ranges(widened(np.any(utilisation > 1.0, axis=(1, 2)), 2)):
        inside = utilisation[first : last + 1]
        _, limit, carriage = np.unravel_index(inside.argmax(), inside.shape)
        worst = float(inside.max())
        yield Violation(first_segment + first, first_segment + last, int(limit), int(carriage), worst, _factor(worst))


def timing_violations(late: BoolArray) -> Iterator[Violation]:
    """Yield where segments (n,) cannot be executed in their time."""
    for first, last in _ranges(widened(late, 1)):
        yield Violation(first, last, TIMING, 0, 1.0, 0.8)


def widened(marked: BoolArray, by: int) -> BoolArray:
    """Mark the neighbours of marked segments too."""
    return np.asarray(np.convolve(marked, np.ones(2 * by + 1))[by : by + len(marked)] > 0.5)


def _ranges(marked: BoolArray) -> Iterator[tuple[int, int]]:
    """Yield the first and the last of each range of marked segments."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    for first, after in edges.reshape(-1, 2):
        yield int(first), int(after) - 1
