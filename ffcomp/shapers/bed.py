"""Shaper frequencies over the bed: a table that the x and y shapers read along the path."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from ffcomp.shapers.apply import FrequencyOfPosition
from models.arrays import FloatArray
from models.machine import Machine


def dominant_frequencies(machine: Machine, xy: FloatArray) -> FloatArray:
    """Return the frequencies of the modes at one position in which the nozzle vibrates most.

    For the same commanded acceleration, that is the largest |X/Ẍ_d| = |G|/ω² at a natural frequency, with G from
    commanded to real nozzle. The drive's own resonance is not among the modes: it is the same everywhere.

    Parameters
    ----------
    machine : Machine
    xy : (2,) array
        In mm, columns X Y.

    Returns
    -------
    (2,) array
        In Hz, for command and response along X, and along Y.
    """
    natural = machine.vibration.modes_at(xy).frequencies_hz
    loudness = (
        np.abs(machine.vibration.frequency_response(xy, natural, "nozzle", "nozzle")) / natural[:, None, None] ** 2
    )  # (modes, 3, 3)
    return natural[np.argmax(loudness[:, [0, 1], [0, 1]], axis=0)]


def over_the_bed(
    machine: Machine, frequencies_at: Callable[[FloatArray], FloatArray], pitch_mm: float = 10.0
) -> FrequencyOfPosition:
    """Tabulate frequencies at the nodes of a square grid, and interpolate linearly between them.

    Where the dominant mode changes, its frequency jumps, and with it the shaped position would; between two nodes the
    interpolation makes a slope of it. Outside the bed the value at the rim's nearest node holds.

    Parameters
    ----------
    machine : Machine
    frequencies_at : callable
        (2,) mm, columns X Y → (2,) Hz, along X and Y.
    pitch_mm : float
    """
    reach = machine.kinematics.model_reach_mm
    if not reach:
        everywhere = frequencies_at(np.zeros(2))
        return lambda xy: np.tile(everywhere, (len(xy), 1))
    x = np.linspace(-reach, reach, 2 * int(np.ceil(reach / pitch_mm)) + 1)
    nodes = _inside(np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2), reach)
    values = np.array([frequencies_at(node) for node in nodes]).reshape(len(x), len(x), 2)

    def of_position(xy: FloatArray) -> FloatArray:
        return _interpolated(np.ascontiguousarray(_inside(xy, reach)), reach, values)

    return of_position


def _inside(xy: FloatArray, reach_mm: float) -> FloatArray:
    """Move positions (n, 2) mm outside the bed to its rim."""
    distance = np.hypot(xy[:, 0], xy[:, 1])
    return xy * (reach_mm / np.maximum(distance, reach_mm))[:, None]


@njit(cache=True, nogil=True)
def _interpolated(xy: FloatArray, reach_mm: float, values: FloatArray) -> FloatArray:
    """Interpolate values (n, n, 2) at the nodes of a square grid from -reach_mm to reach_mm, linearly in x and in y."""
    out = np.empty((len(xy), 2))
    cells = len(values) - 1
    for k in range(len(xy)):
        across, along = ((xy[k, 0] + reach_mm) * cells / (2 * reach_mm), (xy[k, 1] + reach_mm) * cells / (2 * reach_mm))
        # a position on the rim may round to just outside the grid
        i, j = min(max(int(across), 0), cells - 1), min(max(int(along), 0), cells - 1)
        u, v = across - i, along - j
        for c in range(2):
            low = (1 - v) * values[i, j, c] + v * values[i, j + 1, c]
            high = (1 - v) * values[i + 1, j, c] + v * values[i + 1, j + 1, c]
            out[k, c] = (1 - u) * low + u * high
    return out
