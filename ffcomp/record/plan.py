"""Plan what a printer does so that its own sensor shows what its machine file lacks.

Up to twelve experiments, each made twice: every place gets three of the four kinds of moves, so that each kind is made
at three places of four. What is found at some places can then be tested at others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ffcomp.errors import LimitsError
from ffcomp.inverse.settings import settings_for
from ffcomp.planner.limits import SLOW_RATIOS
from ffcomp.planner.machine_limits import planner_limits
from ffcomp.record.motion import Motion
from ffcomp.record.moves import HIGHEST_HZ, KINDS, LOWEST_HZ, MODES_HZ, Demand
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.kinematics.base import Kinematics
from models.machine import Machine

MOST_EXPERIMENTS, KINDS_AT_A_PLACE = 12, 3
NEAREST_MM, OUT = 40.0, 0.6  # between two places; share of the bed's radius
MARGIN_MM = 22.0  # that the moves need around their place
CARRIAGE_SHARE = 0.5  # of the carriages' limits: motors keep reserves
REST_BEFORE_S, REST_AFTER_S = 1.0, 0.5  # in the capture: gravity and noise; ringing
SETTLE_S = 0.5  # before a capture begins, so that the firmware has time in hand and begins exactly
LONGEST_S = 300.0
TRAVEL_SHARE = 0.2  # of the machine's velocity, between experiments
MOST_ROUNDING = 0.15  # of the command, by microsteps
LOWEST_TOP_HZ = 40.0  # of a multisine, which is narrowed until microsteps do not matter
MOST_PACE = 3.0  # of slow moves, which become faster until then
RATE_HZ = 3200.0

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Request:
    """The requested recording."""

    places_mm: Sequence[Place] = ()  # none: the centre, and three around it
    height_mm: float = 30.0
    seconds: float = 4.0  # of each experiment, about
    repeats: int = 2
    acceleration_mm_per_s2: float | None = None  # of the nozzle; None: the machine file's limit
    seed: int = 1
    kinds: Sequence[str] = tuple(KINDS)


@dataclass(frozen=True, eq=False)
class Experiment:
    """One motion, and where."""

    name: str  # ffcomp-<kind>-<place>
    kind: str
    place: int
    position_mm: tuple[float, float, float]  # of the nozzle at rest
    motion: Motion = field(repr=False)
    rounding: float  # by microsteps, as a share of the command

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.motion.duration_s


@dataclass(frozen=True, eq=False)
class MovesPlan:
    """All experiments of a file, in the order of their first execution."""

    machine: str
    machine_sha256: str
    experiments: tuple[Experiment, ...]
    repeats: int
    rest_before_s: float = REST_BEFORE_S
    rest_after_s: float = REST_AFTER_S
    seed: int = 1
    print_file: str = ""  # the print that is the experiment

    def runs(self) -> list[tuple[Experiment, int]]:
        """List experiment and repeat, from 1, in the order of the file: a repeat follows when all were made once."""
        return [(each, repeat) for repeat in range(1, self.repeats + 1) for each in self.experiments]

    @property
    def duration_s(self) -> float:
        """From the first experiment to the end of the last one, without homing and travel."""
        resting = self.rest_before_s + self.rest_after_s + SETTLE_S
        return self.repeats * sum(each.duration_s + resting for each in self.experiments)


def make_plan(machine: Machine, request: Request) -> MovesPlan:
    """Choose and check the experiments.

    Raises
    ------
    LimitsError
        For places out of reach or too near to each other, or a file that would take too long.
    """
    places = list(request.places_mm) or default_places(machine)
    _check_places(machine, places, request.height_mm)
    experiments = []
    for kind, place in schedule(len(places), request.kinds):
        x, y = places[place]
        at = np.array([x, y, request.height_mm])
        rng = np.random.default_rng([request.seed, place, list(KINDS).index(kind)])
        motion, rounding = _fitting(machine, kind, at, request, rng)
        _check_reach(machine, f"ffcomp-{kind}-{place}", motion)
        experiments.append(
            Experiment(f"ffcomp-{kind}-{place}", kind, place, (x, y, request.height_mm), motion, rounding)
        )
    plan = MovesPlan(machine.name, machine.sha256, tuple(experiments), request.repeats, seed=request.seed)
    if plan.duration_s > LONGEST_S:
        raise LimitsError(
            f"The file would take {plan.duration_s / 60:.1f} min, and may take {LONGEST_S / 60:.0f}: choose fewer "
            "places (--at), fewer --seconds or fewer --repeats."
        )
    return plan


def default_places(machine: Machine) -> list[Place]:
    """Return the centre and three places around it, 0.6 of the way out; fewer where the bed is small."""
    centre = machine.kinematics.centre_mm
    around = machine.kinematics.around(OUT, MARGIN_MM)[::2]
    chosen: list[Place] = [centre]
    for x, y in np.round(around, 1).tolist():
        if all(np.hypot(x - a, y - b) >= NEAREST_MM for a, b in chosen):
            chosen.append((x, y))
    return chosen


def schedule(places: int, kinds: Sequence[str] = tuple(KINDS)) -> list[tuple[str, int]]:
    """List kind and place of each experiment, at most twelve, every kind about equally often."""
    if places == 1:
        return [(kind, 0) for kind in kinds]
    each = min(KINDS_AT_A_PLACE, len(kinds), MOST_EXPERIMENTS // places)
    if each < 1:
        raise LimitsError(f"There are {places} places, and a file has at most {MOST_EXPERIMENTS} experiments.")
    return [(kinds[(place + k) % len(kinds)], place) for place in range(places) for k in range(each)]


# Checks


def _check_places(machine: Machine, places: Sequence[Place], height_mm: float) -> None:
    for x, y in places:
        try:
            machine.kinematics.check_reach(np.array([[x, y, height_mm]]))
        except UnreachableError as error:
            raise LimitsError(f"The nozzle cannot be moved there: {error}") from error
    for i, (x, y) in enumerate(places):
        for a, b in places[:i]:
            if np.hypot(x - a, y - b) < NEAREST_MM:
                raise LimitsError(
                    f"The places {x:g},{y:g} and {a:g},{b:g} are {np.hypot(x - a, y - b):.0f} mm apart; places are at "
                    f"least {NEAREST_MM:g} mm apart, so that what is found at one can be tested at another."
                )


def _check_reach(machine: Machine, name: str, motion: Motion) -> None:
    xyz = motion.vertices_mm
    try:
        machine.kinematics.check_reach(xyz)
    except UnreachableError as error:
        raise LimitsError(f"{name} leaves the bed: {error} Choose a place farther from its border.") from error
    zones = planner_limits(machine).delta
    radius, widest = float(np.hypot(xyz[:, 0], xyz[:, 1]).max()), zones and zones.radius_of_ratio(SLOW_RATIOS[0][0])
    if widest and radius > widest:
        raise LimitsError(
            f"{name} reaches {radius:.1f} mm from the centre; beyond {widest:.1f} mm a delta's firmware slows down. "
            "Choose a place farther in."
        )


# How hard


def _fitting(
    machine: Machine, kind: str, at: FloatArray, request: Request, rng: np.random.Generator
) -> tuple[Motion, float]:
    """Make a motion whose rounding to microsteps is small: faster, or of fewer high frequencies."""
    demand, seed = _demand(machine, at, request), int(rng.integers(2**31))
    while True:
        motion = KINDS[kind](at, demand, request.seconds, np.random.default_rng(seed))
        top = demand.highest_hz if kind == "multisine" else MODES_HZ
        rounding = rounding_share(motion, machine.kinematics, machine.steps.per_motor, top)
        if rounding <= MOST_ROUNDING or demand.pace > MOST_PACE:
            return motion, rounding
        narrower = max(0.85 * demand.highest_hz, LOWEST_TOP_HZ)
        demand = replace(demand, highest_hz=narrower, pace=1.25 * demand.pace)


def _demand(machine: Machine, at: FloatArray, request: Request) -> Demand:
    """Return what the limits of nozzle and carriages allow at a place (3,) mm."""
    own, output = machine.limits, settings_for(machine).output
    gain = _carriage_gain(machine.kinematics, at)
    rising = own.velocity_mm_per_s if own.z_velocity_mm_per_s is None else own.z_velocity_mm_per_s
    acceleration = min(own.acceleration_mm_per_s2, CARRIAGE_SHARE * own.carriage_acceleration_mm_per_s2 / gain)
    wanted = request.acceleration_mm_per_s2
    if wanted is not None and wanted > acceleration:
        raise LimitsError(
            f"{wanted:g} mm/s² is more than the machine's limits allow at {at[0]:g},{at[1]:g} mm; {acceleration:.0f} "
            "would fit."
        )
    return Demand(
        velocity_mm_per_s=min(own.velocity_mm_per_s, CARRIAGE_SHARE * own.carriage_velocity_mm_per_s / gain),
        acceleration_mm_per_s2=wanted or acceleration,
        corner_mm_per_s=own.square_corner_velocity_mm_per_s,
        z_velocity_mm_per_s=rising if "Z" in machine.kinematics.raisable_axes else 0.0,
        segments=output,
        highest_hz=HIGHEST_HZ,
    )


def _carriage_gain(kinematics: Kinematics, at: FloatArray) -> float:
    """Return the speed of the fastest carriage while the nozzle moves at 1 mm/s in the plane."""
    inverse = np.linalg.inv(kinematics.jacobian(at[None, :2])[0])
    return float(np.linalg.norm(inverse[:, :2], axis=1).max())


def rounding_share(motion: Motion, kinematics: Kinematics, steps_per_mm: FloatArray, highest_hz: float) -> float:
    """Compute the rounding to microsteps as a share of the command, both as accelerations of the motors in a band.

    Motors step when the command crosses half a step.
    """
    t = np.arange(0.0, motion.duration_s, 1 / RATE_HZ)
    motors = kinematics.inverse(motion.nozzle(t)) @ kinematics.motors.T
    rounded = np.rint(motors * steps_per_mm) / steps_per_mm - motors
    frequency = np.fft.rfftfreq(len(t), 1 / RATE_HZ)
    weight = frequency**2 * ((frequency >= LOWEST_HZ) & (frequency <= highest_hz))
    wanted, error = (
        float(np.linalg.norm(weight[:, None] * np.fft.rfft(each * np.hanning(len(t))[:, None], axis=0)))
        for each in (motors - motors.mean(axis=0), rounded)
    )
    return error / wanted
