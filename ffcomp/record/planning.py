"""`ffcomp record plan`: from a request to the G-code of experiments and the plan next to it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import ClassVar

import numpy as np

from ffcomp.errors import LimitsError, RequestError
from ffcomp.inverse.settings import settings_for
from ffcomp.numerics.serialise import keys
from ffcomp.options import number_pair
from ffcomp.planner.segment_timing import SegmentLimits
from ffcomp.record import multisine
from ffcomp.record.gcode_writer import Recorder, gcode_lines
from ffcomp.record.moves import MOST_ROUNDING, Place, Request, check_inside, make_plan, rounding_share
from ffcomp.record.multisine import Band, always_moving, band
from ffcomp.record.page import PageRequest, make_page, page_lines, twins
from ffcomp.record.plan import Excitation, Experiment, Motion, Page, Plan, save_plan, segment_motion
from ffcomp.record.prints import plan_print, print_lines
from ffcomp.record.request import CENTRE, LINE_OF_ACTION, PlanRequest, one_of
from ffcomp.request import shared_with
from ffcomp.result import Fact, Result
from gcode.atomic_write import replace_atomically
from gcode.dialect import KLIPPER
from gcode.dialects import shaper_commands
from gcode.emit import XYZ_COUNTS
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.file import load_machine
from models.kinematics.base import Kinematics
from models.machine import Machine

CHECK_KINDS, CHECK_SECONDS, CHECK_REPEATS, CHECK_SEED = ("multisine", "loop", "reversals"), 2.0, 2, 17


@dataclass(frozen=True, eq=False, repr=False)
class PlanResult(Result):
    """The plan of a recording, and its files."""

    schema = "ffcomp-record-plan/1"
    json_keys: ClassVar = keys("output", "experiments", "captures", "recommended_places_mm", "warnings", "next") | {
        "machine.name": "plan.machine",
        "machine.sha256": "plan.machine_sha256",
        "plan": "plan_file",
        "flavor": "recorder.flavor",
        "duration_s": "plan.duration_s",
        "repeats": "plan.repeats",
        "restores": "restores",
    }

    plan: Plan
    machine: Machine
    output: Path
    plan_file: Path
    recorder: Recorder
    next: str  # command line
    recommended_places_mm: tuple[Place, ...] = ()

    @property
    def captures(self) -> list[str]:
        """Patterns of the captures' names."""
        return [each.capture for each in self.plan.named_runs]

    @property
    def warnings(self) -> list[str]:
        """Say where microsteps matter."""
        if self.plan.page is not None:  # they are lost in the roughness of the lines
            return []
        of_periods = self.plan.experiments[0].excitation is not None
        largest = COARSE_ROUNDING if of_periods else MOST_ROUNDING
        coarse = [each for each in self.plan.experiments if each.rounding > largest]
        if not coarse:
            return []
        worst, count = max(coarse, key=lambda each: each.rounding), f"{len(coarse)} of {len(self.plan.experiments)}"
        louder = "a larger --amplitude-mm-per-s2, a lower --highest-hz" if of_periods else "higher limits"
        return [
            f"In {count} experiments rounding to microsteps is more than {largest:.0%} of the command; most in "
            f"{worst.name}, {worst.rounding:.0%}. Finer microsteps or {louder} make it smaller."
        ]

    @property
    def missing_places_mm(self) -> list[Place]:
        """More informative places."""
        planned = {each.position_mm[:2] for each in self.plan.experiments}
        return [place for place in self.recommended_places_mm if place not in planned]

    @property
    def experiments(self) -> list[PlannedExperiment]:
        """Every experiment, without its moves."""
        return [PlannedExperiment(each) for each in self.plan.experiments]

    @property
    def restores(self) -> list[str]:
        """How limits, shaper and bed mesh are put back."""
        return self.recorder.restores()

    @property
    def headline(self) -> str:
        """The contents of the file and its duration."""
        plan, minutes = self.plan, self.plan.duration_s / 60
        if plan.page is not None:
            return f"{self.output}: a page of {len(twins(plan))} strokes, {minutes:.0f} min to print."
        often = f", {plan.repeats} times each" if plan.repeats > 1 else ""
        return f"{self.output}: {len(plan.experiments)} experiments{often}, {minutes:.1f} min recorded."

    @property
    def facts(self) -> list[Fact]:
        """Every experiment of a recording."""
        own = [("Firmware", self.recorder.flavor), ("Plan", str(self.plan_file))]
        return own if self.plan.page is not None else [*own, *map(self._fact, self.plan.experiments)]

    def _fact(self, experiment: Experiment) -> Fact:
        x, y, *_ = experiment.position_mm
        words = f"at {x:g}, {y:g} mm, {experiment.duration_s:.1f} s, microstep error {100 * experiment.rounding:.0f} %"
        return experiment.name.removeprefix("ffcomp-"), words

    @property
    def next_steps(self) -> list[str]:
        """How to run the file, and what to do with its captures."""
        return [*self._next_steps(), *self.restores, f"Then: {self.next}"]

    def _next_steps(self) -> Iterator[str]:
        if self.plan.page is not None:
            yield f"Print {self.output.name} with the input shaper off, and keep {self.plan_file.name}."
            yield "Scan it at 600 dpi or more, or photograph all of it straight from above, in even light, no flash."
            return
        if places := self.missing_places_mm:
            options = " ".join(f"--at {x:g},{y:g}" for x, y in places)
            yield f"More informative places: {options} (or --at line-of-action)."
        if self.recorder.records:
            count = f"{len(self.captures)} captures for each accelerometer"
            yield f"Run it with the accelerometer on the nozzle holder, the heaters off, and bring back {count}."
        else:
            yield "This firmware records nothing: record all of it with a sensor of your own."
        yield f"Keep {self.plan_file}."


