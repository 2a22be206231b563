"""The methods that are compared, tuned, each with a sentence on how."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp import shapers
from ffcomp.compare import rivals
from ffcomp.compare.baselines import LinearPrinter, calibrated_shapers, scaled, shaped, shaped_by_position
from ffcomp.compare.compensated import compensated, segments, segments_motion
from ffcomp.compare.result import Family
from ffcomp.compare.sampling import PrintSlice
from ffcomp.compensate.statistics import Statistics
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings
from ffcomp.shapers.apply import FrequencyOfPosition
from ffcomp.shapers.calibration import Spectrum
from ffcomp.shapers.kinds import USUAL
from ffcomp.simulate.motion import Motion
from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import Machine

KINDS = tuple(shapers.SHAPERS)
CALIBRATED, SCHEDULED = "-calibrated", "-scheduled"  # behind a kind
ONE_MODEL, ROBUST, COMPENSATED = "fbs-lti", "fbs-robust", "fbs-lpv"
PLAIN_LABEL = "ffcomp, plain"  # of COMPENSATED, where another row is what the command line writes
NAMES = (
    "none",
    *(kind + CALIBRATED for kind in (*KINDS, *rivals.NAMES)),
    *KINDS,
    *rivals.NAMES,
    *(kind + SCHEDULED for kind in KINDS),
    ONE_MODEL,
    ROBUST,
    COMPENSATED,
)  # in the order of the table
USUAL_RIVALS = ("mzv-z",)  # the best rival near the centre of a delta
USUAL_NAMES = tuple(  # compared unless others are named
    name
    for name in NAMES
    if name.removesuffix(CALIBRATED).removesuffix(SCHEDULED) in (*USUAL, *USUAL_RIVALS)
    or name in ("none", ONE_MODEL, ROBUST, COMPENSATED)
)


Executor = Callable[[PrintSlice], tuple[Motion, Statistics | None]]


@dataclass(frozen=True, eq=False)
class TunedMethod:
    """One method, ready to execute any slice."""

    name: str
    label: str
    family: Family
    tuning: str
    motion: Executor


def is_rival(name: str) -> bool:
    """Tell whether a method, calibrated or not, is one of `rivals`."""
    return name.removesuffix(CALIBRATED) in rivals.NAMES


def rival(tuner: rivals.Tuner, machine: Machine, name: str) -> TunedMethod:
    """Return a rival by its method's name."""
    own = rivals.rival(*rivals.parsed(name.removesuffix(CALIBRATED)), machine)
    return tuned_rival(tuner, own, "calibrated" if name.endswith(CALIBRATED) else "best fixed", machine)


def tuned_rival(tuner: rivals.Tuner, rival: rivals.Rival, family: Family, machine: Machine) -> TunedMethod:
    """Return a rival as its firmware would set it (family "calibrated") or at its best on this print."""
    if family == "calibrated":
        settings, how = tuner.calibrated(rival), "Klipper's calibration from resonance tests in the middle of the bed."
    else:
        settings = tuner.best(rival).settings
        how = "the least contour rms on this print, sought with the plant known."
    return set_rival(rival, settings, family, how, machine)


def set_rival(rival: rivals.Rival, settings: FloatArray, family: Family, how: str, machine: Machine) -> TunedMethod:
    """Return a rival with these settings."""
    name = rival.kind + rival.variant + (CALIBRATED if family == "calibrated" else "")
    tuning = f"{rival.said(settings)}: {how}"

    def motion(print_slice: PrintSlice) -> tuple[Motion, Statistics | None]:
        return rivals.shaped(rival, print_slice.motion, settings, machine), None

    return TunedMethod(name, f"{rival.label}, {family}", family, tuning, motion)


def none() -> TunedMethod:
    """Return the print without compensation."""
    tuning = "The firmware's plan as it stands."
    return TunedMethod("none", "no compensation", "none", tuning, lambda s: (s.motion, None))


def calibrated(tests: Sequence[Spectrum], kind: str) -> TunedMethod:
    """Return a shaper as the firmware's own resonance test at the bed's middle would set it.

    tests : of x and y, see `resonance_tests`
    """
    frequency, x, y = calibrated_shapers(tests, kind)
    tuning = f"x {frequency[0]:.1f} Hz, y {frequency[1]:.1f} Hz: Klipper's calibration from a resonance test at 0, 0."
    label = f"{kind.upper()}, calibrated"
    return TunedMethod(kind + CALIBRATED, label, "calibrated", tuning, _shaping(x, y))


def best_fixed(linear: LinearPrinter, kind: str) -> TunedMethod:
    """Return a shaper at the fixed frequencies that serve this very print best."""
    found = linear.best_fixed(kind)
    x, y = found.frequency_hz
    tuning = (
        f"x {x:.1f} Hz, y {y:.1f} Hz, damping ratio {found.damping_ratio:g}: the least contour rms on this print, "
        "sought with the plant known."
    )
    return TunedMethod(kind, f"{kind.upper()}, best fixed", "best fixed", tuning, _shaping(found.x, found.y))


def scheduled(linear: LinearPrinter, of_position: FrequencyOfPosition, kind: str) -> TunedMethod:
    """Return a shaper whose frequency follows the mode over the bed.

    No firmware schedules by the place on the bed; Marlin's dynamic frequency mode does by height or by mass.
    """
    factor = linear.best_factor(kind, of_position)
    tuning = (
        f"{factor:.2f} times the frequency of the plant's dominant mode at each position, the best of twelve factors."
    )
    motion = _by_position(scaled(of_position, factor), kind)
    return TunedMethod(kind + SCHEDULED, f"{kind.upper()}, scheduled", "scheduled", tuning, motion)


def inversion(machine: Machine, settings: Settings, name: str) -> TunedMethod:
    """Return inversion with the model of the bed's middle, of each position, or of each with its uncertainty."""
    one_model, robust = name == ONE_MODEL, name == ROBUST
    label = {ONE_MODEL: "ffcomp, one model", ROBUST: "ffcomp, robust"}.get(name, "ffcomp")
    model = "at 0, 0 for the whole bed" if one_model else "at each position"
    if robust:
        model += ", with the least expected contour error over the file's uncertainties"
    tuning = (
        f"The machine file's model {model}; {1 / settings.segment_s:.0f} segments/s at most, bandwidth "
        f"{settings.bandwidth_hz:.0f} Hz; the compensated G-code, read again and planned as the firmware plans it."
    )
    # every method keeps the plan's time
    inverse_model = InverseModel(machine, replace(settings, one_model=one_model, robust=robust, time_scaling=False))
    return TunedMethod(name, label, "inversion", tuning, _inverting(inverse_model))


def _shaping(x: shapers.Shaper, y: shapers.Shaper) -> Executor:
    return lambda print_slice: (shaped(print_slice.motion, x, y), None)


def _by_position(of_position: FrequencyOfPosition, kind: str) -> Executor:
    return lambda print_slice: (shaped_by_position(print_slice.motion, of_position, kind), None)


def _inverting(inverse_model: InverseModel) -> Executor:
    def motion(s: PrintSlice) -> tuple[Motion, Statistics | None]:
        file = compensated(s.planned, s.machine, inverse_model, s.flavor, s.offset)
        return segments_motion(segments(file, s.machine, s.before, s.start)), file.statistics

    return motion


def mode_frequencies(plant: Machine) -> FrequencyOfPosition:
    """Return the dominant mode's frequency over the plant's bed, along x and along y."""
    own = effective_machine(plant)

    def at(xy: np.ndarray) -> np.ndarray:
        return shapers.dominant_frequencies(own, xy)

    return shapers.over_the_bed(own, at)
