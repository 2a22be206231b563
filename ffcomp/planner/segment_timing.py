"""The firmware's execution of our G1 segments, in closed form.

A segment of length d must last S seconds. The firmware enters it at the junction speed, ramps at its acceleration to
the segment's own speed c (its F), and ramps down to the next junction. Distance d in time S needs

    d = c S − [(c − v₀)² + (c − v₁)²] / 2a                     v₀, v₁ <= c the junction speeds, a the acceleration

which is a quadratic in c: with F = 60 c every duration comes out exact. Junction speeds follow the firmware's own rules
(Klipper and Kalico: the smaller of both speeds, the junction deviation, the centripetal and the extruder limit).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ffcomp.planner.lookahead import corner_v2
from models.arrays import FloatArray
from models.compiled import kernel

SWEEPS = 12  # at most, of the fixed point between neighbouring speeds; it contracts by about Δv/(a S), 0.1 or less
SETTLED_MM_PER_S = 1e-9  # a smaller change of a junction does not affect its segments


@dataclass(frozen=True, slots=True)
class SegmentLimits:
    """The limits under which our segments are executed: the header opens them, the footer closes them."""

    velocity_mm_per_s: float = 1000.0
    acceleration_mm_per_s2: float = 100_000.0
    square_corner_velocity_mm_per_s: float = 100.0
    z_acceleration_mm_per_s2: float = 10_000.0  # the printer's own: a G-code file cannot raise it
    retract_acceleration_mm_per_s2: float = 2600.0  # of the filament, on moves that pull it back; the printer's own
    raised_axes: str = "XYZ"  # whose limits the header opens where firmware has one for each: no lead screw's


class SegmentSpeeds(NamedTuple):
    """Speeds of n segments as the firmware will execute them."""

    cruise: FloatArray  # (n,) mm/s: requested by F
    junction: FloatArray  # (n + 1,) mm/s
    acceleration: FloatArray  # (n,) mm/s²
    duration: FloatArray  # (n,) s; S wherever the acceleration allows it


class TimedSegments(NamedTuple):
    """Segments of uneven lengths, each from when it is due."""

    due: FloatArray  # (n + 1,) s, rising
    vertices: FloatArray  # (n + 1, 3) mm
    speeds: SegmentSpeeds

    def part(self, first: int, last: int) -> TimedSegments:
        """Return the segments from one to before another."""
        s = self.speeds
        speeds = SegmentSpeeds(
            s.cruise[first:last], s.junction[first : last + 1], s.acceleration[first:last], s.duration[first:last]
        )
        return TimedSegments(self.due[first : last + 1], self.vertices[first : last + 1], speeds)

    def positions(self, times: FloatArray) -> FloatArray:
        """Return where the firmware is at times (m,) s, rising, (m, 3) mm; outside the segments, at their ends."""
        return _positions(*self, times)


def segment_speeds(
    vertices: FloatArray, extrusion: FloatArray, lasting: FloatArray, limits: SegmentLimits
) -> SegmentSpeeds:
    """Choose the speeds that make each segment last as long as it should, from rest to rest.

    Parameters
    ----------
    vertices : (n + 1, 3) mm, columns X Y Z
    extrusion : (n,) mm of filament in each segment
    lasting : (n,) s, the S of each segment
    """
    along = limits.acceleration_mm_per_s2, limits.square_corner_velocity_mm_per_s, limits.velocity_mm_per_s
    of_axes = limits.z_acceleration_mm_per_s2, limits.retract_acceleration_mm_per_s2
    return SegmentSpeeds(*_played(vertices, extrusion, lasting, *along, *of_axes))


def sample_even_segments(
    vertices: FloatArray, extrusion: FloatArray, lasting_s: float, limits: SegmentLimits, substeps: int
) -> FloatArray:
    """Sample segments that all last the same time: `segment_speeds`, then `sample_segments`."""
    speeds = segment_speeds(vertices, extrusion, np.full(len(vertices) - 1, lasting_s), limits)
    return sample_segments(vertices, speeds, substeps)


@kernel
def _played(
    vertices: FloatArray, extrusion: FloatArray, lasting: FloatArray,
    acceleration: float, corner_v: float, top_v: float, z_acceleration: float, retract_acceleration: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    n = len(vertices) - 1
    d = np.empty(n)
    a = np.empty(n)
    unit = np.zeros((n, 3))
    ratio = np.zeros(n)
    for k in range(n):
        dx = vertices[k + 1, 0] - vertices[k, 0]
        dy = vertices[k + 1, 1] - vertices[k, 1]
        dz = vertices[k + 1, 2] - vertices[k, 2]
        d[k] = np.sqrt(dx * dx + dy * dy + dz * dz)
        a[k] = acceleration
        if d[k] > 1e-9:
            unit[k, 0], unit[k, 1], unit[k, 2] = dx / d[k], dy / d[k], dz / d[k]
            ratio[k] = extrusion[k] / d[k]
            if abs(dz) > 1e-12:
                a[k] = min(a[k], z_acceleration * d[k] / abs(dz))
            if ratio[k] < 0.0:
                a[k] = min(a[k], -retract_acceleration / ratio[k])
    limit = _junction_limits(d, a, unit, ratio, corner_v**2 * (np.sqrt(2.0) - 1.0) / acceleration)
    cruise, junction = _settle(d, lasting, a, limit, top_v)
    duration = lasting.copy()
    for k in range(n):
        c = cruise[k]
        if c > 0.0:
            v0, v1 = min(junction[k], c), min(junction[k + 1], c)
            duration[k] = (d[k] + ((c - v0) ** 2 + (c - v1) ** 2) / (2 * a[k])) / c
    return cruise, junction, a, duration


@kernel
def _settle(
    d: FloatArray, lasting: FloatArray, a: FloatArray, limit: FloatArray, top_v: float
) -> tuple[FloatArray, FloatArray]:
    """Each segment's speed (n,) and the junctions' (n + 1,) that agree with each other, mm/s."""
    n = len(d)
    cruise = d / lasting
    junction = np.zeros(n + 1)
    stale = np.ones(n, dtype=np.bool_)  # segments with a junction that has moved
    for _ in range(SWEEPS):
        for k in range(1, n):
            v = min(limit[k], cruise[k - 1], cruise[k])
            if abs(v - junction[k]) > SETTLED_MM_PER_S:
                junction[k] = v
                stale[k - 1] = stale[k] = True
        if not stale.any():
            break
        for k in range(n):
            if stale[k]:
                cruise[k] = min(top_v, _speed(d[k], lasting[k], a[k], junction[k], junction[k + 1]))
                stale[k] = False
    return cruise, junction


@kernel
def _speed(d: float, t: float, a: float, v0: float, v1: float) -> float:
    """Return c of the module's docstring; where the ramps cannot make it in time, the fastest there is."""
    if d <= 1e-9:
        return 0.0
    b = t + (v0 + v1) / a
    root = b * b - 4.0 / a * (d + (v0 * v0 + v1 * v1) / (2.0 * a))
    return 0.5 * a * (b - np.sqrt(root)) if root > 0.0 else np.sqrt(a * d + 0.5 * (v0 * v0 + v1 * v1))


