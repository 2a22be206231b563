"""Read what an accelerometer on a printer recorded, of whatever firmware or program; the content decides.

| file | what it holds |
|---|---|
| `raw_data_*.csv`, `adxl345-*.csv` | `#time,accel_x,accel_y,accel_z`: s of print time, mm/s²; lines `##…` before it |
| `resonances_*.csv`, `calibration_data_*.csv` | `freq,psd_x,psd_y,psd_z,psd_xyz[,accel_per_hz][,shapers:][,…]` |
| the same of several points or chips | `freq,<name 1>,<name 2>,…[,shapers:,…]` |
| Shake&Tune `*.stdata` | Zstandard over JSON, one line a capture: `{"name": …, "samples": [[t, x, y, z], …]}` |
| RepRapFirmware `Sample,X,Y,Z` | a capture in g with its rate in the last line |
| any other table with a time and three accelerations, such as a phone's or a laboratory's | a capture |

The columns of such a table are found by their names: a time (`t`, `t_s`, `Time (s)`, `timestamp_ms`, …) and one
acceleration for each of x, y and z (`ax`, `acc_x`, `Acceleration x (m/s^2)`, …). The unit is in the name, or
is inferred from gravity.

A spectrum of Klipper's is the one-sided power spectral density of a whole test in (mm/s²)²/Hz. Files that list shapers
hold it divided by (f + 0.1 Hz), and attenuated below 10 Hz. File names carry the axis and, when a test has several
points, the point. Gravity is in the captures.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture, make_capture
from ffcomp.measurement.frf_files import is_universal
from ffcomp.measurement.printer_logs import is_motion_log
from ffcomp.measurement.sensors import G
from ffcomp.measurement.table import Table, comments_of, read_table, read_text, rows_of
from gcode.text import most_unpacked
from models.arrays import FloatArray

_RULE = (
    "The first line must be '#time,accel_x,accel_y,accel_z', 'freq,psd_x,…', 'Sample,X,Y,Z' or "
    "name a time and three accelerations, as 't_s,ax_m_per_s2,ay_m_per_s2,az_m_per_s2'"
)

_LOG = (
    "It is a log of motion and sensors of Klipper's data_logger.py; `ffcomp record join`, `gap` and `diagnose` read it "
    "with the plan of its moves (--plan)."
)


def read_vibrations(path: str | Path) -> list[Capture | Resonances]:
    """Read everything that a file holds; MeasurementError with every mistake in the file."""
    if Path(path).is_file():
        if is_stdata(path):
            return list(stdata_captures(path))
        if is_motion_log(path):
            raise MeasurementError(str(path), [_LOG])
    text = read_text(path)
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    first = next((line for line in lines if not line.startswith("##")), lines[0])
    if is_raw(first):
        return [raw_capture(str(path), text)]
    if first.lower().startswith("freq,"):
        return [resonances_of_table(str(path), read_table(path, text))]
    if tuple(name.strip().lower() for name in first.split(",")) == _RRF_HEADER:
        return [_reprapfirmware_capture(str(path), text)]
    header = next((line for line in lines if not line.startswith("#")), first)
    if columns_of(header) is not None or columns_of(first) is not None:
        return [_plain_capture(str(path), text)]
    raise MeasurementError(str(path), [f"{_RULE}, but it is {first[:60]!r}."])


def read_captures(path: str | Path) -> list[Capture]:
    """Read the records of acceleration in time; see `read_vibrations`."""
    captures = [each for each in read_vibrations(path) if isinstance(each, Capture)]
    if not captures:
        raise MeasurementError(str(path), ["It holds spectra; a record of acceleration in time is needed."])
    return captures


# ---- RepRapFirmware (M956) -----------------------------------------------------------------------

_RRF_HEADER = ("sample", "x", "y", "z")
_TAIL = re.compile(r"^Rate\s+(0*[1-9]\d*(?:\.\d+)?)\D+overflows\s+(\d+)\s*$", re.IGNORECASE)
_FAILED = re.compile(r"^(failed .*|.*\bfailed\b.*|.*\btimed? ?out\b.*)$", re.IGNORECASE)


def _reprapfirmware_capture(path: str, text: str) -> Capture:
    """Read a capture in g; its last line has the rate, because the rows have no time: `Rate 1344, overflows 0`."""
    lines = [line for line in text.splitlines() if line.strip()]
    failed = next((line.strip() for line in lines[1:] if _FAILED.match(line)), None)
    if failed is not None:
        raise MeasurementError(path, [f"The firmware says in it: {failed!r}. Check M955, and record it again."])
    tail = _TAIL.match(lines[-1].strip())
    if tail is None:
        rule = "The last line must be 'Rate 1344, overflows 0', because the rows have no time"
        raise MeasurementError(
            path, [f"{rule}, but it is {lines[-1].strip()[:60]!r}: the recording was cut short. Record it again."]
        )
    table = rows_of(path, lines[:-1], 1, _RRF_HEADER, {})
    time_s = table.column("sample") / float(tail[1])
    return make_capture(path, table, time_s, table.values[:, 1:] * G, overflows=int(tail[2]))


# ---- any other table -----------------------------------------------------------------------------

_DELIMITERS = (",", ";", "\t", None)
_UNIT = r"[\s_]*[\[(/]?\s*(?P<unit>{})?\s*[\])]?"
_TIME_UNITS = {"": 1.0, "s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_SQUARED = ("/s2", "/s^2", "/s²", "_per_s2")
_ACCELERATION_UNITS = {f"{m}{s}": size for m, size in (("m", 1.0), ("mm", 1e-3)) for s in _SQUARED}
_ACCELERATION_UNITS |= {"g": G, "mg": 1e-3 * G}


def _alternatives(units: Sequence[str]) -> str:
    return "|".join(re.escape(unit) for unit in sorted(units, key=len, reverse=True) if unit)


_TIME = re.compile(r"(?:t|time|timestamp|seconds_elapsed)" + _UNIT.format(_alternatives([*_TIME_UNITS])))
_AXIS = re.compile(
    r"(?:linear[\s_]*)?(?:a|acc|accel|acceleration)?[\s_]*(?P<axis>[xyz])"
    + _UNIT.format(_alternatives([*_ACCELERATION_UNITS]))
)


def columns_of(line: str) -> tuple[str | None, dict[str, int]] | None:
    """Find the columns in a header line: its delimiter, and name → place of `t`, `x`, `y`, `z`; None if it has none."""
    for delimiter in _DELIMITERS:
        names = [name.strip().strip('"').lower() for name in line.strip().lstrip("#").split(delimiter)]
        times = [i for i, name in enumerate(names) if _TIME.fullmatch(name)]
        axes = {
            axis: [i for i, n in enumerate(names) if (m := _AXIS.fullmatch(n)) and m["axis"] == axis] for axis in "xyz"
        }
        if times and all(axes.values()):
            return delimiter, {"t": times[0], **{axis: places[0] for axis, places in axes.items()}}
    return None


def _plain_capture(path: str, text: str) -> Capture:
    """Read a capture whose columns `columns_of` finds."""
    lines = text.splitlines()
    head = next(k for k, line in enumerate(lines) if columns_of(line) is not None)
    columns = columns_of(lines[head])
    assert columns is not None
    delimiter, places = columns
    names = tuple(name.strip().strip('"') for name in lines[head].strip().lstrip("#").split(delimiter))
    table = rows_of(path, lines, head + 1, names, comments_of(lines[:head]), delimiter)
    if table.problems:
        raise MeasurementError(path, table.problems)
    timed = _TIME.fullmatch(names[places["t"]].lower())
    time_s = table.values[:, places["t"]] * _TIME_UNITS[(timed["unit"] or "") if timed else ""]
    raw = table.values[:, [places[axis] for axis in "xyz"]]
    scale = [_stated_unit(names[places[axis]]) for axis in "xyz"]
    known = [value for value in scale if value is not None]
    factor = known[0] if len(known) == 3 and len(set(known)) == 1 else _by_gravity(path, raw)
    # sentences about the clock name the first column
    table = Table((names[places["t"]], *table.columns), table.values, table.row, table.comments)
    return make_capture(path, table, time_s, raw * factor)


def _stated_unit(name: str) -> float | None:
    """Return the unit in a column's name in m/s²; None: it states none."""
    match = _AXIS.fullmatch(name.lower())
    return None if match is None or match["unit"] is None else _ACCELERATION_UNITS[match["unit"]]


