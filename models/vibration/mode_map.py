"""Which vibration of a delta is which: what a mode moves, and its number, the same at every place.

Over the bed modes approach, veer and cross, so their order by frequency means little. A mode is followed from the
centre by its shape: at each step the modes are matched by the modal assurance criterion (R. Allemang, "The modal
assurance criterion", Sound and Vibration, 2003).
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from models.arrays import ComplexArray, FloatArray
from models.vibration.base import Modes
from models.vibration.delta import DeltaVibration

AXES = "xyz"
DOMINANT_SHARE = 0.7  # of a mode's energy: a mode with more than this along one axis is named after it
MINOR_SHARE = 0.15  # of a mode's energy: less than this along an axis is not mentioned
STEP_MM = 3.0  # from place to place
DEGENERATE_SHARE = 1e-3  # of a frequency: closer modes are the pair of a symmetric printer, any mixture of the two


def kinds(model: DeltaVibration, xy: FloatArray, modes: Modes) -> list[str]:
    """Describe what each mode at one position moves."""
    energy = np.abs(_motion(model, xy, modes.shapes)) ** 2
    return [_words(each[:3] + each[3:], float(each[3:].sum())) for each in energy]


def numbers(model: DeltaVibration, xy: FloatArray) -> list[int]:
    """Return the number of each mode at one position, its order at the centre from 1; 0: it is not found there.

    The pair of a symmetric printer is numbered at the first step, where it is two modes.
    """
    from scipy.optimize import linear_sum_assignment

    steps = int(np.ceil(np.hypot(*xy) / STEP_MM))
    places = np.linspace(0.0, 1.0, steps + 1)[:, None] * xy
    modes = model.modes(places)
    frequency = modes[0].frequencies_hz
    begin = int(steps > 0 and np.min(np.diff(frequency) / frequency[1:], initial=1.0) < DEGENERATE_SHARE)
    motions = [_motion(model, place, each.shapes) for place, each in zip(places, modes, strict=True)][begin:]
    number = np.arange(1, len(motions[0]) + 1)
    for here, there in pairwise(motions):
        rows, columns = linear_sum_assignment(-(np.abs(here.conj() @ there.T) ** 2))
        before, number = number, np.zeros(len(there), dtype=np.int64)
        number[columns] = before[rows]
    return [int(each) for each in number]


def _motion(model: DeltaVibration, xy: FloatArray, shapes: ComplexArray) -> ComplexArray:
    """Return √mass times motion of nozzle side X Y Z and extruder X Y Z, of length 1, (m, 6) from shapes (m, 6)."""
    nozzle = shapes[:, :3] @ model.kinematics.jacobian(xy[None])[0].T
    masses = np.repeat([model.nozzle_side_mass_kg, model.effector.extruder_mass_kg], 3)
    motion = np.sqrt(masses) * np.concatenate([nozzle, nozzle + shapes[:, 3:]], axis=1)
    return np.asarray(motion / np.linalg.norm(motion, axis=1, keepdims=True))


def _words(axes: FloatArray, extruder: float) -> str:
    part = [axis for axis, share in zip(AXES, axes.tolist(), strict=True) if share > MINOR_SHARE]
    listed = " and ".join([", ".join(part[:-1]), *part[-1:]] if len(part) > 1 else part)
    along = f"mostly {AXES[int(np.argmax(axes))]}" if axes.max() > DOMINANT_SHARE else listed
    return f"extruder, {along}" if extruder > 0.5 else along
