"""Every method of one print, set as its firmware would and at its best: what the comparison judges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffcomp.comparison import methods as every
from ffcomp.comparison.baselines import (
    CARRIAGES,
    INVERSE,
    SHAPED_Z,
    LinearPrinter,
    ShaperVariant,
    VariantTuner,
    shaper_variant,
)
from ffcomp.comparison.methods import TunedMethod
from ffcomp.comparison.sampling import PrintSlice
from ffcomp.inverse.settings import settings_for
from ffcomp.metrics import peak_acceleration
from ffcomp.shapers import SHAPERS
from ffcomp.shapers.search import Optimum
from ffcomp.simulation.linear import STEP_S
from models.arrays import FloatArray
from models.machine import Machine

INVERTED = ("smooth_zv", "smooth_mzv")  # the kernels of the firmware that inverts a mode
SPANS_S = (0.004, 0.001)  # over which accelerations count: of one segment of ours, and of a quick kernel
JUDGED = 6  # kinds, the best of all on this print, that are executed; of the others the linear plant's answer is told
SOUGHT = "the least contour rms on this print, sought with the plant known."


@dataclass(frozen=True, eq=False)
class Pair:
    """One method as its firmware sets it, and at its best."""

    label: str
    group: str  # what is shaped
    calibrated: TunedMethod | None
    best: TunedMethod
    plain: bool  # a shaper of x and y, as most firmware has it
    by_firmware: bool = True  # some firmware has it, or somebody tried it in one


@dataclass(frozen=True, eq=False)
class Known:
    """A rival, its best settings and what they leave on the linear plant, µm."""

    rival: ShaperVariant
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
    linear = LinearPrinter(machine, slices)
    tuner = VariantTuner(machine, machine, linear)
    kinds = sorted((_known(tuner, shaper_variant(kind, "", machine)) for kind in SHAPERS), key=lambda k: k.found.cost)
    first = kinds[:JUDGED]
    known = list(first)
    inverted = [_known(tuner, shaper_variant(kind, INVERSE, machine)) for kind in INVERTED]
    known += inverted
    if z_rings(machine):
        known += [_with_z(tuner, each, machine) for each in first + inverted]
    if carriages_mix(machine):
        known += [_known(tuner, shaper_variant(each.rival.kind, CARRIAGES, machine)) for each in first]
    found = [_pair(tuner, each, machine) for each in known] + _scheduled(linear, machine, first)
    return found, {each.rival.label: each.found.cost for each in kinds[JUDGED:]}


class _GentleTuner(VariantTuner):
    """Settings whose commands ask for no more than a peak acceleration over a time."""

    peak_mm_per_s2, span_s = np.inf, SPANS_S[0]

    def _possible(self, command: FloatArray) -> bool:
        carriages = self._compiled.inverse(command)
        return super()._possible(command) and peak_acceleration(carriages, STEP_S, self.span_s) <= self.peak_mm_per_s2


def inverse_within(machine: Machine, slices: list[PrintSlice], peak_mm_per_s2: float, span_s: float) -> Pair:
    """Set the best inverse of a mode whose command has no higher peak of acceleration."""
    tuner = _GentleTuner(machine, machine, LinearPrinter(machine, slices))
    tuner.peak_mm_per_s2, tuner.span_s = peak_mm_per_s2, span_s
    each = [_known(tuner, shaper_variant(kind, INVERSE, machine)) for kind in INVERTED]
    return _pair(tuner, min(each, key=lambda known: known.found.cost), machine)


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


def carriages_mix(machine: Machine) -> bool:
    """Tell whether a carriage is something else than an axis."""
    middle = np.array([*machine.kinematics.centre_mm, 0.0])
    there = middle + np.array([[3.0, 5.0, 10.0], [4.0, 7.0, 13.0]])
    moved = np.diff(machine.kinematics.inverse(there), axis=0)
    return not np.allclose(moved, np.diff(there, axis=0))


def _known(tuner: VariantTuner, rival: ShaperVariant) -> Known:
    return Known(rival, tuner.best(rival))


def _with_z(tuner: VariantTuner, known: Known, machine: Machine) -> Known:
    """Shape z too: from the best of x and y on, first z alone, then all."""
    rival = shaper_variant(known.rival.kind, known.rival.variant + SHAPED_Z, machine)
    at = rival.names.index("z")
    start = np.insert(known.found.settings, at, tuner.calibrated(rival)[at])
    first = tuner.best(rival, start, [at])
    return Known(rival, first)


def _pair(tuner: VariantTuner, known: Known, machine: Machine) -> Pair:
    rival = known.rival
    calibrated = every.tuned_variant(tuner, rival, "calibrated", machine)
    best = every.fixed_variant(rival, known.found.settings, "best fixed", SOUGHT, machine)
    group = {"": "x and y", CARRIAGES: "each carriage"}.get(
        rival.variant, "x, y and z" if rival.shapes_z else "x and y"
    )
    return Pair(rival.label, group, calibrated, best, plain=not rival.variant)


def _scheduled(linear: LinearPrinter, machine: Machine, first: list[Known]) -> list[Pair]:
    of_place = every.mode_frequencies(machine)
    found = [every.scheduled(linear, of_place, each.rival.kind) for each in first[:2]]
    return [Pair(each.label, "x and y", None, each, plain=False, by_firmware=False) for each in found]
