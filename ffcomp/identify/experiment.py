"""Experiments that a printer runs on itself: G-code that excites it, and an exact record of the command.

Each experiment moves one coordinate from rest to rest, at one place: one carriage alone (A, B, C; the nozzle follows
by forward kinematics) or the nozzle along one axis (x, y, z), which suffices for a cartesian machine. The motion
between the knots, ramps included, follows from the vertices and the limits they are executed under (`ffcomp.planner`),
so the record holds no more than these.

mm, s, mm/s, mm/s²; carriages in the order A, B, C. Times of an experiment begin with its first segment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from ffcomp.errors import LimitsError
from ffcomp.identify.multisine import Band, Excitation, Lines, band, excitation, lines_of
from ffcomp.inverse.settings import settings_for
from ffcomp.planner.limits import SLOW_RATIOS, PlannerLimits
from ffcomp.planner.lookahead import plan_moves
from ffcomp.planner.machine_limits import planner_limits
from ffcomp.planner.segment_timing import SegmentLimits, SegmentSpeeds, segment_speeds
from ffcomp.planner.trajectory import Trajectory
from gcode.emit import F_COUNTS, XYZ_COUNTS
from gcode.program import Moves
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.kinematics.base import Kinematics
from models.machine import Machine

TOWERS, AXES = ("A", "B", "C"), ("x", "y", "z")
ON_TIME_S = 5e-5  # a knot reached later than this demands too much
CLEARANCE_MM = 5.0  # kept between nozzle and bed
LINE_OF_ACTION = 80.0 / 135.0  # of the print radius: where the paper measured, away from each tower
COARSE = 0.25  # a microstep error from which on the user is warned
FEED_COUNTS = 60 * F_COUNTS  # of F, in one mm/s
SHARES = np.geomspace(0.98, 0.02, 80)  # of an amplitude, tried for one that can be executed
SUBSTEPS = 32  # samples per segment where a spectrum is taken


@dataclass(frozen=True, slots=True)
class Peaks:
    """The largest speeds and accelerations of a command, or how large they may be."""

    carriage_velocity_mm_per_s: float
    carriage_acceleration_mm_per_s2: float
    nozzle_velocity_mm_per_s: float
    nozzle_acceleration_mm_per_s2: float
    z_acceleration_mm_per_s2: float  # of the nozzle; a G-code file cannot raise the firmware's own limit


# Without an amplitude from the user, these shares of the machine file's limits: motors keep reserves, the nozzle is
# excited no harder than in a print, and segments that turn back in Z keep their time. With one, only the limits of the
# motors and of the nozzle's speed count, as in compensation.
CONSERVATIVE = Peaks(0.5, 0.25, 0.5, 0.9, 0.2)
HARD = ("carriage_velocity_mm_per_s", "carriage_acceleration_mm_per_s2", "nozzle_velocity_mm_per_s")


@dataclass(frozen=True, slots=True)
class Request:
    """The requested excitation."""

    places_mm: Sequence[tuple[float, float]] = ((0.0, 0.0),)
    height_mm: float = 50.0
    directions: Sequence[str] = TOWERS
    kind: str = "multisine"
    lowest_hz: float = 5.0
    highest_hz: float = 150.0
    period_s: float = 4.0
    periods: int = 6
    realisations: int = 1  # of the random phases
    z_acceleration_mm_per_s2: float | None = None  # the firmware's own limit; None: the machine file's acceleration
    acceleration_mm_per_s2: float | None = None  # peak of what is excited; None: what the limits allow
    segments_per_second: float = 250.0  # or more, if the highest frequency needs them
    seed: int = 1


@dataclass(frozen=True, eq=False)
class Experiment:
    """One motion from rest to rest, as it is executed."""

    name: str  # ffcomp-<direction>-<place>-<realisation>
    direction: str  # A B C: this carriage alone; x y z: the nozzle along this axis
    position_mm: tuple[float, float, float]  # of the nozzle at rest
    band: Band
    marker_knots: int  # segments of the marker, which begins at 0, and of its rest
    first_knot: int  # where the first whole period begins that is not transient
    periods: int
    vertices_mm: FloatArray  # (n + 1, 3) columns X Y Z, as the file states them
    geometry: Kinematics = field(repr=False)
    output: SegmentLimits = field(repr=False)

    @cached_property
    def trajectory(self) -> Trajectory:
        """The nozzle's motion as the firmware executes the segments."""
        return play(self.vertices_mm, self.segment_s, self.output)

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self.trajectory.end_t

    @property
    def segment_s(self) -> float:
        """Time between two knots."""
        return self.band.segment_s

    @property
    def period_s(self) -> float:
        """Period of the excitation."""
        return self.band.period_s

    @property
    def measured_from_s(self) -> float:
        """Start of the first period whose response is periodic; its lines' phases count from here."""
        return float(self.trajectory.start_t[self.first_knot])

    def nozzle(self, t_s: FloatArray) -> FloatArray:
        """Return the nozzle's command at the times (k,) s: (k, 3) mm. It rests before and after."""
        return np.ascontiguousarray(self.trajectory.position(t_s)[:, :3])

    def command(self, t_s: FloatArray) -> FloatArray:
        """Return the carriages' command at the times (k,) s: (k, 3) mm, as executed, between the knots too."""
        return self.geometry.inverse(self.nozzle(t_s))

    @cached_property
    def lines(self) -> Lines:
        """Spectrum of the excited coordinate in one measured period, as it is executed.

        NOTE: between segments the firmware ramps; that lifts the highest lines by up to 15 % over those of straight
        lines between the knots, which were designed.
        """
        return lines_of(self._excited(self.period_times()), self.band)

    def period_times(self) -> FloatArray:
        """Return the times of the first measured period, (k,) s."""
        count = self.band.knots * SUBSTEPS
        return self.measured_from_s + self.period_s / count * np.arange(count, dtype=np.float64)

    def _excited(self, t_s: FloatArray) -> FloatArray:
        """Return the excited coordinate, (k,) mm."""
        if self.direction in TOWERS:
            return self.command(t_s)[:, TOWERS.index(self.direction)]
        return self.nozzle(t_s)[:, AXES.index(self.direction)]

    @cached_property
    def peaks(self) -> Peaks:
        """Largest differences from knot to knot."""
        nozzle, s = self.vertices_mm, self.segment_s
        carriages = self.geometry.inverse(nozzle) @ self.geometry.motors.T
        bends = np.diff(nozzle, 2, axis=0) / s**2
        return Peaks(
            float(np.abs(np.diff(carriages, axis=0)).max()) / s,
            float(np.abs(np.diff(carriages, 2, axis=0)).max()) / s**2,
            float(np.linalg.norm(np.diff(nozzle, axis=0), axis=1).max()) / s,
            float(np.linalg.norm(bends, axis=1).max()),
            float(np.abs(bends[:, 2]).max()),
        )


