"""Shake&Tune's captures (`.stdata`): Zstandard over JSON, one line a capture.

A line is `{"name": …, "samples": [[t, x, y, z], …]}`.
The samples are Klipper's own: print time in s, mm/s², gravity included.
"""

from __future__ import annotations

import json
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.errors import MeasurementError
from ffcomp.measurement.capture import Capture, make_capture
from ffcomp.measurement.table import Table
from gcode.text import most_unpacked
from models.arrays import FloatArray

PIECE = 1 << 20  # bytes that are unpacked at a time
FED = 256  # packed bytes at a time, where what they unpack to cannot be bounded: some megabytes at most
MAGIC = b"\x28\xb5\x2f\xfd"
_COLUMNS = ("time", "accel_x", "accel_y", "accel_z")
_AXIS = re.compile(r"(axis_[XYZ]|belt_[AB])(?=_|$)")
_EXCITED = {
    "axis_X": "x",
    "axis_Y": "y",
    "axis_Z": "z",
    "belt_A": "axis=1.000,-1.000",
    "belt_B": "axis=1.000,1.000",
}


def is_stdata(path: str | Path) -> bool:
    """Tell by the first bytes."""
    with Path(path).open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def stdata_captures(path: str | Path) -> list[Capture]:
    """Read every measurement in the file.

    Raises
    ------
    MeasurementError
        If it cannot be unpacked, or a measurement cannot be used.
    """
    captures = []
    for number, line in enumerate(_unpacked(path).splitlines(), 1):
        if line.strip():
            captures.append(_capture(str(path), number, line))
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
    return _from_samples(path, name, samples)


def _from_samples(path: str, name: str, samples: FloatArray) -> Capture:
    table = Table(_COLUMNS, samples, np.arange(1, len(samples) + 1), {})
    axis = _AXIS.search(name)
    return make_capture(
        path,
        table,
        samples[:, 0],
        samples[:, 1:] * 1e-3,
        axis=_EXCITED[axis[1]] if axis else None,
        name=name,
        clock="firmware",
    )


def _unpacked(path: str | Path) -> bytes:
    packed = Path(path).read_bytes()
    for module, unpack in (("compression.zstd", _standard), ("zstandard", _package)):
        try:
            library = import_module(module)
        except ImportError:
            continue
        try:
            return unpack(library, packed)
        except Exception as error:  # of the library's own kind
            raise MeasurementError(str(path), [f"It cannot be unpacked: {error}."]) from error
    raise MeasurementError(
        str(path),
        ["Shake&Tune's files are Zstandard archives; to read them, install the extra: pip install 'ffcomp[stdata]'."],
    )


def _standard(library: Any, packed: bytes) -> bytes:
    """Unpack with Python's own library (3.14 and later), frame by frame."""
    pieces: list[bytes] = []
    most = most_unpacked(len(packed))
    while packed:
        frame, given = library.ZstdDecompressor(), packed
        while not frame.eof:
            pieces.append(frame.decompress(given, max_length=PIECE))
            given = b""
            if not pieces[-1] and frame.needs_input:
                raise ValueError("the file ends in the middle")
            most = _left(most, pieces[-1])
        packed = frame.unused_data
    return b"".join(pieces)


def _package(library: Any, packed: bytes) -> bytes:
    """Unpack with the package zstandard, frame by frame; a frame need not state its size."""
    pieces: list[bytes] = []
    most = most_unpacked(len(packed))
    while packed:
        frame, at = library.ZstdDecompressor().decompressobj(), 0
        while not frame.eof and at < len(packed):
            pieces.append(frame.decompress(packed[at : at + FED]))
            at += FED
            most = _left(most, pieces[-1])
        if not frame.eof:
            raise ValueError("the file ends in the middle")
        packed = frame.unused_data + packed[at:]
    return b"".join(pieces)


def _left(most: int, piece: bytes) -> int:
    """Return how much may still come: archives can be made that fill any memory."""
    if len(piece) > most:
        raise ValueError("it unpacks to more than any recording does")
    return most - len(piece)
