"""Moves that are worth recording, and the plan of a diagnosis: which of them are made where.

| kind | what it is | what it shows |
|---|---|---|
| zigzag | hard strokes in all directions | stiffnesses, masses, modes |
| reversals | short, slow strokes to and fro | dry friction, backlash |
| loop | polygons at three speeds, rising and sinking where Z is as quick as the rest | damping, delays, geometry |
| multisine | all frequencies of a band at once, along x and y | modes and their damping |

Moves are relative to the place of the experiment, and return to where they began. Each is sampled from a seed, so that
no stretch of it repeats: a capture then fits at one time only. Every place gets three of the four kinds, so that each
kind is made at three places of four: an estimate from some places can then be tested at others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ffcomp.errors import LimitsError
from ffcomp.inverse.settings import settings_for
from ffcomp.planner.limits import SLOW_RATIOS, PlannerLimits, planner_limits
from ffcomp.planner.segment_timing import SegmentLimits
from ffcomp.record.multisine import Band, always_moving, band, scaled, smooth_step
from ffcomp.record.plan import Experiment, Motion, Plan, plain_motion, segment_motion
from gcode.emit import F_COUNTS, XYZ_COUNTS
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.kinematics.base import Kinematics
from models.machine import Machine

STROKE_MM = (3.0, 14.0)  # of a zigzag
SHORT_MM = (1.0, 4.0)  # of slow reversals
SLOW_MM_PER_S, SLOW_MM_PER_S2 = (12.0, 40.0), 3000.0
ANGLES = (0.0, 90.0, 45.0, 135.0)  # degrees: along x, along y, both
LOOP_RADIUS_MM, CHORD_MM = 10.0, 5.0  # polygons: at every corner the speed changes
LOOP_SPEEDS = (0.2, 0.35, 0.5)  # of the velocity limit
LOOP_SHARE = 0.8  # of the acceleration limit, towards the centre
RISE_MM, RISE_SHARE = 6.0, 0.5  # of a loop; of the velocity limit in Z
MODES_HZ = 80.0  # below which the main modes of printers lie: there rounding to microsteps is compared
LOWEST_HZ, HIGHEST_HZ, PERIOD_S = 4.0, 100.0, 2.0  # of a multisine
AXIS_SHARE = 0.85  # of what the nozzle may, along x and along y: their peaks hardly ever meet
FADE_S = 0.4

MOST_EXPERIMENTS, KINDS_AT_A_PLACE = 12, 3
NEAREST_MM, PLACE_RADIUS_SHARE = 40.0, 0.6  # between two places; of the bed's radius
MARGIN_MM = 22.0  # that the moves need around their place
CARRIAGE_SHARE = 0.5  # of the carriages' limits: motors keep reserves
LONGEST_S = 300.0
MOST_ROUNDING = 0.15  # of the command, by microsteps
LOWEST_TOP_HZ = 40.0  # of a multisine, which is narrowed until microsteps do not matter
MOST_PACE = 3.0  # of slow moves, which become faster until then
RATE_HZ = 3200.0

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Demand:
    """How hard a place may be excited."""

    velocity_mm_per_s: float
    acceleration_mm_per_s2: float
    corner_mm_per_s: float
    z_velocity_mm_per_s: float  # zero: Z is left alone
    segments: SegmentLimits  # of the multisine
    highest_hz: float = HIGHEST_HZ  # of the multisine
    pace: float = 1.0  # of slow reversals and loops, times their usual speed


MoveFunction = Callable[[FloatArray, Demand, float, np.random.Generator], Motion]


def zigzag(place_mm: FloatArray, demand: Demand, seconds: float, rng: np.random.Generator) -> Motion:
    """Make hard strokes of all lengths and directions around a place (3,) mm."""
    limits = _limits(demand, demand.acceleration_mm_per_s2)
    speeds = demand.velocity_mm_per_s * np.array([0.3, 0.6])
    return _strokes(place_mm, limits, STROKE_MM, (float(speeds[0]), float(speeds[1])), seconds, rng)


def reversals(place_mm: FloatArray, demand: Demand, seconds: float, rng: np.random.Generator) -> Motion:
    """Make slow strokes to and fro around a place (3,) mm: many reversals, little vibration."""
    limits = _limits(demand, min(demand.acceleration_mm_per_s2, SLOW_MM_PER_S2))
    slow, fast = demand.pace * np.array(SLOW_MM_PER_S)
    top = float(min(fast, 0.5 * demand.velocity_mm_per_s))
    return _strokes(place_mm, limits, SHORT_MM, (float(min(slow, top)), top), seconds, rng)


def _strokes(
    place_mm: FloatArray,
    limits: PlannerLimits,
    length_mm: tuple[float, float],
    speed: tuple[float, float],
    seconds: float,
    rng: np.random.Generator,
) -> Motion:
    """Sample strokes until the time is over; a stroke that would lead far away turns round."""
    at, spent, vertices = np.zeros(2), 0.0, [np.zeros(2)]
    speeds: list[float] = []
    while spent < seconds:
        length, v = np.exp(rng.uniform(*np.log(length_mm))), rng.uniform(*speed)
        angle = np.deg2rad(ANGLES[len(speeds) % len(ANGLES)] + 180.0 * rng.integers(2))
        step = length * np.array([np.cos(angle), np.sin(angle)])
        if np.linalg.norm(at + step) > length_mm[1]:
            step = -step
        at = at + step if np.linalg.norm(at + step) <= length_mm[1] else np.zeros(2)
        way = float(np.linalg.norm(at - vertices[-1]))  # from rest to rest
        top = min(v, float(np.sqrt(way * limits.acceleration_mm_per_s2)))
        spent += way / max(top, 1e-9) + top / limits.acceleration_mm_per_s2
        vertices.append(at)
        speeds.append(v)
    xy = np.array([*vertices, np.zeros(2)])
    return _rounded_motion(place_mm, np.column_stack([xy, np.zeros(len(xy))]), [*speeds, speeds[-1]], limits)


def loop(place_mm: FloatArray, demand: Demand, seconds: float, rng: np.random.Generator) -> Motion:
    """Draw polygons through a place (3,) mm, each faster than the one before; to one side, then to the other."""
    limits = _limits(demand, demand.acceleration_mm_per_s2)
    fastest = float(np.sqrt(LOOP_SHARE * demand.acceleration_mm_per_s2 * LOOP_RADIUS_MM))
    points, speeds, spent, side = [np.zeros((1, 3))], [], 0.0, 1.0
    while spent < seconds:
        for share in LOOP_SPEEDS:
            v = min(share * demand.pace * demand.velocity_mm_per_s, share / LOOP_SPEEDS[-1] * fastest)
            v *= rng.uniform(0.9, 1.0)
            turn = np.linspace(0.0, 2 * np.pi, round(2 * np.pi * LOOP_RADIUS_MM / CHORD_MM) + 1)[1:]
            lasting = 2 * np.pi * LOOP_RADIUS_MM / v
            rise = min(RISE_MM, RISE_SHARE * demand.z_velocity_mm_per_s * lasting / np.pi)
            x, y = LOOP_RADIUS_MM * np.sin(turn), side * LOOP_RADIUS_MM * (1 - np.cos(turn))
            points.append(np.column_stack([x, y, 0.5 * rise * (1 - np.cos(turn))]))
            speeds += [v] * len(turn)
            spent += lasting
            side = -side
            if spent >= seconds:
                break
    return _rounded_motion(place_mm, np.vstack(points), speeds, limits)


def multisine(place_mm: FloatArray, demand: Demand, seconds: float, rng: np.random.Generator) -> Motion:
    """Excite a band of frequencies along x and y at once, with phases of their own."""
    spectrum_band = band(LOWEST_HZ, demand.highest_hz, PERIOD_S)
    waves = [
        scaled(
            spectrum_band,
            AXIS_SHARE * demand.acceleration_mm_per_s2,
            AXIS_SHARE * demand.velocity_mm_per_s,
            seed,
        )
        for seed in rng.integers(1, 2**31, 2).tolist()
    ]
    xy = np.column_stack([_faded(wave, spectrum_band, seconds) for wave in waves])
    counts = np.rint((place_mm + np.column_stack([xy, np.zeros(len(xy))])) * XYZ_COUNTS).astype(np.int64)
    vertices = always_moving(counts.tolist(), axis=0) / XYZ_COUNTS
    return segment_motion(vertices, spectrum_band.segment_s, demand.segments)


def _faded(wave: FloatArray, spectrum_band: Band, seconds: float) -> FloatArray:
    """Repeat a period (k,) mm for so long, from zero to zero: (n + 1,) mm."""
    n = round(seconds / spectrum_band.segment_s)
    t = spectrum_band.segment_s * np.arange(n + 1, dtype=np.float64)
    window = smooth_step(t / FADE_S) * smooth_step((t[-1] - t) / FADE_S)
    return np.asarray(window * wave[np.arange(n + 1) % len(wave)])


KINDS: Mapping[str, MoveFunction] = {"zigzag": zigzag, "reversals": reversals, "loop": loop, "multisine": multisine}


def _limits(demand: Demand, acceleration: float) -> PlannerLimits:
    return PlannerLimits(
        velocity_mm_per_s=demand.velocity_mm_per_s,
        acceleration_mm_per_s2=acceleration,
        square_corner_velocity_mm_per_s=demand.corner_mm_per_s,
        minimum_cruise_ratio=0.0,
    )


def _rounded_motion(
    place_mm: FloatArray, relative_mm: FloatArray, speeds: list[float], limits: PlannerLimits
) -> Motion:
    """Make the motion through (n + 1, 3) mm around a place as the file can state it."""
    vertices = np.asarray(np.rint((place_mm + relative_mm) * XYZ_COUNTS) / XYZ_COUNTS)
    moving = np.append(True, np.any(np.diff(vertices, axis=0) != 0.0, axis=1))
    f = np.rint(np.array(speeds) * 60 * F_COUNTS) / (60 * F_COUNTS)
    return plain_motion(vertices[moving], f[moving[1:]], limits)


# The plan


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


def make_plan(machine: Machine, request: Request) -> Plan:
    """Choose and check the experiments.

    Raises LimitsError for places out of reach or too near to each other, or a file that would take too long.
    """
    places = list(request.places_mm) or default_places(machine)
    _check_places(machine, places, request.height_mm)
    experiments = []
    for kind, place in schedule(len(places), request.kinds):
        x, y = places[place]
        at = np.array([x, y, request.height_mm])
        rng = np.random.default_rng([request.seed, place, list(KINDS).index(kind)])
        motion, rounding = _fitting(machine, kind, at, request, rng)
        check_inside(machine, f"ffcomp-{kind}-{place}", motion.vertices_mm)
        experiments.append(
            Experiment(f"ffcomp-{kind}-{place}", kind, place, (x, y, request.height_mm), motion, rounding)
        )
    plan = Plan(machine.name, machine.sha256, tuple(experiments), request.repeats, seed=request.seed)
    if plan.duration_s > LONGEST_S:
        raise LimitsError(
            f"The file would take {plan.duration_s / 60:.1f} min, and may take {LONGEST_S / 60:.0f}: choose fewer "
            "places (--at), fewer --seconds or fewer --repeats."
        )
    return plan


def default_places(machine: Machine) -> list[Place]:
    """Return the centre and three places around it, 0.6 of the way out; fewer where the bed is small."""
    centre = machine.kinematics.centre_mm
    around = machine.kinematics.around(PLACE_RADIUS_SHARE, MARGIN_MM)[::2]
    chosen: list[Place] = [centre]
    for x, y in np.round(around, 1).tolist():
        if all(np.hypot(x - a, y - b) >= NEAREST_MM for a, b in chosen):
            chosen.append((x, y))
    return chosen


def schedule(places: int, kinds: Sequence[str]) -> list[tuple[str, int]]:
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
        check_inside(machine, f"The place {x:g},{y:g}", np.array([[x, y, height_mm]]))
    for i, (x, y) in enumerate(places):
        for a, b in places[:i]:
            if np.hypot(x - a, y - b) < NEAREST_MM:
                raise LimitsError(
                    f"The places {x:g},{y:g} and {a:g},{b:g} are {np.hypot(x - a, y - b):.0f} mm apart; places are at "
                    f"least {NEAREST_MM:g} mm apart, so that estimates from one can be tested at another."
                )


def check_inside(machine: Machine, name: str, xyz: FloatArray) -> None:
    """Raise LimitsError for points (n, 3) mm outside the print volume, or where a delta's firmware slows down."""
    zones, radius = planner_limits(machine).delta, float(np.hypot(xyz[:, 0], xyz[:, 1]).max())
    if zones is not None:
        widest = min(zones.radius_of_ratio(SLOW_RATIOS[0][0]), machine.kinematics.bed_radius_mm)
        if radius > widest:
            raise LimitsError(
                f"{name} reaches {radius:.1f} mm from the centre; this delta's firmware keeps its speed up to "
                f"{widest:.1f} mm. Choose a place {radius - widest + 0.1:.1f} mm farther in."
            )
    try:
        machine.kinematics.check_reach(xyz)
    except UnreachableError as error:
        raise LimitsError(f"{name} leaves the bed: {error} Choose a place farther inside.") from error


