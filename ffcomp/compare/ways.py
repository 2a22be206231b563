"""Every way of driving the printer that is compared, tuned, with a sentence on how."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ffcomp import shapers
from ffcomp.calibrate import Fixed
from ffcomp.compare.motion import Motion, shaped, shaped_by_place
from ffcomp.compare.ours import compensated, segments, segments_motion
from ffcomp.compare.result import Family
from ffcomp.compare.stretch import Stretch
from ffcomp.compare.tuning import LinearPrinter, calibrated_shapers, scaled
from ffcomp.invert.fbs import Inverter
from ffcomp.invert.settings import Settings
from ffcomp.pipeline import Summary
from ffcomp.shapers.motion import FrequencyOfPlace
from models.effects.catalogue import effective_machine
from models.machine import Machine

KINDS = ("zv", "mzv", "zvd", "ei", "2hump_ei", "3hump_ei")
OURS = "fbs-lpv"


@dataclass(frozen=True, eq=False)
class Way:
    """One method, ready to play any stretch."""

    name: str
    label: str
    family: Family
    tuning: str
    motion: Callable[[Stretch], tuple[Motion, Summary | None]]
    fixed: Fixed | None = None  # of a fixed shaper that was sought
    kind: str = ""  # of a shaper


def none() -> Way:
    return Way("none", "no compensation", "none", "The firmware's plan as it stands.", lambda s: (s.motion, None))


def calibrated(plant: Machine) -> Iterator[Way]:
    """Shapers as the firmware's own resonance test at the bed's middle would set them."""
    for kind in KINDS:
        frequency, x, y = calibrated_shapers(effective_machine(plant), kind)
        tuning = (
            f"x {frequency[0]:.1f} Hz, y {frequency[1]:.1f} Hz: Klipper's calibration from a resonance test at 0, 0."
        )
        yield Way(f"{kind}-calibrated", f"{kind.upper()}, calibrated", "calibrated", tuning, _shaping(x, y), kind=kind)


def best_fixed(linear: LinearPrinter, kinds: tuple[str, ...] = KINDS) -> Iterator[Way]:
    """Shapers at the fixed frequencies that serve this very print best."""
    for kind in kinds:
        yield fixed_way(kind, linear.best_fixed(kind))


def fixed_way(kind: str, found: Fixed) -> Way:
    x, y = found.frequency_hz
    tuning = (
        f"x {x:.1f} Hz, y {y:.1f} Hz, damping ratio {found.damping_ratio:g}: the least contour rms on this print, "
        "sought with the plant known."
    )
    return Way(kind, f"{kind.upper()}, best fixed", "best fixed", tuning, _shaping(found.x, found.y), found, kind)


def scheduled(linear: LinearPrinter, of_place: FrequencyOfPlace) -> Iterator[Way]:
    """Shapers whose frequency follows the mode over the bed: no firmware has them."""
    for kind in KINDS:
        factor = linear.best_factor(kind, of_place)
        tuning = (
            f"{factor:.2f} times the frequency of the plant's dominant mode at each place, the best of twelve factors."
        )
        motion = _by_place(scaled(of_place, factor), kind)
        yield Way(f"{kind}-scheduled", f"{kind.upper()}, scheduled", "scheduled", tuning, motion, kind=kind)


def inversion(machine: Machine, settings: Settings) -> Iterator[Way]:
    """Filtered B-splines with the model of the bed's middle, and with the model of each place: ours."""
    about = (
        f"{1 / settings.segment_s:.0f} segments/s at most, bandwidth {settings.bandwidth_hz:.0f} Hz; the compensated "
        "G-code, read again and planned as the firmware plans it."
    )
    for name, label, one_model, model in (
        ("fbs-lti", "inversion, one model", True, "The machine file's model at 0, 0 for the whole bed"),
        (OURS, "ffcomp, scheduled inversion", False, "The machine file's model at each place"),
    ):
        inverter = Inverter(machine, replace(settings, one_model=one_model))
        yield Way(name, label, "inversion", f"{model}; {about}", _inverting(inverter))


Player = Callable[[Stretch], tuple[Motion, Summary | None]]


def _shaping(x: shapers.Shaper, y: shapers.Shaper) -> Player:
    return lambda stretch: (shaped(stretch.motion, x, y), None)


def _by_place(of_place: FrequencyOfPlace, kind: str) -> Player:
    return lambda stretch: (shaped_by_place(stretch.motion, of_place, kind), None)


def _inverting(inverter: Inverter) -> Player:
    def motion(stretch: Stretch) -> tuple[Motion, Summary | None]:
        ours = compensated(stretch.planned, stretch.machine, inverter, stretch.flavor, stretch.offset)
        return segments_motion(ours, segments(ours, stretch.machine, stretch.offset)), ours.summary

    return motion


def mode_frequencies(plant: Machine) -> FrequencyOfPlace:
    """The dominant mode's frequency over the plant's bed, along x and along y."""
    own = effective_machine(plant)

    def at(xy: np.ndarray) -> np.ndarray:
        return shapers.dominant_frequencies(own, xy)

    return shapers.over_the_bed(own, at)
