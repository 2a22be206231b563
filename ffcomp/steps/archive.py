"""Step timings on disk: one NumPy archive that grows while it is written, its steps in full or as compressed rows.

For each motor m in a, b, c (and e, which moves no carriage and is only checked)

    m_start_mm, m_step_mm    where it begins, and how far one step goes
    m_tick, m_direction      every step: when, and up (1) or down (−1)
    m_interval, m_count, m_add, m_direction    or rows of steps: step j = 1 … count of a row comes
                             j interval + add j (j − 1)/2 ticks after the last step of the row before (or after tick 0)

and once `clock_hz`; where there are rows, `error_s`, the bound on their steps' error. Lines of G-code to
run meanwhile: events_tick, events_line.
"""

from __future__ import annotations

import io
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import DTypeLike, NDArray

from gcode.atomic_write import replacing
from gcode.errors import GcodeError
from models.arrays import FloatArray, IntArray

_BLOCK_BYTES = 1 << 20


class Column:
    """One array under way, in a nameless file that vanishes with the process."""

    def __init__(self, dtype: DTypeLike, folder: Path) -> None:
        self.dtype, self.length = np.dtype(dtype), 0
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - `close` closes it

    def append(self, values: NDArray[Any]) -> None:
        """Append values (n,) of the column's type, or one that fits into it."""
        self._file.write(np.ascontiguousarray(values, dtype=self.dtype).data)
        self.length += len(values)

    def npy(self) -> Iterator[bytes]:
        """Yield the bytes of its `.npy` file."""
        yield _header(self.dtype, (self.length,))
        self._file.seek(0)
        while block := self._file.read(_BLOCK_BYTES):
            yield block

    def close(self) -> None:
        """Give up the gathered values."""
        self._file.close()


class TextColumn:
    """An array of byte strings under way, as wide as the longest one."""

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - `close` closes it
        self._length, self._width = 0, 1

    def append(self, line: bytes) -> None:
        """Append a line without its line ending."""
        self._file.write(line + b"\n")
        self._length += 1
        self._width = max(self._width, len(line))

    def npy(self) -> Iterator[bytes]:
        """Yield the bytes of its `.npy` file."""
        yield _header(np.dtype(f"S{self._width}"), (self._length,))
        self._file.seek(0)
        for line in self._file:
            yield line[:-1].ljust(self._width, b"\0")

    def close(self) -> None:
        """Give up the gathered lines."""
        self._file.close()


