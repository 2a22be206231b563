"""How well a motion follows the wanted one: contour error, tracking error, delay, command effort.

Contour error is the distance to the wanted path wherever on it the nozzle should be; it is what a print
shows. Tracking error compares at equal times. Lengths in mm and times in s here; `Track` carries its units
in its names.

Distances are taken to the path's *segments*, never to sampled points, which would put a floor of several µm
under every figure: a wanted path of straight moves is given by its corners, once each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from models.arrays import FloatArray, IntArray

WINDOW_S = 0.05  # a sample may belong to where the path is within this time: other lines and layers are not its own
LONGEST_DELAY_S = 0.02
EFFORT_SPAN_S = 1e-3  # a jump of speed at a corner counts as spread over this time, whatever the sampling
SCAN_SAMPLES = 20_000  # enough of them to see in which millisecond the best delay lies


@dataclass(frozen=True, slots=True)
class Tracking:
    """Errors at equal times; the delay is positive where the actual motion is late."""

    rms_mm: float
    max_mm: float
    delay_s: float
    rms_no_delay_mm: float


@dataclass(frozen=True, slots=True)
class Track:
    """One motion judged: the TRACK object of every JSON answer."""

    tracking_rms_um: float
    tracking_max_um: float
    contour_rms_um: float
    contour_p99_um: float
    contour_max_um: float
    delay_s: float
    tracking_rms_no_delay_um: float
    print_time_s: float
    peak_command_acceleration_mm_per_s2: float


def track(
    t: FloatArray,
    wanted: FloatArray,
    actual: FloatArray,
    path_t: FloatArray,
    path_xyz: FloatArray,
    peak_command_acceleration: float,
) -> Track:
    """Judge one motion.

    Parameters
    ----------
    t : (m,) s, evenly spaced;  wanted, actual : (m, 3) mm, the nozzle at these times.
    path_t : (n,) s;  path_xyz : (n, 3) mm, the wanted path's corners and when each is due.
    peak_command_acceleration : mm/s², of what the motors are told (see `peak_acceleration`).
    """
    dt = _step(t)
    at_equal_times = tracking(wanted, actual, dt)
    contour = contour_error(path_t, path_xyz, t, actual)
    return Track(
        tracking_rms_um=at_equal_times.rms_mm * 1e3,
        tracking_max_um=at_equal_times.max_mm * 1e3,
        contour_rms_um=_rms(contour) * 1e3,
        contour_p99_um=float(np.percentile(contour, 99)) * 1e3,
        contour_max_um=float(np.max(contour)) * 1e3,
        delay_s=at_equal_times.delay_s,
        tracking_rms_no_delay_um=at_equal_times.rms_no_delay_mm * 1e3,
        print_time_s=float(path_t[-1] - path_t[0]),
        peak_command_acceleration_mm_per_s2=peak_command_acceleration,
    )


def _step(t: FloatArray) -> float:
    dt = float(t[-1] - t[0]) / (len(t) - 1)
    worst = float(np.max(np.abs(np.diff(t) - dt)))
    if worst > 1e-3 * dt:
        raise ValueError(f"Times must be evenly spaced; here a step of {dt:.3g} s is off by {worst:.3g} s.")
    return dt


def _rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(x**2)))


# ---- contour -------------------------------------------------------------------------------------


def contour_error(
    path_t: FloatArray,
    path_xyz: FloatArray,
    actual_t: FloatArray,
    actual_xyz: FloatArray,
    window_s: float = WINDOW_S,
) -> FloatArray:
    """Distance : (m,) mm of each actual sample to the wanted segments in progress within ± window_s of its
    time.

    Parameters
    ----------
    path_t : (n,) s, never falling;  path_xyz : (n, 3) mm, the corners, n ≥ 2. A rest is a corner twice.
    actual_t : (m,) s, in any order;  actual_xyz : (m, 3) mm.
    """
    if len(path_t) < 2 or np.any(np.diff(path_t) < 0):
        raise ValueError(f"A wanted path needs two corners or more, at times that never fall; it has {len(path_t)}.")
    first, last = path_t[:-1], path_t[1:]
    # before the path begins its first segment counts, after its end the last one
    low = np.minimum(np.searchsorted(last, actual_t - window_s, side="left"), len(last) - 1)
    high = np.maximum(np.searchsorted(first, actual_t + window_s, side="right"), 1)
    return _nearest(np.ascontiguousarray(path_xyz), np.ascontiguousarray(actual_xyz), low, high)


@njit(cache=True, fastmath=True, nogil=True)
def _nearest(path: FloatArray, points: FloatArray, low: IntArray, high: IntArray) -> FloatArray:
    """Distance : (m,) of each point to the nearest of its segments low ≤ k < high."""
    out = np.empty(len(points))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        best = np.inf
        for k in range(low[i], high[i]):
            best = min(best, _distance2(path, k, x, y, z))
        out[i] = np.sqrt(best)
    return out


@njit(cache=True, fastmath=True, nogil=True)
def _distance2(path: FloatArray, k: int, x: float, y: float, z: float) -> float:
    """Squared distance of a point to segment k; the foot of the perpendicular is clipped to its ends."""
    ux, uy, uz = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1], path[k + 1, 2] - path[k, 2]
    dx, dy, dz = x - path[k, 0], y - path[k, 1], z - path[k, 2]
    length2 = ux * ux + uy * uy + uz * uz
    along = 0.0
    if length2 > 0.0:
        along = min(1.0, max(0.0, (dx * ux + dy * uy + dz * uz) / length2))
    dx, dy, dz = dx - along * ux, dy - along * uy, dz - along * uz
    return dx * dx + dy * dy + dz * dz


# ---- tracking ------------------------------------------------------------------------------------


def tracking(wanted: FloatArray, actual: FloatArray, dt: float, longest_delay_s: float = LONGEST_DELAY_S) -> Tracking:
    """Errors of two motions : (m, 3) mm sampled every dt, and the constant delay that explains most of them.

    The delay τ minimises the mean of |actual(t) - wanted(t - τ)|², continuously: the wanted motion is
    interpolated by the cubic through four samples, and rests before its first and after its last one.
    """
    if wanted.shape != actual.shape or len(wanted) < 4:
        raise ValueError(f"Motions must match and have four samples: {wanted.shape} against {actual.shape}.")
    wanted, actual = np.ascontiguousarray(wanted), np.ascontiguousarray(actual)
    distance2 = np.sum((actual - wanted) ** 2, axis=1)
    now = float(np.mean(distance2))
    delay = _best_delay(wanted, actual, dt, longest_delay_s)
    then = _mean_square(wanted, actual, delay / dt, 1)
    if then >= now:  # nothing moves, or no delay helps
        delay, then = 0.0, now
    return Tracking(float(np.sqrt(now)), float(np.sqrt(np.max(distance2))), delay, float(np.sqrt(then)))


def _best_delay(wanted: FloatArray, actual: FloatArray, dt: float, longest: float) -> float:
    """A scan over whole milliseconds on some samples finds the valley, Brent's method on all its floor."""
    some = 1 + len(wanted) // SCAN_SAMPLES
    grid = np.linspace(-longest, longest, 2 * max(1, round(longest / 1e-3)) + 1)
    valley = grid[np.argmin([_mean_square(wanted, actual, tau / dt, some) for tau in grid])]
    step = grid[1] - grid[0]

    def cost(tau: float) -> float:
        return float(_mean_square(wanted, actual, tau / dt, 1))

    from scipy.optimize import minimize_scalar  # 0.2 s to import: only when a delay is sought

    found = minimize_scalar(cost, bounds=(valley - step, valley + step), method="bounded", options={"xatol": 1e-10})
    if not found.success:
        raise RuntimeError(f"The search for the delay near {valley:.4f} s has not ended: {found.message}")
    return float(found.x)


