"""Files of accelerometers on Klipper printers: captures and spectra of the firmware and of Shake&Tune.

| file | what it holds |
|---|---|
| `raw_data_*.csv`, `adxl345-*.csv` | `#time,accel_x,accel_y,accel_z`: s of print time, mm/s²; lines `##…` before it |
| `resonances_*.csv`, `calibration_data_*.csv` | `freq,psd_x,psd_y,psd_z,psd_xyz[,accel_per_hz][,shapers:][,…]` |
| the same of several points or chips | `freq,<name 1>,<name 2>,…[,shapers:,…]` |
| Shake&Tune `*.stdata` | Zstandard over JSON, one line a capture: `{"name": …, "samples": [[t, x, y, z], …]}` |

A spectrum is the one-sided power spectral density of a whole test in (mm/s²)²/Hz. Files that list shapers hold it
divided by (f + 0.1 Hz), and attenuated below 10 Hz. File names carry the axis and, when a test has several points,
the point. Gravity is in the captures.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture, make_capture
from ffcomp.measurement.table import Table, rows_of
from gcode.text import most_unpacked
from models.arrays import FloatArray

_RAW_HEADER = ("time", "accel_x", "accel_y", "accel_z")
_SHAPER = re.compile(r"\w+\s?\([\d.]+(?:\s?Hz)?\)")
_AXIS = re.compile(r"(?:raw_data|resonances|calibration_data)_(x|y|z|axis=[-\d.]+,[-\d.]+(?:,[-\d.]+)?)(?=_|\.)")
_POINT = re.compile(r"_(-?\d+\.\d{3})_(-?\d+\.\d{3})_(-?\d+\.\d{3})(?=_|\.)")
_LOST = re.compile(r"(?:drops|overflows|errors)=(\d+)")
_FEWEST_LINES = 20
_UNTOUCHED_HZ = 10.0  # normalised spectra are attenuated below
_NORMALISING_HZ = 0.1
_PIECE = 1 << 20  # bytes that are unpacked at a time
_ZSTANDARD = b"\x28\xb5\x2f\xfd"
_STDATA_AXIS = re.compile(r"(axis_[XYZ]|belt_[AB])(?=_|$)")
_EXCITED = {
    "axis_X": "x",
    "axis_Y": "y",
    "axis_Z": "z",
    "belt_A": "axis=1.000,-1.000",
    "belt_B": "axis=1.000,1.000",
}


@dataclass(frozen=True, eq=False)
class Resonances:
    """Spectra of one test, or of several points or chips."""

    source: str
    frequency_hz: FloatArray  # (k,) Hz
    psd: dict[str, FloatArray]  # "x", "y", "z", "xyz", or each set's name → (k,) as in the file
    normalised: bool  # divided by (f + 0.1 Hz)
    axis: str | None = None
    position_mm: tuple[float, float, float] | None = None
    by_axis: bool = False  # its header has psd_x and so on; else columns may be anything

    def power(self, name: str) -> tuple[FloatArray, FloatArray]:
        """Return frequencies (k,) Hz and power spectral density (k,) (mm/s²)²/Hz, the normalisation undone."""
        if not self.normalised:
            return self.frequency_hz, self.psd[name]
        keep = self.frequency_hz >= _UNTOUCHED_HZ
        frequency = self.frequency_hz[keep]
        return frequency, self.psd[name][keep] * (frequency + _NORMALISING_HZ)

    @property
    def total(self) -> tuple[FloatArray, FloatArray]:
        """Return frequencies (k,) and the power of all axes or sets together (k,)."""
        names = ["xyz"] if "xyz" in self.psd else list(self.psd)
        powers = [self.power(name) for name in names]
        return powers[0][0], np.sum([power for _, power in powers], axis=0)

    def chosen(self, name: str | None) -> str:
        """Return the name of the spectrum to use: the requested one, or the only candidate.

        Raises MeasurementError if there is no such spectrum, or there are several and none of them is the excited axis'
        or the sum.
        """
        if name is not None and name not in self.psd:
            rule = f"There is no spectrum {name!r}; there are {', '.join(self.psd)}."
            raise MeasurementError(self.source, [rule])
        known = (self.axis, "xyz") if self.by_axis else ()
        certain = [each for each in (name, *known) if each in self.psd]
        if certain or len(self.psd) == 1:
            return certain[0] if certain else next(iter(self.psd))
        rule = (
            f"It holds several spectra, {', '.join(self.psd)}, and neither its header nor its name says which one is "
            "of the excited axis. Say --column NAME with one of them."
        )
        raise MeasurementError(self.source, [rule])


def is_raw(line: str) -> bool:
    """Return whether a line is the header of a capture."""
    return tuple(name.strip().lower() for name in line.lstrip("#").split(",")) == _RAW_HEADER


def raw_capture(path: str, text: str) -> Capture:
    """Read a capture of Klipper or Kalico."""
    lines = text.splitlines()
    head = next(k for k, line in enumerate(lines) if is_raw(line))
    table = rows_of(path, lines, head + 1, _RAW_HEADER, {})
    lost = sum(int(count) for line in lines[:head] for count in _LOST.findall(line))
    acceleration = table.values[:, 1:] * 1e-3
    return make_capture(
        path, table, table.column("time"), acceleration, clock="firmware", overflows=lost, **_named(path)
    )


def resonances_of_table(path: str, table: Table) -> Resonances:
    """Read spectra."""
    names = [name for name in table.columns[1:] if name != "accel_per_hz" and not name.startswith("shapers:")]
    shapers = [name for name in names if _SHAPER.fullmatch(name)]
    sets = {name.removeprefix("psd_"): table.column(name) for name in names if name not in shapers}
    frequency = table.values[:, 0]
    problems = [*table.problems, *_bad_spectra(frequency, sets)]
    if problems:
        raise MeasurementError(path, problems)
    normalised = bool(shapers) or any(name.startswith("shapers:") for name in table.columns)
    by_axis = all(name.startswith("psd_") for name in names if name not in shapers)
    return Resonances(path, frequency, sets, normalised, by_axis=by_axis, **_named(path))


def _named(path: str) -> dict[str, Any]:
    """Return the excited axis and the point that a file's name states."""
    axis, point = _AXIS.search(Path(path).name), _POINT.search(Path(path).name)
    place = None if point is None else tuple(float(number) for number in point.groups())
    return {"axis": axis and axis[1], "position_mm": place}


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


