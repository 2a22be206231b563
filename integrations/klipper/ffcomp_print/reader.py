# Reads files of motion; needs nothing of the host.
#
# Copyright (C) 2026  The ffcomp authors
#
# This file may be distributed under the terms of the GNU GPLv3 license.
"""A file of motion (`ffcomp-motion/1`), record by record, in flat memory.

As a program, it tells what is in a file: `python reader.py FILE.ffm`.
"""

import json
import struct
import sys
import zlib

import numpy as np

MAGIC = b"FFCMOT1\n"
SCHEMA = "ffcomp-motion/1"
LINES, KNOTS, WAIT = 1, 2, 4
BEGINS, RESTS_BEFORE, RESTS_AFTER, ANY_HEIGHT = 1, 2, 4, 8
RECORD = np.dtype([("kind", "u1"), ("flags", "u1"), ("zero", "<u2"), ("count", "<u4")])
MOST_HEADER = 1 << 20
MOST_CHUNK = 1 << 26


class MotionFileError(Exception):
    """A file that cannot be played."""


class Text:
    """Lines of G-code, to be run when the motion before them is over."""

    __slots__ = ("lines",)

    def __init__(self, text):
        self.lines = text.decode("utf-8", "replace").split("\n")[:-1]


class Wait:
    """The nozzle rests for some seconds."""

    __slots__ = ("seconds",)

    def __init__(self, seconds):
        self.seconds = seconds


class Motion:
    """Straight pieces from knot to knot, each at one speed: places (n + 1, 4) mm, X Y Z E, every `spacing` s."""

    __slots__ = ("flags", "places", "rests_after", "rests_before", "spacing")

    def __init__(self, flags, spacing, places):
        self.flags, self.spacing, self.places = flags, spacing, places
        self.rests_before, self.rests_after = bool(flags & RESTS_BEFORE), bool(flags & RESTS_AFTER)

    @property
    def duration(self):
        """How long all of them take, s."""
        return self.spacing * (len(self.places) - 1)

    def part(self, first, last):
        """Pieces `first` to before `last`."""
        flags = self.flags if not first else self.flags & ~RESTS_BEFORE
        return Motion(flags, self.spacing, self.places[first : None if last is None else last + 1])


def open_motion(path):
    """Open a file and read its header; returns the file, at its first chunk, and the header."""
    stream = open(path, "rb")  # noqa: SIM115 - it stays open
    try:
        return stream, read_header(stream)
    except Exception:
        stream.close()
        raise


def read_header(stream):
    """Read what a file says of itself."""
    start = stream.read(len(MAGIC) + 4)
    if start[: len(MAGIC)] != MAGIC or len(start) < len(MAGIC) + 4:
        raise MotionFileError("This is no file of motion; ffcomp compensate --kind host writes one.")
    (size,) = struct.unpack("<I", start[len(MAGIC) :])
    if size > MOST_HEADER:
        raise MotionFileError("The file's header is damaged.")
    try:
        header = json.loads(stream.read(size).decode("utf-8"))
    except ValueError:
        raise MotionFileError("The file's header is damaged.") from None
    if header.get("schema") != SCHEMA:
        schema = header.get("schema")
        raise MotionFileError("The file is of the kind %s; this module plays %s. Update it." % (schema, SCHEMA))
    return header


def records(stream, header):
    """Yield `Text`, `Wait` and `Motion`, in order, from a stream that stands after its header."""
    while True:
        start = stream.read(8)
        if not start:
            return
        yield from _chunk(_unpacked(stream, start), header["grid_mm"])


def _unpacked(stream, start):
    damaged = MotionFileError("The file is damaged or cut short; copy it again.")
    if len(start) < 8:
        raise damaged
    packed, raw = struct.unpack("<II", start)
    if packed > MOST_CHUNK or raw > MOST_CHUNK:
        raise damaged
    data = stream.read(packed)
    if len(data) < packed:
        raise damaged
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(data, raw)
    except zlib.error:
        raise damaged from None
    if len(unpacked) != raw:
        raise damaged
    return unpacked


def _chunk(raw, grid_mm):
    sizes = struct.unpack_from("<5I", raw)
    parts, at = [], struct.calcsize("<5I")
    for size in sizes:
        parts.append(raw[at : at + size])
        at += size
    table = np.frombuffer(parts[0], RECORD)
    numbers, bends = np.frombuffer(parts[1], "<f8"), _bends(parts[4])
    number = text = bend = 0
    spacing, last, step = 0.0, None, None  # of the run of knots under way
    for kind, flags, _, count in table.tolist():
        if kind == LINES:
            yield Text(parts[2][text : text + count])
            text += count
        elif kind == WAIT:
            yield Wait(float(numbers[number]))
            number += 1
        elif kind == KNOTS:
            if flags & BEGINS:
                spacing, last = float(numbers[number]), np.rint(numbers[number + 1 : number + 5] / grid_mm)
                step = np.zeros(4)
                number += 5
            steps = step + np.cumsum(bends[bend : bend + count], axis=0, dtype=np.int64)
            places = np.vstack([last, last + np.cumsum(steps, axis=0)])
            bend, last, step = bend + count, places[-1], steps[-1]
            yield Motion(flags, spacing, places * grid_mm)
        else:
            raise MotionFileError("The file holds what this module does not know. Update it.")


def _bends(planes):
    """Second differences (n, 4), from their bytes sorted by axis and weight."""
    parts = np.frombuffer(planes, np.uint8).reshape(4, 4, -1)
    folded = np.ascontiguousarray(parts.transpose(0, 2, 1)).view("<u4")[:, :, 0]
    return ((folded >> 1) ^ (0 - (folded & 1))).astype(np.int32).T


def main(path):
    """Print a file's header, and what its records add up to."""
    stream, header = open_motion(path)
    counts, seconds, segments = {"Text": 0, "Wait": 0, "Motion": 0}, 0.0, 0
    with stream:
        for record in records(stream, header):
            counts[type(record).__name__] += 1
            if isinstance(record, Motion):
                seconds += record.duration
                segments += len(record.places) - 1
    print(json.dumps({**header, "found": counts, "moves_s": seconds, "segments": segments}, indent=1))


if __name__ == "__main__":
    main(sys.argv[1])
