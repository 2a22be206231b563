"""Captures of any other sensor: a text table with a time and three accelerations, such as a phone's or a laboratory's.

The columns are found by their names: a time (`t`, `t_s`, `Time (s)`, `timestamp_ms`, …) and one acceleration for each
of x, y and z (`ax`, `acc_x`, `Acceleration x (m/s^2)`, …). The unit stands in the name, or gravity tells it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture, make_capture
from ffcomp.measurement.sensors import G
from ffcomp.measurement.table import Table, comments_of, rows_of
from models.arrays import FloatArray

_DELIMITERS = (",", ";", "\t", None)
_UNIT = r"[\s_]*[\[(/]?\s*(?P<unit>{})?\s*[\])]?"
_TIME_UNITS = {"": 1.0, "s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_ACCELERATION_UNITS = {
    "m/s2": 1.0,
    "m/s^2": 1.0,
    "m/s²": 1.0,
    "m_per_s2": 1.0,
    "mm/s2": 1e-3,
    "mm/s^2": 1e-3,
    "mm/s²": 1e-3,
    "mm_per_s2": 1e-3,
    "g": G,
    "mg": 1e-3 * G,
}


def _alternatives(units: Sequence[str]) -> str:
    return "|".join(re.escape(unit) for unit in sorted(units, key=len, reverse=True) if unit)


_TIME = re.compile(r"(?:t|time|timestamp|seconds_elapsed)" + _UNIT.format(_alternatives([*_TIME_UNITS])))
_AXIS = re.compile(
    r"(?:linear[\s_]*)?(?:a|acc|accel|acceleration)?[\s_]*(?P<axis>[xyz])"
    + _UNIT.format(_alternatives([*_ACCELERATION_UNITS]))
)
_NEARLY = 0.15  # of gravity, by which a unit is known


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


def plain_capture(path: str, text: str) -> Capture:
    """Read a capture whose columns `columns_of` finds.

    Raises
    ------
    MeasurementError
        With every mistake in the file; where no unit is stated and gravity does not tell it.
    """
    lines = text.splitlines()
    head = next(k for k, line in enumerate(lines) if columns_of(line) is not None)
    found = columns_of(lines[head])
    assert found is not None
    delimiter, places = found
    names = tuple(name.strip().strip('"') for name in lines[head].strip().lstrip("#").split(delimiter))
    table = rows_of(path, lines, head + 1, names, comments_of(lines[:head]), delimiter)
    time_s = table.values[:, places["t"]] * _time_unit(names[places["t"]])
    raw = table.values[:, [places[axis] for axis in "xyz"]]
    scale = [_stated_unit(names[places[axis]]) for axis in "xyz"]
    known = [value for value in scale if value is not None]
    factor = known[0] if len(known) == 3 and len(set(known)) == 1 else _by_gravity(path, raw)
    return make_capture(path, _first_is_time(table, names[places["t"]]), time_s, raw * factor)


def _first_is_time(table: Table, name: str) -> Table:
    """Name the time's column first, as sentences about the clock do."""
    return Table((name, *table.columns), table.values, table.row, table.comments, table.problems)


def _time_unit(name: str) -> float:
    match = _TIME.fullmatch(name.lower())
    return _TIME_UNITS[(match["unit"] or "") if match else ""]


def _stated_unit(name: str) -> float | None:
    """Return the unit in a column's name in m/s²; None: it states none."""
    match = _AXIS.fullmatch(name.lower())
    return None if match is None or match["unit"] is None else _ACCELERATION_UNITS[match["unit"]]


def _by_gravity(path: str, values: FloatArray) -> float:
    """Tell the unit (n, 3) by gravity, which every sensor on Earth measures while it rests."""
    size = float(np.linalg.norm(np.nanmedian(values, axis=0)))
    for factor in (1.0, 1e-3, G, 1e-3 * G):
        if abs(size * factor / G - 1.0) < _NEARLY:
            return factor
    raise MeasurementError(
        path,
        [
            f"The unit of the accelerations is not stated, and gravity does not tell it: at rest they measure "
            f"{size:.4g}. Write the unit into the columns' names, as in 't_s,ax_m_per_s2,ay_m_per_s2,az_m_per_s2'."
        ],
    )