@dataclass(frozen=True, eq=False)
class PlannedExperiment:
    """An experiment of a plan, without its moves."""

    json_keys: ClassVar = keys(
        name="experiment.name",
        kind="experiment.kind",
        direction="experiment.excitation.direction",
        position_mm="experiment.position_mm",
        duration_s="experiment.duration_s",
        moves="experiment.moves",
        microstep_error="experiment.rounding",
    )

    experiment: Experiment


def plan_recording(request: PlanRequest) -> PlanResult:
    """Plan experiments, and write their G-code with the plan next to it.

    Raises RequestError for options that contradict each other, LimitsError for motion that the machine cannot execute.
    """
    if request.plan_file.exists() and not request.force:  # captures of it may exist, which nothing else explains
        raise RequestError(f"{request.plan_file} exists already; give another -o, or --force.")
    machine = load_machine(request.machine)
    flavor = request.flavor or machine.flavor or KLIPPER
    recorder = Recorder(flavor, request.chip or None, shaper_commands(flavor, machine.input_shaper))
    plan, lines = _planned(request, machine, recorder)
    save_plan(plan, request.plan_file)
    replace_atomically(request.output, lines)
    recommended: tuple[Place, ...] = ()
    if request.purpose == "identify":
        recommended = (machine.kinematics.centre_mm, *line_of_action(machine.kinematics))
    return PlanResult(plan, machine, request.output, request.plan_file, recorder, _next(request, plan), recommended)


