"""Files of accelerometers on printers: Klipper's and Kalico's captures and spectra, and py3dpaxxel's captures.

| file | what it holds |
|---|---|
| `raw_data_*.csv`, `adxl345-*.csv` | `#time,accel_x,accel_y,accel_z`: s, mm/s² |
| `resonances_*.csv`, `calibration_data_*.csv` | `freq,psd_x,psd_y,psd_z,psd_xyz[,accel_per_hz][,shapers:][,…]` |
| the same of several points or chips | `freq,<name 1>,<name 2>,…[,shapers:,…]` |
| py3dpaxxel `*.tsv` | `seq sample x y z`: mg, the rate in a comment (ODR3200) |

A spectrum is the one-sided power spectral density of a whole test in (mm/s²)²/Hz. Files that list shapers hold it
divided by (f + 0.1 Hz), and attenuated below 10 Hz. File names carry the axis and, when a test has several points,
the point. Gravity is in the captures.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.clock import clock_of
from ffcomp.measurement.sensors import G, broken_sensor
from ffcomp.measurement.table import Table, read_table, read_text, rows_of
from models.arrays import FloatArray

_RAW_HEADER = ("time", "accel_x", "accel_y", "accel_z")
_PAXXEL_HEADER = ("seq", "sample", "x", "y", "z")
_SHAPER = re.compile(r"\w+\s?\([\d.]+(?:\s?Hz)?\)")
_AXIS = re.compile(r"(?:raw_data|resonances|calibration_data)_(x|y|z|axis=[-\d.]+,[-\d.]+(?:,[-\d.]+)?)(?=_|\.)")
_POINT = re.compile(r"_(-?\d+\.\d{3})_(-?\d+\.\d{3})_(-?\d+\.\d{3})(?=_|\.)")
_PAXXEL_NAME = re.compile(r"-a([xyz])-f(\d+)-z(\d+)\.tsv$")
_PLAUSIBLE_RMS = (0.03, 1000.0)  # m/s²: between the noise of the best such chip and the range of the worst
_FEWEST_LINES = 20
_UNTOUCHED_HZ = 10.0  # normalised spectra are attenuated below
_NORMALISING_HZ = 0.1


@dataclass(frozen=True, eq=False)
class Capture:
    """An accelerometer's record, gravity included; its clock starts anywhere."""

    source: str
    time_s: FloatArray  # (n,) s, uniform
    acceleration: FloatArray  # (n, 3) m/s², columns X Y Z of the chip; NaN where a row is missing
    axis: str | None = None  # excited: x, y, z or axis=1.000,0.500
    position_mm: tuple[float, float, float] | None = None
    excitation_hz: float | None = None

    @property
    def sample_rate_hz(self) -> float:
        """Mean sample rate."""
        return float((len(self.time_s) - 1) / (self.time_s[-1] - self.time_s[0]))


