"""Read comma-separated text into an array: comments, a header, rows; report bad cells by their line."""

from __future__ import annotations

import difflib
import gzip
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np

from ffcomp.errors import MeasurementError
from models.arrays import FloatArray, IntArray

_NAMED_MISTAKES = 5  # of one kind; a broken file has thousands

_LARGEST = 1e30  # beyond it squares overflow; of whatever unit, nothing that is measured comes near

_GZIP = b"\x1f\x8b"  # how compressed files begin

_NO_TEXT = "the file is not a text file. Save it as CSV with the encoding UTF-8."


@dataclass(frozen=True, eq=False)
class Table:
    """The rows of a file, with its header and comments."""

    columns: tuple[str, ...]
    values: FloatArray  # (n, columns); NaN where a field was empty
    row: IntArray  # (n,) 1-based line of the file
    comments: dict[str, str]
    problems: tuple[str, ...] = ()  # full sentences about cells and rows

    def column(self, name: str) -> FloatArray:
        """Return a column, (n,)."""
        return self.values[:, self.columns.index(name)]


def read_text(path: str | Path) -> str:
    """Read a measurement file, compressed (.gz) or not, as text; MeasurementError if it is empty, or no text."""
    content = Path(path).read_bytes()
    if not content.strip():
        raise MeasurementError(str(path), ["The file is empty."])
    if content.startswith(_GZIP):
        try:
            content = gzip.decompress(content)
        except (OSError, EOFError, zlib.error) as error:
            raise MeasurementError(str(path), [f"The compressed file cannot be read: {error}."]) from error
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MeasurementError(str(path), [f"Byte {error.start} is not UTF-8: {_NO_TEXT}"]) from error
    if "\0" in text:
        raise MeasurementError(str(path), [f"Byte {text.index(chr(0))} is zero: {_NO_TEXT}"])
    return text


def read_table(path: str | Path, text: str) -> Table:
    """Read `# key: value` lines, a header line, then rows of numbers."""
    lines = text.splitlines()
    head = next((k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), None)
    if head is None:
        raise MeasurementError(str(path), ["There is no header line naming the columns, only comments."])
    if "," not in lines[head] and len(lines[head].split(";")) > 2:
        rule = "The header line separates its columns by semicolons; write commas between fields, and decimal points."
        raise MeasurementError(str(path), [rule])
    columns = tuple(name.strip() for name in lines[head].split(","))
    return rows_of(path, lines, head + 1, columns, comments_of(lines[:head]))


def comments_of(lines: Sequence[str]) -> dict[str, str]:
    """Parse `# key: value` lines, keys in small letters; other comments are ignored."""
    pairs = (line.lstrip("# ").split(":", 1) for line in lines if ":" in line)
    return {key.strip().lower(): value.strip() for key, value in pairs}


def rows_of(
    path: str | Path,
    lines: Sequence[str],
    first: int,
    columns: tuple[str, ...],
    comments: dict[str, str],
    delimiter: str | None = ",",
) -> Table:
    """Read the rows from lines[first] on; `delimiter` None is any white space."""
    kept = [k for k in range(first, len(lines)) if lines[k].strip() and not lines[k].lstrip().startswith("#")]
    if not kept:
        raise MeasurementError(str(path), ["There are no rows after the header line."])
    body, row = [lines[k] for k in kept], np.array(kept, dtype=np.int64) + 1
    problems: list[str] = []
    try:
        values = np.loadtxt(StringIO("\n".join(body)), delimiter=delimiter, ndmin=2)
    except ValueError:
        values, problems = _cell_by_cell(body, row, columns, delimiter)
    if values.shape[1] != len(columns):
        rule = f"The rows have {values.shape[1]} fields, but the header names {len(columns)} columns."
        raise MeasurementError(str(path), [rule])
    problems += _endless(values, row, columns)
    return Table(columns, values, row, comments, tuple(problems))


def _cell_by_cell(
    body: Sequence[str], row: IntArray, columns: tuple[str, ...], delimiter: str | None
) -> tuple[FloatArray, list[str]]:
    """Read cell by cell, for files with empty fields or mistakes: slow, but it locates each."""
    values = np.full((len(body), len(columns)), np.nan)
    bad_cells, bad_rows, wrong = [], [], set[int]()
    for i, line in enumerate(body):
        fields = line.split(delimiter)
        if len(fields) != len(columns):
            bad_rows.append(f"row {row[i]} has {len(fields)}")
            wrong.add(i)
            continue
        for j, field in enumerate(fields):
            try:
                values[i, j] = float(field) if field.strip() else np.nan
            except ValueError:
                bad_cells.append(f"row {row[i]}, column {columns[j]}: {field.strip()[:20]!r}")
                wrong.add(i)
    remedy = " The file breaks off there: copy it again, or record again." if wrong == {len(body) - 1} else ""
    points = " Write decimal points, not commas." if any(re.search(r"\d,\d", cell) for cell in bad_cells) else ""
    problems = [f"A field must be a number or empty, but {_some(bad_cells)}.{points}{remedy}"] if bad_cells else []
    if bad_rows:
        problems.append(f"Every row needs {len(columns)} fields, as the header names, but {_some(bad_rows)}.{remedy}")
    return values, problems


def _endless(values: FloatArray, row: IntArray, columns: tuple[str, ...]) -> list[str]:
    where = np.argwhere(np.abs(values) > _LARGEST)
    if not len(where):
        return []
    places = [f"row {row[i]}, column {columns[j]}: {values[i, j]}" for i, j in where]
    if np.isinf(values).any():
        rule = "No sensor measures infinity (leave the field empty where a sample is missing)"
    else:
        rule = f"No sensor measures more than {_LARGEST:g}"
    return [f"{rule}, but {_some(places)}."]


def _some(places: Sequence[str]) -> str:
    rest = len(places) - _NAMED_MISTAKES
    return "; ".join(places[:_NAMED_MISTAKES]) + (f"; and {rest} more" if rest > 0 else "")


def repeated_columns(columns: Sequence[str]) -> list[str]:
    """Report columns of the same name, in full sentences."""
    twice = [name for name in dict.fromkeys(columns) if columns.count(name) > 1]
    return [f"Column {name!r} is there {columns.count(name)} times; one is needed." for name in twice]


def closest(name: str, known: Sequence[str]) -> str | None:
    """Suggest the known name nearest to a name; a wrong case decides before a wrong letter."""
    same = [one for one in known if one.lower() == name.lower()]
    return next(iter(same or difflib.get_close_matches(name, known, 1)), None)
