"""How the response to a reference differs among the printers that a machine file's `[uncertainty]` allows.

With the plain inverse K₀ of the machine, D = G K₀ is the response to a reference. D is decomposed at each place of a
grid into its mean and its principal directions over the possible printers. Principal components: Jolliffe, Principal
Component Analysis, 2nd ed. 2002.

A path is looked at in spans of a second or two, each with the D of its middle. Some rows more are in sight on either
side of a span.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.arrays import ComplexArray, FloatArray
from models.compiled import fast_kernel
from models.machine import Machine, with_values

# NOTE: single precision is enough for an offset, which is a tenth of a millimetre, and takes half the time.
ShortArray = NDArray[np.float32]
ShortComplexArray = NDArray[np.complex64]

DRAWS, DRAWS_WIDE = 32, 128  # of twice as many the offsets are no better; where the uncertainty is wide, they are
FARTHEST = 2.5  # standard deviations
LEAST_VALUE = 0.2  # of a parameter's nominal value
DIRECTIONS = 3  # of D over the draws, besides its mean; with six the errors are 1 to 3 % lower,
DIRECTIONS_WIDE = 8  # and where the modes are known to 20 % only, three hold 70 % of the spread and eight 93 %
PLACES_MM = 15.0  # to which the middle of a span is rounded
PITCH_MM = 60.0  # half of it gives the same errors to 3 %
PLACES_KEPT = 24  # of 0.6 MB each

SPANS = (256, 384, 512, 768, 1024, 1536)  # rows worked on at a time, margins included: the first that is long enough
MARGIN = 128  # rows in sight on either side: a quarter of a second
ROWS = 3072  # whose lines of frequency are those of every span
NODE_ROWS = 1024  # whose lines D is worked out at; between them it is interpolated
SLOWEST_WEIGHED_HZ = 5.0  # from where on a draw's D is compared with one
SLOWEST_HZ = 0.1  # stands for zero where a line of frequency would be divided by it


def spans_of(n: int) -> Iterator[tuple[int, int]]:
    """Yield first and last of the rows that a path of n rows is taken in at a time, without their margins."""
    count = -(-n // (SPANS[-1] - 2 * MARGIN))
    ends = [round(k * n / count) for k in range(count + 1)]
    yield from pairwise(ends)


def span_length(rows: int) -> int:
    """Return over how many rows a span of so many is worked out."""
    return next(each for each in SPANS if rows <= each)


class Sensitivity:
    """D = G K₀ over the bed: its mean over the draws, and its principal directions.

    Without draws: the machine's own D, and the directions over its parameters, each off by one standard deviation.
    """

    def __init__(
        self,
        machine: Machine,
        row_s: float,
        bandwidth_hz: float,
        control_weight: float,
        sampled: bool = True,
        wide: bool = False,
    ) -> None:
        """Choose the printers; wide: more of them, and more directions, as a large uncertainty needs."""
        self.machine, self.row_s, self.bandwidth_hz, self.control_weight = machine, row_s, bandwidth_hz, control_weight
        self._sampled, self.directions = sampled, DIRECTIONS_WIDE if wide else DIRECTIONS
        draws = DRAWS_WIDE if wide else DRAWS
        self._possible = sampled_machines(machine, draws) if sampled else perturbed_machines(machine)
        self._nodes: dict[tuple[int, int], ShortComplexArray] = {}
        self.has_grown = False  # beyond what was taken up

    @cached_property
    def frequency(self) -> FloatArray:
        """(lines,) Hz of a span's lines, up to where nothing is commanded any more."""
        return self._lines(ROWS)

    def _lines(self, rows: int) -> FloatArray:
        f = np.fft.rfftfreq(rows, self.row_s)
        f[0] = SLOWEST_HZ
        return np.asarray(f[f <= 2.0 * self.bandwidth_hz])

    @cached_property
    def _mixing(self) -> FloatArray:
        """(1 + directions, draws): the draws' shares in their mean, and in each direction at the bed's middle."""
        d, draws = self._of_draws(np.zeros(2)), len(self._possible)
        # the first of machines that are off one at a time is the machine itself, and no draw
        mean, scale = np.eye(1, draws)[0], np.ones(draws)
        if self._sampled:
            mean = self._weights(d)
            scale = np.sqrt(mean)
        apart = scale[:, None] * (d - np.tensordot(mean, d, axes=1)).reshape(draws, -1)
        directions = scale * np.linalg.eigh((apart @ np.conj(apart.T)).real)[1][:, ::-1].T[: self.directions]
        shares = np.concatenate([mean[None], directions - directions.sum(axis=1, keepdims=True) * mean])
        return np.concatenate([shares, np.zeros((1 + self.directions - len(shares), draws))])  # always as many

    def _weights(self, d: ComplexArray) -> FloatArray:
        """Return the weight (draws,) of each draw, whose D is (draws, lines, 3, 3); their sum is one.

        Printers are judged by the mean of their errors, and the search adds up squares. A sum of squares divided by the
        errors is a sum of errors (iteratively reweighted least squares: Holland & Welsch, Communications Stat. 6 (1977)
        813-827). How large they are is foretold by how far D is from one, for accelerations of all frequencies, plus
        as much as the median draw for what the search leaves on every printer. Without weights a few far printers,
        which no command serves, decide.
        """
        f = self._lines(NODE_ROWS)
        apart = np.sum(np.abs(d - np.eye(3)) ** 2, axis=(2, 3)) * (f >= SLOWEST_WEIGHED_HZ) / f**4
        errors = np.sqrt(np.trapezoid(apart, f, axis=1))
        if not errors.any():
            return np.full(len(d), 1.0 / len(d))
        weight = 1.0 / (errors + np.median(errors))
        return np.asarray(weight / weight.sum())

    def place_of(self, xy: FloatArray) -> tuple[int, int]:
        """Return the index of the place that represents a span (m, 2) mm: nearly its middle, or that of the bed."""
        if self.machine.kinematics.model_reach_mm == 0.0:
            return 0, 0
        i, j = np.round(xy.mean(axis=0) / PLACES_MM).astype(np.int64).tolist()
        return i, j

    def of_place(self, i: int, j: int) -> ShortComplexArray:
        """Return D at a place, (1 + directions, 3, 3, lines)."""
        at = np.array([i, j]) * (PLACES_MM / PITCH_MM)
        nodes = np.floor(at).astype(np.int64) + np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        shares = np.prod(np.maximum(1.0 - np.abs(at - nodes), 0.0), axis=1).astype(np.float32)
        parts = [share * self._node((a, b)) for share, (a, b) in zip(shares, nodes.tolist(), strict=True) if share]
        known, at_nodes = np.sum(parts, axis=0), self._lines(NODE_ROWS)
        before = np.clip(np.searchsorted(at_nodes, self.frequency, side="right") - 1, 0, len(at_nodes) - 2)
        share = ((self.frequency - at_nodes[before]) / np.diff(at_nodes)[before]).astype(np.float32)
        return np.asarray(known[..., before] + share * (known[..., before + 1] - known[..., before]))

    def known(self) -> dict[str, NDArray[Any]]:
        """Return all of D so far, to be taken up again."""
        return {"node": np.array(list(self._nodes)), "response": np.stack(list(self._nodes.values()))}

    def take_up(self, known: Mapping[str, NDArray[Any]]) -> None:
        """Take up D of the same machine that somebody else has worked out."""
        for (a, b), response in zip(known["node"].tolist(), known["response"], strict=True) if known else ():
            self._nodes.setdefault((a, b), response)

    def _node(self, node: tuple[int, int]) -> ShortComplexArray:
        if node not in self._nodes:
            mixed = np.tensordot(self._mixing, self._of_draws(np.array(node) * PITCH_MM), axes=1)
            self._nodes[node], self.has_grown = np.moveaxis(mixed, 1, -1).astype(np.complex64), True
        return self._nodes[node]

    def _of_draws(self, xy: FloatArray) -> ComplexArray:
        """(draws, lines, 3, 3) at one place, or where the bed ends on the way there."""
        reach = self.machine.kinematics.model_reach_mm
        xy = xy * min(1.0, reach / max(float(np.hypot(*xy)), 1e-9))
        f = self._lines(NODE_ROWS)
        known = self.machine.vibration.frequency_response(xy, f, "nozzle", "nozzle")
        bend = (2 * np.sin(np.pi * f * 2 * self.row_s)) ** 4  # of the command, over a segment of two rows
        weight = (self.control_weight / 2 * bend)[:, None, None] * np.eye(3)
        plain = np.linalg.solve(_h(known) @ known + weight, _h(known))
        return (
            np.array([machine.vibration.frequency_response(xy, f, "nozzle", "nozzle") for machine in self._possible])
            @ plain
        )

    def to_steps(self, known: ShortComplexArray) -> ShortComplexArray:
        """D − 1 of D (1 + directions, 3, 3, lines), applied to a path's steps: (3 (1 + directions), 3, lines).

        Steps are nothing at both ends of a span, where the path itself is at different places.
        """
        error = known.copy()
        error[0] -= np.eye(3, dtype=np.float32)[:, :, None]
        return flat(error / (np.exp(2j * np.pi * self.frequency * self.row_s) - 1.0))

    def tracking_error(self, rows: FloatArray) -> ShortArray:
        """Return D r − r of a path (n + 2 MARGIN, 3) mm, which has so many rows more: (1 + directions, n, 3) mm."""
        parts = [np.empty((1 + self.directions, 0, 3), np.float32)]
        for first, last in spans_of(len(rows) - 2 * MARGIN):
            span = rows[first : last + 2 * MARGIN]
            length = span_length(len(span))
            response = self.to_steps(self.of_place(*self.place_of(span[:, :2])))[None, :, :, :: ROWS // length]
            lines = lines_of(steps_of(span, length)[None], response.shape[-1])
            error = rows_of(apply(response, lines, length // 2 + 1), length)
            parts.append(
                np.moveaxis(error[0, :, MARGIN : len(span) - MARGIN].reshape(1 + self.directions, 3, -1), 1, 2)
            )
        return np.concatenate(parts, axis=1)


def steps_of(rows: FloatArray, length: int) -> ShortArray:
    """Return a span's steps from row to row, (3, length) mm, fading in and out over half of its margins."""
    steps = np.zeros((3, length), np.float32)
    steps[:, : len(rows) - 1] = ((rows[1:] - rows[:-1]) * _fading(len(rows))[:-1, None]).T
    return steps


@lru_cache(maxsize=64)
def _fading(n: int) -> FloatArray:
    edge = np.arange(n) + 0.5
    near = np.clip(np.minimum(edge, n - edge) / (MARGIN / 2), 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * near))


def lines_of(rows: ShortArray, lines: int) -> ShortComplexArray:
    """Return the first lines of frequency of rows along the last axis."""
    from scipy import fft  # 0.1 s to import; numpy's takes six times as long for rows of 32 bits

    return np.ascontiguousarray(fft.rfft(rows, axis=-1)[..., :lines])


def rows_of(lines: ShortComplexArray, length: int) -> ShortArray:
    """Return the rows along the last axis whose lines of frequency these are."""
    from scipy import fft

    return np.asarray(fft.irfft(lines, length))


def flat(known: NDArray[np.complexfloating[Any, Any]]) -> ShortComplexArray:
    """Flatten (1 + directions, 3, 3, lines) to (3 (1 + directions), 3, lines)."""
    return np.ascontiguousarray(known.reshape(-1, 3, known.shape[-1]), dtype=np.complex64)


@fast_kernel
def apply(known: ShortComplexArray, lines: ShortComplexArray, width: int) -> ShortComplexArray:
    """Multiply known (s, p, 3, f) by lines (s, 3, f): (s, p, width), zero from f on."""
    spans, directions, _, n = known.shape
    out = np.zeros((spans, directions, width), np.complex64)
    for s in range(spans):
        for p in range(directions):
            for f in range(n):
                out[s, p, f] = (
                    known[s, p, 0, f] * lines[s, 0, f]
                    + known[s, p, 1, f] * lines[s, 1, f]
                    + known[s, p, 2, f] * lines[s, 2, f]
                )
    return out


@fast_kernel
def apply_adjoint(known: ShortComplexArray, lines: ShortComplexArray, width: int) -> ShortComplexArray:
    """Multiply the adjoint of known (s, p, 3, f) by lines (s, p, f): (s, 3, width), zero from f on."""
    spans, directions, _, n = known.shape
    out = np.zeros((spans, 3, width), np.complex64)
    for s in range(spans):
        for p in range(directions):
            for j in range(3):
                for f in range(n):
                    out[s, j, f] += np.conj(known[s, p, j, f]) * lines[s, p, f]
    return out


def sampled_machines(machine: Machine, count: int = DRAWS) -> list[Machine]:
    """Return machines as the uncertainties allow them, the same every time; an even number, or this one."""
    rng, columns = np.random.default_rng(1), machine.vibration.parameters().columns
    half = np.clip(rng.standard_normal((count // 2, columns)), -FARTHEST, FARTHEST)
    return machines_off(machine, np.concatenate([half, -half])) or [machine]  # in pairs: their mean is the machine


def perturbed_machines(machine: Machine) -> list[Machine]:
    """Return the machine, and those with one parameter off by one standard deviation."""
    columns = machine.vibration.parameters().columns
    return machines_off(machine, np.concatenate([np.zeros((1, columns)), np.eye(columns)])) or [machine]


def machines_off(machine: Machine, deviates: FloatArray) -> list[Machine]:
    """Return machines whose parameters are off by deviates (k, columns); none if the file is certain of everything."""
    parameters = machine.vibration.parameters()
    spread = parameters.relative_sd(machine.uncertainty)
    each = deviates if np.any(spread) else ()
    return [with_values(machine, parameters.scaled(row, spread, least=LEAST_VALUE)) for row in each]


def _h(matrix: ComplexArray) -> ComplexArray:
    return np.conj(np.swapaxes(matrix, -1, -2))
