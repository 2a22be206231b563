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

D is taken apart once for each place of a grid, into its mean and its principal directions over the draws
(`Sensitivity`). The expectation is the mean over machines that lie on either side of the mean in each direction, so far
that their spread is right: sigma points. The minimum is sought by Gauss-Newton steps, from nearest points to nearest
points, with conjugate gradients for each, in spans of some seconds which overlap.

The minimum of an expected error over uncertain parameters: Nagy & Braatz, J. Process Control 14 (2004) 411-422. Errors
across a path rather than at a time: Koren, J. Dyn. Sys. Meas. Control 102 (1980) 265-272. Sigma points: Julier &
Uhlmann, Proc. IEEE 92 (2004) 401-422.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

from models.arrays import BoolArray, ComplexArray, FloatArray
from models.machine import Machine
from models.parameters import with_values

# NOTE: single precision is enough for d, which is a tenth of a millimetre, and takes half the time.
ShortArray = NDArray[np.float32]
ShortComplexArray = NDArray[np.complex64]

DRAWS = 64
FARTHEST = 2.5  # standard deviations
MIDDLES_MM = 15.0  # to which the middle of a span is rounded, where that is enough
PITCH_MM = 60.0  # half of it gives the same errors to 3 %

SPANS = (512, 1024, 2048)  # rows worked on at a time, margins included: the first that is long enough
BLEND = 64  # rows over which one span's answer goes over into the next one's
SLOWEST_HZ = 0.1  # stands for zero where a line of frequency would be divided by it

ALONG = 0.002  # ε
CALM = 1e-3  # λ
CLOSE = 1e-4  # share of the gradient's square at which the conjugate gradients end earlier


@dataclass(frozen=True, slots=True)
class Care:
    """How much work goes into an offset."""

    directions: int = 6  # of D over the draws, besides its mean
    margin: int = 256  # rows in sight on either side: half a second, after which the machine has forgotten
    shortest: int = 1024  # rows worked on at a time, at least
    near: int = 25  # rows around a moment among which the path's nearest point is sought
    rounds: int = 3  # of Gauss-Newton
    steps: int = 10  # of the conjugate gradients in each
    everywhere: bool = True  # D of every place; not: of the middle of each span
    drawn: bool = True  # D over random draws; not: over the parameters, each off by one standard deviation


FULL = Care()
QUICK = Care(
    directions=4, margin=128, shortest=512, near=8, rounds=2, steps=10, everywhere=False, drawn=False
)  # 95 % of the gain


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
        length = next(each for each in SPANS if max(len(rows), care.shortest) <= each)
        response = self.sensitivity.along(rows[:, :2], length)
        allowed = moving[:, None].astype(np.float32)
        rates = np.diff(rows, axis=0, append=rows[-1:]) * _faded(len(rows), care.margin)[:, None]
        missed = response.to_path(rates.astype(np.float32))
        d = np.zeros(rows.shape, np.float32)

        def gradient(errors: ShortArray) -> ShortArray:
            return allowed * response.adjoint(gathered(errors))

        for _ in range(care.rounds):
            left, along = beside(rows, sigma_points(missed + response.to_offset(d)), care.near)

            def curvature(change: ShortArray, along: ShortArray = along) -> ShortArray:
                return allowed * response.adjoint(weighed(response.to_offset(change), along)) + CALM * change

            d = d + conjugate_gradients(curvature, -gradient(left) - CALM * d, care.steps)
        return d.astype(np.float64)


def sigma_points(errors: ShortArray) -> ShortArray:
    """(2 k, m, 3): with the mean errors[0] and the spread of the other k of errors (1 + k, m, 3)."""
    far = np.float32(np.sqrt(len(errors) - 1)) * errors[1:]
    return np.concatenate([errors[0] + far, errors[0] - far])


def gathered(points: ShortArray) -> ShortArray:
    """Apply the transpose of `sigma_points` over their number: (1 + k, m, 3) of (2 k, m, 3)."""
    k = len(points) // 2
    apart = (points[:k] - points[k:]) * np.float32(0.5 / np.sqrt(k))
    return np.concatenate([points.mean(axis=0, keepdims=True), apart])


def across(errors: ShortArray, along: ShortArray) -> ShortArray:
    """Errors (p, m, 3) with what lies along the directions (p, m, 3) shortened to ε of it."""
    return errors - np.float32(1.0 - ALONG) * np.sum(along * errors, axis=-1, keepdims=True) * along