def _by_gravity(path: str, values: FloatArray) -> float:
    """Find the unit (n, 3) by gravity, which every sensor on Earth measures while it rests."""
    size = float(np.linalg.norm(np.nanmedian(values, axis=0)))
    for factor in (1.0, 1e-3, G, 1e-3 * G):
        if abs(size * factor / G - 1.0) < 0.15:
            return factor
    raise MeasurementError(
        path,
        [
            f"The unit of the accelerations is not stated, and gravity does not show it: at rest they measure "
            f"{size:.4g}. Write the unit into the columns' names, as in 't_s,ax_m_per_s2,ay_m_per_s2,az_m_per_s2'."
        ],
    )


FileKind = Literal["frf", "recording", "vibration"]


def kind_of(path: Path) -> FileKind:
    """Return the kind of a file by its first line that is no comment of ours.

    Raises MeasurementError if it cannot be read, or is of no known kind.
    """
    if not path.is_file():
        raise MeasurementError(str(path), ["There is no such file."]) from FileNotFoundError(str(path))
    if is_stdata(path) or is_motion_log(path):
        return "vibration"
    if is_universal(path):
        return "frf"
    lines = [line.strip().lower() for line in read_text(path).splitlines() if line.strip()]
    if not lines:
        raise MeasurementError(str(path), ["The file is empty."])
    header = next((line for line in lines if not line.startswith("# ") and ":" not in line.split(",")[0]), lines[0])
    if header.startswith("frequency_hz"):
        return "frf"
    if columns_of(header) is not None and "cmd_" not in header:
        return "vibration"
    if "t_s" in [name.strip() for name in header.split(",")] or "cmd_" in header:
        return "recording"
    return "vibration"


# ---- Klipper and Kalico --------------------------------------------------------------------------

_RAW_HEADER = ("time", "accel_x", "accel_y", "accel_z")
_SHAPER = re.compile(r"\w+\s?\([\d.]+(?:\s?Hz)?\)")
_TESTED = re.compile(r"(?:raw_data|resonances|calibration_data)_(x|y|z|axis=[-\d.]+,[-\d.]+(?:,[-\d.]+)?)(?=_|\.)")
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
    axis, point = _TESTED.search(Path(path).name), _POINT.search(Path(path).name)
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