def _planned(request: PlanRequest, machine: Machine, recorder: Recorder) -> tuple[Plan, Iterable[bytes]]:
    kinematics, amplitude = machine.kinematics, request.amplitude_mm_per_s2
    if request.print_file is not None:
        plan, program = plan_print(request.print_file, machine, recorder.flavor)
        return plan, print_lines(plan, program, recorder)
    if request.purpose == "scan":
        page = Page(**shared_with(request, Page))
        options = shared_with(request, PageRequest, page=page, acceleration_mm_per_s2=amplitude)
        plan = make_page(machine, PageRequest(**options))
        return plan, page_lines(plan, machine, recorder)
    if request.purpose == "identify":
        groups = kinematics.excitation_directions
        axes = request.axes or next(iter(groups))  # the first is the machine's default
        one_of("--axes", [axes], groups)
        options = shared_with(
            request,
            ExcitationRequest,
            places_mm=_excited_places(request.at or (CENTRE,), machine),
            directions=groups[axes],
            acceleration_mm_per_s2=amplitude,
        )
        plan = make_excitation_plan(machine, ExcitationRequest(**options))
    elif request.purpose == "check":  # half a minute in the middle of the bed, always the same
        options = {"seconds": CHECK_SECONDS, "repeats": CHECK_REPEATS, "seed": CHECK_SEED, "kinds": CHECK_KINDS}
        plan = make_plan(machine, Request([kinematics.centre_mm], **options))
    else:
        places = [number_pair("--at", text) for text in request.at]
        kinds = list(dict.fromkeys(request.kind)) or None
        options = shared_with(request, Request, places_mm=places, kinds=kinds, acceleration_mm_per_s2=amplitude)
        plan = make_plan(machine, Request(**options))
    return plan, gcode_lines(plan, machine, recorder)


def _excited_places(texts: Sequence[str], machine: Machine) -> list[Place]:
    """Return places in mm, each once, in their order."""
    places: list[Place] = []
    for text in texts:
        if text == CENTRE:
            places.append(machine.kinematics.centre_mm)
        elif text == LINE_OF_ACTION:
            if not machine.kinematics.tower_directions:
                raise RequestError(f"--at {text}: that is a delta's; straight axes answer alike everywhere.")
            places += line_of_action(machine.kinematics)
        else:
            places.append(number_pair("--at", text))
    return list(dict.fromkeys(places))


def _next(request: PlanRequest, plan: Plan) -> str:
    of_plan = f"--plan {request.plan_file} -m {request.machine}"
    if request.purpose == "identify":
        return f"ffcomp identify fit -m {request.machine} --plan {request.plan_file} CAPTURES"
    if request.purpose == "scan":
        return f"ffcomp identify scan PICTURE {of_plan} -o better.toml"
    if request.purpose == "check":
        return f"ffcomp record check CAPTURES {of_plan}"
    return f"ffcomp diagnose CAPTURES {of_plan}{'' if plan.repeats > 1 else ' --without-repeats'}"


# ---- identification ------------------------------------------------------------------------------
#
# Each experiment excites one coordinate with a periodic signal, at one place. One carriage alone moves (A, B, C; the
# nozzle follows by forward kinematics) or the nozzle along one axis (x, y, z), which suffices for a cartesian machine.
# The motion between the knots, ramps included, follows from the vertices and the limits they are executed under.

TOWERS, AXES = ("A", "B", "C"), ("x", "y", "z")
CLEARANCE_MM = 5.0  # kept between nozzle and bed
MEASURED_AT = 80.0 / 135.0  # of the print radius: where the paper measured, away from each tower
COARSE_ROUNDING = 0.25  # by microsteps: from here on the user is warned


VELOCITIES, ACCELERATIONS = slice(0, 2), slice(2, 5)  # of carriage and nozzle; the fifth is the nozzle's along z
# Without an amplitude from the user, these shares of the machine file's limits: motors keep reserves, the nozzle is
# excited no harder than in a print, and segments that turn back in Z keep their time. With one, only the first three
# limits count, those of the motors and of the nozzle's speed, as in compensation.
CONSERVATIVE = np.array([0.5, 0.5, 0.25, 0.9, 0.2])


@dataclass(frozen=True, slots=True)
class ExcitationRequest:
    """What an identification excites, where and how."""

    places_mm: Sequence[tuple[float, float]] = ((0.0, 0.0),)
    height_mm: float = 50.0
    directions: Sequence[str] = TOWERS
    lowest_hz: float = 5.0
    highest_hz: float = 150.0
    period_s: float = 4.0
    periods: int = 6
    acceleration_mm_per_s2: float | None = None  # peak of the excitation; None: the largest that the limits allow
    repeats: int = 1
    seed: int = 1


