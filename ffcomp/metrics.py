"""Contour error, tracking error, delay and command effort of a motion; the only place that builds a TRACK.

Contour error is the distance from the nozzle to the reference path, wherever on it the nozzle should be; it is what a
print shows. Tracking error compares at equal times. Lengths in mm and times in s; `Track` has units in its names.

Distances are taken to the path's *segments*: distances to sampled points would put a floor of several µm under every
figure. A reference path of straight moves is given by its corners, once each.

Where neither clock can be trusted, `progress_in_order` computes how far along a path each point is and keeps the order:
the nearest segment of the path may belong to a line that crosses, runs parallel, or returns a layer later. All points
are assigned to pieces of the path in one go and never move backwards (Viterbi's algorithm). The cost is the sum of
squared distances plus a small penalty for each piece that is skipped. Long motions are processed in windows that
overlap by half.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from models.arrays import FloatArray, IntArray
from models.compiled import fast_kernel, kernel

WINDOW_S = 0.05  # a sample belongs to where the path is within this time, not to other lines and layers
LONGEST_DELAY_S = 0.02
EFFORT_SPAN_S = 4e-3  # one segment: a jump of speed at a corner is spread over this time, whatever the sampling
SCAN_SAMPLES = 20_000  # enough to find the best delay to a millisecond
PARABOLAS = np.array([1.0, 0.3, 0.01])  # half their widths, of that millisecond


@dataclass(frozen=True, slots=True)
class Tracking:
    """Errors at equal times; the delay is positive where the actual motion is late."""

    rms_mm: float
    max_mm: float
    delay_s: float
    rms_no_delay_mm: float


@dataclass(frozen=True, slots=True)
class ContourStatistics:
    """Contour error over some samples."""

    rms_um: float
    p99_um: float
    max_um: float


@dataclass(frozen=True, slots=True)
class Track:
    """Evaluation of one motion: the TRACK object of every JSON output."""

    tracking_rms_um: float  # nozzle against plan at equal times, root mean square
    tracking_max_um: float  # its maximum
    contour_rms_um: float  # distance to the reference path's segments, root mean square: what a print shows
    contour_p99_um: float  # 99 % of the samples are closer
    contour_max_um: float  # the maximum
    delay_s: float  # mean lag of the nozzle
    tracking_rms_no_delay_um: float  # tracking error after that lag is removed
    print_time_s: float  # of the part that was evaluated
    # the highest acceleration commanded to a carriage: change of its velocity over one segment's time
    peak_command_acceleration_mm_per_s2: float


def build_track(
    at_equal_times: Tracking, contour_mm: FloatArray, print_time_s: float, peak_command_acceleration: float
) -> Track:
    """Build the TRACK of one motion from `tracking`, `contour_error`, mm, and the accelerations of `peaks`, mm/s²."""
    contour = contour_statistics(contour_mm)
    return Track(
        tracking_rms_um=at_equal_times.rms_mm * 1e3,
        tracking_max_um=at_equal_times.max_mm * 1e3,
        contour_rms_um=contour.rms_um,
        contour_p99_um=contour.p99_um,
        contour_max_um=contour.max_um,
        delay_s=at_equal_times.delay_s,
        tracking_rms_no_delay_um=at_equal_times.rms_no_delay_mm * 1e3,
        print_time_s=print_time_s,
        peak_command_acceleration_mm_per_s2=peak_command_acceleration,
    )


def rms(x: FloatArray) -> float:
    """Return the root mean square of all values; 0 if there are none."""
    return float(np.sqrt(np.mean(x**2))) if x.size else 0.0


# ---- contour -------------------------------------------------------------------------------------


def contour_statistics(contour_mm: FloatArray) -> ContourStatistics:
    """Return rms, 99th percentile and maximum of a contour error, (m,) mm; zeros if there are no samples."""
    if not contour_mm.size:
        return ContourStatistics(0.0, 0.0, 0.0)
    p99 = float(np.percentile(contour_mm, 99))
    return ContourStatistics(rms(contour_mm) * 1e3, p99 * 1e3, float(np.max(contour_mm)) * 1e3)


def contour_error(
    path_t: FloatArray, path_xyz: FloatArray, actual_t: FloatArray, actual_xyz: FloatArray, window_s: float = WINDOW_S
) -> FloatArray:
    """Return the distance : (m,) mm of each sample to the reference segments in progress within ± window_s of its time.

    Parameters
    ----------
    path_t : (n,) array
        Times in s, never falling.
    path_xyz : (n, 3) array
        The path's corners in mm, n ≥ 2. A rest is a corner twice.
    actual_t : (m,) array
        Times in s, in any order.
    actual_xyz : (m, 3) array
        The nozzle in mm.
    window_s : float

    Raises
    ------
    ValueError
        If the path has fewer than two corners, or times that fall.
    """
    near = segments_near(path_t, actual_t, window_s)
    return distance_to_path(np.ascontiguousarray(path_xyz), np.ascontiguousarray(actual_xyz), *near)


def segments_near(path_t: FloatArray, actual_t: FloatArray, window_s: float = WINDOW_S) -> tuple[IntArray, IntArray]:
    """Return the segments low ≤ k < high, (m,) each, that `contour_error` looks at; it has the parameters."""
    if len(path_t) < 2 or np.any(np.diff(path_t) < 0):
        raise ValueError(f"A reference path needs two corners or more, at times that never fall; it has {len(path_t)}.")
    first, last = path_t[:-1], path_t[1:]
    # before the path begins its first segment counts, after its end the last one
    low = np.minimum(np.searchsorted(last, actual_t - window_s, side="left"), len(last) - 1)
    return low, np.maximum(np.searchsorted(first, actual_t + window_s, side="right"), 1)


@fast_kernel
def distance_to_path(path: FloatArray, points: FloatArray, low: IntArray, high: IntArray) -> FloatArray:
    """Return the distance : (m,) of each point to the nearest of its segments low ≤ k < high."""
    out = np.empty(len(points))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        best = np.inf
        for k in range(low[i], high[i]):
            dx, dy, dz = _offset(path, k, x, y, z)
            best = min(best, dx * dx + dy * dy + dz * dz)
        out[i] = np.sqrt(best)
    return out


@fast_kernel
def _offset(path: FloatArray, k: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the vector from segment k to a point; the foot of the perpendicular is clipped to the segment's ends."""
    ux, uy, uz = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1], path[k + 1, 2] - path[k, 2]
    dx, dy, dz = x - path[k, 0], y - path[k, 1], z - path[k, 2]
    length2 = ux * ux + uy * uy + uz * uz
    along = 0.0
    if length2 > 0.0:
        along = min(1.0, max(0.0, (dx * ux + dy * uy + dz * uz) / length2))
    return dx - along * ux, dy - along * uy, dz - along * uz


