"""The plan of an identification: each experiment excites one coordinate with a periodic signal, at one place.

One carriage alone moves (A, B, C; the nozzle follows by forward kinematics) or the nozzle along one axis (x, y, z),
which suffices for a cartesian machine. The motion between the knots, ramps included, follows from the vertices and the
limits they are executed under.

mm, s, mm/s, mm/s²; carriages in the order A, B, C. Times of an experiment begin with its first segment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ffcomp.errors import LimitsError
from ffcomp.inverse.settings import settings_for
from ffcomp.planner.segment_timing import SegmentLimits
from ffcomp.record import multisine
from ffcomp.record.moves import check_inside, rounding_share
from ffcomp.record.multisine import Band, always_moving, band
from ffcomp.record.plan import Excitation, Experiment, Motion, Plan, segment_motion
from gcode.emit import XYZ_COUNTS
from models.arrays import FloatArray
from models.errors import UnreachableError
from models.kinematics.base import Kinematics
from models.machine import Machine

TOWERS, AXES = ("A", "B", "C"), ("x", "y", "z")
CLEARANCE_MM = 5.0  # kept between nozzle and bed
LINE_OF_ACTION = 80.0 / 135.0  # of the print radius: where the paper measured, away from each tower
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
    places = [np.round(-LINE_OF_ACTION * reach * tower) + 0.0 for tower in towards]
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