def line_of_action(geometry: Kinematics) -> list[tuple[float, float]]:
    """Return places away from each tower through the centre, whole mm: there its carriage's dynamics differ most."""
    reach, towards = geometry.bed_radius_mm, geometry.tower_directions.values()
    places = [np.round(-MEASURED_AT * reach * tower) + 0.0 for tower in towards]
    return [(float(x), float(y)) for x, y in places]


def make_excitation_plan(machine: Machine, request: ExcitationRequest) -> Plan:
    """Design every experiment; LimitsError for a motion out of reach, too fast or too hard, with one that would fit."""
    spectrum_band = band(request.lowest_hz, request.highest_hz, request.period_s)
    output = settings_for(machine).output
    limits = machine.limits
    nozzle = limits.velocity_mm_per_s, limits.acceleration_mm_per_s2, output.z_acceleration_mm_per_s2
    carriage = limits.carriage_velocity_mm_per_s, limits.carriage_acceleration_mm_per_s2
    allowed = np.array([carriage[0], nozzle[0], carriage[1], *nozzle[1:]])
    for x, y in request.places_mm:
        check_inside(machine, f"The place {x:g},{y:g}", np.array([[x, y, request.height_mm]]))
    experiments = []
    for place, direction in product(range(len(request.places_mm)), request.directions):
        top_a, top_v = _allowed(machine, request, direction, allowed)
        displacement, first = multisine.excitation(spectrum_band, request.periods, top_a, top_v, request.seed)
        position, name = (*request.places_mm[place], request.height_mm), f"ffcomp-{direction}-{place}"
        target = _Target(machine, output, name, direction, position)
        motion = _checked_motion(target, spectrum_band, displacement, top_a, allowed)
        rounding = rounding_share(motion, machine.kinematics, machine.steps.per_motor, spectrum_band.highest_hz)
        excited = Excitation(direction, spectrum_band, first, request.periods)
        experiments.append(Experiment(name, "multisine", place, position, motion, rounding, excited))
    return Plan(machine.name, machine.sha256, tuple(experiments), request.repeats, seed=request.seed)


@dataclass(frozen=True, eq=False, slots=True)
class _Target:
    """What an experiment moves, and on which machine."""

    machine: Machine
    output: SegmentLimits
    name: str
    direction: str
    position_mm: tuple[float, float, float]

    def vertices(self, displacement_mm: FloatArray) -> FloatArray:
        """Move the coordinate by (n + 1,) mm: the nozzle's vertices, (n + 1, 3) mm, as the file can state them."""
        geometry, rest = self.machine.kinematics, np.array([self.position_mm])
        if self.direction in TOWERS:
            q = geometry.inverse(rest) + displacement_mm[:, None] * np.eye(3)[TOWERS.index(self.direction)]
            try:
                nozzle = geometry.forward(q)
            except UnreachableError as error:
                raise LimitsError(f"Carriage {self.direction} cannot be moved so far: {error}") from error
        else:
            nozzle = rest + displacement_mm[:, None] * np.eye(3)[AXES.index(self.direction)]
        nudged = AXES.index("z" if self.direction in TOWERS else self.direction)
        return always_moving(np.rint(nozzle * XYZ_COUNTS).astype(np.int64).tolist(), nudged) / XYZ_COUNTS


def _checked_motion(
    target: _Target, spectrum_band: Band, displacement_mm: FloatArray, acceleration: float, allowed: FloatArray
) -> Motion:
    vertices, segment_s = target.vertices(displacement_mm), spectrum_band.segment_s
    _check_vertices(target, vertices, segment_s, acceleration, allowed)
    try:
        return segment_motion(vertices, segment_s, target.output)
    except LimitsError as error:
        reason = error
    feasible = 0.0  # the largest tried share of the displacement that can be executed
    for share in np.geomspace(0.98, 0.02, 80).tolist():
        try:
            segment_motion(target.vertices(share * displacement_mm), segment_s, target.output)
        except LimitsError:
            continue
        feasible = share
        break
    raise LimitsError(f"{target.name}: {reason} An amplitude of {feasible * acceleration:.0f} mm/s² would fit.")