@kernel
def _junction_limits(d: FloatArray, a: FloatArray, unit: FloatArray, ratio: FloatArray, deviation: float) -> FloatArray:
    """Return the largest speed at each junction, mm/s: by its angle and by the extruder's jump."""
    n = len(d)
    limit = np.zeros(n + 1)
    for k in range(1, n):
        if d[k] <= 1e-9 or d[k - 1] <= 1e-9:
            continue
        dot = unit[k, 0] * unit[k - 1, 0] + unit[k, 1] * unit[k - 1, 1] + unit[k, 2] * unit[k - 1, 2]
        by_deviation, by_length = deviation * min(a[k], a[k - 1]), min(d[k] * a[k], d[k - 1] * a[k - 1])
        v2 = corner_v2(dot, by_deviation, by_length, abs(ratio[k] - ratio[k - 1]))
        limit[k] = np.sqrt(v2)
    return limit


@kernel
def _point(vertices: FloatArray, speeds: SegmentSpeeds, k: int, t: float) -> tuple[float, float, float]:
    """Return where the nozzle is, mm, so long after segment k has begun."""
    c, a, left = speeds.cruise[k], speeds.acceleration[k], speeds.duration[k] - t
    v0, v1 = min(speeds.junction[k], c), min(speeds.junction[k + 1], c)
    x, y, z = vertices[k, 0], vertices[k, 1], vertices[k, 2]
    dx, dy, dz = vertices[k + 1, 0] - x, vertices[k + 1, 1] - y, vertices[k + 1, 2] - z
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    t_up, t_down = (c - v0) / a, (c - v1) / a
    if t < t_up:
        way = v0 * t + 0.5 * a * t * t
    elif left < t_down:
        way = length - v1 * left - 0.5 * a * left * left
    else:
        way = v0 * t_up + 0.5 * a * t_up * t_up + c * (t - t_up)
    f = (1.0 / length if length > 0.0 else 0.0) * way
    return x + f * dx, y + f * dy, z + f * dz


@kernel
def _positions(due: FloatArray, vertices: FloatArray, speeds: SegmentSpeeds, times: FloatArray) -> FloatArray:
    k, out = 0, np.empty((len(times), 3))
    for i in range(len(times)):
        while k < len(due) - 2 and times[i] >= due[k + 1]:
            k += 1
        t = min(max(times[i] - due[k], 0.0), speeds.duration[k])
        out[i, 0], out[i, 1], out[i, 2] = _point(vertices, speeds, k, t)
    return out


@kernel
def sample_segments(vertices: FloatArray, speeds: SegmentSpeeds, substeps: int) -> FloatArray:
    """Sample the nozzle command at `substeps` equal parts of every segment, ramps included: (n·substeps + 1, 3) mm."""
    n = len(speeds.cruise)
    out = np.empty((n * substeps + 1, 3))
    for row in range(n * substeps):
        k, t = row // substeps, speeds.duration[row // substeps] * (row % substeps) / substeps
        out[row, 0], out[row, 1], out[row, 2] = _point(vertices, speeds, k, t)
    for i in range(3):
        out[n * substeps, i] = vertices[n, i]
    return out