@njit(cache=True, nogil=True)
def beside(rows: FloatArray, missed: ShortArray, near: int = FULL.near) -> tuple[ShortArray, ShortArray]:
    """Return n + ε l, and T, for the path (m, 3) mm whose positions are missed by (p, m, 3) mm.

    near : rows around a moment among which the path's nearest point is sought

    Returns
    -------
    (p, m, 3) mm; (p, m, 3), zero where the nearest point is a corner or the nozzle rests
    """
    left, along = np.empty_like(missed), np.zeros_like(missed)
    for p in range(len(missed)):
        for i in range(len(rows)):
            x, y, z = rows[i, 0] + missed[p, i, 0], rows[i, 1] + missed[p, i, 1], rows[i, 2] + missed[p, i, 2]
            k, share = _nearest(rows, x, y, z, max(i - near, 0), min(i + near, len(rows) - 1))
            kept = min(max(share, 0.0), 1.0)
            ux, uy, uz = rows[k + 1, 0] - rows[k, 0], rows[k + 1, 1] - rows[k, 1], rows[k + 1, 2] - rows[k, 2]
            left[p, i, 0] = x - rows[k, 0] - kept * ux
            left[p, i, 1] = y - rows[k, 1] - kept * uy
            left[p, i, 2] = z - rows[k, 2] - kept * uz
            if kept == share:
                late = ux * missed[p, i, 0] + uy * missed[p, i, 1] + uz * missed[p, i, 2]
                size = ux * ux + uy * uy + uz * uz
                length = np.sqrt(size)
                along[p, i, 0], along[p, i, 1], along[p, i, 2] = ux / length, uy / length, uz / length
                left[p, i, 0] += ALONG * late / size * ux
                left[p, i, 1] += ALONG * late / size * uy
                left[p, i, 2] += ALONG * late / size * uz
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
def weighed(errors: ShortArray, along: ShortArray) -> ShortArray:
    """Return `gathered(across(sigma_points(errors), along))`, in one pass."""
    k, m = len(errors) - 1, errors.shape[1]
    out = np.zeros_like(errors)
    far, least = np.float32(np.sqrt(k)), np.float32(1.0 - ALONG)
    share, mean = np.float32(0.5 / np.sqrt(k)), np.float32(0.5 / k)
    point = np.empty(3, np.float32)
    for j in range(2 * k):
        sign = np.float32(1.0) if j < k else np.float32(-1.0)
        d = 1 + j % k
        for i in range(m):
            late = np.float32(0.0)
            for c in range(3):
                point[c] = errors[0, i, c] + sign * far * errors[d, i, c]
                late += along[j, i, c] * point[c]
            for c in range(3):
                value = point[c] - least * late * along[j, i, c]
                out[0, i, c] += mean * value
                out[d, i, c] += sign * share * value
    return out


def conjugate_gradients(apply: Callable[[ShortArray], ShortArray], wanted: ShortArray, steps: int) -> ShortArray:
    """Solve A x = b for a positive definite A, as far as so many steps go. Hestenes & Stiefel 1952."""
    x = np.zeros_like(wanted)
    left, direction = wanted, wanted
    size = first = np.vdot(left, left)
    for _ in range(steps):
        if size <= CLOSE * first:
            break
        turned = apply(direction)
        share = size / np.vdot(direction, turned)
        x = x + share * direction
        left = left - share * turned
        size, before = np.vdot(left, left), size
        direction = left + size / before * direction
    return x


# ---- the machine's response to an offset ---------------------------------------------------------


