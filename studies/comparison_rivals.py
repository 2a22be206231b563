"""Every method of one print, set as its firmware would and at its best: what the comparison judges."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ffcomp.comparison import methods as every
from ffcomp.comparison.baselines import LinearPrinter, Shaping
from ffcomp.comparison.methods import TunedMethod
from ffcomp.comparison.sampling import PrintSlice
from ffcomp.inverse.settings import settings_for
from ffcomp.shapers import SHAPERS
from ffcomp.shapers.search import Optimum
from models.machine import Machine
from studies.comparison_inverse import InversePrinter, ModeInverse

INVERTED = ("smooth_zv", "smooth_mzv")  # the kernels of the firmware that inverts a mode
JUDGED = 6  # kinds, the best of all on this print, that are executed; of the others the linear plant's answer is told
SOUGHT = "the least contour rms on this print, sought with the plant known."


@dataclass(frozen=True, eq=False)
class Pair:
    """One method as its firmware sets it, and at its best."""

    label: str
    group: str  # what is shaped
    calibrated: TunedMethod
    best: TunedMethod
    plain: bool  # a shaper of x and y, as most firmware has it


@dataclass(frozen=True, eq=False)
class Known:
    """A rival, its best settings and what they leave on the linear plant, µm."""

    rival: Shaping
    found: Optimum


def pairs(machine: Machine, slices: list[PrintSlice]) -> tuple[list[Pair], dict[str, float]]:
    """Set every rival on some slices of a print.

    Returns
    -------
    pairs : list of Pair
        What is worth executing.
    others : dict
        Label → contour rms on the linear plant, µm, of the kinds that are not.
    """
    linear = InversePrinter(machine, slices)
    kinds = sorted((_known(linear, Shaping(kind)) for kind in SHAPERS), key=lambda known: known.found.cost)
    first, inverted = kinds[:JUDGED], [_known(linear, ModeInverse(kind)) for kind in INVERTED]
    known = first + inverted
    if z_rings(machine):
        known += [_with_z(linear, each) for each in first + inverted]
    return [_pair(linear, each) for each in known], {each.rival.label: each.found.cost for each in kinds[JUDGED:]}


def inverse_within(machine: Machine, slices: list[PrintSlice], peak_mm_per_s2: float, span_s: float) -> Pair:
    """Set the best inverse of a mode whose command has no higher peak of acceleration."""
    linear = InversePrinter(machine, slices, peak_mm_per_s2, span_s)
    each = [_known(linear, ModeInverse(kind)) for kind in INVERTED]
    return _pair(linear, min(each, key=lambda known: known.found.cost))


def inversions(machine: Machine) -> list[TunedMethod]:
    """Return ffcomp's ways."""
    settings = settings_for(machine)
    names = (every.ONE_MODEL, every.ROBUST, every.COMPENSATED)
    return [every.inversion(machine, settings, name) for name in names]


def z_rings(machine: Machine) -> bool:
    """Tell whether the nozzle answers to z otherwise than by following."""
    hz = np.linspace(10.0, 150.0, 141)
    middle = np.array(machine.kinematics.centre_mm)
    answer = machine.vibration.frequency_response(middle, hz, "nozzle", "nozzle")[:, 2, 2]
    return bool(np.abs(answer).max() > 1.05)


def _known(linear: LinearPrinter, rival: Shaping) -> Known:
    return Known(rival, linear.best(rival))


def _with_z(linear: LinearPrinter, known: Known) -> Known:
    """Shape z too: from the best of x and y on, z alone."""
    rival = replace(known.rival, shapes_z=True)
    at = rival.names.index("z")
    start = np.insert(known.found.settings, at, linear.calibrated(rival)[at])
    return Known(rival, linear.best(rival, start, [at]))


def _pair(linear: LinearPrinter, known: Known) -> Pair:
    rival = known.rival
    calibrated = every.fixed(rival, linear.calibrated(rival), "calibrated", "as its firmware sets it.")
    best = every.fixed(rival, known.found.settings, "best fixed", SOUGHT)
    plain = type(rival) is Shaping and not rival.shapes_z
    return Pair(rival.label, "x, y and z" if rival.shapes_z else "x and y", calibrated, best, plain)