# ---- tracking ------------------------------------------------------------------------------------


def tracking(reference: FloatArray, actual: FloatArray, dt: float) -> Tracking:
    """Return tracking errors of two motions sampled every dt, and the constant delay that explains most of them.

    The delay τ minimises the mean of |actual(t) - reference(t - τ)|², continuously: the reference is interpolated by
    the cubic through four samples, and rests before its first and after its last one.

    Parameters
    ----------
    reference, actual : (m, 3) arrays
        In mm, m ≥ 4.
    dt : float
        In s.

    Raises
    ------
    ValueError
        If the shapes differ or there are too few samples.
    """
    if reference.shape != actual.shape or len(reference) < 4:
        raise ValueError(f"Motions must match and have four samples: {reference.shape} against {actual.shape}.")
    reference, actual = np.ascontiguousarray(reference), np.ascontiguousarray(actual)
    distance2 = np.sum((actual - reference) ** 2, axis=1)
    now = float(np.mean(distance2))
    delay = _best_delay(reference, actual, dt)
    then = _mean_square(reference, actual, delay / dt, 1)
    if then >= now:  # nothing moves, or no delay helps
        delay, then = 0.0, now
    return Tracking(float(np.sqrt(now)), float(np.sqrt(np.max(distance2))), delay, float(np.sqrt(then)))