@dataclass(frozen=True, eq=False)
class Resonances:
    """Spectra of one test, or of several points or chips."""

    source: str
    frequency_hz: FloatArray  # (k,) Hz
    psd: dict[str, FloatArray]  # "x", "y", "z", "xyz", or each set's name → (k,) as in the file
    normalised: bool  # divided by (f + 0.1 Hz)
    axis: str | None = None
    position_mm: tuple[float, float, float] | None = None
    accel_per_hz: float | None = None  # mm/s² per Hz, if the file says it

    def power(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return frequencies (k,) Hz and power spectral density (k,) (mm/s²)²/Hz, the normalisation undone."""
        if not self.normalised:
            return self.frequency_hz, self.psd[name]
        keep = self.frequency_hz >= _UNTOUCHED_HZ
        frequency = self.frequency_hz[keep]
        return frequency, self.psd[name][keep] * (frequency + _NORMALISING_HZ)


def read_vibration(path: str | Path) -> Capture | Resonances:
    """Read any of the files above; the content decides which it is. MeasurementError names every mistake."""
    text = read_text(path)
    first = text.lstrip().split("\n", 1)[0]
    if _names(first.lstrip("#"), ",") == _RAW_HEADER:
        return _raw_capture(str(path), text)
    if _names(first, None) == _PAXXEL_HEADER:
        return _paxxel_capture(str(path), text)
    if first.strip().lower().startswith("freq,"):
        return _resonances(str(path), read_table(path, text))
    rule = (
        "The first line must be '#time,accel_x,accel_y,accel_z', 'freq,psd_x,…' or 'seq sample x y z', but it is "
        f"{first[:60].strip()!r}."
    )
    raise MeasurementError(str(path), [rule])


def read_capture(path: str | Path) -> Capture:
    """Read a record of acceleration in time; see `read_vibration`."""
    found = read_vibration(path)
    if not isinstance(found, Capture):
        raise MeasurementError(str(path), ["It holds spectra; a record of acceleration in time is needed."])
    return found


def _names(line: str, delimiter: str | None) -> tuple[str, ...]:
    return tuple(name.strip().lower() for name in line.split(delimiter))


def _rows(path: str, text: str, header: tuple[str, ...], delimiter: str | None) -> Table:
    """Read the rows below the first line that is not empty."""
    lines = text.splitlines()
    first = next(k for k, line in enumerate(lines) if line.strip()) + 1
    return rows_of(path, lines, first, header, {}, delimiter)


def _raw_capture(path: str, text: str) -> Capture:
    table = _rows(path, text, _RAW_HEADER, ",")
    axis, point = _AXIS.search(Path(path).name), _POINT.search(Path(path).name)
    return _capture(
        path,
        table,
        table.column("time"),
        table.values[:, 1:] * 1e-3,
        axis[1] if axis else None,
        _point(point),
    )


def _paxxel_capture(path: str, text: str) -> Capture:
    table = _rows(path, text, _PAXXEL_HEADER, None)
    rate = re.search(r"ODR(\d+)", text)
    if rate is None:
        raise MeasurementError(path, ["The sample rate is missing; a comment must name it, as in 'ODR3200'."])
    if np.ptp(table.column("seq")) > 0:
        raise MeasurementError(path, ["Column seq changes: there are several records in it; give each its own file."])
    name = _PAXXEL_NAME.search(Path(path).name)
    return _capture(
        path,
        table,
        table.column("sample") / float(rate[1]),
        table.values[:, 2:] * (G * 1e-3),
        name[1] if name else None,
        excitation_hz=float(name[2]) if name else None,
    )


def _capture(
    path: str,
    table: Table,
    time_s: FloatArray,
    acceleration: FloatArray,
    axis: str | None,
    position_mm: tuple[float, float, float] | None = None,
    excitation_hz: float | None = None,
) -> Capture:
    problems = list(table.problems)
    timed = np.isfinite(time_s)
    clock, clock_problems = clock_of(time_s[timed], table.row[timed])
    problems += [text.replace("column t_s", f"column {table.columns[0]}") for text in clock_problems]
    for j, name in enumerate("xyz"):
        problems += broken_sensor(f"acc_{name}", acceleration[:, j], table.row)
    problems += _implausible(acceleration) if not problems else []
    if problems or clock is None:
        raise MeasurementError(path, problems)
    on_grid = np.column_stack([clock.on_grid(acceleration[timed, j]) for j in range(3)])
    return Capture(path, clock.grid_s, on_grid, axis, position_mm, excitation_hz)


def _implausible(acceleration: FloatArray) -> list[str]:
    """Check the size of an acceleration (n, 3) m/s²."""
    known = acceleration[np.isfinite(acceleration).all(axis=1)]
    rms = float(np.sqrt((known**2).sum(axis=1).mean())) if len(known) else 1.0
    low, high = _PLAUSIBLE_RMS
    if low < rms < high:
        return []
    return [
        f"The acceleration is {rms:.3g} m/s² rms; a sensor on Earth measures between {low:g} and {high:g}. Are the "
        "numbers in another unit than the file's format asks for?"
    ]


def _resonances(path: str, table: Table) -> Resonances:
    names = [name for name in table.columns[1:] if name != "accel_per_hz" and not name.startswith("shapers:")]
    shapers = [name for name in names if _SHAPER.fullmatch(name)]
    sets = {name.removeprefix("psd_"): table.column(name) for name in names if name not in shapers}
    frequency = table.values[:, 0]
    problems = [*table.problems, *_bad_spectra(frequency, sets)]
    if problems:
        raise MeasurementError(path, problems)
    axis, point = _AXIS.search(Path(path).name), _POINT.search(Path(path).name)
    per_hz = float(table.column("accel_per_hz")[0]) if "accel_per_hz" in table.columns else None
    normalised = bool(shapers) or any(name.startswith("shapers:") for name in table.columns)
    return Resonances(path, frequency, sets, normalised, axis[1] if axis else None, _point(point), per_hz)


def _point(found: re.Match[str] | None) -> tuple[float, float, float] | None:
    return None if found is None else (float(found[1]), float(found[2]), float(found[3]))


def _bad_spectra(frequency: FloatArray, sets: dict[str, FloatArray]) -> list[str]:
    problems = [] if sets else ["There is no spectrum in it; at least one column must follow freq."]
    if len(frequency) < _FEWEST_LINES:
        problems.append(f"There are {len(frequency)} frequencies; at least {_FEWEST_LINES} are needed.")
    if not np.isfinite(frequency).all() or (np.diff(frequency) <= 0).any() or frequency[0] < 0:
        problems.append("Column freq must not be negative, rise from row to row, and have no gaps.")
    for name, psd in sets.items():
        if not np.isfinite(psd).all():
            problems.append(f"The spectrum {name!r} has gaps; a spectrum has a number at every frequency.")
        elif (psd < 0).any():
            problems.append(f"The spectrum {name!r} goes down to {psd.min():.3g}; a power is not negative.")
        elif not psd.any():
            problems.append(f"The spectrum {name!r} is zero everywhere: nothing was measured.")
    return problems
