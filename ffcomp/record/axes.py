"""Which axis of the printer each axis of a sensor measures: stated by the user, or found in the captures.

Gravity shows which of the sensor's axes is vertical, and the commanded motion below 20 Hz which of the others is x.
What gravity is then still off the vertical is the sensor's tilt, and is turned away.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations, product

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.sensors import G
from ffcomp.record.clock import Matches
from models.arrays import FloatArray

NEARLY_G = 0.25  # of g: less or more at rest, and gravity is not in the capture
UPRIGHT = 0.8  # of gravity along the axis that is taken for the vertical
STRAIGHT = ("x", "y", "z")
LEFT_HANDED_SHARE = 0.8  # of its score that counts


def turn_of(axes_map: str | None) -> FloatArray | None:
    """Return the matrix (3, 3) from sensor to printer axes that a text like "x,-z,y" means; None: to be found.

    Raises MeasurementError unless they are x, y and z with signs.
    """
    if axes_map is None:
        return None
    axes, turn = axes_map.split(","), np.zeros((3, 3))
    for row, text in enumerate(axes):
        name = text.strip().lstrip("+-")
        if name not in STRAIGHT:
            raise MeasurementError(
                "--axes-map", [f"{text!r} is no axis; it is x, y or z, with a minus if it points back."]
            )
        turn[row, STRAIGHT.index(name)] = -1.0 if text.strip().startswith("-") else 1.0
    if abs(np.linalg.det(turn)) != 1.0:
        raise MeasurementError("--axes-map", [f"{', '.join(axes)} does not name each of x, y and z once."])
    return turn


def candidates(gravity: FloatArray) -> list[FloatArray]:
    """List the signed permutations (3, 3) from sensor to printer axes that gravity (3,) m/s² at rest allows."""
    turns = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        turn = np.zeros((3, 3))
        turn[range(3), order] = signs
        turns.append(turn)
    if abs(np.linalg.norm(gravity) / G - 1.0) > NEARLY_G:
        return [turn for turn in turns if np.linalg.det(turn) > 0]
    upright = [turn for turn in turns if (turn @ gravity)[2] > UPRIGHT * np.linalg.norm(gravity)]
    return upright or turns


def find_turn(matches: Sequence[Matches], gravity: FloatArray) -> FloatArray:
    """Return the signed permutation (3, 3) under which the captures of one chip fit their experiments best."""

    def score(turn: FloatArray) -> float:
        # left-handed only if it fits clearly better: chips are right-handed, a firmware's `axes_map` need not be
        handedness = 1.0 if np.linalg.det(turn) > 0 else LEFT_HANDED_SHARE
        return handedness * sum(best_score(each, turn)[0] for each in matches)

    return max(candidates(gravity), key=score)


def best_score(matches: Matches, turn: FloatArray) -> tuple[float, tuple[float, float]]:
    """Return the correlation of the turned sensor, and the clock (offset, ratio) that maximises it."""
    scores = np.einsum("sij,ji->s", matches.correlation, turn)
    best = int(scores.argmax())
    return float(scores[best]), matches.starts[best]


def tilt(gravity: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) that brings gravity (3,), along the printer's axes, upright; identity without gravity.

    The smallest one, because gravity does not show a rotation about the vertical.
    """
    size = float(np.linalg.norm(gravity))
    if abs(size / G - 1.0) > NEARLY_G or gravity[2] < UPRIGHT * size:
        return np.eye(3)
    a = gravity / size
    cross = np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]]) @ np.array([0.0, 0.0, 1.0])
    skew = np.array([[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + a[2]))


def words(turn: FloatArray) -> str:
    """Name a signed permutation (3, 3) as --axes-map does: the printer's axes in the sensor's own."""
    places = np.abs(turn).argmax(axis=1)
    return ",".join(("-" if turn[row, i] < 0 else "") + STRAIGHT[i] for row, i in enumerate(places.tolist()))
