"""Robust reference modification under parameter uncertainty.

The numbers of a machine file have standard deviations (its `[uncertainty]`), so its FRF G is one draw of many, and so
is D = G K₀ with the plain inverse K₀: what comes of the path r if it is wanted as it is. Near a lightly damped mode D
is not I, what is wanted there comes out wrong, and it is better to want something else, r + d. A print is judged by its
distance to the path alone: at what time the nozzle is where is free along a line, but not at a corner. So

    d = argmin  E [ |n|² + ε |l|² ] + λ |d|²        D (r + d) = q + n        l = T Tᵀ (D (r + d) − r)

with q the nearest point of the path, n the way from there, across the path but at corners, and l by how much the nozzle
is early or late, T being the path's direction at q. So d speeds up and slows down differently where the next corner
would ring of it, by about a tenth of a millimetre at most in practice, and leaves out what else would come out wrong.
It keeps the plan's clock.

D is its mean M₀ and its principal directions M₁, M₂, … over the possible printers (`sensitivity.py`). With T as it is
for the mean, the expectation is a sum of squares, each of one direction's response:

    E |P D (r + d) − P r|² = |P (M₀ (r + d) − r)|² + Σ |P Mₖ (r + d)|²        P = I − (1 − ε) T Tᵀ

So it costs one problem of the nominal size with a few more rows, whatever the number of printers. The minimum is sought
by Gauss-Newton steps, from nearest points to nearest points, in spans of some seconds which overlap. Each is solved by
conjugate gradients, which weigh errors along the path as dear as `Care.ahead`, for a change along it alters little: a
third of the steps do.

The minimum of an expected error over uncertain parameters: Nagy & Braatz, J. Process Control 14 (2004) 411-422. Errors
across a path rather than at a time: Koren, J. Dyn. Sys. Meas. Control 102 (1980) 265-272. Preconditioned conjugate
gradients: Golub & Van Loan, Matrix Computations, 4th ed. 2013, section 11.5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from ffcomp.inverse.sensitivity import FULL, SPANS, Care, Sensitivity, ShortArray, machines_off, span_length
from ffcomp.inverse.settings import Settings
from models.arrays import BoolArray, ComplexArray, FloatArray
from models.machine import Machine

BLEND = 64  # rows over which one span's answer goes over into the next one's

ALONG = 0.002  # ε
CALM = 1e-3  # λ
CLOSE = 1e-4  # share of the gradient's square at which they end earlier

Linear = Callable[[ShortArray], ShortArray]


class RobustReference:
    """d over the bed of one machine, for rows `row_s` apart."""

    def __init__(self, machine: Machine, row_s: float, bandwidth_hz: float, effort: float, care: Care = FULL) -> None:
        """Prepare the sensitivity; effort: ρ against one row, as in the sweeps."""
        self.care = care
        self.sensitivity = Sensitivity(machine, row_s, bandwidth_hz, effort, care)

    def offset(self, rows: FloatArray, moving: BoolArray) -> FloatArray:
        """Return the offset d (n, 3) mm from a path (n + 2 margin, 3) mm, which has so many rows more at either end.

        moving : (n + 2 margin,) where d may be something; outside, the command rests on the path
        """
        margin = self.care.margin
        n = len(rows) - 2 * margin
        step = SPANS[-1] - 2 * margin
        out = np.zeros((n + 2 * BLEND, 3))  # with what the first and the last span blend into
        for first in range(0, n, step):
            last = min(first + step, n)
            seen = slice(first, last + 2 * margin)
            found = self._span(rows[seen], moving[seen])[margin - BLEND : len(rows[seen]) - margin + BLEND]
            out[first : last + 2 * BLEND] += found * _blending(len(found), first > 0, last < n)[:, None]
        return out[BLEND : n + BLEND]

    def _span(self, rows: FloatArray, moving: BoolArray) -> FloatArray:
        """Find d (m, 3) mm of one span (m, 3) mm by itself."""
        care = self.care
        response = self.sensitivity.along(rows[:, :2], span_length(len(rows)))
        allowed = moving[:, None].astype(np.float32)
        rates = np.diff(rows, axis=0, append=rows[-1:]) * _faded(len(rows), care.margin)[:, None]
        missed = response.to_path(rates.astype(np.float32))
        d, answer = np.zeros(rows.shape, np.float32), missed
        for round_ in range(care.rounds):
            if round_:
                answer = missed + response.to_offset(d)
            left, along = beside(rows, answer[0], care.near)
            errors = across(answer, along)
            errors[0] = left

            def curvature(change: ShortArray, along: ShortArray = along) -> ShortArray:
                return allowed * response.adjoint(across(response.to_offset(change), along)) + CALM * change

            def eased(gradient: ShortArray, along: ShortArray = along) -> ShortArray:
                return allowed * stretched(gradient, along, care.ahead)

            gradient = allowed * response.adjoint(errors) + CALM * d
            d = d + conjugate_gradients(curvature, -gradient, care.steps, eased)
        return d.astype(np.float64)


@njit(cache=True, nogil=True)
def beside(rows: FloatArray, missed: ShortArray, near: int = FULL.near) -> tuple[ShortArray, ShortArray]:
    """Return n + ε l, and T, for the path (m, 3) mm whose positions are missed by (m, 3) mm.

    near : rows around a moment among which the path's nearest point is sought

    Returns
    -------
    (m, 3) mm; (m, 3), zero where the nearest point is a corner or the nozzle rests
    """
    left, along = np.empty_like(missed), np.zeros_like(missed)
    for i in range(len(rows)):
        x, y, z = rows[i, 0] + missed[i, 0], rows[i, 1] + missed[i, 1], rows[i, 2] + missed[i, 2]
        k, share = _nearest(rows, x, y, z, max(i - near, 0), min(i + near, len(rows) - 1))
        kept = min(max(share, 0.0), 1.0)
        ux, uy, uz = rows[k + 1, 0] - rows[k, 0], rows[k + 1, 1] - rows[k, 1], rows[k + 1, 2] - rows[k, 2]
        left[i, 0] = x - rows[k, 0] - kept * ux
        left[i, 1] = y - rows[k, 1] - kept * uy
        left[i, 2] = z - rows[k, 2] - kept * uz
        if kept == share:
            late = ux * missed[i, 0] + uy * missed[i, 1] + uz * missed[i, 2]
            size = ux * ux + uy * uy + uz * uz
            length = np.sqrt(size)
            along[i, 0], along[i, 1], along[i, 2] = ux / length, uy / length, uz / length
            left[i, 0] += ALONG * late / size * ux
            left[i, 1] += ALONG * late / size * uy
            left[i, 2] += ALONG * late / size * uz
    return left, along


@njit(cache=True, nogil=True)
def _nearest(rows: FloatArray, x: float, y: float, z: float, low: int, high: int) -> tuple[int, float]:
    """Find the nearest of the path's steps low ≤ k < high to a position, and the share of it before that position.

    A share below zero or above one: one of its ends is nearest.
    """
    best, best_k, best_share = np.inf, low, -1.0
    for k in range(low, high):
        ux, uy, uz = rows[k + 1, 0] - rows[k, 0], rows[k + 1, 1] - rows[k, 1], rows[k + 1, 2] - rows[k, 2]
        dx, dy, dz = x - rows[k, 0], y - rows[k, 1], z - rows[k, 2]
        size = ux * ux + uy * uy + uz * uz
        share = (ux * dx + uy * dy + uz * dz) / size if size > 0.0 else -1.0
        kept = min(max(share, 0.0), 1.0)
        apart = (dx - kept * ux) ** 2 + (dy - kept * uy) ** 2 + (dz - kept * uz) ** 2
        if apart < best:
            best, best_k, best_share = apart, k, share
    return best_k, best_share


@njit(cache=True, nogil=True)
def across(errors: ShortArray, along: ShortArray) -> ShortArray:
    """Errors (p, m, 3) with what lies along the directions (m, 3) shortened to ε of it."""
    out = np.empty_like(errors)
    most = np.float32(1.0 - ALONG)
    for p in range(len(errors)):
        for i in range(errors.shape[1]):
            late = along[i, 0] * errors[p, i, 0] + along[i, 1] * errors[p, i, 1] + along[i, 2] * errors[p, i, 2]
            for c in range(3):
                out[p, i, c] = errors[p, i, c] - most * late * along[i, c]
    return out


@njit(cache=True, nogil=True)
def stretched(rows: ShortArray, along: ShortArray, ahead: float) -> ShortArray:
    """Rows (m, 3) with what lies along the directions (m, 3) lengthened by 1 / `ahead`."""
    out = np.empty_like(rows)
    more = np.float32(1.0 / ahead - 1.0)
    for i in range(len(rows)):
        late = along[i, 0] * rows[i, 0] + along[i, 1] * rows[i, 1] + along[i, 2] * rows[i, 2]
        for c in range(3):
            out[i, c] = rows[i, c] + more * late * along[i, c]
    return out


def conjugate_gradients(apply: Linear, wanted: ShortArray, steps: int, eased: Linear) -> ShortArray:
    """Solve A x = b for a positive definite A, as far as so many steps go. eased : r ↦ M⁻¹ r, M being near A."""
    x = np.zeros_like(wanted)
    left, direction = wanted, eased(wanted)
    size = first = np.vdot(left, direction)
    for _ in range(steps):
        if size <= CLOSE * first:
            break
        turned = apply(direction)
        share = size / np.vdot(direction, turned)
        x = x + share * direction
        left = left - share * turned
        ahead = eased(left)
        size, before = np.vdot(left, ahead), size
        direction = ahead + size / before * direction
    return x


def _blending(n: int, rises: bool, falls: bool) -> FloatArray:
    """(n,) shares of a span's answer: where another one goes before or after it, they add up to one."""
    share = np.ones(n)
    ramp = (np.arange(2 * BLEND) + 0.5) / (2 * BLEND)
    if rises:
        share[: 2 * BLEND] = ramp
    if falls:
        share[n - 2 * BLEND :] *= ramp[::-1]
    return share