@njit(cache=True, fastmath=True, nogil=True)
def _mean_square(wanted: FloatArray, actual: FloatArray, shift: float, every: int) -> float:
    """Mean of |actual_i - wanted(i - shift)|² over every so many i; Lagrange's cubic between samples."""
    total, count, top = 0.0, 0, len(wanted) - 1
    for i in range(0, len(wanted), every):
        at = min(max(i - shift, 0.0), float(top))
        k = min(max(int(at) - 1, 0), top - 3)
        s = at - k
        w0, w1 = -(s - 1) * (s - 2) * (s - 3) / 6, s * (s - 2) * (s - 3) / 2
        w2, w3 = -s * (s - 1) * (s - 3) / 2, s * (s - 1) * (s - 2) / 6
        for j in range(3):
            there = w0 * wanted[k, j] + w1 * wanted[k + 1, j] + w2 * wanted[k + 2, j] + w3 * wanted[k + 3, j]
            total += (actual[i, j] - there) ** 2
        count += 1
    return total / count


# ---- effort --------------------------------------------------------------------------------------


def peak_acceleration(command: FloatArray, dt: float, span_s: float = EFFORT_SPAN_S) -> float:
    """Largest |acceleration| of any motor's command, mm/s² : second difference over span_s (one sample at
    least).

    NOTE: a planner's corner is a jump of speed, whose acceleration has no limit as dt goes to zero; over a
    fixed span it is a number that does not depend on how finely the command was sampled.
    """
    n = max(1, round(span_s / dt))
    bend = command[2 * n :] - 2 * command[n:-n] + command[: -2 * n]
    return float(np.max(np.abs(bend))) / (n * dt) ** 2
