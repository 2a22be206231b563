"""Read what an accelerometer on a printer recorded, of whatever firmware or program; the content decides.

| file | what it holds |
|---|---|
| Klipper, Kalico | captures and spectra: `ffcomp.measurement.klipper` |
| Shake&Tune `.stdata` | one or more of Klipper's captures: `ffcomp.measurement.klipper` |
| RepRapFirmware `Sample,X,Y,Z` | a capture in g with its rate in the last line |
| any other table with a time and three accelerations, such as a phone's or a laboratory's | a capture |

The columns of such a table are found by their names: a time (`t`, `t_s`, `Time (s)`, `timestamp_ms`, …) and one
acceleration for each of x, y and z (`ax`, `acc_x`, `Acceleration x (m/s^2)`, …). The unit is in the name, or
is inferred from gravity.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture, make_capture
from ffcomp.measurement.frf_files import is_universal
from ffcomp.measurement.klipper import (
    Resonances,
    is_raw,
    is_stdata,
    raw_capture,
    resonances_of_table,
    stdata_captures,
)
from ffcomp.measurement.printer_logs import is_motion_log
from ffcomp.measurement.sensors import G
from ffcomp.measurement.table import Table, comments_of, read_table, read_text, rows_of
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
    """Read everything that a file holds.

    Raises MeasurementError with every mistake in the file.
    """
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
