"""Time records to frequency responses: periodic excitation, and random excitation by averaged spectra.

Two estimators, by excitation: `periodic_frf` for whole periods of a multisine or stepped sine, `sweep_frf` for a single
sweep or any record that is not periodic.

Records are samples of smooth signals: the command is what its samples say if its spectrum ends below half the rate,
so spectra of samples are divided directly. Acceleration outputs need no integration: the response of the position
is that of the acceleration divided by (jω)².

Axes, everywhere: e experiments, n samples, i inputs, o outputs, k frequency lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from ffcomp.errors import MeasurementError
from ffcomp.measurement.frf import FrequencyResponse
from models.arrays import ComplexArray, FloatArray, IntArray

_NEIGHBOURS = 9  # lines a noise level is averaged over: five periods then give 72 degrees of freedom
_EXCITED_LOCALLY = 0.05  # of the strongest of the lines around
_EXCITED_AT_ALL = 1e-6  # of the strongest of all lines: below is rounding
_AROUND = 21  # lines


@dataclass(frozen=True, eq=False)
class FrfMatrix:
    """The response of every output to every input."""

    frequency_hz: FloatArray  # (k,)
    value: ComplexArray  # (k, o, i)
    variance: FloatArray  # (k, o, i) E|δ|²

    def responses(
        self, inputs: Sequence[str], outputs: Sequence[str], band_hz: tuple[float, float], **labels: Any
    ) -> list[FrequencyResponse]:
        """Split into one response for each output and input, within a band; `labels` are fields of all of them."""
        return [
            FrequencyResponse(u, y, self.frequency_hz, self.value[:, o, i], self.variance[:, o, i], **labels).between(
                *band_hz
            )
            for o, y in enumerate(outputs)
            for i, u in enumerate(inputs)
        ]


def periodic_frf(
    input: FloatArray,
    output: FloatArray,
    rate_hz: float,
    period_samples: int,
) -> FrfMatrix:
    """Estimate the response to a periodic excitation from the mean over whole periods; its variance from their spread.

    With several inputs, H = Y U⁺ from at least as many experiments with different commands. The spread of
    Y − H U over the periods holds the noise of outputs and inputs alike (Pintelon & Schoukens, System
    Identification, 2012, ch. 2 and 3); few periods say little about it, so it is averaged over nine neighbouring
    lines before it goes through U⁺. The lines are those where the weakest direction of the inputs reaches 5 % of the
    strongest line nearby.

    input : (e, n, i) or (n, i) of one experiment.
    output : (e, n, o) or (n, o).
    period_samples : length of a period, a whole number of samples. The first one is left out: the machine settles.
    """
    u, y = _experiments(input), _experiments(output)
    periods = u.shape[1] // period_samples - 1
    if periods < 2:
        rule = f"{periods} whole periods of {period_samples} samples are left after one for settling"
        raise MeasurementError("", [f"{rule}; at least 2 are needed for a mean and a variance."])
    if u.shape[0] < u.shape[2]:
        rule = f"{u.shape[2]} inputs need at least {u.shape[2]} experiments with different commands, but there are"
        raise MeasurementError("", [f"{rule} {u.shape[0]}; sweep_frf can do with fewer."])
    spectra = [_period_spectra(record, period_samples, periods) for record in (u, y)]
    mean_u, mean_y = (spectrum.mean(axis=0) for spectrum in spectra)  # (e, k, i), (e, k, o)
    frequency = lines_of_dft(period_samples, rate_hz)
    lines = _excited(mean_u)
    solver = np.linalg.pinv(mean_u[:, lines].transpose(1, 0, 2))  # (k, i, e)
    value = (solver @ mean_y[:, lines].transpose(1, 0, 2)).transpose(0, 2, 1)  # (k, o, i)
    residual = spectra[1][:, :, lines] - np.einsum("peki,koi->peko", spectra[0][:, :, lines], value)
    spread = (np.abs(residual - residual.mean(axis=0)) ** 2).sum(axis=0) / (periods - 1) / periods
    noise = uniform_filter1d(spread, min(_NEIGHBOURS, len(lines)), axis=1, mode="nearest")  # (e, k, o)
    variance = np.einsum("eko,kie->koi", noise, np.abs(solver) ** 2)
    return FrfMatrix(frequency[lines], value, variance)


def _experiments(record: FloatArray) -> FloatArray:
    return record if record.ndim == 3 else record[None]


def _period_spectra(record: FloatArray, period: int, periods: int) -> ComplexArray:
    """Transform each period but the first: (e, n, c) -> (p, e, k, c)."""
    e, _, c = record.shape
    cut = record[:, period : (1 + periods) * period].reshape(e, periods, period, c)
    return np.asarray(np.fft.rfft(cut - cut.mean(axis=(1, 2), keepdims=True), axis=2).transpose(1, 0, 2, 3))


def lines_of_dft(samples: int, rate_hz: float) -> FloatArray:
    """Return the frequencies of a real record's DFT, (samples // 2 + 1,) Hz."""
    return np.arange(samples // 2 + 1, dtype=np.float64) * (rate_hz / samples)


def _excited(mean_u: ComplexArray) -> IntArray:
    """Find the lines where all inputs can be separated, (e, k, i) -> indices."""
    singular = np.linalg.svd(mean_u.transpose(1, 0, 2), compute_uv=False)  # (k, i)
    strongest, weakest = singular[:, 0], singular[:, -1]
    nearby = maximum_filter1d(strongest, _AROUND, mode="nearest")
    keep = (weakest > _EXCITED_LOCALLY * nearby) & (weakest > _EXCITED_AT_ALL * strongest.max())
    keep[[0, -1]] = False
    if not keep.any():
        raise MeasurementError("", ["No line is excited in all inputs; give different commands to the experiments."])
    return np.flatnonzero(keep)


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

    input : (e, n, i) or (n, i) of one record, SI.
    output : (e, n, o) or (n, o), SI.
    lowest_hz, highest_hz : the band that was excited.
    half_width_hz : of the window; take about half of ζ f of the narrowest mode. Widened if the unknowns need it.
    degree : of the polynomials.
    """
    u, y = _experiments(input), _experiments(output)
    frequency = lines_of_dft(u.shape[1], rate_hz)
    unknowns = (degree + 1) * (u.shape[2] + len(u))
    half = max(round(half_width_hz / frequency[1]), int(np.ceil((_SPARE_EQUATIONS * unknowns / len(u) - 1) / 2)))
    centre = _centres(frequency, lowest_hz, highest_hz, half, degree)
    spectra_u, spectra_y = (np.fft.rfft(record - record[:, :1], axis=1) for record in (u, y))
    parts = [_local(spectra_u, spectra_y, centre[k : k + _BLOCK], half, degree) for k in range(0, len(centre), _BLOCK)]
    value, variance = (np.concatenate(blocks) for blocks in zip(*parts, strict=True))
    return FrfMatrix(frequency[centre], value, variance)


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