def _best_delay(reference: FloatArray, actual: FloatArray, dt: float) -> float:
    """Find the valley by a scan in milliseconds on some samples, then its floor by narrowing parabolas on all."""
    some, longest = 1 + len(reference) // SCAN_SAMPLES, LONGEST_DELAY_S
    grid = np.linspace(-longest, longest, 2 * max(1, round(longest / 1e-3)) + 1)
    delay = float(grid[np.argmin([_mean_square(reference, actual, tau / dt, some) for tau in grid])])
    for width in float(grid[1] - grid[0]) * PARABOLAS:
        before, here, after = (
            _mean_square(reference, actual, (delay + side * width) / dt, 1) for side in (-1.0, 0.0, 1.0)
        )
        bend = before - 2.0 * here + after
        if bend > 0.0:
            delay += width * min(max(0.5 * (before - after) / bend, -1.0), 1.0)
    return delay


@fast_kernel
def _mean_square(reference: FloatArray, actual: FloatArray, shift: float, every: int) -> float:
    """Return the mean of |actual_i - reference(i - shift)|² over every so many i; Lagrange's cubic between samples."""
    total, count, top = 0.0, 0, len(reference) - 1
    for i in range(0, len(reference), every):
        at = min(max(i - shift, 0.0), float(top))
        k = min(max(int(at) - 1, 0), top - 3)
        s = at - k
        w0, w1 = -(s - 1) * (s - 2) * (s - 3) / 6, s * (s - 2) * (s - 3) / 2
        w2, w3 = -s * (s - 1) * (s - 3) / 2, s * (s - 1) * (s - 2) / 6
        for j in range(3):
            there = (
                w0 * reference[k, j] + w1 * reference[k + 1, j] + w2 * reference[k + 2, j] + w3 * reference[k + 3, j]
            )
            total += (actual[i, j] - there) ** 2
        count += 1
    return total / count