def _header(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    head = io.BytesIO()
    description = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    npy.write_array_header_1_0(head, description)
    return head.getvalue()


def number_npy(value: float) -> Iterator[bytes]:
    """Return the bytes of a `.npy` file that holds one number."""
    yield _header(np.dtype(np.float64), ())
    yield np.float64(value).tobytes()


def write_archive(target: Path, members: Mapping[str, Iterator[bytes]]) -> None:
    """Arrays, each as the bytes of a `.npy` file, into one archive, which is replaced atomically."""
    with replacing(target) as file, zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, blocks in members.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                member.writelines(blocks)


MOTORS = "abc"
FOLLOWING = "e"  # no carriage
MOST_STEPS = 2**31  # of a motor: a month at 800 a second


class StepsError(GcodeError):
    """A step archive that cannot be played."""


@dataclass(frozen=True, eq=False)
class MotorSteps:
    """n steps of one motor."""

    time_s: FloatArray  # (n,) rising
    direction: NDArray[np.int8]  # (n,) ±1
    start_mm: float
    step_mm: float

    @cached_property
    def level_mm(self) -> FloatArray:
        """(n + 1,) where the motor holds before the first step, and after each."""
        steps = np.concatenate([[0], np.cumsum(self.direction, dtype=np.int64)])
        return self.start_mm + self.step_mm * steps


def is_step_archive(path: str | Path) -> bool:
    """By content: a zip archive with arrays in it."""
    if not zipfile.is_zipfile(path):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return any(name.endswith(".npy") for name in archive.namelist())
    except (zipfile.BadZipFile, ValueError, RuntimeError, OSError):  # whoever reads it otherwise says what is wrong
        return False


def read_steps(path: str | Path) -> dict[str, MotorSteps]:
    """Read the steps of every motor in the archive.

    Raises StepsError at the first mistake: key, place in the array, value and rule.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: np.asarray(archive[name]) for name in archive.files}
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise StepsError(
            f"The archive cannot be read as NumPy arrays without pickles: {error}.", path=str(path)
        ) from error
    try:
        return _motors(arrays)
    except StepsError as error:
        raise error.located(str(path)) from None


def _motors(arrays: Mapping[str, NDArray[Any]]) -> dict[str, MotorSteps]:
    named = [motor for motor in MOTORS + FOLLOWING if motor in MOTORS or f"{motor}_direction" in arrays]
    needed = ["clock_hz"]
    for motor in named:
        times = ("interval", "count", "add") if f"{motor}_interval" in arrays else ("tick",)
        needed += [f"{motor}_{key}" for key in (*times, "direction", "start_mm", "step_mm")]
    if missing := [key for key in needed if key not in arrays]:
        raise StepsError(f"The archive has no {', '.join(missing)}; step timings need {', '.join(needed)}.")
    clock_hz = _number(arrays, "clock_hz")
    return {motor: _motor(motor, arrays, clock_hz) for motor in named}


def _motor(motor: str, arrays: Mapping[str, NDArray[Any]], clock_hz: float) -> MotorSteps:
    direction = _whole(arrays, f"{motor}_direction")
    _require(np.abs(direction) == 1, direction, f"{motor}_direction", "a direction is 1 (up) or -1 (down)")
    if f"{motor}_interval" in arrays:
        tick, direction = _expanded(motor, arrays, direction)
        name = f"{motor}_interval, _count, _add written out: step"
    else:
        tick, name = _whole(arrays, f"{motor}_tick"), f"{motor}_tick"
        _same_length(f"{motor}_direction", direction, name, tick)
    _require(np.diff(tick, prepend=-1) > 0, tick, name, "ticks are not negative and rise from step to step")
    start_mm = _number(arrays, f"{motor}_start_mm", positive=False)
    return MotorSteps(tick / clock_hz, direction.astype(np.int8), start_mm, _number(arrays, f"{motor}_step_mm"))


def _expanded(motor: str, arrays: Mapping[str, NDArray[Any]], direction: IntArray) -> tuple[IntArray, IntArray]:
    """Every step's tick and direction, (n,) each, of rows `queue_step interval count add`."""
    interval, count, add = (_whole(arrays, f"{motor}_{key}") for key in ("interval", "count", "add"))
    for key, values in (("count", count), ("add", add), ("direction", direction)):
        _same_length(f"{motor}_{key}", values, f"{motor}_interval", interval)
    _require(count > 0, count, f"{motor}_count", "a row has one step or more")
    if (steps := int(count.sum())) > MOST_STEPS:
        raise StepsError(f"{motor}_count adds up to {steps} steps; at most {MOST_STEPS} can be played.")
    lasts = count * interval + add * (count * (count - 1) // 2)
    before = np.cumsum(lasts) - lasts
    first = np.cumsum(count) - count
    j = np.arange(1, steps + 1, dtype=np.int64) - np.repeat(first, count)
    each = [np.repeat(values, count) for values in (before, interval, add, direction)]
    return each[0] + j * each[1] + each[2] * (j * (j - 1) // 2), each[3]


def _whole(arrays: Mapping[str, NDArray[Any]], key: str) -> IntArray:
    """(n,) whole numbers."""
    values = arrays[key]
    if values.ndim != 1 or values.dtype.kind not in "iu":
        rule = "it must be one row of whole numbers"
        raise StepsError(f"{key} has the shape {values.shape} and the type {values.dtype}; {rule}.")
    return values.astype(np.int64)


def _number(arrays: Mapping[str, NDArray[Any]], key: str, *, positive: bool = True) -> float:
    values = arrays[key]
    rule = "one finite number" + (" above zero" if positive else "")
    if values.size != 1 or values.dtype.kind not in "iuf":
        raise StepsError(f"{key} has the shape {values.shape} and the type {values.dtype}; it must be {rule}.")
    value = float(values.reshape(()))
    if not np.isfinite(value) or (positive and value <= 0.0):
        raise StepsError(f"{key} is {value:g}; it must be {rule}.")
    return value


def _require(good: NDArray[np.bool_], values: IntArray, name: str, rule: str) -> None:
    bad = np.flatnonzero(~good)
    if bad.size:
        k = int(bad[0])
        after = f" after {values[k - 1]}" if k else ""
        raise StepsError(f"{name}[{k}] is {values[k]}{after}; {rule} ({bad.size} such).")


def _same_length(name: str, values: IntArray, other: str, others: IntArray) -> None:
    if len(values) != len(others):
        raise StepsError(f"{name} has {len(values)} values, but {other} has {len(others)}; they belong together.")