@dataclass(frozen=True, eq=False)
class Plan:
    """All experiments of a file."""

    machine: str
    machine_sha256: str
    kind: str
    seed: int
    experiments: tuple[Experiment, ...]


def line_of_action(geometry: Kinematics) -> list[tuple[float, float]]:
    """Return places away from each tower through the centre, whole mm: there its carriage's dynamics differ most."""
    reach, towards = geometry.bed_radius_mm, geometry.tower_directions.values()
    places = [np.round(-LINE_OF_ACTION * reach * tower) + 0.0 for tower in towards]
    return [(float(x), float(y)) for x, y in places]


# Making a plan


def make_plan(machine: Machine, request: Request) -> Plan:
    """Design every experiment, and check that the machine can do it.

    Raises
    ------
    LimitsError
        For a motion out of reach, too fast or too hard, with one that would fit.
    """
    wanted = band(request.lowest_hz, request.highest_hz, request.period_s, request.segments_per_second)
    output = _output(machine, request)
    allowed = limits_of(machine, output)
    for x, y in request.places_mm:
        _check_place(machine, x, y, request.height_mm)
    experiments = []
    for place, realisation, direction in _each(request):
        seed = request.seed + realisation
        top_a, top_v = _allowed(machine, request, direction, allowed)
        moved = excitation(request.kind, wanted, request.periods, top_a, top_v, seed)
        x, y = request.places_mm[place]
        name = f"ffcomp-{direction}-{place}-{realisation}"
        made = _experiment(machine, output, name, direction, (x, y, request.height_mm), wanted, moved)
        _check(machine, made, top_a, allowed)
        _check_timing(made, moved.displacement_mm, top_a)
        experiments.append(made)
    return Plan(machine.name, machine.sha256, request.kind, request.seed, tuple(experiments))


