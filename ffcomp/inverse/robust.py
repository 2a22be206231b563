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
conjugate gradients, preconditioned with a lower weight along the path, for a change along it alters little: a third of
the steps do.

The minimum of an expected error over uncertain parameters: Nagy & Braatz, J. Process Control 14 (2004) 411-422. Errors
across a path rather than at a time: Koren, J. Dyn. Sys. Meas. Control 102 (1980) 265-272. Preconditioned conjugate
gradients: Golub & Van Loan, Matrix Computations, 4th ed. 2013, section 11.5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from ffcomp.inverse.sensitivity import (
    FULL,
    SPANS,
    RobustSettings,
    Sensitivity,
    ShortArray,
    perturbed_machines,
    span_length,
)
from ffcomp.inverse.settings import Settings
from models.arrays import BoolArray, ComplexArray, FloatArray
from models.machine import Machine

BLEND = 64  # rows over which one span's answer goes over into the next one's

TANGENT_WEIGHT = 0.002  # ε
REGULARISATION = 1e-3  # λ
CONVERGENCE_RTOL = 1e-4  # share of the gradient's square at which they end earlier

Linear = Callable[[ShortArray], ShortArray]


class RobustReference:
    """d over the bed of one machine, for rows `row_s` apart."""

    def __init__(
        self, machine: Machine, row_s: float, bandwidth_hz: float, control_weight: float, solver: RobustSettings = FULL
    ) -> None:
        """Prepare the sensitivity; control_weight: ρ against one row, as in the sweeps."""
        self.solver = solver
        self.sensitivity = Sensitivity(machine, row_s, bandwidth_hz, control_weight, solver)

    def offset(self, rows: FloatArray, moving: BoolArray) -> FloatArray:
        """Return the offset d (n, 3) mm from a path (n + 2 margin, 3) mm, which has so many rows more at either end.

        moving : (n + 2 margin,) where d may be something; outside, the command rests on the path
        """
        margin = self.solver.margin
        n = len(rows) - 2 * margin
        step = SPANS[-1] - 2 * margin
        out = np.zeros((n + 2 * BLEND, 3))  # with what the first and the last span blend into
        for first in range(0, n, step):
            last = min(first + step, n)
            seen = slice(first, last + 2 * margin)
            offset = self._span(rows[seen], moving[seen])[margin - BLEND : len(rows[seen]) - margin + BLEND]
            out[first : last + 2 * BLEND] += offset * _blending(len(offset), first > 0, last < n)[:, None]
        return out[BLEND : n + BLEND]

    def _span(self, rows: FloatArray, moving: BoolArray) -> FloatArray:
        """Find d (m, 3) mm of one span (m, 3) mm by itself."""
        solver = self.solver
        response = self.sensitivity.along(rows[:, :2], span_length(len(rows)))
        allowed = moving[:, None].astype(np.float32)
        rates = np.diff(rows, axis=0, append=rows[-1:]) * _faded(len(rows), solver.margin)[:, None]
        tracking_error = response.to_path(rates.astype(np.float32))
        d, answer = np.zeros(rows.shape, np.float32), tracking_error
        for round_ in range(solver.rounds):
            if round_:
                answer = tracking_error + response.to_offset(d)
            normal_error, tangents = normal_errors(rows, answer[0], solver.nearby_rows)
            errors = across(answer, tangents)
            errors[0] = normal_error

            def curvature(change: ShortArray, tangents: ShortArray = tangents) -> ShortArray:
                return (
                    allowed * response.adjoint(across(response.to_offset(change), tangents)) + REGULARISATION * change
                )

            def precondition(gradient: ShortArray, tangents: ShortArray = tangents) -> ShortArray:
                return allowed * preconditioned(gradient, tangents, solver.preconditioner_weight)

            gradient = allowed * response.adjoint(errors) + REGULARISATION * d
            d = d + conjugate_gradients(curvature, -gradient, solver.steps, precondition)
        return d.astype(np.float64)


@njit(cache=True, nogil=True)
def normal_errors(rows: FloatArray, error: ShortArray, nearby: int = FULL.nearby_rows) -> tuple[ShortArray, ShortArray]:
    """Return n + ε l, and T, for the path (m, 3) mm whose positions are missed by (m, 3) mm.

    nearby : rows around a moment among which the path's nearest point is sought

    Returns
    -------
    (m, 3) mm; (m, 3), zero where the nearest point is a corner or the nozzle rests
    """
    normal_error, tangents = np.empty_like(error), np.zeros_like(error)
    for i in range(len(rows)):
        x, y, z = rows[i, 0] + error[i, 0], rows[i, 1] + error[i, 1], rows[i, 2] + error[i, 2]
        k, share = _nearest(rows, x, y, z, max(i - nearby, 0), min(i + nearby, len(rows) - 1))
        clipped = min(max(share, 0.0), 1.0)
        ux, uy, uz = rows[k + 1, 0] - rows[k, 0], rows[k + 1, 1] - rows[k, 1], rows[k + 1, 2] - rows[k, 2]
        normal_error[i, 0] = x - rows[k, 0] - clipped * ux
        normal_error[i, 1] = y - rows[k, 1] - clipped * uy
        normal_error[i, 2] = z - rows[k, 2] - clipped * uz
        if clipped == share:
            late = ux * error[i, 0] + uy * error[i, 1] + uz * error[i, 2]
            size = ux * ux + uy * uy + uz * uz
            length = np.sqrt(size)
            tangents[i, 0], tangents[i, 1], tangents[i, 2] = ux / length, uy / length, uz / length
            normal_error[i, 0] += TANGENT_WEIGHT * late / size * ux
            normal_error[i, 1] += TANGENT_WEIGHT * late / size * uy
            normal_error[i, 2] += TANGENT_WEIGHT * late / size * uz
    return normal_error, tangents


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
        clipped = min(max(share, 0.0), 1.0)
        apart = (dx - clipped * ux) ** 2 + (dy - clipped * uy) ** 2 + (dz - clipped * uz) ** 2
        if apart < best:
            best, best_k, best_share = apart, k, share
    return best_k, best_share


