"""When a firmware makes each move: trapezoids between corners, with Klipper's rules of corners, and no code of others.

A corner is passed at the speed at which a circle that touches both moves, and leaves the corner by what the corner
velocity allows at a right angle, needs the acceleration; an extruder may change its own speed by `CORNER_E` at once.
Only a share of each hill may be used for speeding up and slowing down again (the cruise ratio).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from validation.independent.reader import Moves

FloatArray = NDArray[np.float64]

CORNER_E = 1.0  # mm/s by which the filament's speed may jump
STILL_MM = 1e-9


@dataclass(frozen=True, slots=True)
class Times:
    """n moves: speeds at their ends, and when each begins."""

    begin_s: FloatArray  # (n,) on the clock of the file
    lasts_s: FloatArray  # (n,)
    start_v: FloatArray  # (n,) mm/s along the move
    cruise_v: FloatArray
    end_v: FloatArray
    acceleration: FloatArray
    length: FloatArray  # (n,) mm: of the nozzle's way, or of the filament's where the nozzle rests
    feed: FloatArray  # (n,) mm/s asked for, after the limits of velocity

    @property
    def end_s(self) -> float:
        """How long all of it takes."""
        return float(self.begin_s[-1] + self.lasts_s[-1]) if len(self.begin_s) else 0.0


@dataclass(frozen=True, slots=True)
class Own:
    """Limits that no file can change; None: none of its own."""

    z_velocity: float | None = None  # mm/s
    z_acceleration: float | None = None  # mm/s²
    e_velocity: float | None = None  # mm/s of filament, where the nozzle rests
    e_acceleration: float | None = None  # mm/s²


def times(moves: Moves, own: Own) -> Times:
    """Plan all moves as a firmware would, from rest to rest."""
    step = moves.step
    way = np.linalg.norm(step[:, :3], axis=1)
    travels = way > STILL_MM
    length = np.where(travels, way, np.abs(step[:, 3]))
    velocity, acceleration, corner, ratio = moves.limits.T.copy()
    gentle = acceleration * (1.0 - ratio)
    feed = np.where(travels, np.minimum(moves.feed, velocity), moves.feed)
    rise = np.where(travels, np.abs(step[:, 2]) / np.maximum(length, STILL_MM), 0.0)
    tilted = rise > 1e-9
    if own.z_velocity:
        feed[tilted] = np.minimum(feed[tilted], own.z_velocity / rise[tilted])
    if own.z_acceleration:
        acceleration[tilted] = np.minimum(acceleration[tilted], own.z_acceleration / rise[tilted])
    if own.e_velocity:
        feed[~travels] = np.minimum(feed[~travels], own.e_velocity)
    if own.e_acceleration:
        acceleration[~travels] = own.e_acceleration
    corners = _corners(step, length, travels, feed, acceleration, corner)
    corners[moves.rest[1:] | (moves.wait_s[1:] > 0.0)] = 0.0
    peak = _hills(length, feed, np.minimum(gentle, acceleration), corners)
    start, end = _speeds(length, feed, acceleration, corners, peak)
    cruise = np.sqrt(
        np.clip(
            np.minimum.reduce([feed**2, peak, 0.5 * (start**2 + end**2) + acceleration * length]),
            np.maximum(start, end) ** 2,
            None,
        )
    )
    slow = (cruise - start + cruise - end) / acceleration
    covered = (2 * cruise**2 - start**2 - end**2) / (2 * acceleration)
    lasts = slow + np.maximum(length - covered, 0.0) / np.maximum(cruise, 1e-12)
    ends = np.cumsum(lasts + moves.wait_s)
    return Times(ends - lasts, lasts, start, cruise, end, acceleration, length, feed)


def _corners(
    step: FloatArray,
    length: FloatArray,
    travels: NDArray[np.bool_],
    feed: FloatArray,
    acceleration: FloatArray,
    corner: FloatArray,
) -> FloatArray:
    """(n - 1,) square of the greatest speed between two moves."""
    direction = step / np.maximum(length, STILL_MM)[:, None]
    a, b = direction[:-1, :3], direction[1:, :3]
    cosine = np.clip(-np.einsum("ij,ij->i", a, b), -1.0, 1.0)  # of the angle between them: 1 is a turn back
    half_sine = np.sqrt(np.maximum(0.5 * (1.0 - cosine), 0.0))
    half_cosine = np.sqrt(np.maximum(0.5 * (1.0 + cosine), 0.0))
    deviates = corner**2 * (np.sqrt(2.0) - 1.0) / acceleration  # mm from a right angle's corner
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = np.where(half_sine < 1.0 - 1e-12, half_sine / (1.0 - half_sine), np.inf)
        tangent = np.where(half_cosine > 1e-9, half_sine / half_cosine, np.inf)
        by_circle = np.minimum(radius * (deviates * acceleration)[:-1], radius * (deviates * acceleration)[1:])
        by_length = 0.5 * tangent * np.minimum((length * acceleration)[:-1], (length * acceleration)[1:])
        turn = np.abs(np.diff(direction[:, 3]))
        by_filament = np.where(turn > 1e-12, (CORNER_E / np.maximum(turn, 1e-12)) ** 2, np.inf)
    found = np.minimum.reduce([by_circle, by_length, by_filament, feed[:-1] ** 2, feed[1:] ** 2])
    found[~(travels[:-1] & travels[1:])] = 0.0
    return np.nan_to_num(found, posinf=np.inf)


def _hills(length: FloatArray, feed: FloatArray, acceleration: FloatArray, corners: FloatArray) -> FloatArray:
    """(n,) square of the speed that each move may reach when hills are climbed with a part of the acceleration."""
    gain = (2.0 * acceleration * length).tolist()
    most = [0.0, *corners.tolist(), 0.0]
    for i in range(1, len(most)):
        most[i] = min(most[i], most[i - 1] + gain[i - 1])
    for i in range(len(most) - 2, -1, -1):
        most[i] = min(most[i], most[i + 1] + gain[i])
    top = (feed**2).tolist()
    found, peak = [], 0.0
    for i, climb in enumerate(gain):
        falls = most[i] >= (most[i + 1] + climb) * (1.0 - 1e-12)
        if not falls or peak == 0.0:
            peak = min(top[i], 0.5 * (most[i] + most[i + 1] + climb))
        found.append(max(peak, most[i]) if falls else peak)
        if most[i + 1] == 0.0:
            peak = 0.0
    return np.array(found)


def _speeds(
    length: FloatArray, feed: FloatArray, acceleration: FloatArray, corners: FloatArray, peak: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Speeds at the beginning and at the end of each move."""
    gain = (2.0 * acceleration * length).tolist()
    inner = np.minimum(corners, np.minimum(peak[:-1], peak[1:]))
    most = [0.0, *inner.tolist(), 0.0]
    for i in range(len(most) - 2, -1, -1):
        most[i] = min(most[i], most[i + 1] + gain[i])
    for i in range(1, len(most)):
        most[i] = min(most[i], most[i - 1] + gain[i - 1])
    speed = np.sqrt(np.array(most))
    return speed[:-1], speed[1:]