def _output(machine: Machine, request: Request) -> SegmentLimits:
    output = settings_for(machine).output
    own = request.z_acceleration_mm_per_s2 or output.z_acceleration_mm_per_s2
    return replace(output, z_acceleration_mm_per_s2=own)


def _each(request: Request) -> list[tuple[int, int, str]]:
    """List place, realisation, direction of every experiment, in the order of the file."""
    places, realisations = range(len(request.places_mm)), range(request.realisations)
    return [(place, r, direction) for place in places for r in realisations for direction in request.directions]


def limits_of(machine: Machine, output: SegmentLimits) -> Peaks:
    """Return the peaks that the machine file allows."""
    own = machine.limits
    return Peaks(
        own.carriage_velocity_mm_per_s,
        own.carriage_acceleration_mm_per_s2,
        own.velocity_mm_per_s,
        own.acceleration_mm_per_s2,
        output.z_acceleration_mm_per_s2,
    )


def _allowed(machine: Machine, request: Request, direction: str, limits: Peaks) -> tuple[float, float]:
    """Return acceleration and velocity of the excited coordinate that suit every position, mm/s² and mm/s."""
    gains = [_gains(machine.kinematics, place, direction) for place in request.places_mm]
    fitting = {
        each.name: min(
            getattr(CONSERVATIVE, each.name) * getattr(limits, each.name) / max(getattr(gain, each.name), 1e-9)
            for gain in gains
        )
        for each in fields(Peaks)
    }
    acceleration = min(value for name, value in fitting.items() if "acceleration" in name)
    velocity = min(value for name, value in fitting.items() if "velocity" in name)
    return request.acceleration_mm_per_s2 or acceleration, velocity


def _gains(geometry: Kinematics, place: tuple[float, float], direction: str) -> Peaks:
    """Return the speeds of carriages and nozzle when the excited coordinate moves at 1 mm/s (Eq. 12: Ẋ = J q̇)."""
    j = geometry.jacobian(np.array([place]))[0]
    if direction in TOWERS:
        carriage, nozzle = 1.0, j[:, TOWERS.index(direction)]
    else:
        nozzle = np.eye(3)[AXES.index(direction)]
        carriage = float(np.abs(np.linalg.solve(j, nozzle)).max())
    length = float(np.linalg.norm(nozzle))
    return Peaks(carriage, carriage, length, length, float(abs(nozzle[2])))


def _experiment(
    machine: Machine,
    output: SegmentLimits,
    name: str,
    direction: str,
    position: tuple[float, float, float],
    wanted: Band,
    moved: Excitation,
) -> Experiment:
    return Experiment(
        name=name,
        direction=direction,
        position_mm=position,
        band=wanted,
        marker_knots=moved.marker_knots,
        first_knot=moved.first_knot,
        periods=moved.periods,
        vertices_mm=_vertices(machine.kinematics, direction, position, moved.displacement_mm),
        geometry=machine.kinematics,
        output=output,
    )


def _vertices(
    geometry: Kinematics, direction: str, position: tuple[float, float, float], displacement: FloatArray
) -> FloatArray:
    """Move one coordinate by (n + 1,) mm: the nozzle's vertices, (n + 1, 3) mm, as the file can state them."""
    rest = np.array([position])
    if direction in TOWERS:
        q = geometry.inverse(rest) + displacement[:, None] * np.eye(3)[TOWERS.index(direction)]
        nozzle = _forward(geometry, q, direction)
    else:
        nozzle = rest + displacement[:, None] * np.eye(3)[AXES.index(direction)]
    nudged = AXES.index("z" if direction in TOWERS else direction)
    return always_moving(np.rint(nozzle * XYZ_COUNTS).astype(np.int64).tolist(), nudged) / XYZ_COUNTS