class Sensitivity:
    """D = G K₀ over the bed: its mean over the draws, and the directions in which it differs most."""

    def __init__(self, machine: Machine, row_s: float, bandwidth_hz: float, effort: float, care: Care = FULL) -> None:
        self.machine, self.row_s, self.bandwidth_hz, self.effort = machine, row_s, bandwidth_hz, effort
        self.care = care
        self._possible = drawn_machines(machine) if care.drawn else machines_off(machine)
        self._nodes: dict[tuple[int, int], ShortComplexArray] = {}
        self._middles: dict[tuple[int, int, int], Response] = {}
        self._working = Lock()

    @cached_property
    def frequency(self) -> FloatArray:
        """(lines,) Hz of the longest span, up to where nothing is commanded any more."""
        f = fft.rfftfreq(SPANS[-1], self.row_s)
        f[0] = SLOWEST_HZ
        return np.asarray(f[f <= 2.0 * self.bandwidth_hz])

    @cached_property
    def _mixing(self) -> FloatArray:
        """(1 + directions, draws): the draws' shares in their mean, and in each direction at the bed's middle."""
        d, draws = self._of_draws(np.zeros(2)), len(self._possible)
        # the first of machines that are off one at a time is the machine itself, and no draw
        mean = np.full(draws, 1.0 / draws) if self.care.drawn else np.eye(1, draws)[0]
        apart = (d - np.tensordot(mean, d, axes=1)).reshape(draws, -1)
        product = (apart @ np.conj(apart.T)).real
        directions = np.linalg.eigh(product)[1][:, ::-1].T[: min(self.care.directions, draws - 1)]
        if self.care.drawn:
            return np.concatenate([mean[None], directions / np.sqrt(draws)])
        return np.concatenate([mean[None], directions - directions.sum(axis=1, keepdims=True) * mean])

    def along(self, place: FloatArray, length: int) -> Response:
        """For a span of places (m, 2) mm, worked out over `length` rows."""
        if not self.care.everywhere:
            return self._at(place.mean(axis=0), len(place), length)
        low = np.floor(place / PITCH_MM).astype(np.int64)
        nodes = np.unique((low[:, None] + np.array([[0, 0], [0, 1], [1, 0], [1, 1]])).reshape(-1, 2), axis=0)
        near = np.prod(np.maximum(1.0 - np.abs(place / PITCH_MM - nodes[:, None]), 0.0), axis=2)
        used = near.max(axis=1) > 0.0
        with self._working:
            known = [self._node((i, j)) for i, j in nodes[used].tolist()]
        return self._response(np.array(known), near[used], length)

    def _at(self, middle: FloatArray, rows: int, length: int) -> Response:
        """For a span that is taken to be all at one place (2,) mm, between the grid's nodes."""
        i, j = np.round(middle / MIDDLES_MM).astype(np.int64).tolist()
        if (i, j, length) not in self._middles:
            place = np.array([i, j]) * (MIDDLES_MM / PITCH_MM)
            nodes = np.floor(place).astype(np.int64) + np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
            shares = np.prod(np.maximum(1.0 - np.abs(place - nodes), 0.0), axis=1)
            with self._working:
                known = [
                    share * self._node((a, b)) for share, (a, b) in zip(shares, nodes.tolist(), strict=True) if share
                ]
            self._middles[i, j, length] = self._response(np.sum(known, axis=0)[None], np.ones((1, length)), length)
        return self._middles[i, j, length].of_rows(rows)

    def _response(self, known: ShortComplexArray, near: FloatArray, length: int) -> Response:
        every = SPANS[-1] // length
        f = self.frequency[::every]
        # beyond the bandwidth nothing is commanded: leave the offset alone
        band = np.clip(2.0 - f / self.bandwidth_hz, 0.0, 1.0)
        rate = np.exp(2j * np.pi * f * self.row_s) - 1.0
        return Response(known[..., ::every], near, band, rate, length)

    def _node(self, node: tuple[int, int]) -> ShortComplexArray:
        """Return D at a node, (1 + directions, 3, 3, lines)."""
        if node not in self._nodes:
            mixed = np.tensordot(self._mixing, self._of_draws(np.array(node) * PITCH_MM), axes=1)
            self._nodes[node] = np.moveaxis(mixed, 1, -1).astype(np.complex64)
        return self._nodes[node]

    def _of_draws(self, xy: FloatArray) -> ComplexArray:
        """(draws, lines, 3, 3) at one place, or where the bed ends on the way there."""
        reach = self.machine.kinematics.model_reach_mm
        xy = xy * min(1.0, reach / max(float(np.hypot(*xy)), 1e-9))
        f = self.frequency
        known = self.machine.vibration.frequency_response(xy, f, "nozzle", "nozzle")
        bend = (2 * np.sin(np.pi * f * 2 * self.row_s)) ** 4  # of the command, over a segment of two rows
        weight = (self.effort / 2 * bend)[:, None, None] * np.eye(3)
        plain = np.linalg.solve(_h(known) @ known + weight, _h(known))
        return (
            np.array([machine.vibration.frequency_response(xy, f, "nozzle", "nozzle") for machine in self._possible])
            @ plain
        )