@njit(cache=True, nogil=True)
def across(errors: ShortArray, tangent: ShortArray) -> ShortArray:
    """Errors (p, m, 3) with what lies along the directions (m, 3) shortened to ε of it."""
    out = np.empty_like(errors)
    most = np.float32(1.0 - TANGENT_WEIGHT)
    for p in range(len(errors)):
        for i in range(errors.shape[1]):
            late = tangent[i, 0] * errors[p, i, 0] + tangent[i, 1] * errors[p, i, 1] + tangent[i, 2] * errors[p, i, 2]
            for c in range(3):
                out[p, i, c] = errors[p, i, c] - most * late * tangent[i, c]
    return out


@njit(cache=True, nogil=True)
def preconditioned(rows: ShortArray, tangent: ShortArray, weight: float) -> ShortArray:
    """Rows (m, 3) with what lies along the directions (m, 3) lengthened by 1 / `weight`."""
    out = np.empty_like(rows)
    more = np.float32(1.0 / weight - 1.0)
    for i in range(len(rows)):
        late = tangent[i, 0] * rows[i, 0] + tangent[i, 1] * rows[i, 1] + tangent[i, 2] * rows[i, 2]
        for c in range(3):
            out[i, c] = rows[i, c] + more * late * tangent[i, c]
    return out


def conjugate_gradients(apply: Linear, right_side: ShortArray, steps: int, precondition: Linear) -> ShortArray:
    """Solve A x = b for a positive definite A, as far as so many steps go.

    precondition : r ↦ z = M⁻¹ r, M being near A
    """
    x = np.zeros_like(right_side)
    residual, direction = right_side, precondition(right_side)
    energy = first = np.vdot(residual, direction)
    for _ in range(steps):
        if energy <= CONVERGENCE_RTOL * first:
            break
        a_direction = apply(direction)
        share = energy / np.vdot(direction, a_direction)
        x = x + share * direction
        residual = residual - share * a_direction
        z = precondition(residual)
        energy, last_energy = np.vdot(residual, z), energy
        direction = z + energy / last_energy * direction
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


PAYING_SD = (0.02, 0.1)  # of the modes: where the median gains, and peaks of the command stay near the plan's
STEP = 0.01  # relative, small: what counts is the slope
LINES, LOWEST_HZ = 60, 5.0
BAND_MARGIN = 1.5  # times the bandwidth, up to which the response counts


@dataclass(frozen=True, slots=True)
class RobustChoice:
    """Whether to invert robustly, and why."""

    robust: bool
    reason: str


PLAIN = RobustChoice(False, "Plain inversion: nothing else was asked for.")
BOUNDED = RobustChoice(True, "Robust inversion, as always under a bound on the error.")


def choose_robust(machine: Machine, settings: Settings, requested: bool | None = None) -> RobustChoice:
    """Choose for a machine. requested : by the user; None: by the machine file."""
    if requested is not None:
        return RobustChoice(requested, f"{'Robust' if requested else 'Plain'} inversion, as it was asked for.")
    sd = mode_sd(machine, settings.bandwidth_hz)
    known = f"by its [uncertainty] the machine file knows its modes to {100 * sd:.2g} %"
    if not PAYING_SD[0] <= sd <= PAYING_SD[1]:
        least, most = (f"{100 * each:g}" for each in PAYING_SD)
        return RobustChoice(False, f"Plain inversion: {known}; --robust pays from {least} to {most} %.")
    return RobustChoice(True, f"Robust inversion: {known}. If the file is exact: --no-robust.")


def mode_sd(machine: Machine, bandwidth_hz: float) -> float:
    """Return the relative standard deviation of all modes together that makes the response as uncertain as it is."""
    most = max(machine.uncertainty.values(), default=0.0)
    if most == 0.0:
        return 0.0
    f = np.geomspace(LOWEST_HZ, BAND_MARGIN * bandwidth_hz, LINES)
    scaled = {name: STEP / most * value for name, value in machine.uncertainty.items()}
    nominal, *off = (_response(each, f) for each in perturbed_machines(replace(machine, uncertainty=scaled)))
    return most * _spread(nominal, off, f) / _spread(nominal, [_response(machine, f / (1.0 + STEP))], f)


def _response(machine: Machine, f: FloatArray) -> ComplexArray:
    return machine.vibration.frequency_response(np.zeros(2), f, "nozzle", "nozzle")


def _spread(nominal: ComplexArray, off: Sequence[ComplexArray], f: FloatArray) -> float:
    """Return the root of the summed square of the changes, for acceleration that is alike at all frequencies."""
    squares = [np.sum(np.abs(np.linalg.solve(nominal, each - nominal)) ** 2, axis=(1, 2)) for each in off]
    return float(np.sqrt(np.trapezoid(np.sum(squares, axis=0) / f**4, f))) if off else 0.0
