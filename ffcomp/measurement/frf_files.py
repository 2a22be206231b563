"""Files of frequency responses: CSV, and universal files (UFF), data set 58 (function at nodal DOF), through `pyuff`.

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

A universal file may describe a response by the same `key: value; key: value` in its ID lines, and by the DOF fields:
nodes 1, 2, 3 are the carriages A, B, C, moving along direction 3 (z); any other node is the nozzle, directions 1, 2, 3
are x, y, z. A coherence follows as function type 6, a variance as type 0; all three share a version number. Files of
others are read by those fields and by the data types of ordinate and denominator: displacement, velocity
(differentiated), acceleration, force. Values are taken to SI by the units' labels, else by data set 164.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import savgol_coeffs, savgol_filter

from ffcomp.errors import MeasurementError
from ffcomp.measurement.frf import KEYS, FrequencyResponse, describe, read_labels, unknown
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
    if is_universal(path):
        return _read_universal(str(path))
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
    if problems:
        return None, problems
    above, averages = frequency_hz > 0, labels.pop("averages", None)
    value, frequency_hz = value[above], frequency_hz[above]
    coherence, variance = (None if extra is None else extra[above] for extra in (coherence, variance))
    if variance is None:
        variance = _estimated_variance(value, coherence, averages)
    response = FrequencyResponse(
        frequency_hz=frequency_hz,
        value=value,
        variance=variance,
        coherence=coherence,
        source=Path(path).name,
        **labels,
    )
    return response, []


def _estimated_variance(value: ComplexArray, coherence: FloatArray | None, averages: float | None) -> FloatArray:
    """Compute E|δH|² = |H|² (1 − γ²)/(γ² n) of an H1 estimate from n independent averages (Bendat & Piersol, 2010)."""
    smallest = _SMALLEST_RELATIVE_VARIANCE * np.abs(value) ** 2
    rough = _roughness_variance(value)
    if coherence is None:
        return np.maximum(rough, smallest)
    square = np.clip(coherence, 1e-12, 1.0)
    shape = np.abs(value) ** 2 * (1 - square) / square
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


def _roughness_variance(value: ComplexArray) -> FloatArray:
    """Estimate E|δ|² of each line from the residual to a quadratic through the lines around it, (k,) → (k,).

    A quadratic through the w lines around a line leaves of white noise at that line 1 − h, h the middle coefficient of
    the fit (Savitzky & Golay, 1964); the squares are averaged over w lines.
    """
    residual = value - savgol_filter(value.real, _WINDOW, _DEGREE) - 1j * savgol_filter(value.imag, _WINDOW, _DEGREE)
    half = _WINDOW // 2
    square = np.pad(np.abs(residual[half:-half]) ** 2, half, mode="edge")
    square = square / (1 - savgol_coeffs(_WINDOW, _DEGREE)[half])
    return np.asarray(uniform_filter1d(square, _WINDOW, mode="nearest"), dtype=np.float64)


# ---- universal files -----------------------------------------------------------------------------


_GENERAL, _FRF, _COHERENCE = 0, 4, 6  # function types
_DISPLACEMENT, _VELOCITY, _ACCELERATION = 8, 11, 12  # specific data types
_REACTION, _EXCITATION = 9, 13
_SI = {"m": 1.0, "mm": 1e-3, "m/s": 1.0, "mm/s": 1e-3, "n": 1.0, "mn": 1e-3, "kn": 1e3, "g": 9.80665}
_SI |= dict.fromkeys(("m/s2", "m/s^2", "m/s**2", "m/s²", "m/sec2", "m/sec^2"), 1.0)
_SI |= dict.fromkeys(("mm/s2", "mm/s^2", "mm/s**2", "mm/s²"), 0.001)
_NO_LABEL = ("", "none")
_EXTRAS = {"coherence": _COHERENCE, "variance": _GENERAL}
_ENDS = {  # of a response: its end and part in the file, the power of its unit, the signals by their data type
    "input": ("ref", "orddenom", -1, {_DISPLACEMENT: "cmd", _REACTION: "force", _EXCITATION: "force"}),
    "output": ("rsp", "ordinate", 1, {_DISPLACEMENT: "pos", _VELOCITY: "acc", _ACCELERATION: "acc"}),
}


def is_universal(path: str | Path) -> bool:
    """Return whether a file begins as universal files do: a line `-1`, then one with the data set's number."""
    try:
        with open(path, "rb") as file:
            head = file.read(400).splitlines()[:2]
    except OSError:
        return False
    return len(head) == 2 and head[0].strip() == b"-1" and head[1].strip()[:1].isdigit()