# How hard


def _fitting(
    machine: Machine, kind: str, at: FloatArray, request: Request, rng: np.random.Generator
) -> tuple[Motion, float]:
    """Sample a motion whose rounding to microsteps is small: faster, or of fewer high frequencies."""
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
    limits, output = machine.limits, settings_for(machine).output
    gain = carriage_gain(machine.kinematics, at)
    rising = limits.velocity_mm_per_s if limits.z_velocity_mm_per_s is None else limits.z_velocity_mm_per_s
    acceleration = min(limits.acceleration_mm_per_s2, CARRIAGE_SHARE * limits.carriage_acceleration_mm_per_s2 / gain)
    requested = request.acceleration_mm_per_s2
    if requested is not None and requested > acceleration:
        raise LimitsError(
            f"{requested:g} mm/s² is more than the machine's limits allow at {at[0]:g},{at[1]:g} mm; "
            f"{acceleration:.0f} would fit."
        )
    return Demand(
        velocity_mm_per_s=min(limits.velocity_mm_per_s, CARRIAGE_SHARE * limits.carriage_velocity_mm_per_s / gain),
        acceleration_mm_per_s2=requested or acceleration,
        corner_mm_per_s=limits.square_corner_velocity_mm_per_s,
        z_velocity_mm_per_s=rising if "Z" in machine.kinematics.raisable_axes else 0.0,
        segments=output,
        highest_hz=HIGHEST_HZ,
    )


def carriage_gain(kinematics: Kinematics, at: FloatArray) -> float:
    """Return the speed of the fastest carriage while the nozzle moves at 1 mm/s in the plane."""
    inverse = np.linalg.inv(kinematics.jacobian(at[None, :2])[0])
    return float(np.linalg.norm(inverse[:, :2], axis=1).max())


def rounding_share(motion: Motion, kinematics: Kinematics, steps_per_mm: FloatArray, highest_hz: float) -> float:
    """Compute the rounding to microsteps as a share of the command, both as accelerations of the motors in a band."""
    t = np.arange(0.0, motion.duration_s, 1 / RATE_HZ)
    motors = kinematics.inverse(motion.nozzle(t)) @ kinematics.motors.T
    rounded = np.rint(motors * steps_per_mm) / steps_per_mm  # motors step when the command crosses half a step
    frequency = np.fft.rfftfreq(len(t), 1 / RATE_HZ)
    weight = frequency**2 * ((frequency >= LOWEST_HZ) & (frequency <= highest_hz))
    command, error = (
        float(np.linalg.norm(weight[:, None] * np.fft.rfft(each * np.hanning(len(t))[:, None], axis=0)))
        for each in (motors - motors.mean(axis=0), rounded - motors)
    )
    return error / command
