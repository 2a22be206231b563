"""Read logs of Klipper's data logger: motion and sensors.

It writes a log, `NAME.json.gz`, and next to it an index, `NAME.index.gz`, which is not needed. The log is a gzip stream
of JSON objects with a byte 3 behind each. Of its messages `{"q": ID, "params": {...}}` these are read:

| ID | what |
|---|---|
| `trapq:toolhead` | the commanded nozzle: constant accelerations, before the input shaper |
| `accelerometer:<name>` | mm/s², gravity in it, the chip's axes turned as the configuration says |

All times are print times. A log that was cut off is read as far as it goes.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.errors import MeasurementError
from models.arrays import FloatArray

_GZIP = b"\x1f\x8b"
ENDINGS = (".json.gz", ".index.gz")


@dataclass(frozen=True, eq=False)
class Nozzle:
    """The commanded nozzle in n segments of constant acceleration; in between it rests."""

    begin_s: FloatArray  # (n,) print time, rising
    lasts_s: FloatArray  # (n,)
    speed: FloatArray  # (n,) mm/s at the beginning
    acceleration: FloatArray  # (n,) mm/s² along the way
    start_mm: FloatArray  # (n, 3)
    direction: FloatArray  # (n, 3)

    def at(self, t: FloatArray) -> FloatArray:
        """Return the position at print times (k,) s: (k, 3) mm."""
        k = np.maximum(np.searchsorted(self.begin_s, t, side="right") - 1, 0)
        since = np.clip(t - self.begin_s[k], 0.0, self.lasts_s[k])
        way = self.speed[k] * since + 0.5 * self.acceleration[k] * since**2
        return np.asarray(self.start_mm[k] + self.direction[k] * way[:, None])


@dataclass(frozen=True, eq=False)
class Samples:
    """What an accelerometer measured."""

    time_s: FloatArray  # (n,) print time
    acceleration: FloatArray  # (n, 3) m/s²
    lost_at_s: FloatArray  # (k,) print times of messages behind which samples were lost


@dataclass(frozen=True, eq=False)
class MotionLog:
    """One log."""

    source: str
    nozzle: Nozzle
    sensors: Mapping[str, Samples]  # by the chip's name


def is_motion_log(path: str | Path) -> bool:
    """Recognise a log or its index by its ending and its first bytes."""
    if not str(path).endswith(ENDINGS):
        return False
    with Path(path).open("rb") as file:
        return file.read(len(_GZIP)) == _GZIP


def is_index(path: str | Path) -> bool:
    """Recognise an index from a log by its ending."""
    return str(path).endswith(ENDINGS[1])


def read_motion_log(path: str | Path) -> MotionLog:
    """Read a log; MeasurementError for a file that is no such log, or lacks motion or accelerations."""
    messages: dict[str, dict[str, list[dict[str, Any]]]] = {"trapq": {}, "accelerometer": {}}
    for message in _objects(path):
        (kind, _, name), params = str(message.get("q", "")).partition(":"), message.get("params")
        if kind in messages and isinstance(params, dict) and params.get("data"):
            messages[kind].setdefault(name, []).append(params)
    moves = messages["trapq"].get("toolhead", [])
    if not moves or not messages["accelerometer"]:
        missing = "commanded motion (trapq:toolhead)" if not moves else "acceleration (accelerometer:…)"
        raise MeasurementError(
            str(path),
            [
                f"It is no log of Klipper's data_logger.py, or holds no {missing}. Log with -s 'accelerometer:*', "
                "from before the G-code starts until it has ended."
            ],
        )
    return MotionLog(
        str(path),
        _nozzle([row for each in moves for row in each["data"]]),
        {name: _samples(parts) for name, parts in messages["accelerometer"].items()},
    )


def _objects(path: str | Path) -> Iterator[dict[str, Any]]:
    """Yield the JSON objects of a gzip stream, as far as it goes."""
    unpack, rest = zlib.decompressobj(wbits=31), b""
    try:
        text = unpack.decompress(Path(path).read_bytes())
    except zlib.error as error:
        raise MeasurementError(str(path), [f"It cannot be unpacked ({error}). Copy the file again."]) from error
    for rest in text.split(b"\x03"):
        if not rest.strip():
            continue
        try:
            message = json.loads(rest)
        except ValueError:
            continue  # the last one of a log that was cut off
        if isinstance(message, dict):
            yield message


def _nozzle(rows: list[list[Any]]) -> Nozzle:
    unique = {float(row[0]): row for row in rows}  # a message may repeat the last segment
    ordered = [unique[t] for t in sorted(unique)]
    numbers = np.array([row[:4] for row in ordered], dtype=np.float64)
    start = np.array([row[4][:3] for row in ordered], dtype=np.float64)
    direction = np.array([row[5][:3] for row in ordered], dtype=np.float64)
    begin, lasts, speed, acceleration = np.ascontiguousarray(numbers.T)
    return Nozzle(begin, lasts, speed, acceleration, start, direction)


def _samples(messages: list[dict[str, Any]]) -> Samples:
    rows = np.concatenate([np.array(each["data"], dtype=np.float64)[:, :4] for each in messages])
    counts = [float(each.get("overflows", 0)) + float(each.get("errors", 0)) for each in messages]
    ends = [float(each["data"][-1][0]) for each in messages]
    lost = [end for end, count, before in zip(ends, counts, [counts[0], *counts], strict=False) if count > before]
    return Samples(rows[:, 0], rows[:, 1:] * 1e-3, np.array(lost))
