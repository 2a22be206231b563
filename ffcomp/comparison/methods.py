"""The methods that are compared, tuned, each with a sentence on how."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from ffcomp import shapers
from ffcomp.comparison.result import Family, Peaks
from ffcomp.comparison.sampling import SETTLE_S, PrintSlice
from ffcomp.compensation.gcode_writer import GcodeRenderer
from ffcomp.compensation.plan import Context, PlannedChunk
from ffcomp.compensation.program import compensated_sections
from ffcomp.compensation.statistics import Statistics
from ffcomp.firmware.program import PlannedProgram, known_to_the_firmware, plan_program
from ffcomp.inverse.model import InverseModel
from ffcomp.inverse.settings import Settings
from ffcomp.planner.reach import within_reach
from ffcomp.planner.trajectory import Trajectory
from ffcomp.shapers.calibration import Axis, fit, resonance_test_psd
from ffcomp.shapers.pulses import KERNELS, USUAL
from ffcomp.shapers.search import Optimum, Scan, search
from ffcomp.simulation.command import Motion, SectionClock, SectionStarts, motion_of, section_starts
from ffcomp.simulation.expectation import MARGIN, Commanded, Piece, errors_um
from ffcomp.simulation.linear import STEP_S, LinearPlayback, whole_steps
from gcode.reader import read_program
from models.arrays import FloatArray
from models.effects.catalogue import effective_machine
from models.machine import Machine

# ---- input shapers -------------------------------------------------------------------------------
#
# Each at its best: as the firmware's own calibration sets it, and as a search finds it on the print itself with the
# linear plant along the path; thousands of candidates would be too many for the nonlinear printer, which evaluates the
# winners. Besides shapers of x and y there are those of x, y and z (`-z`), as Marlin has them.

SHAPED_Z = "-z"  # after a kind
SHAPER_NAMES = (*shapers.SHAPERS, *(kind + SHAPED_Z for kind in shapers.SHAPERS))
COMMON_FACTORS = (0.65, 0.75, 0.87, 1.15, 1.32, 1.52, 1.75, 2.0)  # factors of all frequencies at once
DAMPING = "damping ratio"
DAMPING_FACTORS = (0.4, 0.6, 1.5, 2.2)  # factors


@dataclass(frozen=True)
class Shaping:
    """One kind of shaper for x and y, or for z too, and what its k settings are."""

    kind: str
    shapes_z: bool = False

    @classmethod
    def of(cls, name: str) -> Shaping:
        """Return the shaping of a name in `SHAPER_NAMES`."""
        return cls(name.removesuffix(SHAPED_Z), name.endswith(SHAPED_Z))

    @property
    def name(self) -> str:
        """The key of its method."""
        return self.kind + (SHAPED_Z if self.shapes_z else "")

    @property
    def label(self) -> str:
        """The name in a table."""
        return self.kind.upper() + (", z too" if self.shapes_z else "")

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Axes that are shaped."""
        return ("x", "y", "z") if self.shapes_z else ("x", "y")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the settings; the kernel of a smooth shaper is made for one damping ratio."""
        return self.axes if self.kind in KERNELS else (*self.axes, DAMPING)

    @property
    def scans(self) -> tuple[Scan, ...]:
        """The trials before the search steps along each setting."""
        frequencies = Scan(range(len(self.axes)), COMMON_FACTORS)
        return (frequencies,) if self.kind in KERNELS else (frequencies, Scan([len(self.axes)], DAMPING_FACTORS))

    def settings_text(self, settings: FloatArray) -> str:
        """Return the settings in words."""
        return ", ".join(
            f"{name} {value:.2f}" if name == DAMPING else f"{name} {value:.1f} Hz"
            for name, value in zip(self.names, settings, strict=True)
        )

    def shapers(self, settings: FloatArray) -> tuple[shapers.Shaper | None, ...]:
        """Return the shapers of x, y and z."""
        zeta = float(settings[-1]) if DAMPING in self.names else shapers.DAMPING_RATIO
        each = [shapers.SHAPERS[self.kind](float(hz), zeta) for hz in settings[: len(self.axes)]]
        return (*each, None)[:3]


class LinearPrinter:
    """Evaluate shapers on the plant's linear model along the path: quick, and near enough to choose by."""

    def __init__(self, plant: Machine, slices: Sequence[PrintSlice]) -> None:
        self._plant, self._middle = effective_machine(plant), np.array(plant.kinematics.centre_mm, dtype=float)
        self._playback = LinearPlayback(self._plant)
        self._spectrum = cache(partial(resonance_test_psd, self._plant, self._middle))  # along an axis
        self.pieces = [_piece(each) for each in slices if each.trajectory.end_t > 2 * SETTLE_S]

    def contour_rms_um(self, commanded: Callable[[Piece], Commanded]) -> float:
        """Return the contour rms of a command of every piece, µm."""
        return float(errors_um(self.pieces, [self._playback], commanded)[0])

    def calibrated(self, shaping: Shaping) -> FloatArray:
        """Return the settings that a firmware's calibration finds in the middle of the bed."""
        frequencies = [fit(shaping.kind, self._spectrum(axis)).frequency_hz for axis in shaping.axes]
        return np.array([*frequencies, shapers.DAMPING_RATIO] if DAMPING in shaping.names else frequencies)

    def cost(self, shaping: Shaping, settings: FloatArray) -> float:
        """Return the contour rms of the shaped print, µm."""
        by_axis = shaping.shapers(settings)
        return self.contour_rms_um(lambda piece: piece.planned(*by_axis))

    def best(self, shaping: Shaping) -> Optimum:
        """Return the settings with the least contour rms on this print, sought from the calibrated ones, and that."""
        return search(lambda settings: self.cost(shaping, settings), self.calibrated(shaping), shaping.scans)