def _read_universal(path: str) -> list[FrequencyResponse]:
    """Read the responses of a universal file; MeasurementError if there is none."""
    sets = _sets(path)
    units: Mapping[str, Any] = next((one for one in sets.values() if one["type"] == 164), {})
    kinds = {number: _function(one) for number, one in sets.items() if one["type"] == 58}
    if _FRF not in kinds.values():
        raise MeasurementError(path, ["There is no frequency response (data set 58, function type 4) in it."])
    extras = {(_dof(sets[n]), kind): np.real(sets[n]["data"]) for n, kind in reversed(kinds.items())}
    responses, problems = [], list[str]()
    for number, one in sets.items():
        if kinds.get(number) != _FRF:
            continue
        labels, value, wrong = _described(one, units)
        mates = {name: extras.get((_dof(one), kind)) for name, kind in _EXTRAS.items()}
        frequency = np.asarray(one["x"], dtype=np.float64)
        response, more = build(path, labels, frequency, value, **mates) if not wrong else (None, [])
        responses += [] if response is None else [response]
        problems += [f"Data set {number}: {text}" for text in (*wrong, *more)]
    if problems:
        raise MeasurementError(path, problems)
    return responses


def _sets(path: str) -> dict[int, dict[str, Any]]:
    try:
        pyuff = import_module("pyuff")  # optional, and without types
    except ImportError as error:
        rule = "Universal files need the package pyuff: pip install 'ffcomp[uff]'."
        raise MeasurementError(path, [rule]) from error
    try:
        file = pyuff.UFF(path)
        read = [n for n, kind in enumerate(file.get_set_types()) if int(kind) in (58, 164)]
        return {n + 1: file.read_sets(n) for n in read}
    except Exception as error:  # pyuff raises plain Exception, and whatever a broken line makes of it
        raise MeasurementError(path, [f"It is no universal file that can be read: {error}."]) from error


def _function(one: Mapping[str, Any]) -> int:
    """Return the set's function type; a general one is only ours by its ID lines."""
    kind = int(one["func_type"])
    return kind if kind != _GENERAL or "input" in _labels(one) else -1


def _dof(one: Mapping[str, Any]) -> tuple[int, ...]:
    """Return the fields that a response and its coherence have in common."""
    return (*(int(one[key]) for key in ("rsp_node", "rsp_dir", "ref_node", "ref_dir", "ver_num")), len(one["x"]))


def _described(one: Mapping[str, Any], units: Mapping[str, Any]) -> tuple[dict[str, str], ComplexArray, list[str]]:
    """Return the labels of a response, its values in SI with the sign of the directions, and the problems."""
    labels, problems, value = _labels(one), list[str](), np.asarray(one["data"], dtype=np.complex128)
    for name, (end, part, power, words) in _ENDS.items():
        kind, direction = int(one[f"{part}_spec_data_type"]), int(one[f"{end}_dir"])
        if not labels.setdefault(name, _signal(one, end, words, kind)):
            problems.append(
                f"its {name} cannot be derived from its direction and data type {kind}; say 'input: cmd_A; output: "
                "pos_A' (or what it is) in the ID lines."
            )
        label = str(one.get(f"{part}_axis_units_lab", "")).strip().lower()
        if label not in _NO_LABEL and label not in _SI:
            problems.append(f"unit {label!r} is unknown; known are {', '.join(_SI)}.")
        quantity = "force" if kind in (_REACTION, _EXCITATION) else "length"
        default = 1.0 / (float(units.get(quantity, 1.0)) or 1.0)  # data set 164: from SI to the file's units
        value = value * float(np.sign(direction or 1)) * _SI.get(label, default) ** power
        if kind == _VELOCITY and end == "rsp":
            value = value * 2j * np.pi * np.asarray(one["x"], dtype=np.float64)
    return labels, value, problems


def _labels(one: Mapping[str, Any]) -> dict[str, str]:
    parts = ";".join(str(one.get(f"id{k}", "")) for k in range(1, 6)).split(";")
    pairs = [part.split(":", 1) for part in parts if ":" in part]
    return {key.strip().lower(): value.strip() for key, value in pairs if key.strip().lower() in KEYS}


def _signal(one: Mapping[str, Any], end: str, words: Mapping[int, str], kind: int) -> str:
    """Name a signal by its node, direction and data type; '' if they do not name it."""
    node, direction = int(one[f"{end}_node"]), abs(int(one[f"{end}_dir"]))
    if kind not in words or direction not in (1, 2, 3):
        return ""
    hammer = _EXCITATION in (kind, int(one["orddenom_spec_data_type"]))
    on_carriage = node in (1, 2, 3) and direction == 3 and not hammer
    return f"{words[kind]}_{'ABC'[node - 1] if on_carriage else 'xyz'[direction - 1]}"