def _forward(geometry: Kinematics, q: FloatArray, direction: str) -> FloatArray:
    try:
        return geometry.forward(q)
    except UnreachableError as error:
        raise LimitsError(f"Carriage {direction} cannot be moved so far: {error}") from error


def always_moving(counts: list[list[int]], axis: int) -> FloatArray:
    """Make every vertex (n + 1, 3), in counts, differ from the one before.

    A segment that goes nowhere would be left out, and its time lost: its end is moved by one count along an axis.
    """
    for before, here in pairwise(counts):
        if here == before:
            here[axis] += 1
    return np.array(counts, dtype=np.float64)


def play(vertices: FloatArray, segment_s: float, output: SegmentLimits) -> Trajectory:
    """Plan the firmware's motion through (n + 1, 3) mm, every segment meant to last S, with F as it is written.

    Raises
    ------
    LimitsError
        Knots that the firmware's acceleration cannot reach in time.
    """
    n = len(vertices) - 1
    speeds = segment_speeds(vertices, np.zeros(n), np.full(n, segment_s), output)
    written = _as_written(np.linalg.norm(np.diff(vertices, axis=0), axis=1), speeds)
    trajectory = _planned(vertices, written, output)
    late = trajectory.start_t + trajectory.duration - segment_s * np.arange(1, n + 1)
    if np.abs(late).max() > ON_TIME_S:
        raise LimitsError(
            f"Segments of {1e3 * segment_s:.2f} ms would come up to {1e3 * np.abs(late).max():.2f} ms late: the "
            f"firmware's own acceleration in Z, {output.z_acceleration_mm_per_s2:g} mm/s², is too low for them."
        )
    return trajectory


def _planned(vertices: FloatArray, speed: FloatArray, output: SegmentLimits) -> Trajectory:
    """Plan moves through (n + 1, 3) mm at (n,) mm/s, from rest to rest, as the firmware does."""
    n = len(speed)
    places = np.column_stack([vertices, np.zeros(n + 1)])
    own = (np.full(n, np.nan) for _ in range(4))
    moves = Moves(np.arange(n), places[:-1], places[1:], speed, np.zeros(n, dtype=np.int64), *own)
    limits = PlannerLimits(
        velocity_mm_per_s=output.velocity_mm_per_s,
        acceleration_mm_per_s2=output.acceleration_mm_per_s2,
        square_corner_velocity_mm_per_s=output.square_corner_velocity_mm_per_s,
        minimum_cruise_ratio=0.0,
        z_acceleration_mm_per_s2=output.z_acceleration_mm_per_s2,
    )
    return plan_moves(moves, limits, stop_before=np.zeros(n, dtype=np.bool_), wait_before=np.zeros(n))


def _as_written(length: FloatArray, speeds: SegmentSpeeds) -> FloatArray:
    """Round speeds to F, (n,) mm/s: each segment makes up for the delay that rounding gave the one before."""
    late, written = 0.0, []
    columns = (length, speeds.cruise, speeds.acceleration, speeds.duration, speeds.junction[:-1], speeds.junction[1:])
    for d, wanted, a, lasting, before, after in zip(*(column.tolist() for column in columns), strict=True):
        c = max(round(wanted * (1.0 + late / lasting) * FEED_COUNTS), 1) / FEED_COUNTS
        ramps = (c - min(before, c)) ** 2 + (c - min(after, c)) ** 2
        late += (d + ramps / (2.0 * a)) / c - lasting
        written.append(c)
    return np.array(written)


# Checks


def _check_place(machine: Machine, x: float, y: float, z: float) -> None:
    """Check that a place is inside the print volume, and where the firmware does not slow down."""
    try:
        machine.kinematics.check_reach(np.array([[x, y, z]]))
    except UnreachableError as error:
        raise LimitsError(f"The nozzle cannot be excited there: {error}") from error
    widest = _widest(machine)
    if widest is not None and np.hypot(x, y) > widest:
        raise LimitsError(
            f"The place X = {x:g}, Y = {y:g} mm lies {np.hypot(x, y):.1f} mm from the centre; beyond {widest:.1f} mm "
            "a delta's firmware slows down, and segments come too late."
        )


