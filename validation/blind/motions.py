"""Commanded motions of a measurement: nozzle paths over time, drawn from seeds.

A motion is drawn once and then known at every time; it begins and ends at rest. mm, s.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Place: TypeAlias = tuple[float, float, float]
Path: TypeAlias = Callable[[FloatArray], FloatArray]  # (n,) s → (n, 3) mm, columns x y z
QUIET_S = 0.08  # at rest before and after
FADE_S = 0.25


@dataclass(frozen=True)
class Motion:
    """One experiment, as the files will name it."""

    name: str
    path: Path
    seconds: float


@lru_cache(maxsize=32)
def points(motion: Motion, rows_per_s: float) -> FloatArray:
    """(n, 3) mm, the nozzle from the beginning to the end; an odd number of rows."""
    count = 2 * round(motion.seconds * rows_per_s / 2) + 1
    found = motion.path(np.arange(count) / rows_per_s)
    found.flags.writeable = False  # shared by all who ask
    return found


def multisine(rng: np.random.Generator, place: Place, seconds: float, loudness: float = 1.0) -> Path:
    """Forty sines from 2 to 120 Hz in every direction at once, about equal in acceleration, faded in and out."""
    f = np.sort(rng.uniform(2.0, 120.0, (40, 3)), axis=0)
    phase = rng.uniform(0.0, 2 * np.pi, f.shape)
    level = loudness * 4500.0 * np.sqrt(2 / 40)  # mm/s² rms along each axis
    amplitude = level / (2 * np.pi * f) ** 2 * (f / (f + 8.0))

    def path(t: FloatArray) -> FloatArray:
        window = _fade(t, seconds)[:, None]
        moved = np.stack([np.sin(np.outer(t, 2 * np.pi * f[:, j]) + phase[:, j]) @ amplitude[:, j] for j in range(3)])
        return np.asarray(place) + window * moved.T

    return path


def _fade(t: FloatArray, seconds: float) -> FloatArray:
    """0 at both ends, 1 between, three times differentiable."""
    x = np.clip((np.minimum(t, seconds - t) - QUIET_S) / FADE_S, 0.0, 1.0)
    return x**4 * (35 - 84 * x + 70 * x**2 - 20 * x**3)


def infill(rng: np.random.Generator, place: Place, seconds: float, loudness: float = 1.0) -> Path:
    """Zigzag lines with turns, as a print's infill: straight moves from rest to rest."""
    along = rng.uniform(0, np.pi)
    forth = np.array([np.cos(along), np.sin(along), 0.0])
    aside = np.array([-forth[1], forth[0], 0.0])
    length, speed, push = rng.uniform(12, 24), rng.uniform(60, 110), loudness * rng.uniform(3000, 6000)
    corners = [np.asarray(place, dtype=float)]
    for n in range(200):
        corners.append(corners[-1] + length * forth * (-1) ** n)
        corners.append(corners[-1] + 0.8 * aside * (1 if (n // 15) % 2 == 0 else -1))
    return _moves(np.array(corners), speed, push, 0.0, seconds)


def steps(rng: np.random.Generator, place: Place, seconds: float, loudness: float = 1.0) -> Path:
    """Hard single moves in random directions, each rung out: also up and down."""
    corners = np.asarray(place) + rng.uniform(-1, 1, (60, 3)) * [9.0, 9.0, 4.0]
    corners[0] = place
    return _moves(corners, rng.uniform(80, 150), loudness * rng.uniform(6000, 10000), rng.uniform(0.05, 0.12), seconds)


def slow(rng: np.random.Generator, place: Place, seconds: float, loudness: float = 1.0) -> Path:
    """Slow moves to and fro, much of the time near a standstill."""
    corners = np.asarray(place) + rng.uniform(-1, 1, (60, 3)) * [1.2, 1.2, 0.6]
    corners[0] = place
    return _moves(corners, loudness * rng.uniform(6, 20), 600.0, 0.02, seconds)


def strokes(rng: np.random.Generator, place: Place, seconds: float, loudness: float = 1.0) -> Path:
    """Long single moves along x to and fro, each of its own length, as a stage goes from work to work."""
    ends = np.cumsum(rng.uniform(25.0, 50.0, 60) * (-1.0) ** np.arange(60))
    corners = np.asarray(place) + np.column_stack([np.append(0.0, ends), np.zeros((61, 2))])
    speed, push = loudness * rng.uniform(120, 200), loudness * rng.uniform(1500, 3000)
    return _moves(corners, speed, push, rng.uniform(0.01, 0.05), seconds)


def turns(rng: np.random.Generator, place: Place, seconds: float, loudness: float = 1.0) -> Path:
    """Round and round, rising, and back: long travel without corners."""
    radius, rise = rng.uniform(8, 15), rng.uniform(5, 12)
    top = loudness * rng.uniform(70, 110) / radius  # rad/s

    def path(t: FloatArray) -> FloatArray:
        run = np.clip((t - QUIET_S) / (seconds - 2 * QUIET_S), 0.0, 1.0)
        angle = top * (seconds - 2 * QUIET_S) * 5.2 * (run * (1 - run)) ** 2  # 5.2: the fastest is `top`
        round_about = radius * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
        return np.asarray(place) + np.column_stack([round_about, rise * run**3 * (10 - 15 * run + 6 * run**2)])

    return path


KINDS: Mapping[str, Callable[..., Path]] = {
    each.__name__: each for each in (multisine, infill, steps, slow, strokes, turns)
}


def _moves(corners: FloatArray, speed: float, push: float, pause: float, seconds: float) -> Path:
    """From corner to corner, each move a cosine-shaped run-up, cruise and run-out: acceleration without jumps.

    A run-up of duration T_a covers speed T_a/2 and peaks at π/2 speed/T_a = `push`.
    """
    lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    top = np.minimum(speed, np.sqrt(2 / np.pi * push * lengths))
    ramp = np.pi / 2 * top / push
    duration = lengths / top + ramp
    begins = QUIET_S + np.concatenate([[0.0], np.cumsum(duration + pause)[:-1]])
    count = int(np.searchsorted(begins + duration, seconds - QUIET_S))
    if count == 0:
        raise ValueError(f"No move of {duration[0]:.2f} s fits into a motion of {seconds} s.")

    def path(t: FloatArray) -> FloatArray:
        move = np.clip(np.searchsorted(begins[:count], t, side="right") - 1, 0, count - 1)
        since = np.clip(t - begins[move], 0.0, duration[move])
        gone = _run(since, top[move], ramp[move], duration[move])
        toward = np.diff(corners, axis=0)[move] / lengths[move][:, None]
        return np.asarray(corners[move] + gone[:, None] * toward)

    return path


def _run(t: FloatArray, top: FloatArray, ramp: FloatArray, duration: FloatArray) -> FloatArray:
    """Distance after t : (n,) s of a move whose speed rises and falls as (1 - cos)/2."""

    def rising(x: FloatArray) -> FloatArray:
        return np.asarray(top * (x - ramp / np.pi * np.sin(np.pi * x / ramp)) / 2)

    up = rising(np.minimum(t, ramp))
    cruise = top * np.clip(t - ramp, 0.0, duration - 2 * ramp)
    left = np.clip(duration - t, 0.0, ramp)
    return np.asarray(up + cruise + top * ramp / 2 - rising(left))
