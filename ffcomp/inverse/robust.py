"""Robust reference modification under parameter uncertainty.

The numbers of a machine file have standard deviations (its `[uncertainty]`), so its FRF G is one draw of many, and so
is D = G K₀ with the plain inverse K₀, the response to the path r as reference. Near a lightly damped mode D
is not I, and another reference, r + d, gives a smaller error. A print is judged by its
distance to the path alone: timing along a line is free, but not at a corner. So

    d = argmin  E [ |n|² + ε |l|² ] + λ |F⁻¹ d|²      D (r + d) = q + n        l = T Tᵀ (D (r + d) − r)

with q the nearest point of the path, n the way from there, across the path but at corners, and l by how much the nozzle
is early or late, T being the path's direction at q. So d speeds up and slows down differently where the next corner
would ring of it, by about a tenth of a millimetre at most in practice, and leaves out what else would come out wrong.
It keeps the plan's clock. F is a low pass: nothing of d is beyond twice the bandwidth.

D is its mean M₀ and its principal directions M₁, M₂, … over the possible printers (`sensitivity.py`). With the T of
the mean, the expectation is a sum of squares, each of one direction's response:

    E |P D (r + d) − P r|² = |P (M₀ (r + d) − r)|² + Σ |P Mₖ (r + d)|²        P² = W = I − (1 − ε) T Tᵀ

So it costs one problem of the nominal size with a few more rows, whatever the number of printers. The minimum over
y = F⁻¹ d is sought by nonlinear conjugate gradients, in spans of a second or two which overlap, many at a time. At each
step nearest points are updated, as in Gauss-Newton's method, and the gradient is preconditioned with a lower weight
along the path, because a change along it alters little. The search ends after a few steps: later ones add
mostly acceleration. After seven a command's peaks are 1.5 times those of a plain one at most. An offset has half as
many samples as the path has rows; W there is its average over the rows around, so that the moment of a corner counts
and not only which samples are before it.

A kernel for each place that is robust by itself, without looking at the path, does little: at 10 % the tower's median
goes from 7.4 to 6.1 µm, with a path in sight to 3.3. What helps is the freedom along the path.

The minimum of an expected error over uncertain parameters: Nagy & Braatz, J. Process Control 14 (2004) 411-422. Errors
across a path rather than at a time: Koren, J. Dyn. Sys. Meas. Control 102 (1980) 265-272. Nonlinear conjugate gradients
with a preconditioner: Nocedal & Wright, Numerical Optimization, 2nd ed. 2006, section 5.2 (Polak-Ribière).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ffcomp.inverse.sensitivity import (
    MARGIN,
    PLACES_KEPT,
    ROWS,
    SPANS,
    Sensitivity,
    ShortArray,
    ShortComplexArray,
    apply,
    apply_adjoint,
    flat,
    lines_of,
    perturbed_machines,
    rows_of,
    span_length,
    spans_of,
    steps_of,
)
from ffcomp.inverse.settings import Settings
from models.arrays import BoolArray, ComplexArray, FloatArray
from models.compiled import fast_kernel, kernel
from models.machine import Machine

TANGENT_WEIGHT = 0.002  # ε,
TANGENT_WEIGHT_WIDE = 0.01  # and where modes are known worse than WIDE_SD: a nozzle early or late by 0.8 mm otherwise
REGULARISATION = 1e-3  # λ
STEPS = 7  # of conjugate gradients; more steps cost acceleration and gain little,
STEPS_WIDE = 14  # but for modes known worse than
WIDE_SD = 0.11  # this: there a longer search over more directions takes 8 to 14 % off the expected error
ALONG = 10.0  # times as far along the path as across it: what they are preconditioned with
BLEND = 64  # rows over which one span's answer goes over into the next one's
TOGETHER = 12288  # rows of several spans


class Path(NamedTuple):
    """A path to be followed, with MARGIN rows more at either end than its offset."""

    rows: FloatArray  # (n + 2 MARGIN, 3) mm
    moving: BoolArray  # (n + 2 MARGIN,) where an offset may be something; outside, the command rests on the path


class _Span(NamedTuple):
    """Rows first … last of one of several paths."""

    path: int
    first: int
    last: int
    before: int  # rows in sight before the first
    rows: FloatArray  # (before + last - first + MARGIN, 3) mm
    moving: BoolArray


class RobustReference:
    """d over the bed of one machine, for rows `row_s` apart."""

    def __init__(self, machine: Machine, row_s: float, bandwidth_hz: float, control_weight: float) -> None:
        """Prepare the sensitivity; control_weight: ρ against one row, as in the sweeps."""
        wide = mode_sd(machine, bandwidth_hz) > WIDE_SD
        self.sensitivity = Sensitivity(machine, row_s, bandwidth_hz, control_weight, wide=wide)
        self._steps = STEPS_WIDE if wide else STEPS
        self._tangent_weight = TANGENT_WEIGHT_WIDE if wide else TANGENT_WEIGHT
        f = self.sensitivity.frequency[: ROWS // 4]  # of the offset's own samples
        # beyond the bandwidth nothing is commanded: leave the offset alone
        self._low_pass = np.clip(2.0 - f / bandwidth_hz, 0.0, 1.0).astype(np.float32)
        self._operators = lru_cache(PLACES_KEPT)(self._operators_at)

    def offsets(self, paths: Sequence[Path]) -> list[FloatArray]:
        """Return the offset d (n, 3) mm from each path."""
        sizes = [len(path.rows) - 2 * MARGIN for path in paths]
        out = [np.zeros((n + 2 * BLEND, 3)) for n in sizes]  # with what the first and the last span blend into
        spans = list[_Span]()
        for k, (path, n) in enumerate(zip(paths, sizes, strict=True)):
            for first, last in spans_of(n):
                before = MARGIN if first else BLEND  # at rest
                seen = slice(first + MARGIN - before, last + 2 * MARGIN)
                spans.append(_Span(k, first, last, before, path.rows[seen], path.moving[seen]))
        for length in SPANS:
            alike = [span for span in spans if span_length(len(span.rows)) == length]
            together = TOGETHER // length
            for begin in range(0, len(alike), together):
                some = alike[begin : begin + together]
                for span, d in zip(some, self._solve(some, length), strict=True):
                    part = d[:, span.before - BLEND : len(span.rows) - MARGIN + BLEND].T
                    blended = part * _blending(len(part), span.first > 0, span.last < sizes[span.path])[:, None]
                    out[span.path][span.first : span.last + 2 * BLEND] += blended
        return [each[BLEND:-BLEND] for each in out]

    def _operators_at(self, i: int, j: int) -> tuple[ShortComplexArray, ShortComplexArray]:
        """Return what leads from a path's steps, and from y, to the errors at a place."""
        known = self.sensitivity.of_place(i, j)
        return self.sensitivity.to_steps(known), flat(known[..., : len(self._low_pass)] * self._low_pass)

    def _solve(self, spans: Sequence[_Span], length: int) -> ShortArray:
        """Find d (spans, 3, length) mm of some spans, each by itself."""
        from scipy.fft import rfft

        n, stride = length // 2, ROWS // length
        operators = [self._operators(*self.sensitivity.place_of(span.rows[:, :2])) for span in spans]
        of_steps, of_y = (np.stack([each[k][..., ::stride] for each in operators]) for k in range(2))
        lines = of_y.shape[-1]
        rows, moving = np.empty((len(spans), length, 3)), np.zeros((len(spans), 1, length), np.float32)
        for k, span in enumerate(spans):
            rows[k, : len(span.rows)], rows[k, len(span.rows) :] = span.rows, span.rows[-1]
            moving[k, 0, : len(span.rows)] = span.moving
        directions = directions_of(rows)
        allowed = np.ascontiguousarray(moving[..., ::2])

        steps = np.stack([steps_of(span.rows, length) for span in spans])
        path_lines = apply(of_steps, lines_of(steps, of_steps.shape[-1]), length // 2 + 1)
        path_error, spread = rows_of(path_lines[:, :3], length), rows_of(_folded(path_lines[:, 3:], n), n)
        mean_lines = np.zeros((len(spans), 3, length // 2 + 1), np.complex64)  # of what y makes of the mean, twice
        y: ShortArray = np.zeros((len(spans), 3, n), np.float32)
        direction, last_z = np.zeros_like(y), np.zeros_like(y)
        last_energy = np.full(len(spans), np.inf, np.float32)
        error, errors = path_error, np.empty((len(spans), 3 + spread.shape[1], lines), np.complex64)
        for left in reversed(range(self._steps)):
            normal, weight = normal_errors(rows, directions, error, self._tangent_weight)
            np.multiply(rfft(normal)[..., :lines], 0.5, out=errors[:, :3])
            errors[:, 3:] = rfft(weigh(weight, spread))[..., :lines]
            gradient = allowed * rows_of(apply_adjoint(of_y, errors, n // 2 + 1), n) + REGULARISATION * y
            z = ALONG * gradient - (ALONG - 1.0) * weigh(weight, gradient)
            energy = _product(gradient, z)
            share = np.maximum((energy - _product(gradient, last_z)) / last_energy, 0.0)
            direction = allowed * z + share[:, None, None] * direction
            last_z, last_energy = z, np.where(energy > 0.0, energy, np.inf)  # nothing by nothing is nothing
            change_lines = apply(of_y, lines_of(direction, lines), n // 2 + 1)
            change = rows_of(change_lines, n)
            curvature = _product(change, weigh(weight, change)) + REGULARISATION * _product(direction, direction)
            descent = _product(gradient, direction)
            step = np.divide(descent, curvature, out=np.zeros_like(descent), where=curvature > 0.0)[:, None, None]
            y -= step * direction
            if left:
                spread -= step * change[:, 3:]
                mean_lines[..., :lines] -= 2.0 * step * change_lines[:, :3, :lines]
                error = path_error + rows_of(mean_lines, length)
        return moving * rows_of(lines_of(y, lines) * (2.0 * self._low_pass[::stride]), length)


def _folded(lines: ShortComplexArray, n: int) -> ShortComplexArray:
    """Return the lines (…, n/2 + 1) of every other of 2 n samples: each holds those above it as well."""
    count = min(lines.shape[-1], n // 2 + 1)
    out = np.zeros((*lines.shape[:-1], n // 2 + 1), np.complex64)
    out[..., :count] = lines[..., :count]
    above = lines[..., n // 2 :]
    if above.shape[-1]:
        out[..., n // 2 + 1 - above.shape[-1] :] += np.conj(above[..., ::-1])
    return np.asarray(0.5 * out, dtype=np.complex64)


def _product(a: ShortArray, b: ShortArray) -> ShortArray:
    """Return the scalar product (s,) of arrays (s, k, n), each s by itself."""
    return np.asarray(np.einsum("skn,skn->s", a, b))


@kernel
def directions_of(rows: FloatArray) -> FloatArray:
    """Return the directions X Y Z and lengths mm of the steps between rows (s, m, 3) mm: (s, m - 1, 4)."""
    out = np.zeros((rows.shape[0], rows.shape[1] - 1, 4))
    for s in range(rows.shape[0]):
        for k in range(rows.shape[1] - 1):
            x, y, z = (
                rows[s, k + 1, 0] - rows[s, k, 0],
                rows[s, k + 1, 1] - rows[s, k, 1],
                rows[s, k + 1, 2] - rows[s, k, 2],
            )
            length = np.sqrt(x * x + y * y + z * z)
            if length > 0.0:
                out[s, k, 0], out[s, k, 1], out[s, k, 2], out[s, k, 3] = x / length, y / length, z / length, length
    return out


@kernel
def normal_errors(
    rows: FloatArray, steps: FloatArray, error: ShortArray, tangent_weight: float
) -> tuple[ShortArray, ShortArray]:
    """Return n + ε l, and W, for paths (s, m, 3) mm whose positions are missed by (s, 3, m) mm.

    steps : (s, m - 1, 4), `directions_of` the rows
    tangent_weight : ε

    Returns
    -------
    (s, 3, m) mm; (s, 6, m/2), xx yy zz xy xz yz of W at every other row, averaged over the rows around: one where the
    nearest point is a corner or the nozzle rests
    """
    spans, m = rows.shape[:2]
    normal_error, weight = np.empty_like(error), np.zeros((spans, 6, m // 2), np.float32)
    for s in range(spans):
        weight[s, :3] = 1.0
        path, ways = rows[s], steps[s]
        for i in range(m):
            ex, ey, ez = error[s, 0, i], error[s, 1, i], error[s, 2, i]
            if _rests(ways, i):
                normal_error[s, 0, i], normal_error[s, 1, i], normal_error[s, 2, i] = ex, ey, ez
                continue
            k, along = _nearest(path, ways, ex, ey, ez, i)
            tx, ty, tz, length = ways[k, 0], ways[k, 1], ways[k, 2], ways[k, 3]
            if 0.0 < along < length:
                for at in range(i // 2, (i + 1) // 2 + 1):  # the sample at it, or those on both sides
                    if at < m // 2:
                        share = (0.5 if 2 * at == i else 0.25) * (1.0 - tangent_weight)
                        weight[s, 0, at] -= share * tx * tx
                        weight[s, 1, at] -= share * ty * ty
                        weight[s, 2, at] -= share * tz * tz
                        weight[s, 3, at] -= share * tx * ty
                        weight[s, 4, at] -= share * tx * tz
                        weight[s, 5, at] -= share * ty * tz
                along -= tangent_weight * (tx * ex + ty * ey + tz * ez)
            normal_error[s, 0, i] = path[i, 0] - path[k, 0] + ex - along * tx
            normal_error[s, 1, i] = path[i, 1] - path[k, 1] + ey - along * ty
            normal_error[s, 2, i] = path[i, 2] - path[k, 2] + ez - along * tz
    return normal_error, weight


@kernel
def _rests(steps: FloatArray, i: int) -> bool:
    """Return whether the path rests around its row i: then no other of its points is nearer."""
    for k in range(max(i - 1, 0), min(i + 2, len(steps))):
        if steps[k, 3] != 0.0:
            return False
    return i < len(steps)


@kernel
def _nearest(rows: FloatArray, steps: FloatArray, ex: float, ey: float, ez: float, i: int) -> tuple[int, float]:
    """Find the nearest of the path's steps to a position that is off its row i, and where along it: 0 to its length mm.

    The search goes downhill from i, either way. An end of a step is nearest outside a corner, or at rest.
    """
    first = min(i, len(steps) - 1)
    best, best_k, best_along, at_first = np.inf, first, 0.0, np.inf
    for way in (1, -1):
        k, last = (first, np.inf) if way == 1 else (first - 1, at_first)
        while 0 <= k < len(steps):
            x, y, z = rows[i, 0] - rows[k, 0] + ex, rows[i, 1] - rows[k, 1] + ey, rows[i, 2] - rows[k, 2] + ez
            along = min(max(steps[k, 0] * x + steps[k, 1] * y + steps[k, 2] * z, 0.0), steps[k, 3])
            x, y, z = x - along * steps[k, 0], y - along * steps[k, 1], z - along * steps[k, 2]
            apart = x * x + y * y + z * z
            if apart > last or (apart == last and steps[k, 3] == 0.0):
                break
            if apart < best:
                best, best_k, best_along = apart, k, along
            if k == first:
                at_first = apart
            last = apart
            k += way
    return best_k, best_along


@fast_kernel
def weigh(weight: ShortArray, errors: ShortArray) -> ShortArray:
    """Multiply errors (s, 3 p, m) by W (s, 6, m)."""
    out = np.empty_like(errors)
    for s in range(errors.shape[0]):
        w = weight[s]
        xx, yy, zz, xy, xz, yz = w[0], w[1], w[2], w[3], w[4], w[5]
        for p in range(0, errors.shape[1], 3):
            x, y, z = errors[s, p], errors[s, p + 1], errors[s, p + 2]
            ox, oy, oz = out[s, p], out[s, p + 1], out[s, p + 2]
            for i in range(errors.shape[2]):
                ox[i] = xx[i] * x[i] + xy[i] * y[i] + xz[i] * z[i]
                oy[i] = xy[i] * x[i] + yy[i] * y[i] + yz[i] * z[i]
                oz[i] = xz[i] * x[i] + yz[i] * y[i] + zz[i] * z[i]
    return out


def _blending(n: int, rises: bool, falls: bool) -> FloatArray:
    """(n,) shares of a span's answer: where another one goes before or after it, they add up to one."""
    share = np.ones(n)
    ramp = (np.arange(2 * BLEND) + 0.5) / (2 * BLEND)
    if rises:
        share[: 2 * BLEND] = ramp
    if falls:
        share[n - 2 * BLEND :] *= ramp[::-1]
    return share


PAYING_SD = 0.02  # of the modes: from there on it gains more than it costs on a printer as the file says
STEP = 0.01  # relative, small: what counts is the slope
LINES, LOWEST_HZ = 60, 5.0
BAND_MARGIN = 1.5  # times the bandwidth, up to which the response counts


@dataclass(frozen=True, slots=True)
class RobustChoice:
    """Whether to invert robustly, and why."""

    robust: bool
    reason: str


PLAIN = RobustChoice(False, "Plain inversion: the default.")
BOUNDED = RobustChoice(True, "Robust inversion, as always under a bound on the error.")


def choose_robust(machine: Machine, settings: Settings, requested: bool | None = None) -> RobustChoice:
    """Choose for a machine. requested : by the user; None: by the machine file."""
    if requested is not None:
        return RobustChoice(requested, f"{'Robust' if requested else 'Plain'} inversion, as requested.")
    sd = mode_sd(machine, settings.robust_share * settings.bandwidth_hz)
    known = f"by its [uncertainty] the machine file knows its modes to {100 * sd:.2g} %"
    if sd < PAYING_SD:
        return RobustChoice(False, f"Plain inversion: {known}; --robust on pays from {100 * PAYING_SD:g} %.")
    return RobustChoice(True, f"Robust inversion: {known}. If the file is exact: --robust off.")


def mode_sd(machine: Machine, bandwidth_hz: float) -> float:
    """Return the relative standard deviation of all modes together that gives the same uncertainty of the response."""
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
