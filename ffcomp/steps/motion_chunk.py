"""Pack a part of a print's motion, as docs/reference/files.md describes it: lines, waits, knots and pieces in order.

Knots lie on a grid and are equally far apart in time, so that of each coordinate only the second difference is kept:
small whole numbers, whose bytes are sorted by their weight before `zlib` takes them. What is no knot (the ramps of an
uncompensated plan) is kept as it is, in double precision.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

import numpy as np

from ffcomp.steps.pieces import GRID_MM
from models.arrays import FloatArray, IntArray

LINES, KNOTS, PIECES, WAIT = 1, 2, 3, 4  # kinds of record
BEGINS, RESTS_BEFORE, RESTS_AFTER, ANY_HEIGHT = 1, 2, 4, 8  # flags of a record of knots or pieces
RECORD = np.dtype([("kind", "u1"), ("flags", "u1"), ("zero", "<u2"), ("count", "<u4")])
MOST_KNOTS = (
    512  # in a record, which is what the player handles at once: longer ones cost it less, and pauses come later
)
FULL_BYTES = 1 << 18
AXES = 4


@dataclass
class Chunk:
    """Records under way."""

    records: list[tuple[int, int, int, int]] = field(default_factory=list)
    numbers: list[float] = field(default_factory=list)  # of runs: spacing, origin; of waits: how long
    text: list[bytes] = field(default_factory=list)
    pieces: list[FloatArray] = field(default_factory=list)  # (n, 11) each
    bends: list[IntArray] = field(default_factory=list)  # (n, 4) each
    size: int = 0
    run: tuple[float, IntArray, IntArray] | None = (
        None  # s between knots; the last knot and the step to it, on the grid
    )

    def lines(self, text: bytes) -> None:
        """Append lines of G-code, each with its line ending."""
        self._record(LINES, 0, len(text))
        self.text.append(text)
        self.size += len(text)

    def wait(self, seconds: float) -> None:
        """Append a rest."""
        self._record(WAIT, 0, 1)
        self.numbers.append(seconds)

    def knots(self, spacing_s: float, places: IntArray, flags: int) -> None:
        """Append the knots (n + 1, 4) of straight segments, the first of them where the last record ended."""
        if self.run is None or self.run[0] != spacing_s or (self.run[1] != places[0]).any():
            flags |= BEGINS
            self.numbers.extend([spacing_s, *(places[0] * GRID_MM).tolist()])
            step = np.zeros(AXES, dtype=np.int64)
        else:
            step = self.run[2]
        steps = np.diff(places, axis=0)
        self.bends.append(np.diff(steps, axis=0, prepend=step[None]))
        self._record(KNOTS, flags, len(steps))
        self.run = spacing_s, places[-1], steps[-1]
        self.size += 4 * AXES * len(steps)

    def ramps(self, rows: FloatArray, flags: int) -> None:
        """Append pieces (n, 11) of constant acceleration: duration, origin, direction, speed, acceleration."""
        self._record(PIECES, flags, len(rows))
        self.pieces.append(rows)
        self.run = None
        self.size += rows.nbytes

    def rest(self) -> None:
        """Note that the nozzle rests after the last record of motion, if this chunk has one at its end."""
        for k in range(len(self.records) - 1, -1, -1):
            kind, flags, zero, count = self.records[k]
            if kind in (KNOTS, PIECES):
                self.records[k] = kind, flags | RESTS_AFTER, zero, count
                return

    def _record(self, kind: int, flags: int, count: int) -> None:
        self.records.append((kind, flags, 0, count))
        self.size += RECORD.itemsize

    def packed(self) -> bytes:
        """Return its bytes in the file, length first."""
        bends = np.concatenate(self.bends) if self.bends else np.zeros((0, AXES), dtype=np.int64)
        parts = [
            np.array(self.records, dtype=RECORD).tobytes(),
            np.array(self.numbers, dtype="<f8").tobytes(),
            b"".join(self.text),
            b"".join(rows.astype("<f8").tobytes() for rows in self.pieces),
            _planes(bends),
        ]
        raw = struct.pack("<5I", *map(len, parts)) + b"".join(parts)
        packed = zlib.compress(raw, 9)
        return struct.pack("<II", len(packed), len(raw)) + packed


def _planes(bends: IntArray) -> bytes:
    """Sort the bytes of whole numbers (n, 4): axis by axis, and of each axis the lowest byte of all of them first."""
    folded = np.where(bends < 0, -2 * bends - 1, 2 * bends)  # small for small numbers of either sign
    if folded.size and folded.max() >= 1 << 32:
        raise ValueError("The command bends by more between two knots than a file of motion can hold.")
    each = np.ascontiguousarray(folded.T.astype("<u4"))
    return np.ascontiguousarray(each.view(np.uint8).reshape(AXES, -1, 4).transpose(0, 2, 1)).tobytes()