def _piece(print_slice: PrintSlice) -> Piece:
    """Return a slice as a piece whose command is its plan."""
    motion = print_slice.motion
    steps = whole_steps(motion.end_t - motion.begin_t)
    t = motion.begin_t + STEP_S * np.arange(-MARGIN, steps + 1 + MARGIN, dtype=np.float64)
    plan, inside = motion.position(t), slice(MARGIN, -MARGIN)
    return Piece(*print_slice.corners, motion.begin_t, plan, t[inside], plan[inside], SETTLE_S)


def shaped(motion: Motion, *by_axis: shapers.Shaper | None) -> Motion:
    """Execute a motion as a firmware with input shapers does: each axis convolved, no delay at constant speed."""
    return replace(motion, position=lambda t: shapers.shape(motion.position, t, *by_axis))


# ---- the compensated print -----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Compensated:
    """A compensated file, and the plan of its original."""

    text: bytes
    planned: PlannedProgram  # the original
    flavor: str
    statistics: Statistics


def compensated(
    planned: PlannedProgram, model: InverseModel, flavor: str, offset: tuple[float, float] = (0.0, 0.0)
) -> Compensated:
    """Compensate a planned program, whose positions were shifted by an offset (mm), as the command line does."""
    chunk, context = PlannedChunk.whole(planned), Context(model, flavor, offset)
    outputs = list(compensated_sections(chunk, context, GcodeRenderer(chunk, context)))
    text = b"".join(piece for output in outputs for piece in output.text)
    statistics = sum((output.statistics for output in outputs), Statistics())
    return Compensated(text, planned, flavor, statistics)


@dataclass(frozen=True, slots=True)
class Segments:
    """The compensated file as our own planner plans it."""

    trajectory: Trajectory  # of the moves that travel
    starts: SectionStarts  # of them

    def clock(self, start_t: FloatArray) -> SectionClock:
        """Return the clock of these segments when segment k begins at start_t[k], whoever planned them."""
        return self.starts.clock(start_t)

    @property
    def motion(self) -> Motion:
        """Them as our own planner plans them."""
        return motion_of(self.trajectory, self.clock(self.trajectory.start_t))


def segments(
    file: Compensated, machine: Machine, before: bytes = b"", start: tuple[float, float, float] | None = None
) -> Segments:
    """Read the compensated file as a firmware would, and find the sections in it.

    For a slice of a print, the lines `before` restore the state at its beginning, and `start` is the nozzle's position
    there, mm.
    """
    program = read_program(
        before + file.text, "compensated", start=start, flavor=file.flavor, **known_to_the_firmware(machine)
    )
    program = within_reach(program, machine.kinematics)
    trajectory = plan_program(program, machine).trajectory
    travels = trajectory.travels
    starts = section_starts(program, file.planned)
    number = np.cumsum(travels) - 1
    starts = replace(starts, move=number[starts.move], passing=number[starts.passing])
    return Segments(trajectory.part(travels), starts)


