"""Time records to frequency responses: periodic excitation, and random excitation by averaged spectra.

Three estimators, by excitation: `periodic_frf` for whole periods of a multisine or stepped sine, `welch_frf` for
noise and long prints, `sweep_frf` (in sweep.py) for a single sweep or any record that is not periodic.

Records are samples of smooth signals: the command is what its samples say if its spectrum ends below half the rate,
so spectra of samples are divided as they are. Acceleration outputs need no integration: the response of the position
is that of the acceleration divided by (jω)² (`as_position`).

Axes, everywhere: e experiments, n samples, i inputs, o outputs, k frequency lines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import get_window

from ffcomp.errors import MeasurementError
from ffcomp.measurement.frf import FrequencyResponse, Setup, variance_from_coherence
from models.arrays import ComplexArray, FloatArray, IntArray

Estimator = Literal["h1", "h2", "hv"]

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
    coherence: FloatArray | None = None  # (k, o), multiple coherence
    averages: float = 1.0  # effective number behind the coherence

    def responses(
        self,
        inputs: Sequence[str],
        outputs: Sequence[str],
        *,
        setup: Setup = "assembly",
        position_mm: tuple[float, float, float] | None = None,
        added_mass_kg: float = 0.0,
        source: str = "",
        clock: str = "",
    ) -> list[FrequencyResponse]:
        """Split into one response for each output and input; `coherence` only where there is one input."""
        one_input = len(inputs) == 1 and self.coherence is not None
        return [
            FrequencyResponse(
                input_name,
                output_name,
                self.frequency_hz,
                self.value[:, o, i],
                self.variance[:, o, i],
                setup,
                position_mm,
                added_mass_kg,
                self.coherence[:, o] if one_input and self.coherence is not None else None,
                source,
                clock,
            )
            for o, output_name in enumerate(outputs)
            for i, input_name in enumerate(inputs)
        ]

    def between(self, lowest_hz: float, highest_hz: float) -> FrfMatrix:
        """Restrict to a band, both ends included."""
        keep = (self.frequency_hz >= lowest_hz) & (self.frequency_hz <= highest_hz)
        return replace(
            self,
            frequency_hz=self.frequency_hz[keep],
            value=self.value[keep],
            variance=self.variance[keep],
            coherence=None if self.coherence is None else self.coherence[keep],
        )


def as_position(response: FrequencyResponse) -> FrequencyResponse:
    """Convert the response of an acceleration to that of the position: H / (jω)²."""
    if not response.output.startswith("acc_"):
        return response
    omega2 = (2 * np.pi * response.frequency_hz) ** 2
    return replace(
        response,
        output="pos_" + response.output.removeprefix("acc_"),
        value=response.value / -omega2,
        variance=response.variance / omega2**2,
    )


def periodic_frf(
    input: FloatArray,
    output: FloatArray,
    rate_hz: float,
    period_samples: int,
    *,
    transient_periods: int = 1,
    lines_hz: FloatArray | None = None,
) -> FrfMatrix:
    """Estimate the response to a periodic excitation from the mean over whole periods; its variance from their spread.

    With several inputs, H = Y U⁺ from at least as many experiments with different commands. The spread of
    Y − H U over the periods holds the noise of outputs and inputs alike (Pintelon & Schoukens, System
    Identification, 2012, ch. 2 and 3); few periods say little about it, so it is averaged over nine neighbouring
    lines before it goes through U⁺.

    Parameters
    ----------
    input : (e, n, i) or (n, i) of one experiment.
    output : (e, n, o) or (n, o).
    period_samples : length of a period, a whole number of samples.
    transient_periods : so many are dropped at the beginning, while the machine settles.
    lines_hz : the lines that are excited; found if not given: where the weakest direction of the inputs reaches
        5 % of the strongest line nearby.
    """
    u, y = _experiments(input), _experiments(output)
    periods = u.shape[1] // period_samples - transient_periods
    if periods < 2:
        rule = f"{periods} whole periods of {period_samples} samples are left after {transient_periods} for settling"
        raise MeasurementError("", [f"{rule}; at least 2 are needed for a mean and a variance."])
    _enough_experiments(u)
    spectra = [_period_spectra(record, period_samples, transient_periods, periods) for record in (u, y)]
    mean_u, mean_y = (spectrum.mean(axis=0) for spectrum in spectra)  # (e, k, i), (e, k, o)
    frequency = lines_of_dft(period_samples, rate_hz)
    lines = _excited(mean_u) if lines_hz is None else _lines_of(lines_hz, frequency)
    solver = np.linalg.pinv(mean_u[:, lines].transpose(1, 0, 2))  # (k, i, e)
    value = (solver @ mean_y[:, lines].transpose(1, 0, 2)).transpose(0, 2, 1)  # (k, o, i)
    residual = spectra[1][:, :, lines] - np.einsum("peki,koi->peko", spectra[0][:, :, lines], value)
    spread = (np.abs(residual - residual.mean(axis=0)) ** 2).sum(axis=0) / (periods - 1) / periods
    noise = uniform_filter1d(spread, min(_NEIGHBOURS, len(lines)), axis=1, mode="nearest")  # (e, k, o)
    variance = np.einsum("eko,kie->koi", noise, np.abs(solver) ** 2)
    return FrfMatrix(frequency[lines], value, variance, averages=float(periods))


def welch_frf(
    input: FloatArray,
    output: FloatArray,
    rate_hz: float,
    segment_samples: int,
    *,
    overlap: float = 0.5,
    window: str = "hann",
    estimator: Estimator = "h1",
) -> FrfMatrix:
    """Estimate the response from spectra averaged over overlapping windowed segments (Welch, 1967).

    H1 = S_yu S_uu⁻¹ is free of bias from noise on the outputs, H2 = S_yy / S_uy of noise on the input, and
    Hv, their geometric mean, errs least where both have equal shares (Rocklin, Crowley & Vold, 1985). H1 takes any
    number of inputs that are not coherent with one another; H2 and Hv take one.

    The variance of H1 is S_ee (S_uu⁻¹)_ii / (m − i), S_ee the power that the inputs do not explain and m the
    effective number of averages (Bendat & Piersol, 2010, 9.1.2); about the estimate's own mean, without its bias.
    A resonance narrower than a few lines is flattened by the window: take segments longer than 4 / (ζ f).

    Parameters
    ----------
    input : (n, i), or (e, n, i) of several records.
    output : (n, o) or (e, n, o).
    segment_samples : length of a segment.
    overlap : share of a segment that the next one repeats, 0 to below 1.
    """
    records_u, records_y = _experiments(input), _experiments(output)
    inputs = records_u.shape[2]
    if estimator != "h1" and inputs != 1:
        raise MeasurementError("", [f"{estimator.upper()} takes one input, but there are {inputs}; take H1."])
    taper = get_window(window, segment_samples)
    step = max(1, round(segment_samples * (1 - overlap)))
    u, y = (
        np.concatenate([_segments(record, taper, step) for record in records]) for records in (records_u, records_y)
    )  # (s, k, i), (s, k, o)
    averages = len(records_u) * effective_averages(taper, step, len(u) // len(records_u)) if len(u) else 0.0
    if averages <= inputs + 1:
        rule = f"{len(u)} segments of {segment_samples} samples make {averages:.2g} independent averages"
        raise MeasurementError("", [f"{rule}; {inputs} inputs need more than {inputs + 1}."])
    s_uu = np.einsum("ski,skj->kij", u, u.conj()) / len(u)
    s_yu = np.einsum("sko,ski->koi", y, u.conj()) / len(u)
    s_yy = (np.abs(y) ** 2).mean(axis=0)  # (k, o)
    inverse = np.linalg.pinv(s_uu, hermitian=True)
    h1 = s_yu @ inverse
    explained = np.einsum("koi,koi->ko", h1, s_yu.conj()).real
    coherence = np.clip(explained / np.maximum(s_yy, 1e-300), 0.0, 1.0)
    unexplained = s_yy * (1 - coherence) / (averages - inputs)
    variance = unexplained[:, :, None] * np.einsum("kii->ki", inverse).real[:, None, :]
    matrix = FrfMatrix(lines_of_dft(segment_samples, rate_hz), h1, variance, coherence, averages)
    return _without_ends(matrix if estimator == "h1" else _other_estimator(matrix, coherence, estimator))


def effective_averages(taper: FloatArray, step: int, segments: int) -> float:
    """Return the effective number of independent segments among overlapping ones.

    m / (1 + 2 Σ_d (1 − d/m) ρ_d²), ρ_d the window's correlation with itself d steps on (Welch, 1967).
    """
    power = float(taper @ taper)
    shifts = range(1, min(segments, -(-len(taper) // step)))
    loss = sum(
        (1 - d / segments) * (float(taper[d * step :] @ taper[: len(taper) - d * step]) / power) ** 2 for d in shifts
    )
    return segments / (1 + 2 * loss)


def _other_estimator(h1: FrfMatrix, coherence: FloatArray, estimator: Estimator) -> FrfMatrix:
    """Convert H1 of one input to H2 = H1/γ² or Hv = H1/γ.

    The relative variance of H2 is that of H1 (change u and y); of Hv it is (1 − γ²)(1 + 1/γ²)/(2 m): phase as H1,
    magnitude as ½ ln S_yy/S_uu.
    """
    gamma2 = np.maximum(coherence, 1e-12)[:, :, None]
    value = h1.value / (gamma2 if estimator == "h2" else np.sqrt(gamma2))
    relative = variance_from_coherence(np.ones_like(value), gamma2, h1.averages)
    if estimator == "hv":
        relative *= (1 + gamma2) / 2
    return replace(h1, value=value, variance=np.abs(value) ** 2 * relative)


def _without_ends(matrix: FrfMatrix) -> FrfMatrix:
    """Drop lines next to 0 Hz, which lack the removed mean, and the last one, which is real."""
    return matrix.between(float(matrix.frequency_hz[2]), float(matrix.frequency_hz[-2]))


def _segments(record: FloatArray, taper: FloatArray, step: int) -> ComplexArray:
    """Transform tapered segments without their means: (n, c) -> (s, k, c)."""
    length = len(taper)
    starts = np.arange(0, len(record) - length + 1, step)
    cut = record[starts[:, None] + np.arange(length)]  # (s, length, c)
    return np.asarray(np.fft.rfft((cut - cut.mean(axis=1, keepdims=True)) * taper[:, None], axis=1))


def _experiments(record: FloatArray) -> FloatArray:
    return record if record.ndim == 3 else record[None]


def _enough_experiments(u: FloatArray) -> None:
    experiments, _, inputs = u.shape
    if experiments < inputs:
        rule = (
            f"{inputs} inputs need at least {inputs} experiments with different commands, but there are {experiments}"
        )
        raise MeasurementError("", [f"{rule}; sweep_frf can do with fewer."])


def _period_spectra(record: FloatArray, period: int, skipped: int, periods: int) -> ComplexArray:
    """Transform each period: (e, n, c) -> (p, e, k, c)."""
    e, _, c = record.shape
    cut = record[:, skipped * period : (skipped + periods) * period].reshape(e, periods, period, c)
    return np.asarray(np.fft.rfft(cut - cut.mean(axis=(1, 2), keepdims=True), axis=2).transpose(1, 0, 2, 3))


def lines_of_dft(samples: int, rate_hz: float) -> FloatArray:
    """Return the frequencies of a real record's DFT, (samples // 2 + 1,) Hz."""
    return np.arange(samples // 2 + 1, dtype=np.float64) * (rate_hz / samples)


def _excited(mean_u: ComplexArray) -> IntArray:
    """Find the lines where all inputs can be told apart, (e, k, i) -> indices."""
    singular = np.linalg.svd(mean_u.transpose(1, 0, 2), compute_uv=False)  # (k, i)
    strongest, weakest = singular[:, 0], singular[:, -1]
    nearby = maximum_filter1d(strongest, _AROUND, mode="nearest")
    keep = (weakest > _EXCITED_LOCALLY * nearby) & (weakest > _EXCITED_AT_ALL * strongest.max())
    keep[[0, -1]] = False
    if not keep.any():
        raise MeasurementError("", ["No line is excited in all inputs; give different commands to the experiments."])
    return np.flatnonzero(keep)


def _lines_of(lines_hz: FloatArray, frequency: FloatArray) -> IntArray:
    return np.unique(np.rint(np.asarray(lines_hz) / frequency[1]).astype(np.int64))


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