def end_to_end(reference: Sequence[FloatArray], actual: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Join sections of two motions, each shifted in space so that the reference has no jump between them.

    Only differences count in a tracking error, and a jump would look like one.

    Parameters
    ----------
    reference, actual : sequences of (k, 3) arrays
        One a section, in mm.

    Returns
    -------
    reference, actual : (m, 3) arrays
    """
    shifts = [np.zeros(3)]
    for before, after in pairwise(reference):
        shifts.append(before[-1] + shifts[-1] - after[0])
    return (
        np.concatenate([part + shift for part, shift in zip(reference, shifts, strict=True)]),
        np.concatenate([part + shift for part, shift in zip(actual, shifts, strict=True)]),
    )


# ---- effort --------------------------------------------------------------------------------------


def peaks(command: FloatArray, dt: float) -> tuple[float, float]:
    """Return the largest speed, mm/s, and acceleration, mm/s², of a command (n, k) mm every dt, in any column.

    Both are differences over EFFORT_SPAN_S. A planner's corner is a jump of speed, whose acceleration has no limit as
    dt goes to zero; over a fixed span it does not depend on how finely the command was sampled.
    """
    n = max(1, round(EFFORT_SPAN_S / dt))
    speed = float(np.abs(command[n:] - command[:-n]).max(initial=0.0)) / (n * dt)
    return speed, peak_acceleration(command, dt)


def peak_acceleration(command: FloatArray, dt: float, span_s: float = EFFORT_SPAN_S) -> float:
    """Return the largest |acceleration| of a command (n, k) mm every dt, mm/s²: second difference over span_s."""
    n = max(1, round(span_s / dt))
    bend = command[2 * n :] - 2 * command[n:-n] + command[: -2 * n]
    return float(np.max(np.abs(bend), initial=0.0)) / (n * dt) ** 2


PIECE_MM = 1.0  # of a path: within one, a point may go back
SKIPPED_MM2 = 0.001  # cost of a mm of the path that no point lies on
WINDOW = 256  # points that are assigned at once; half of them are kept
WINDOW_REACH = 1.5  # times the way of a window's points, that its pieces reach ahead,
WINDOW_REACH_MM = 5.0  # and this much more


def progress_in_order(
    path: FloatArray, points: FloatArray, low: IntArray, high: IntArray
) -> tuple[IntArray, FloatArray]:
    """Return on which segment each point lies, and which share of the segment lies behind it, 0 to 1.

    Parameters
    ----------
    path : (n + 1, 3) array
        The path's corners in mm.
    points : (m, 3) array
        In the order of travel, mm.
    low, high : (m,) arrays
        The segments low ≤ k < high that each point may lie on; neither ever falls.

    Returns
    -------
    (m,) and (m,) arrays
    """
    lengths = np.sqrt((np.diff(path, axis=0) ** 2).sum(axis=1))
    pieces = np.maximum(np.ceil(lengths / PIECE_MM), 1.0).astype(np.int64)
    first = np.concatenate([[0], np.cumsum(pieces)])
    corners = _cut(np.ascontiguousarray(path), pieces)
    along = np.concatenate([[0.0], np.cumsum(np.sqrt((np.diff(corners, axis=0) ** 2).sum(axis=1)))])
    piece, share = _assigned(
        corners, along, np.ascontiguousarray(points), first[low], np.maximum(first[high], first[low] + 1)
    )
    segment = np.searchsorted(first, piece, side="right") - 1
    return segment, (piece - first[segment] + share) / pieces[segment]


@kernel
def _cut(path: FloatArray, pieces: IntArray) -> FloatArray:
    """Return the corners of the path's pieces."""
    out = np.empty((pieces.sum() + 1, 3))
    at = 0
    for k in range(len(pieces)):
        for i in range(pieces[k]):
            for c in range(3):
                out[at, c] = path[k, c] + (path[k + 1, c] - path[k, c]) * (i / pieces[k])
            at += 1
    for c in range(3):
        out[at, c] = path[len(path) - 1, c]
    return out


@kernel
def _foot(path: FloatArray, k: int, point: FloatArray) -> tuple[float, float]:
    """Return the squared distance from piece k, and the share of it that lies before the nearest point."""
    dot = length2 = square = 0.0
    for c in range(3):
        u, d = path[k + 1, c] - path[k, c], point[c] - path[k, c]
        dot, length2, square = dot + u * d, length2 + u * u, square + d * d
    if length2 == 0.0:
        return square, 0.0
    share = min(1.0, max(0.0, dot / length2))
    return max(square - share * (2.0 * dot - share * length2), 0.0), share


@kernel
def _assigned(
    path: FloatArray, along: FloatArray, points: FloatArray, low: IntArray, high: IntArray
) -> tuple[IntArray, FloatArray]:
    """Assign each point to a piece; as `progress_in_order`, of pieces."""
    m = len(points)
    piece, share = np.zeros(m, dtype=np.int64), np.zeros(m)
    for begin in range(0, max(m - WINDOW // 2, min(m, 1)), WINDOW // 2):
        at = piece[begin - 1] if begin else low[0]
        _window(path, along, points, low, high, begin, min(begin + WINDOW, m), at, piece)
    for i in range(m):
        share[i] = _foot(path, piece[i], points[i])[1]
    return piece, share


@kernel
def _window(
    path: FloatArray,
    along: FloatArray,
    points: FloatArray,
    low: IntArray,
    high: IntArray,
    begin: int,
    end: int,
    at: int,
    piece: IntArray,
) -> None:
    """Assign the points begin ≤ i < end to pieces from `at` on."""
    way = 0.0
    for i in range(begin + 1, end):
        way += np.sqrt(((points[i] - points[i - 1]) ** 2).sum())
    first = max(at, low[begin])
    last = int(np.searchsorted(along, along[first] + WINDOW_REACH * way + WINDOW_REACH_MM, side="right"))
    if begin == 0:  # the motion may begin anywhere
        last = high[end - 1]
    last = max(min(last, high[end - 1]), low[end - 1] + 1, first + 1)
    n = last - first
    cost, came = np.full(n, np.inf), np.zeros((end - begin, n), dtype=np.int32)
    for i in range(begin, end):
        best, best_from = np.inf, 0  # of an earlier piece, as if everything since had been left out
        for j in range(n):
            k = first + j
            stay = cost[j]
            if i == begin:
                reached, source = SKIPPED_MM2 * (along[k] - along[at]), j
            elif best + SKIPPED_MM2 * along[k] < stay:
                reached, source = best + SKIPPED_MM2 * along[k], best_from
            else:
                reached, source = stay, j
            if stay - SKIPPED_MM2 * along[k + 1] < best:
                best, best_from = stay - SKIPPED_MM2 * along[k + 1], j
            came[i - begin, j] = source
            inside = low[i] <= k < high[i]
            cost[j] = reached + _foot(path, k, points[i])[0] if inside else np.inf
    j = int(np.argmin(cost))
    for i in range(end - 1, begin - 1, -1):
        piece[i] = first + j
        j = came[i - begin, j]
