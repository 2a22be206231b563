"""Responses from a single sweep, or any record that is not periodic, by the local polynomial method.

The DFT of a finite record of a linear system is Y = H U + T: the transient T, of vibration from before the record and
after it, is as smooth a function of frequency as H itself. So in a narrow window of lines around each line,
H and T are taken as polynomials, and least squares tells them apart, for U is rough: leakage is not windowed away
but estimated (Pintelon & Schoukens, System Identification, 2012, ch. 7).

A sweep's own spectrum is rough where it lies well inside the record: motion in the first or last 1/half_width seconds
looks like a transient itself. So let a record begin and end with that much rest.
"""

from __future__ import annotations

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.estimators import FrfMatrix, lines_of_dft
from models.arrays import ComplexArray, FloatArray, IntArray

_SPARE_EQUATIONS = 1.5  # equations for each unknown, at least
_BLOCK = 64  # lines solved at once, to bound memory


def sweep_frf(
    input: FloatArray,
    output: FloatArray,
    rate_hz: float,
    lowest_hz: float,
    highest_hz: float,
    *,
    half_width_hz: float = 1.0,
    degree: int = 2,
) -> FrfMatrix:
    """Estimate the response from single records by the local polynomial method; several inputs may move at once.

    The variance is of the residual, so it holds noise, nonlinear distortion, and what a polynomial cannot follow:
    where a mode is narrower than the window, it is large. Neighbouring windows share lines; the lines given are so
    far apart (window / (degree + 1)) that together they count each measured line about once.

    Parameters
    ----------
    input : (e, n, i) or (n, i) of one record, SI.
    output : (e, n, o) or (n, o), SI.
    lowest_hz, highest_hz : the band that was excited.
    half_width_hz : of the window; take about half of ζ f of the narrowest mode. Widened if the unknowns need it.
    degree : of the polynomials.
    """
    u, y = (record if record.ndim == 3 else record[None] for record in (input, output))
    frequency = lines_of_dft(u.shape[1], rate_hz)
    half = _half_width(half_width_hz / frequency[1], u.shape[0], u.shape[2], degree)
    centre = _centres(frequency, lowest_hz, highest_hz, half, degree)
    spectra_u, spectra_y = (np.fft.rfft(record - record[:, :1], axis=1) for record in (u, y))
    parts = [_local(spectra_u, spectra_y, centre[k : k + _BLOCK], half, degree) for k in range(0, len(centre), _BLOCK)]
    value, variance = (np.concatenate(blocks) for blocks in zip(*parts, strict=True))
    return FrfMatrix(frequency[centre], value, variance)


def _half_width(lines: float, experiments: int, inputs: int, degree: int) -> int:
    unknowns = (degree + 1) * (inputs + experiments)
    return max(round(lines), int(np.ceil((_SPARE_EQUATIONS * unknowns / experiments - 1) / 2)))


def _centres(frequency: FloatArray, lowest_hz: float, highest_hz: float, half: int, degree: int) -> IntArray:
    step = max(1, (2 * half + 1) // (degree + 1))
    first = max(half + 1, int(np.ceil(lowest_hz / frequency[1])))
    last = min(len(frequency) - 2 - half, int(highest_hz / frequency[1]))
    if last < first:
        rule = f"Between {lowest_hz:g} and {highest_hz:g} Hz there is no room for a window of {2 * half + 1} lines"
        raise MeasurementError("", [f"{rule} of {frequency[1]:.3g} Hz; take a longer record or a wider band."])
    return np.arange(first, last + 1, step)


def _local(
    u: ComplexArray, y: ComplexArray, centre: IntArray, half: int, degree: int
) -> tuple[ComplexArray, FloatArray]:
    """Solve around each centre, (k,): value and variance (k, o, i) from u (e, lines, i) and y (e, lines, o)."""
    inputs = u.shape[2]
    offset = np.arange(-half, half + 1)
    powers = (offset[:, None] / half) ** np.arange(degree + 1)  # (w, d)
    window = centre[:, None] + offset  # (k, w)
    regressor = _regressor(u[:, window], powers)
    observed = y[:, window].transpose(1, 0, 2, 3).reshape(len(centre), -1, y.shape[2])  # (k, e w, o)
    size = np.linalg.norm(regressor, axis=1, keepdims=True)
    size[size == 0] = 1.0
    solver = np.linalg.pinv(regressor / size, rcond=1e-9) / size.transpose(0, 2, 1)  # (k, unknowns, e w)
    unknowns = solver @ observed  # (k, unknowns, o)
    residual = observed - regressor @ unknowns
    spare = residual.shape[1] - regressor.shape[2]
    noise = (np.abs(residual) ** 2).sum(axis=1) / spare  # (k, o)
    gain = (np.abs(solver[:, :inputs]) ** 2).sum(axis=2)  # (k, i)
    return unknowns[:, :inputs].transpose(0, 2, 1), noise[:, :, None] * gain[:, None, :]


def _regressor(u: ComplexArray, powers: FloatArray) -> ComplexArray:
    """Stack columns: each input times each power (power by power, inputs side by side), then each record's transient.

    u (e, k, w, i), powers (w, d) → (k, e w, d i + e d)
    """
    e, k, w, i = u.shape
    d = powers.shape[1]
    driven = np.einsum("ekwi,wd->kewdi", u, powers).reshape(k, e * w, d * i)
    transient = np.kron(np.eye(e), powers)  # (e w, e d)
    return np.concatenate([driven, np.broadcast_to(transient, (k, e * w, e * d))], axis=2)