CALIBRATED = "-calibrated"  # after a shaper's name
ONE_MODEL, ROBUST, COMPENSATED = "fbs-lti", "fbs-robust", "fbs-lpv"
PLAIN_LABEL = "ffcomp, plain"  # of COMPENSATED, where another row is what the command line writes
NAMES = (
    "none",
    *(name + CALIBRATED for name in SHAPER_NAMES),
    *SHAPER_NAMES,
    ONE_MODEL,
    ROBUST,
    COMPENSATED,
)  # in the order of the table
USUAL_SHAPERS = (*USUAL, "mzv-z")  # the second is the best rival near the centre of a delta
USUAL_NAMES = tuple(  # compared unless others are named
    name
    for name in NAMES
    if name.removesuffix(CALIBRATED) in USUAL_SHAPERS or name in ("none", ONE_MODEL, ROBUST, COMPENSATED)
)


Executor = Callable[[PrintSlice], tuple[Motion, Statistics | None]]


@dataclass(frozen=True, eq=False)
class CommandedSlices:
    """A method's commands of some slices."""

    pieces: list[tuple[PrintSlice, Motion]]
    peaks: Peaks
    print_time_s: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class TunedMethod:
    """One method, ready to execute any slice."""

    name: str
    label: str
    family: Family
    tuning: str
    motion: Executor

    def commands(self, slices: Sequence[PrintSlice]) -> CommandedSlices:
        """Command every slice; a thousandth over a carriage's limit is rounding."""
        motions, statistics = zip(*map(self.motion, slices), strict=True)
        limits, peaks = slices[0].machine.limits, [motion.peaks(slices[0].machine) for motion in motions]
        velocity, acceleration = (float(most) for most in np.max(peaks, axis=0))
        within = velocity <= 1.001 * limits.carriage_velocity_mm_per_s
        within = within and acceleration <= 1.001 * limits.carriage_acceleration_mm_per_s2
        longer = sum(s.print_time_s - s.original_print_time_s for s in statistics if s is not None)
        return CommandedSlices(
            pieces=list(zip(slices, motions, strict=True)),
            peaks=Peaks(velocity, acceleration, within),
            print_time_s=sum(each.trajectory.end_t for each in slices) + longer,
            warnings=tuple(sentence for each in statistics if each is not None for sentence in each.warnings),
        )


NONE = TunedMethod("none", "no compensation", "none", "The firmware's plan as it stands.", lambda s: (s.motion, None))


def tuned(name: str, machine: Machine, linear: LinearPrinter, settings: Settings) -> TunedMethod:
    """Return one of NAMES; a shaper as the firmware's calibration sets it, or with the best settings for this print."""
    if name == NONE.name:
        return NONE
    if name in (ONE_MODEL, ROBUST, COMPENSATED):
        return inversion(machine, settings, name)
    shaping = Shaping.of(name.removesuffix(CALIBRATED))
    if name.endswith(CALIBRATED):
        how = "Klipper's calibration from resonance tests in the middle of the bed."
        return fixed(shaping, linear.calibrated(shaping), "calibrated", how)
    how = "the least contour rms on this print, sought with the plant known."
    return fixed(shaping, linear.best(shaping).settings, "best fixed", how)


def fixed(shaping: Shaping, settings: FloatArray, family: Family, how: str) -> TunedMethod:
    """Return a shaper with these settings."""
    by_axis = shaping.shapers(settings)
    name = shaping.name + (CALIBRATED if family == "calibrated" else "")
    tuning = f"{shaping.settings_text(settings)}: {how}"
    return TunedMethod(name, f"{shaping.label}, {family}", family, tuning, lambda s: (shaped(s.motion, *by_axis), None))


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
        file = compensated(s.planned, inverse_model, s.flavor, s.offset)
        return segments(file, s.machine, s.before, s.start).motion, file.statistics

    return TunedMethod(name, label, "inversion", tuning, motion)
