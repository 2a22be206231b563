"""Every way of driving the printer that is compared, tuned, with a sentence on how."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ffcomp import shapers
from ffcomp.compare.baselines import LinearPrinter, calibrated_shapers, scaled, shaped, shaped_by_position
from ffcomp.compare.compensated import compensated, segments, segments_motion
from ffcomp.compare.result import Family
from ffcomp.compare.sampling import Stretch
from ffcomp.compensate.program import Summary
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings
from ffcomp.shapers.apply import FrequencyOfPlace
from ffcomp.simulate.motion import Motion
from models.effects.catalogue import effective_machine
from models.machine import Machine

KINDS = ("zv", "mzv", "zvd", "ei", "2hump_ei", "3hump_ei")
CALIBRATED, SCHEDULED = "-calibrated", "-scheduled"  # behind a kind
ONE_MODEL, ROBUST, OURS = "fbs-lti", "fbs-robust", "fbs-lpv"
NAMES = (
    "none",
    *(kind + CALIBRATED for kind in KINDS),
    *KINDS,
    *(kind + SCHEDULED for kind in KINDS),
    ONE_MODEL,
    ROBUST,
    OURS,
)  # in the order of the table


@dataclass(frozen=True, eq=False)
class Way:
    """One method, ready to play any stretch."""

    name: str
    label: str
    family: Family
    tuning: str
    motion: Callable[[Stretch], tuple[Motion, Summary | None]]


def none() -> Way:
    return Way("none", "no compensation", "none", "The firmware's plan as it stands.", lambda s: (s.motion, None))


def calibrated(plant: Machine, kind: str) -> Way:
    """A shaper as the firmware's own resonance test at the bed's middle would set it."""
    frequency, x, y = calibrated_shapers(effective_machine(plant), kind)
    tuning = f"x {frequency[0]:.1f} Hz, y {frequency[1]:.1f} Hz: Klipper's calibration from a resonance test at 0, 0."
    label = f"{kind.upper()}, calibrated"
    return Way(kind + CALIBRATED, label, "calibrated", tuning, _shaping(x, y))


def best_fixed(linear: LinearPrinter, kind: str) -> Way:
    """A shaper at the fixed frequencies that serve this very print best."""
    found = linear.best_fixed(kind)
    x, y = found.frequency_hz
    tuning = (
        f"x {x:.1f} Hz, y {y:.1f} Hz, damping ratio {found.damping_ratio:g}: the least contour rms on this print, "
        "sought with the plant known."
    )
    return Way(kind, f"{kind.upper()}, best fixed", "best fixed", tuning, _shaping(found.x, found.y))


def scheduled(linear: LinearPrinter, of_place: FrequencyOfPlace, kind: str) -> Way:
    """A shaper whose frequency follows the mode over the bed: no firmware has it."""
    factor = linear.best_factor(kind, of_place)
    tuning = f"{factor:.2f} times the frequency of the plant's dominant mode at each place, the best of twelve factors."
    motion = _by_place(scaled(of_place, factor), kind)
    return Way(kind + SCHEDULED, f"{kind.upper()}, scheduled", "scheduled", tuning, motion)


def inversion(machine: Machine, settings: Settings, name: str) -> Way:
    """Inversion with the model of the bed's middle, with the model of each place, ours, or with its uncertainty."""
    one_model, robust = name == ONE_MODEL, name == ROBUST
    label = {ONE_MODEL: "inversion, one model", ROBUST: "ffcomp, robust inversion"}.get(
        name, "ffcomp, scheduled inversion"
    )
    model = "at 0, 0 for the whole bed" if one_model else "at each place"
    if robust:
        model += ", with the least expected contour error over the file's uncertainties"
    tuning = (
        f"The machine file's model {model}; {1 / settings.segment_s:.0f} segments/s at most, bandwidth "
        f"{settings.bandwidth_hz:.0f} Hz; the compensated G-code, read again and planned as the firmware plans it."
    )
    # every way keeps the plan's time
    inverter = InverseModel(machine, replace(settings, one_model=one_model, robust=robust, slow_down=False))
    return Way(name, label, "inversion", tuning, _inverting(inverter))


Player = Callable[[Stretch], tuple[Motion, Summary | None]]


def _shaping(x: shapers.Shaper, y: shapers.Shaper) -> Player:
    return lambda stretch: (shaped(stretch.motion, x, y), None)


def _by_place(of_place: FrequencyOfPlace, kind: str) -> Player:
    return lambda stretch: (shaped_by_position(stretch.motion, of_place, kind), None)


def _inverting(inverter: InverseModel) -> Player:
    def motion(stretch: Stretch) -> tuple[Motion, Summary | None]:
        ours = compensated(stretch.planned, stretch.machine, inverter, stretch.flavor, stretch.offset)
        return segments_motion(ours, segments(ours, stretch.machine, stretch.before, stretch.start)), ours.summary

    return motion


def mode_frequencies(plant: Machine) -> FrequencyOfPlace:
    """The dominant mode's frequency over the plant's bed, along x and along y."""
    own = effective_machine(plant)

    def at(xy: np.ndarray) -> np.ndarray:
        return shapers.dominant_frequencies(own, xy)

    return shapers.over_the_bed(own, at)