def excited_coordinate(geometry: Kinematics, direction: str, motion: Motion, t_s: FloatArray) -> FloatArray:
    """Return the coordinate that a direction excites, (k,) mm: a carriage's height, or the nozzle along an axis.

    NOTE: between segments the firmware ramps; that lifts the highest lines of its spectrum by up to 15 % over those of
    straight lines between the knots, which were designed.
    """
    if direction in TOWERS:
        return geometry.inverse(motion.nozzle(t_s))[:, TOWERS.index(direction)]
    return motion.nozzle(t_s)[:, AXES.index(direction)]


# How hard


def _allowed(machine: Machine, request: ExcitationRequest, direction: str, limits: FloatArray) -> tuple[float, float]:
    """Return acceleration and velocity of the excited coordinate that suit every position, mm/s² and mm/s."""
    gains = np.array([_gains(machine.kinematics, place, direction) for place in request.places_mm])
    fitting = (CONSERVATIVE * limits / np.maximum(gains, 1e-9)).min(axis=0)
    return request.acceleration_mm_per_s2 or float(fitting[ACCELERATIONS].min()), float(fitting[VELOCITIES].min())


def _gains(geometry: Kinematics, place: tuple[float, float], direction: str) -> list[float]:
    """Return the peaks (5,) of carriages and nozzle when the excited coordinate moves at 1 mm/s (Eq. 12: Ẋ = J q̇)."""
    j = geometry.jacobian(np.array([place]))[0]
    if direction in TOWERS:
        carriage, nozzle = 1.0, j[:, TOWERS.index(direction)]
    else:
        nozzle = np.eye(3)[AXES.index(direction)]
        carriage = float(np.abs(np.linalg.solve(j, nozzle)).max())
    length = float(np.linalg.norm(nozzle))
    return [carriage, length, carriage, length, float(abs(nozzle[2]))]


# Checks


def _check_vertices(
    target: _Target, vertices: FloatArray, segment_s: float, acceleration: float, allowed: FloatArray
) -> None:
    """Check that every vertex is inside, and no peak over its limit."""
    machine = target.machine
    z, heights = target.position_mm[2], vertices[:, 2]
    lowest, highest, top = float(heights.min()), float(heights.max()), machine.kinematics.height_mm
    if lowest < CLEARANCE_MM or highest > top:
        low, high = z - lowest + CLEARANCE_MM, top - (highest - z)
        raise LimitsError(
            f"{target.name} moves the nozzle between {lowest:.2f} and {highest:.2f} mm above the bed, and may between "
            f"{CLEARANCE_MM:g} and {top:g}; a height from {low:.1f} to {high:.1f} mm would fit."
        )
    check_inside(machine, target.name, vertices)
    carriages = machine.kinematics.inverse(vertices) @ machine.kinematics.motors.T
    peaks = {  # from knot to knot
        "carriage velocity in mm/s": np.abs(np.diff(carriages, axis=0)).max() / segment_s,
        "nozzle velocity in mm/s": np.linalg.norm(np.diff(vertices, axis=0), axis=1).max() / segment_s,
        "carriage acceleration in mm/s²": np.abs(np.diff(carriages, 2, axis=0)).max() / segment_s**2,
    }
    for (what, peak), limit in zip(peaks.items(), allowed.tolist(), strict=False):
        if peak > limit:
            raise LimitsError(
                f"{target.name}: the {what} would peak at {peak:.0f}, and may at {limit:.0f}; an amplitude of "
                f"{0.99 * acceleration * limit / peak:.0f} mm/s² would fit."
            )