def _faded(n: int, margin: int) -> FloatArray:
    """(n,) one, but for both ends of a span, over half of its margins: nothing begins or ends with a jump."""
    edge = np.arange(n) + 0.5
    near = np.clip(np.minimum(edge, n - edge) / (margin / 2), 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * near))


PAYS = (0.02, 0.1)  # of the modes: where the median gains, and peaks of the command stay near the plan's
STEP = 0.01  # relative, small: what counts is the slope
LINES, LOWEST_HZ = 60, 5.0
BEYOND = 1.5  # times the bandwidth, up to which the response counts


@dataclass(frozen=True, slots=True)
class RobustChoice:
    """Whether to invert robustly, and why."""

    robust: bool
    reason: str


PLAIN = RobustChoice(False, "Plain inversion: nothing else was asked for.")
BOUNDED = RobustChoice(True, "Robust inversion, as always under a bound on the error.")


def choose_robust(machine: Machine, settings: Settings, asked: bool | None = None) -> RobustChoice:
    """Choose for a machine. asked : by the user; None: by the machine file."""
    if asked is not None:
        return RobustChoice(asked, f"{'Robust' if asked else 'Plain'} inversion, as it was asked for.")
    sd = mode_sd(machine, settings.bandwidth_hz)
    known = f"by its [uncertainty] the machine file knows its modes to {100 * sd:.2g} %"
    if not PAYS[0] <= sd <= PAYS[1]:
        least, most = (f"{100 * each:g}" for each in PAYS)
        return RobustChoice(False, f"Plain inversion: {known}; --robust pays from {least} to {most} %.")
    return RobustChoice(True, f"Robust inversion: {known}. If the file is exact: --no-robust.")


def mode_sd(machine: Machine, bandwidth_hz: float) -> float:
    """Return the relative standard deviation of all modes together that makes the response as uncertain as it is."""
    most = max(machine.uncertainty.values(), default=0.0)
    if most == 0.0:
        return 0.0
    f = np.geomspace(LOWEST_HZ, BEYOND * bandwidth_hz, LINES)
    scaled = {name: STEP / most * value for name, value in machine.uncertainty.items()}
    own, *off = (_response(each, f) for each in machines_off(replace(machine, uncertainty=scaled)))
    return most * _spread(own, off, f) / _spread(own, [_response(machine, f / (1.0 + STEP))], f)


def _response(machine: Machine, f: FloatArray) -> ComplexArray:
    return machine.vibration.frequency_response(np.zeros(2), f, "nozzle", "nozzle")


def _spread(own: ComplexArray, off: Sequence[ComplexArray], f: FloatArray) -> float:
    """Return the root of the summed square of the changes, for acceleration that is alike at all frequencies."""
    squares = [np.sum(np.abs(np.linalg.solve(own, each - own)) ** 2, axis=(1, 2)) for each in off]
    return float(np.sqrt(np.trapezoid(np.sum(squares, axis=0) / f**4, f))) if off else 0.0
