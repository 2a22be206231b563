"""How the response to a reference differs among the printers that a machine file's `[uncertainty]` allows.

With the plain inverse K₀ of the machine, D = G K₀ is what comes of a reference. D is taken apart at each place of a
grid into its mean and its principal directions over the possible printers. Principal components: Jolliffe, Principal
Component Analysis, 2nd ed. 2002.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import fft

from models.arrays import ComplexArray, FloatArray
from models.machine import Machine, with_values

# NOTE: single precision is enough for d, which is a tenth of a millimetre, and takes half the time.
ShortArray = NDArray[np.float32]
ShortComplexArray = NDArray[np.complex64]

DRAWS = 32  # of twice as many the offsets are no better
FARTHEST = 2.5  # standard deviations
MIDDLES_MM = 15.0  # to which the middle of a span is rounded
PITCH_MM = 60.0  # half of it gives the same errors to 3 %

SPANS = (512, 768, 1024, 1536, 2048)  # rows worked on at a time, margins included: the first that is long enough
LINES = 1024  # rows whose lines of frequency D is worked out at; between them it is interpolated
SLOWEST_HZ = 0.1  # stands for zero where a line of frequency would be divided by it


@dataclass(frozen=True, slots=True)
class RobustSettings:
    """How much work goes into an offset."""

    directions: int = 6  # of D over the draws, besides its mean
    margin: int = 128  # rows in sight on either side: a quarter of a second
    nearby_rows: int = 8  # rows around a moment among which the path's nearest point is sought
    rounds: int = 3  # of Gauss-Newton
    steps: int = 7  # of the conjugate gradients in each
    sampled: bool = True  # D over random draws; not: over the parameters, each off by one standard deviation
    preconditioner_weight: float = (
        0.3  # curvature along the path that conjugate gradients begin with, against one across it
    )


FULL = RobustSettings()
# for a search, which solves again and again; with less ahead a small print was 15 % further off, past its bound
QUICK = RobustSettings(directions=4, rounds=2, steps=10, sampled=False, preconditioner_weight=1.0)


def span_length(rows: int) -> int:
    """Return over how many rows a span of so many is worked out."""
    return next(each for each in SPANS if rows <= each)


class Sensitivity:
    """D = G K₀ over the bed: its mean over the draws, and the directions in which it differs most."""

    def __init__(
        self, machine: Machine, row_s: float, bandwidth_hz: float, control_weight: float, solver: RobustSettings = FULL
    ) -> None:
        self.machine, self.row_s, self.bandwidth_hz, self.control_weight = machine, row_s, bandwidth_hz, control_weight
        self.solver = solver
        self._possible = sampled_machines(machine) if solver.sampled else perturbed_machines(machine)
        self._nodes: dict[tuple[int, int], ShortComplexArray] = {}
        self._middles: dict[tuple[int, int, int], Response] = {}
        self._working = Lock()

    @cached_property
    def frequency(self) -> FloatArray:
        """(lines,) Hz at which D is worked out, up to where nothing is commanded any more."""
        return self._lines(LINES)

    def _lines(self, length: int) -> FloatArray:
        f = fft.rfftfreq(length, self.row_s)
        f[0] = SLOWEST_HZ
        return np.asarray(f[f <= 2.0 * self.bandwidth_hz])

    @cached_property
    def _mixing(self) -> FloatArray:
        """(1 + directions, draws): the draws' shares in their mean, and in each direction at the bed's middle."""
        d, draws = self._of_draws(np.zeros(2)), len(self._possible)
        # the first of machines that are off one at a time is the machine itself, and no draw
        mean = np.full(draws, 1.0 / draws) if self.solver.sampled else np.eye(1, draws)[0]
        apart = (d - np.tensordot(mean, d, axes=1)).reshape(draws, -1)
        product = (apart @ np.conj(apart.T)).real
        directions = np.linalg.eigh(product)[1][:, ::-1].T[: min(self.solver.directions, draws - 1)]
        if self.solver.sampled:
            return np.concatenate([mean[None], directions / np.sqrt(draws)])
        return np.concatenate([mean[None], directions - directions.sum(axis=1, keepdims=True) * mean])

    def along(self, place: FloatArray, length: int) -> Response:
        """For a span of places (m, 2) mm, worked out over `length` rows: all of it as at its middle."""
        i, j = np.round(place.mean(axis=0) / MIDDLES_MM).astype(np.int64).tolist()
        if (i, j, length) not in self._middles:
            at = np.array([i, j]) * (MIDDLES_MM / PITCH_MM)
            nodes = np.floor(at).astype(np.int64) + np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
            shares = np.prod(np.maximum(1.0 - np.abs(at - nodes), 0.0), axis=1)
            with self._working:
                known = [
                    share * self._node((a, b)) for share, (a, b) in zip(shares, nodes.tolist(), strict=True) if share
                ]
            self._middles[i, j, length] = self._response(np.sum(known, axis=0), length)
        return self._middles[i, j, length].of_rows(len(place))

    def _response(self, known: ShortComplexArray, length: int) -> Response:
        f = self._lines(length)
        before = np.clip(np.searchsorted(self.frequency, f, side="right") - 1, 0, len(self.frequency) - 2)
        share = (f - self.frequency[before]) / np.diff(self.frequency)[before]
        known = known[..., before] * (1.0 - share) + known[..., before + 1] * share
        # beyond the bandwidth nothing is commanded: leave the offset alone
        band = np.clip(2.0 - f / self.bandwidth_hz, 0.0, 1.0)
        rate = np.exp(2j * np.pi * f * self.row_s) - 1.0
        return Response(known, band, rate, length)

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
        weight = (self.control_weight / 2 * bend)[:, None, None] * np.eye(3)
        plain = np.linalg.solve(_h(known) @ known + weight, _h(known))
        return (
            np.array([machine.vibration.frequency_response(xy, f, "nozzle", "nozzle") for machine in self._possible])
            @ plain
        )


class Response:
    """The response of the mean machine and of those off in each direction to an offset, over one span of m rows."""

    def __init__(self, known: ShortComplexArray, band: FloatArray, rate: ComplexArray, length: int) -> None:
        """Hold D.

        known : (1 + directions, 3, 3, lines);  band : (lines,) of an offset

        rate : (lines,) of the step from one row to the next, for a row of one
        """
        self._length, self._count = length, length
        tracking_error = known.copy()
        tracking_error[0] -= np.eye(3, dtype=np.float32)[:, :, None]
        # by the path's steps: they are nothing at both ends, where the path itself is at different places
        self._tracking_error = _flat(tracking_error / rate)
        self._known = _flat(known * band)

    def of_rows(self, count: int) -> Response:
        """Return it for so many rows."""
        other = copy(self)
        other._count = count
        return other

    def to_path(self, steps: ShortArray) -> ShortArray:
        """D r − r of a path with these steps (m, 3) mm from row to row: (1 + directions, m, 3) mm."""
        return self._through(self._tracking_error, steps)

    def to_offset(self, d: ShortArray) -> ShortArray:
        """D d of (m, 3) mm: (1 + directions, m, 3) mm."""
        return self._through(self._known, d)

    def adjoint(self, errors: ShortArray) -> ShortArray:
        """(m, 3) of errors (1 + directions, m, 3): the transpose of `to_offset`."""
        rows = np.swapaxes(errors, 1, 2).reshape(-1, errors.shape[1])
        return self._rows(_transposed(self._known, self._lines(rows))).T

    def _through(self, known: ShortComplexArray, rows: ShortArray) -> ShortArray:
        answers = self._rows(_applied(known, self._lines(np.ascontiguousarray(rows.T))))
        return np.swapaxes(answers.reshape(-1, 3, len(rows)), 1, 2)

    def _lines(self, rows: ShortArray) -> ShortComplexArray:
        """(p, lines) of (p, m)."""
        return np.ascontiguousarray(fft.rfft(rows, self._length, axis=-1)[:, : self._known.shape[-1]])

    def _rows(self, lines: ShortComplexArray) -> ShortArray:
        """(p, m) of (p, lines)."""
        return np.asarray(fft.irfft(lines, self._length, axis=-1)[:, : self._count])


def _flat(known: NDArray[np.complexfloating[Any, Any]]) -> ShortComplexArray:
    """Flatten to ((1 + directions) · 3, 3, lines)."""
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


def sampled_machines(machine: Machine, count: int = DRAWS) -> list[Machine]:
    """Return machines as the uncertainties allow them, the same every time; an even number, or this one."""
    parameters = machine.vibration.parameters()
    spread = parameters.relative_sd(machine.uncertainty)
    if not np.any(spread):
        return [machine]
    rng = np.random.default_rng(1)
    half = np.clip(rng.standard_normal((count // 2, parameters.columns)), -FARTHEST, FARTHEST)
    draws = np.concatenate([half, -half])  # in pairs: their mean is the machine
    return [with_values(machine, parameters.scaled(row, spread, least=0.2)) for row in draws]


def perturbed_machines(machine: Machine) -> list[Machine]:
    """Return the machine, and those of which one parameter is off by one standard deviation."""
    parameters = machine.vibration.parameters()
    spread = parameters.relative_sd(machine.uncertainty)
    deviates = np.concatenate([np.zeros((1, parameters.columns)), np.eye(parameters.columns)])
    if not np.any(spread):
        return [machine]
    return [with_values(machine, parameters.scaled(row, spread, least=0.2)) for row in deviates]


def _h(matrix: ComplexArray) -> ComplexArray:
    return np.conj(np.swapaxes(matrix, -1, -2))
