"""The methods that are compared, tuned, each with a sentence on how."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ffcomp import shapers
from ffcomp.comparison.baselines import (
    VARIANT_NAMES,
    LinearPrinter,
    ShaperVariant,
    VariantTuner,
    kind_and_variant,
    shaped,
    shaped_by_position,
    shaped_by_variant,
    shaper_variant,
)
from ffcomp.comparison.result import Family
from ffcomp.comparison.sampling import PrintSlice
from ffcomp.compensation.gcode_writer import GcodeRenderer
from ffcomp.compensation.plan import Context, PlannedChunk
from ffcomp.compensation.program import compensate
from ffcomp.compensation.statistics import Statistics
from ffcomp.compensation.text_stream import Stream
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings
from ffcomp.planner.program import PlannedProgram, known_to_the_firmware, plan_program
from ffcomp.planner.reach import within_reach
from ffcomp.planner.trajectory import PlannedMotion, Trajectory
from ffcomp.shapers.apply import FrequencyOfPosition
from ffcomp.shapers.calibration import Spectrum, fit
from ffcomp.shapers.smooth import USUAL
from ffcomp.simulation.command import Motion, SectionClock, SectionStarts, motion_of, section_starts
from gcode.reader import read_program
from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import Machine


@dataclass(frozen=True, slots=True)
class Compensated:
    """A compensated file, and the plan of its original."""

    text: bytes
    planned: PlannedProgram  # the original
    settings: Settings
    flavor: str
    statistics: Statistics


def compensated(
    planned: PlannedProgram,
    machine: Machine,
    model: InverseModel,
    flavor: str,
    offset: tuple[float, float] = (0.0, 0.0),
    progress: Callable[[float], None] = lambda done_s: None,
) -> Compensated:
    """Compensate a planned program, whose positions were shifted by an offset (mm), as the command line does.

    progress : called with the print seconds done so far
    """
    chunk, context = PlannedChunk.whole(planned), Context(machine, model.settings, flavor, offset)
    lines = Stream(compensate(chunk, context, model, GcodeRenderer(chunk, context, model), progress=progress))
    text = b"".join(lines)
    return Compensated(text, planned, model.settings, flavor, lines.value)


@dataclass(frozen=True, slots=True)
class Segments:
    """The compensated file as our own planner plans it."""

    trajectory: Trajectory  # of the moves that travel
    starts: SectionStarts  # of them

    def clock(self, start_t: FloatArray) -> SectionClock:
        """Return the clock of these segments when segment k begins at start_t[k], whoever planned them."""
        return self.starts.clock(start_t)


def segments(
    file: Compensated, machine: Machine, before: bytes = b"", start: tuple[float, float, float] | None = None
) -> Segments:
    """Read the compensated file as a firmware would, and find the sections in it.

    Of a slice of a print, `before` are lines that set what was in effect where it begins, and `start` is where the
    nozzle is then, mm.
    """
    program = read_program(
        before + file.text, "compensated", start=start, flavor=file.flavor, **known_to_the_firmware(machine)
    )
    program = within_reach(program, machine.kinematics)
    trajectory = plan_program(program, machine).trajectory
    travels = np.any(trajectory.direction[:, :3] != 0.0, axis=1)
    starts = section_starts(program, file.planned)
    number = np.cumsum(travels) - 1
    starts = replace(starts, move=number[starts.move], passing=number[starts.passing])
    return Segments(pick(trajectory, travels), starts)


def segments_motion(compensated_segments: Segments) -> Motion:
    """Execute the compensated file as our own planner plans it."""
    return motion_of(
        compensated_segments.trajectory, compensated_segments.clock(compensated_segments.trajectory.start_t)
    )


def pick(trajectory: PlannedMotion, which: NDArray[np.bool_] | slice) -> Trajectory:
    """Return some moves of a plan."""
    names = Trajectory.__dataclass_fields__
    return Trajectory(**{name: np.ascontiguousarray(getattr(trajectory, name)[which]) for name in names})


KINDS = tuple(shapers.SHAPERS)
CALIBRATED, SCHEDULED = "-calibrated", "-scheduled"  # behind a kind
ONE_MODEL, ROBUST, COMPENSATED = "fbs-lti", "fbs-robust", "fbs-lpv"
PLAIN_LABEL = "ffcomp, plain"  # of COMPENSATED, where another row is what the command line writes
NAMES = (
    "none",
    *(kind + CALIBRATED for kind in (*KINDS, *VARIANT_NAMES)),
    *KINDS,
    *VARIANT_NAMES,
    *(kind + SCHEDULED for kind in KINDS),
    ONE_MODEL,
    ROBUST,
    COMPENSATED,
)  # in the order of the table
USUAL_VARIANTS = ("mzv-z",)  # the best rival near the centre of a delta
USUAL_NAMES = tuple(  # compared unless others are named
    name
    for name in NAMES
    if name.removesuffix(CALIBRATED).removesuffix(SCHEDULED) in (*USUAL, *USUAL_VARIANTS)
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


def is_variant(name: str) -> bool:
    """Tell whether a method, calibrated or not, is a variant of newer firmware."""
    return name.removesuffix(CALIBRATED) in VARIANT_NAMES


def variant(tuner: VariantTuner, machine: Machine, name: str) -> TunedMethod:
    """Return a variant by its method's name."""
    shaper = shaper_variant(*kind_and_variant(name.removesuffix(CALIBRATED)), machine)
    return tuned_variant(tuner, shaper, "calibrated" if name.endswith(CALIBRATED) else "best fixed", machine)


