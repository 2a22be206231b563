"""Which frequency to shape at which place: a table over the bed, read by the x and y shapers along the path."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from ffcomp.shapers.apply import FrequencyOfPlace
from models.arrays import FloatArray
from models.machine import Machine
from models.vibration.receptance import modes, nozzle_frf


def dominant_frequencies(machine: Machine, xy: FloatArray) -> FloatArray:
    """Of the modes at one place, the one in which the nozzle vibrates most for the same commanded acceleration.

    That is the largest |X/Ẍ_d| = |G|/ω² at a natural frequency, with G from commanded to real nozzle. The drive's own
    resonance is not among the modes: it is the same everywhere.

    Parameters
    ----------
    xy : (2,) mm, columns X Y.

    Returns
    -------
    (2,) Hz, of what is commanded and answers along X, and along Y.
    """
    natural = modes(machine, xy).frequencies_hz
    loudness = np.abs(nozzle_frf(machine, xy, natural)) / natural[:, None, None] ** 2  # (modes, 3, 3)
    return natural[np.argmax(loudness[:, [0, 1], [0, 1]], axis=0)]


def over_the_bed(
    machine: Machine, frequencies_at: Callable[[FloatArray], FloatArray], pitch_mm: float = 10.0
) -> FrequencyOfPlace:
    """`frequencies_at` asked once at every node of a square grid, then interpolated linearly between them.

    Where the dominant mode changes, its frequency jumps, and with it the shaped position would; between two nodes the
    interpolation makes a slope of it. Outside the bed the value at the rim's nearest node holds.

    Parameters
    ----------
    frequencies_at : (2,) mm, columns X Y → (2,) Hz, along X and Y
    """
    reach = machine.kinematics.model_reach_mm
    if not reach:
        everywhere = frequencies_at(np.zeros(2))
        return lambda xy: np.tile(everywhere, (len(xy), 1))
    x = np.linspace(-reach, reach, 2 * int(np.ceil(reach / pitch_mm)) + 1)
    nodes = _inside(np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1).reshape(-1, 2), reach)
    values = np.array([frequencies_at(node) for node in nodes]).reshape(len(x), len(x), 2)
    # a place on the rim may round to just outside the grid
    table = RegularGridInterpolator((x, x), values, bounds_error=False, fill_value=None)

    def of_place(xy: FloatArray) -> FloatArray:
        return np.asarray(table(_inside(xy, reach)), dtype=float)

    return of_place


def _inside(xy: FloatArray, reach_mm: float) -> FloatArray:
    """Places (n, 2) mm outside the bed are drawn in to its rim."""
    distance = np.hypot(xy[:, 0], xy[:, 1])
    return xy * (reach_mm / np.maximum(distance, reach_mm))[:, None]