# ---- Shake&Tune ----------------------------------------------------------------------------------


def is_stdata(path: str | Path) -> bool:
    """Recognise by the first bytes."""
    with Path(path).open("rb") as file:
        return file.read(len(_ZSTANDARD)) == _ZSTANDARD


def stdata_captures(path: str | Path) -> list[Capture]:
    """Read every measurement in the file.

    Raises MeasurementError if it cannot be unpacked, or a measurement cannot be used.
    """
    lines = enumerate(_unpacked(path).splitlines(), 1)
    captures = [_capture(str(path), number, line) for number, line in lines if line.strip()]
    if not captures:
        raise MeasurementError(str(path), ["There is no measurement in it."])
    return captures


def _capture(path: str, number: int, line: bytes) -> Capture:
    try:
        entry = json.loads(line)
        name, samples = str(entry["name"]), np.array(entry["samples"], dtype=np.float64)
    except (ValueError, KeyError, TypeError) as error:
        rule = 'a line is one JSON object {"name": …, "samples": [[time, x, y, z], …]}'
        raise MeasurementError(path, [f"Line {number} cannot be read ({error}); {rule}."]) from error
    if samples.ndim != 2 or samples.shape[1] != 4:
        raise MeasurementError(path, [f"{name}: a sample is time, x, y, z, but they have the shape {samples.shape}."])
    table, axis = Table(_RAW_HEADER, samples, np.arange(1, len(samples) + 1), {}), _STDATA_AXIS.search(name)
    excited = _EXCITED[axis[1]] if axis else None
    return make_capture(path, table, samples[:, 0], samples[:, 1:] * 1e-3, axis=excited, name=name, clock="firmware")


def _unpacked(path: str | Path) -> bytes:
    """Unpack with Python's own library (3.14 and later) or the package, up to what a recording may unpack to."""
    content, most = bytearray(), most_unpacked(Path(path).stat().st_size)
    try:
        with Path(path).open("rb") as packed, _stream(str(path), packed) as stream:
            while piece := stream.read(_PIECE):
                content += piece
                if len(content) > most:  # archives can be made that fill any memory
                    raise ValueError("it unpacks to more than any recording does")
    except MeasurementError:
        raise
    except Exception as error:  # of the library's own kind
        raise MeasurementError(str(path), [f"It cannot be unpacked: {error}."]) from error
    return bytes(content)


def _stream(path: str, packed: BinaryIO) -> Any:
    try:
        return import_module("compression.zstd").ZstdFile(packed)
    except ImportError:
        pass
    try:
        return import_module("zstandard").ZstdDecompressor().stream_reader(packed, read_across_frames=True)
    except ImportError as error:
        rule = "Shake&Tune's files are Zstandard archives; to read them, install the extra"
        raise MeasurementError(path, [f"{rule}: pip install 'ffcomp[stdata]'."]) from error