class Response:
    """The response of the mean machine and of those off in each direction to an offset, over one span of m rows.

    The machine changes along the path: what each node of the grid would answer is weighed by how near it is.
    """

    def __init__(
        self, known: ShortComplexArray, near: FloatArray, band: FloatArray, rate: ComplexArray, length: int
    ) -> None:
        """Hold the nodes' responses.

        known : (nodes, 1 + directions, 3, 3, lines);  near : (nodes, m)

        band : (lines,) of an offset;  rate : (lines,) of the step from one row to the next, for a row of one
        """
        self._nodes, self._length, self._near = len(known), length, near.astype(np.float32)
        missed = known.copy()
        missed[:, 0] -= np.eye(3, dtype=np.float32)[:, :, None]
        # by the path's steps: they are nothing at both ends, where the path itself is at different places
        self._missed = _flat(missed / rate)
        self._known = _flat(known * band)

    def of_rows(self, count: int) -> Response:
        """Return it for so many rows, all of them at the one place that it is for."""
        own = copy(self)
        own._near = np.ones((1, count), np.float32)
        return own

    def to_path(self, steps: ShortArray) -> ShortArray:
        """D r − r of a path with these steps (m, 3) mm from row to row: (1 + directions, m, 3) mm."""
        return self._through(self._missed, steps)

    def to_offset(self, d: ShortArray) -> ShortArray:
        """D d of (m, 3) mm: (1 + directions, m, 3) mm."""
        return self._through(self._known, d)

    def adjoint(self, errors: ShortArray) -> ShortArray:
        """(m, 3) of errors (1 + directions, m, 3): the transpose of `to_offset`."""
        weighed = self._near[:, None, None, :] * np.swapaxes(errors, 1, 2)
        return self._rows(_transposed(self._known, self._lines(weighed.reshape(-1, weighed.shape[-1])))).T

    def _through(self, known: ShortComplexArray, rows: ShortArray) -> ShortArray:
        answers = self._rows(_applied(known, self._lines(np.ascontiguousarray(rows.T))))
        return np.einsum("gn,gkin->kni", self._near, answers.reshape(self._nodes, -1, 3, len(rows)))

    def _lines(self, rows: ShortArray) -> ShortComplexArray:
        """(p, lines) of (p, m)."""
        return np.ascontiguousarray(fft.rfft(rows, self._length, axis=-1)[:, : self._known.shape[-1]])

    def _rows(self, lines: ShortComplexArray) -> ShortArray:
        """(p, m) of (p, lines)."""
        return np.asarray(fft.irfft(lines, self._length, axis=-1)[:, : self._near.shape[1]])


def _flat(known: NDArray[np.complexfloating[Any, Any]]) -> ShortComplexArray:
    """Flatten to (nodes · (1 + directions) · 3, 3, lines)."""
    return np.ascontiguousarray(known.reshape(-1, 3, known.shape[-1]), dtype=np.complex64)


@njit(cache=True, nogil=True, fastmath=True)
def _applied(known: ShortComplexArray, lines: ShortComplexArray) -> ShortComplexArray:
    """Multiply known (p, 3, f) by lines (3, f): (p, f)."""
    out = np.empty((len(known), lines.shape[1]), np.complex64)
    for p in range(len(known)):
        for f in range(lines.shape[1]):
            out[p, f] = known[p, 0, f] * lines[0, f] + known[p, 1, f] * lines[1, f] + known[p, 2, f] * lines[2, f]
    return out


@njit(cache=True, nogil=True, fastmath=True)
def _transposed(known: ShortComplexArray, lines: ShortComplexArray) -> ShortComplexArray:
    """Multiply the adjoint of known (p, 3, f) by lines (p, f): (3, f)."""
    out = np.zeros((3, lines.shape[1]), np.complex64)
    for p in range(len(known)):
        for j in range(3):
            for f in range(lines.shape[1]):
                out[j, f] += np.conj(known[p, j, f]) * lines[p, f]
    return out


def drawn_machines(machine: Machine, count: int = DRAWS) -> list[Machine]:
    """Return machines as the uncertainties allow them, the same every time; an even number, or this one."""
    parameters = machine.vibration.parameters()
    spread = parameters.relative_sd(machine.uncertainty)
    if not np.any(spread):
        return [machine]
    rng = np.random.default_rng(1)
    half = np.clip(rng.standard_normal((count // 2, parameters.columns)), -FARTHEST, FARTHEST)
    draws = np.concatenate([half, -half])  # in pairs: their mean is the machine
    return [with_values(machine, parameters.scaled(row, spread, least=0.2)) for row in draws]


def machines_off(machine: Machine) -> list[Machine]:
    """Return the machine, and those of which one parameter is off by one standard deviation."""
    parameters = machine.vibration.parameters()
    spread = parameters.relative_sd(machine.uncertainty)
    deviates = np.concatenate([np.zeros((1, parameters.columns)), np.eye(parameters.columns)])
    if not np.any(spread):
        return [machine]
    return [with_values(machine, parameters.scaled(row, spread, least=0.2)) for row in deviates]


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


def _h(matrix: ComplexArray) -> ComplexArray:
    return np.conj(np.swapaxes(matrix, -1, -2))
