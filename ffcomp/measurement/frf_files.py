"""Files of frequency responses: CSV here, universal files (UFF 58) in `uff.py`.

The CSV holds one response. Comments name it, columns `frequency_hz,real,imag` hold it, `coherence` and `variance`
(E|δ|², SI²) may follow::

    # input: cmd_A
    # output: pos_A
    # position_mm: 0, 0, 30
    # setup: assembly            (carriage, carriage+mass, effector or assembly; assembly if not said)
    # added_mass_kg: 0.1
    # averages: 16               (independent averages behind the coherence)
    # clock: logger              (responses with one clock share one unknown delay)
    frequency_hz,real,imag,coherence
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_coeffs

from ffcomp.errors import MeasurementError
from ffcomp.measurement import uff
from ffcomp.measurement.frf import FrequencyResponse, describe, read_labels, unknown, variance_from_coherence
from ffcomp.measurement.table import read_table, read_text, repeated_columns
from models.arrays import ComplexArray, FloatArray

FEWEST_LINES = 10  # the roughness needs nine lines around one

_COLUMNS = ("frequency_hz", "real", "imag", "coherence", "variance")
_SMALLEST_RELATIVE_VARIANCE = 1e-8  # 0.01 % of |H|: no measurement is better, whatever its coherence


def read_frfs(path: str | Path) -> list[FrequencyResponse]:
    """Read the frequency responses in a file; its content decides its kind, not its name.

    The variance is the file's own if there is a `variance` column. Else, with coherence and the number of averages,
    it follows from them; with coherence alone its shape follows from the coherence and its size from the response's
    roughness; with neither it is the roughness: the mean square residual from a quadratic through neighbouring
    lines. That overstates the noise of a resonance narrower than a few lines, and understates that of a smoothed
    response. A line at 0 Hz is left out.
    """
    if uff.is_universal(path):
        return _from_universal(str(path))
    table = read_table(path, read_text(path))
    problems = [*table.problems, *_bad_header(table.columns)]
    if problems:
        raise MeasurementError(str(path), problems)
    value = table.column("real") + 1j * table.column("imag")
    extra = {name: table.column(name) for name in _COLUMNS[3:] if name in table.columns}
    response, problems = build(str(path), table.comments, table.column("frequency_hz"), value, **extra)
    if response is None:
        raise MeasurementError(str(path), problems)
    return [response]


def write_frf(path: str | Path, response: FrequencyResponse) -> None:
    """Write one response as CSV, its variance included."""
    lines = [f"# {key}: {value}" for key, value in describe(response).items()]
    data = {"frequency_hz": response.frequency_hz, "real": response.value.real, "imag": response.value.imag}
    if response.coherence is not None:
        data["coherence"] = response.coherence
    data["variance"] = response.variance
    lines.append(",".join(data))
    lines += [",".join(f"{number:.12g}" for number in row) for row in np.column_stack(list(data.values()))]
    Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def build(
    path: str,
    comments: Mapping[str, str],
    frequency_hz: FloatArray,
    value: ComplexArray,
    coherence: FloatArray | None = None,
    variance: FloatArray | None = None,
) -> tuple[FrequencyResponse | None, list[str]]:
    """Build a response from its labels and its lines (k,), or return the problems, in full sentences."""
    labels, problems = read_labels(comments)
    problems += _bad_lines(frequency_hz, value, coherence, variance)
    if labels is None or problems:
        return None, problems
    above = frequency_hz > 0
    frequency_hz, value = frequency_hz[above], value[above]
    coherence, variance = (None if extra is None else extra[above] for extra in (coherence, variance))
    if variance is None:
        variance = _estimated_variance(value, coherence, labels.averages)
    return FrequencyResponse(
        labels.input,
        labels.output,
        frequency_hz,
        value,
        variance,
        labels.setup,
        labels.position_mm,
        labels.added_mass_kg,
        coherence,
        Path(path).name,
        labels.clock,
    ), []


def _from_universal(path: str) -> list[FrequencyResponse]:
    responses, problems = [], []
    for number, dataset in uff.read_universal(path).items():
        response, wrong = build(
            path, dataset.labels, dataset.frequency_hz, dataset.value, dataset.coherence, dataset.variance
        )
        responses += [] if response is None else [response]
        problems += [f"Data set {number}: {text}" for text in wrong]
    if problems:
        raise MeasurementError(path, problems)
    return responses


def _estimated_variance(value: ComplexArray, coherence: FloatArray | None, averages: float | None) -> FloatArray:
    smallest = _SMALLEST_RELATIVE_VARIANCE * np.abs(value) ** 2
    rough = roughness_variance(value)
    if coherence is None:
        return np.maximum(rough, smallest)
    shape = variance_from_coherence(value, coherence, 1.0)
    if averages is None:
        averages = max(1.0, float(np.median(shape) / max(np.median(rough), 1e-300)))
    return np.maximum(shape / averages, smallest)


def _bad_header(columns: tuple[str, ...]) -> list[str]:
    problems = [unknown(f"Column {name!r}", name, _COLUMNS) for name in columns if name not in _COLUMNS]
    problems += [f"Column {name} is missing." for name in _COLUMNS[:3] if name not in columns]
    return problems + repeated_columns(columns)


def _bad_lines(
    frequency_hz: FloatArray, value: ComplexArray, coherence: FloatArray | None, variance: FloatArray | None
) -> list[str]:
    numbers = [frequency_hz, value, *(extra for extra in (coherence, variance) if extra is not None)]
    problems = []
    if not all(np.isfinite(column).all() for column in numbers):
        problems.append("A frequency response has no gaps, but some of its numbers are missing; leave such lines out.")
    if (frequency_hz > 0).sum() < FEWEST_LINES:
        problems.append(f"There are {(frequency_hz > 0).sum()} lines above 0 Hz; at least {FEWEST_LINES} are needed.")
    if (frequency_hz < 0).any() or (np.diff(frequency_hz) <= 0).any():
        problems.append("The frequencies must not be negative and must rise from line to line.")
    if not np.abs(value).any():
        problems.append("The response is zero at every frequency: nothing was measured.")
    if coherence is not None and ((coherence < 0) | (coherence > 1.000001)).any():
        problems.append(
            f"Coherence lies between 0 and 1, but goes from {coherence.min():.3g} to {coherence.max():.3g}."
        )
    if variance is not None and (variance < 0).any():
        problems.append(f"A variance is not negative, but column variance has {variance.min():.3g}.")
    return problems


_WINDOW = 9  # lines
_DEGREE = 2


def roughness_variance(value: ComplexArray, window: int = _WINDOW) -> FloatArray:
    """Estimate E|δ|² of each line from the residual to a quadratic through the lines around it, (k,) → (k,).

    A quadratic through the w = `window` lines around a line leaves of white noise at that line 1 − h, h the middle
    coefficient of the fit (Savitzky & Golay, 1964); the squares are averaged over w lines.
    """
    coefficients = savgol_coeffs(window, _DEGREE)
    inner = np.convolve(value, coefficients, mode="valid")
    half = window // 2
    residual = np.pad(value[half:-half] - inner, half, mode="edge")
    square = np.abs(residual) ** 2 / (1 - coefficients[half])
    return np.asarray(uniform_filter1d(square, window, mode="nearest"), dtype=np.float64)