def _widest(machine: Machine) -> float | None:
    """Return the radius within which a delta's firmware keeps every segment's speed, mm; None: no delta."""
    reach = planner_limits(machine).delta
    return None if reach is None else min(reach.radius_of_ratio(SLOW_RATIOS[0][0]), machine.kinematics.bed_radius_mm)


def _check(machine: Machine, made: Experiment, acceleration: float, limits: Peaks) -> None:
    """Check that every vertex is inside, and no peak over its limit."""
    _check_sideways(machine, made)
    z, heights = made.position_mm[2], made.vertices_mm[:, 2]
    lowest, highest, top = float(heights.min()), float(heights.max()), machine.kinematics.height_mm
    if lowest < CLEARANCE_MM or highest > top:
        low, high = z - lowest + CLEARANCE_MM, top - (highest - z)
        raise LimitsError(
            f"{made.name} moves the nozzle between {lowest:.2f} and {highest:.2f} mm above the bed, and may between "
            f"{CLEARANCE_MM:g} and {top:g}; a height from {low:.1f} to {high:.1f} mm would fit."
        )
    for name in HARD:
        peak, limit = getattr(made.peaks, name), getattr(limits, name)
        if peak > limit:
            raise LimitsError(
                f"{made.name}: the {_words(name)} would peak at {peak:.0f}, and may at {limit:.0f}; "
                f"an amplitude of {0.99 * acceleration * limit / peak:.0f} mm/s² would fit."
            )


def _check_sideways(machine: Machine, made: Experiment) -> None:
    xyz, widest = made.vertices_mm, _widest(machine)
    if widest is None:
        try:
            machine.kinematics.check_reach(xyz)
        except UnreachableError as error:
            raise LimitsError(f"{made.name} leaves the bed: {error} Choose a place farther from its border.") from error
        return
    radius = float(np.hypot(xyz[:, 0], xyz[:, 1]).max())
    if radius > widest:
        fits = float(np.hypot(*made.position_mm[:2])) - (radius - widest)
        raise LimitsError(
            f"{made.name} reaches {radius:.2f} mm from the centre, and may reach {widest:.2f}; "
            f"a place not farther out than {fits:.1f} mm would fit."
        )


def _check_timing(made: Experiment, displacement: FloatArray, acceleration: float) -> None:
    """Check that every segment can be executed in its time."""
    try:
        _ = made.trajectory
    except LimitsError as error:
        share = _feasible_share(made, displacement)
        raise LimitsError(f"{made.name}: {error} An amplitude of {share * acceleration:.0f} mm/s² would fit.") from None


def _feasible_share(made: Experiment, displacement: FloatArray) -> float:
    for share in SHARES.tolist():
        vertices = _vertices(made.geometry, made.direction, made.position_mm, share * displacement)
        try:
            play(vertices, made.segment_s, made.output)
        except LimitsError:
            continue
        return float(share)
    return 0.0


def _words(name: str) -> str:
    """Put `nozzle_velocity_mm_per_s` in plain words."""
    what, _, unit = name.partition("_mm_")
    return f"{what.replace('_', ' ')} in mm/{unit.removeprefix('per_').replace('s2', 's²')}"


# Microsteps


def microstep_error(made: Experiment, steps_per_mm: FloatArray) -> float:
    """Compute the rounding to microsteps, at the lines of the band's upper half, as a share of the command there.

    Motors step when the command crosses half a step. One measured period is compared with itself, rounded so; it is
    the same in every period, and no averaging takes it away.
    """
    carriages = made.command(made.period_times()) @ made.geometry.motors.T
    moved = carriages - carriages.mean(axis=0)
    rounded = np.rint(carriages * steps_per_mm) / steps_per_mm - carriages
    upper = made.band.lines[len(made.band.lines) // 2 :]
    wanted, error = (np.fft.rfft(each, axis=0)[upper] for each in (moved, rounded))
    largest = int(np.argmax(np.linalg.norm(wanted, axis=0)))
    return float(np.linalg.norm(error[:, largest]) / np.linalg.norm(wanted[:, largest]))