def tuned_variant(tuner: VariantTuner, shaper: ShaperVariant, family: Family, machine: Machine) -> TunedMethod:
    """Return a variant as its firmware would set it (family "calibrated") or at its best on this print."""
    if family == "calibrated":
        settings, how = tuner.calibrated(shaper), "Klipper's calibration from resonance tests in the middle of the bed."
    else:
        settings = tuner.best(shaper).settings
        how = "the least contour rms on this print, sought with the plant known."
    return fixed_variant(shaper, settings, family, how, machine)


def fixed_variant(
    shaper: ShaperVariant, settings: FloatArray, family: Family, how: str, machine: Machine
) -> TunedMethod:
    """Return a variant with these settings."""
    name = shaper.kind + shaper.variant + (CALIBRATED if family == "calibrated" else "")
    tuning = f"{shaper.settings_text(settings)}: {how}"

    def motion(print_slice: PrintSlice) -> tuple[Motion, Statistics | None]:
        return shaped_by_variant(shaper, print_slice.motion, settings, machine), None

    return TunedMethod(name, f"{shaper.label}, {family}", family, tuning, motion)


def none() -> TunedMethod:
    """Return the print without compensation."""
    tuning = "The firmware's plan as it stands."
    return TunedMethod("none", "no compensation", "none", tuning, lambda s: (s.motion, None))


def calibrated(tests: Sequence[Spectrum], kind: str) -> TunedMethod:
    """Return a shaper as the firmware's own resonance test at the bed's middle would set it.

    tests : of x and y, see `resonance_tests`
    """
    frequency = [fit(kind, each).frequency_hz for each in tests]
    tuning = f"x {frequency[0]:.1f} Hz, y {frequency[1]:.1f} Hz: Klipper's calibration from a resonance test at 0, 0."
    x, y = (shapers.SHAPERS[kind](f, shapers.DAMPING_RATIO) for f in frequency)
    return TunedMethod(kind + CALIBRATED, f"{kind.upper()}, calibrated", "calibrated", tuning, _shaping(x, y))


def best_fixed(linear: LinearPrinter, kind: str) -> TunedMethod:
    """Return a shaper at the fixed frequencies that serve this very print best."""
    best = linear.best_fixed(kind)
    x, y = best.frequency_hz
    tuning = (
        f"x {x:.1f} Hz, y {y:.1f} Hz, damping ratio {best.damping_ratio:g}: the least contour rms on this print, "
        "sought with the plant known."
    )
    return TunedMethod(kind, f"{kind.upper()}, best fixed", "best fixed", tuning, _shaping(best.x, best.y))


def scheduled(linear: LinearPrinter, of_position: FrequencyOfPosition, kind: str) -> TunedMethod:
    """Return a shaper whose frequency follows the mode over the bed.

    No firmware schedules by the place on the bed; Marlin's dynamic frequency mode does by height or by mass.
    """
    factor = linear.best_factor(kind, of_position)
    tuning = (
        f"{factor:.2f} times the frequency of the plant's dominant mode at each position, the best of twelve factors."
    )

    def motion(print_slice: PrintSlice) -> tuple[Motion, Statistics | None]:
        return shaped_by_position(print_slice.motion, lambda xy: factor * of_position(xy), kind), None

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
    inverse_model = InverseModel(machine, replace(settings, one_model=one_model, robust=robust))

    def motion(s: PrintSlice) -> tuple[Motion, Statistics | None]:
        file = compensated(s.planned, s.machine, inverse_model, s.flavor, s.offset)
        return segments_motion(segments(file, s.machine, s.before, s.start)), file.statistics

    return TunedMethod(name, label, "inversion", tuning, motion)


def _shaping(x: shapers.Shaper, y: shapers.Shaper) -> Executor:
    return lambda print_slice: (shaped(print_slice.motion, x, y), None)


def mode_frequencies(plant: Machine) -> FrequencyOfPosition:
    """Return the dominant mode's frequency over the plant's bed, along x and along y."""
    linear_plant = effective_machine(plant)
    return shapers.over_the_bed(linear_plant, partial(shapers.dominant_frequencies, linear_plant))
