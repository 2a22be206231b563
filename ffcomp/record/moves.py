"""Moves that are worth recording: each shows something that the others do not, and all return to where they began.

| kind | what it is | what it shows |
|---|---|---|
| zigzag | hard strokes in all directions | stiffnesses, masses, modes |
| reversals | short, slow strokes to and fro | dry friction, backlash |
| loop | polygons at three speeds, rising and sinking where Z is as quick as the rest | damping, delays, geometry |
| multisine | all frequencies of a band at once, along x and y | modes and their damping |

Positions are relative to the place of the experiment. Each is drawn from a seed, so that no stretch of it repeats: a
capture then fits at one time only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ffcomp.identify.experiment import always_moving, play
from ffcomp.identify.multisine import Band, band, scaled, smooth_step
from ffcomp.planner.limits import PlannerLimits
from ffcomp.planner.segment_timing import SegmentLimits
from ffcomp.record.motion import Motion, plain_motion
from gcode.emit import F_COUNTS, XYZ_COUNTS
from models.arrays import FloatArray

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
FADE_S, SEGMENTS_PER_SECOND = 0.4, 250.0


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


Maker = Callable[[FloatArray, Demand, float, np.random.Generator], Motion]


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
    """Draw strokes until the time is over; a stroke that would lead far away turns round."""
    at, spent, vertices = np.zeros(2), 0.0, [np.zeros(2)]
    speeds: list[float] = []
    while spent < seconds:
        length, v = np.exp(rng.uniform(*np.log(length_mm))), rng.uniform(*speed)
        angle = np.deg2rad(ANGLES[len(speeds) % len(ANGLES)] + 180.0 * rng.integers(2))
        step = length * np.array([np.cos(angle), np.sin(angle)])
        if np.linalg.norm(at + step) > length_mm[1]:
            step = -step
        at = at + step if np.linalg.norm(at + step) <= length_mm[1] else np.zeros(2)
        spent += _stroke_s(float(np.linalg.norm(at - vertices[-1])), v, limits.acceleration_mm_per_s2)
        vertices.append(at)
        speeds.append(v)
    xy = np.array([*vertices, np.zeros(2)])
    return _made(place_mm, np.column_stack([xy, np.zeros(len(xy))]), [*speeds, speeds[-1]], limits)


def _stroke_s(length: float, speed: float, acceleration: float) -> float:
    """Time of a stroke from rest to rest."""
    top = min(speed, float(np.sqrt(length * acceleration)))
    return length / max(top, 1e-9) + top / acceleration


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
    return _made(place_mm, np.vstack(points), speeds, limits)


def multisine(place_mm: FloatArray, demand: Demand, seconds: float, rng: np.random.Generator) -> Motion:
    """Excite a band of frequencies along x and y at once, with phases of their own."""
    wanted = band(LOWEST_HZ, demand.highest_hz, PERIOD_S, SEGMENTS_PER_SECOND)
    waves = [
        scaled(
            "multisine", wanted, AXIS_SHARE * demand.acceleration_mm_per_s2, AXIS_SHARE * demand.velocity_mm_per_s, seed
        )
        for seed in rng.integers(1, 2**31, 2).tolist()
    ]
    xy = np.column_stack([_faded(wave, wanted, seconds) for wave in waves])
    counts = np.rint((place_mm + np.column_stack([xy, np.zeros(len(xy))])) * XYZ_COUNTS).astype(np.int64)
    vertices = always_moving(counts.tolist(), axis=0) / XYZ_COUNTS
    trajectory = play(vertices, wanted.segment_s, demand.segments)
    limits = PlannerLimits(
        velocity_mm_per_s=demand.segments.velocity_mm_per_s,
        acceleration_mm_per_s2=demand.segments.acceleration_mm_per_s2,
        square_corner_velocity_mm_per_s=demand.segments.square_corner_velocity_mm_per_s,
        minimum_cruise_ratio=0.0,
        z_acceleration_mm_per_s2=demand.segments.z_acceleration_mm_per_s2,
    )
    return plain_motion(vertices, np.asarray(trajectory.cruise_v), limits)


def _faded(wave: FloatArray, wanted: Band, seconds: float) -> FloatArray:
    """Repeat a period (k,) mm for so long, from zero to zero: (n + 1,) mm."""
    n = round(seconds / wanted.segment_s)
    t = wanted.segment_s * np.arange(n + 1, dtype=np.float64)
    window = smooth_step(t / FADE_S) * smooth_step((t[-1] - t) / FADE_S)
    return np.asarray(window * wave[np.arange(n + 1) % len(wave)])


KINDS: Mapping[str, Maker] = {"zigzag": zigzag, "reversals": reversals, "loop": loop, "multisine": multisine}


def _limits(demand: Demand, acceleration: float) -> PlannerLimits:
    return PlannerLimits(
        velocity_mm_per_s=demand.velocity_mm_per_s,
        acceleration_mm_per_s2=acceleration,
        square_corner_velocity_mm_per_s=demand.corner_mm_per_s,
        minimum_cruise_ratio=0.0,
    )


def _made(place_mm: FloatArray, relative_mm: FloatArray, speeds: list[float], limits: PlannerLimits) -> Motion:
    """Make the motion through (n + 1, 3) mm around a place as the file can state it."""
    vertices = _counted(place_mm + relative_mm)
    moving = np.append(True, np.any(np.diff(vertices, axis=0) != 0.0, axis=1))
    f = np.rint(np.array(speeds) * 60 * F_COUNTS) / (60 * F_COUNTS)
    return plain_motion(vertices[moving], f[moving[1:]], limits)


def _counted(vertices: FloatArray) -> FloatArray:
    """Round (n + 1, 3) mm to the decimals of the file."""
    return np.asarray(np.rint(vertices * XYZ_COUNTS) / XYZ_COUNTS)
