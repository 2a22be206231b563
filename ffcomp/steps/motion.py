"""A nozzle path in, a file of motion out, as it comes: what the module for Klipper's host plays.

The file holds the command itself, not the steps: the host's own kinematics makes the steps of it, on whatever board.
docs/reference/files.md has its header. Memory does not grow with the print.

Knots lie on a grid and are equally far apart in time, so that of each coordinate only the second difference is kept:
small whole numbers, whose bytes are sorted by their weight before `zlib` takes them.
"""

from __future__ import annotations

import json
import re
import struct
import tempfile
import zlib
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ffcomp.steps.crossings import GRID_MM, Knots
from ffcomp.steps.sink import BEFORE_S, MotorTotal, StepSink
from gcode.atomic_write import replace_atomically
from models.arrays import FloatArray, IntArray

LINES, KNOTS, WAIT = 1, 2, 4  # kinds of record
BEGINS, RESTS_BEFORE, RESTS_AFTER, ANY_HEIGHT = 1, 2, 4, 8  # flags of a record of knots
RECORD = np.dtype([("kind", "u1"), ("flags", "u1"), ("zero", "<u2"), ("count", "<u4")])
# A record is what the player hands to the host's look-ahead at once. The host releases one only when it knows what
# follows, and stops on the path where it must make steps sooner: so records are short after a rest, and grow.
LEAST_KNOTS, MOST_KNOTS = 32, 512
GROWTH = 4  # a record is a quarter as long as what precedes it since the rest
FULL_BYTES = 1 << 18
AXES = 4


@dataclass
class MotionBlock:
    """Records under way."""

    records: list[tuple[int, int, int, int]] = field(default_factory=list)
    numbers: list[float] = field(default_factory=list)  # of runs: spacing, origin; of waits: how long
    text: list[bytes] = field(default_factory=list)
    bends: list[IntArray] = field(default_factory=list)  # (n, 4) each
    size: int = 0
    # s between knots; the last knot and the step to it, on the grid
    run: tuple[float, IntArray, IntArray] | None = None

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

    def rest(self) -> None:
        """Note that the nozzle rests after the last record of motion, if this chunk has one at its end."""
        for k in range(len(self.records) - 1, -1, -1):
            kind, flags, zero, count = self.records[k]
            if kind == KNOTS:
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
            b"",  # nothing: a part that the format keeps
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


MAGIC = b"FFCMOT1\n"
SCHEMA = "ffcomp-motion/1"
SOON_S = 1e-7
BLOCK_BYTES = 1 << 20
_WAIT, _MOVE = re.compile(rb"[Gg]0*4(?!\d)"), re.compile(rb"[Gg]0*[01](?![\d.])")
_FEED = re.compile(rb"[Ff]\s*\d[\d.]*")


@dataclass
class _Extremes:
    """What the player compares with the printer's limits before it begins."""

    lowest: FloatArray = field(default_factory=lambda: np.full(3, np.inf))
    highest: FloatArray = field(default_factory=lambda: np.full(3, -np.inf))
    speed: float = 0.0
    acceleration: float = 0.0

    def add(self, knots: Knots) -> None:
        places = knots.places[:, :3]
        self.lowest = np.minimum(self.lowest, places.min(axis=0))
        self.highest = np.maximum(self.highest, places.max(axis=0))
        velocity = np.diff(places, axis=0) / knots.spacing_s
        self.speed = max(self.speed, float(np.linalg.norm(velocity, axis=1).max(initial=0.0)))
        jumps = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / knots.spacing_s
        self.acceleration = max(self.acceleration, float(jumps.max(initial=0.0)))


class MotionSink:
    """Writes the file that `FFCOMP_PRINT` plays; takes what `StepSink` takes, in the same order.

    target : the file
    about : more of the header's keys
    """

    clock_s = BEFORE_S  # of the path so far; whoever gives the path counts on

    def __init__(self, target: str | Path, about: Mapping[str, Any]) -> None:
        self._target, self._about = Path(target), about
        self._body = tempfile.TemporaryFile(dir=self._target.resolve().parent)  # noqa: SIM115 - `close` closes it
        self._chunk, self._extremes = MotionBlock(), _Extremes()
        self._events = deque[tuple[float, bytes]]()
        self._clock: float | None = None  # s; None before the first line, rest or motion
        self._feed = b""  # a line not written yet
        self._factors = 1.0, 1.0
        self._begin_s = self._rests_until = 0.0
        self._knots_since_rest = 0
        self._rests = self._height_known = True
        self._records = self._text_bytes = 0

    def event(self, t: float, line: bytes, *, still: bool = False) -> None:
        """Add a G-code line to run at the time t, s; still: nothing moves by it.

        Comments and waits are left out: the motion has the waits. So are moves that go nowhere, whose place the grid
        cannot represent; their feed is written before the next line that makes the host move by itself.
        """
        self._begin(t)
        line = line.strip()
        if not line or line.startswith(b";") or _WAIT.match(line):
            return
        if still and _MOVE.match(line):
            feed = _FEED.search(line.partition(b";")[0])
            self._feed = self._feed if feed is None else b"G1 " + feed[0].replace(b" ", b"") + b"\n"
            return
        if not still and self._feed:
            self._events.append((t, self._feed))
            self._feed = b""
        self._events.append((t, line + b"\n"))

    def factors(self, t: float, speed: float, flow: float) -> None:
        """Say which M220 and M221 of the print the motion from t on contains already: the host's count on top."""
        if (speed, flow) != self._factors:
            self._factors = speed, flow
            self._events.append((t, b"FFCOMP_FACTORS SPEED=%a FLOW=%a\n" % (speed, flow)))

    def rest(self, until: float) -> None:
        """Note that the nozzle rests where the motion has come to, until a time, s, at least.

        A clock may stop here, and go on at full pace.
        """
        self._rests_until = until
        self._stop()

    def _begin(self, t: float) -> None:
        if self._clock is None:
            self._clock = self._begin_s = t

    def _stop(self) -> None:
        self._rests, self._knots_since_rest = True, 0
        self._chunk.rest()

    def height(self, known: bool) -> None:
        """Say whether the Z of what follows is meant, or only its changes: after a macro the host knows better."""
        self._height_known = known

    def knots(self, knots: Knots) -> None:
        """Take the next part of the path."""
        self._extremes.add(knots)
        begin = knots.start_t
        self._begin(begin)
        self._lines_until(begin + SOON_S)
        self._wait_until(begin)
        self._records_of(knots)
        self._clock = knots.end_t

    def _lines_until(self, t: float) -> None:
        while self._events and self._events[0][0] <= t:
            at, line = self._events.popleft()
            self._wait_until(min(at, t))
            self._line(line)

    def _line(self, line: bytes) -> None:
        self._chunk.lines(line)
        self._text_bytes += len(line)

    def _wait_until(self, t: float) -> None:
        if self._clock is not None and t > self._clock + SOON_S:
            self._stop()
            self._chunk.wait(t - self._clock)
            self._records += 1
            self._clock = t

    def _records_of(self, knots: Knots) -> None:
        places = np.rint(knots.places / GRID_MM).astype(np.int64)
        spacing, begin, first, count = knots.spacing_s, knots.start_t, 0, len(places) - 1
        while first < count:
            due = count
            if self._events:
                due = min(max(round((self._events[0][0] - begin) / spacing), 0), due)
            if due <= first and self._events:
                self._line(self._events.popleft()[1])
                continue
            last = min(first + min(max(self._knots_since_rest // GROWTH, LEAST_KNOTS), MOST_KNOTS), due)
            if self._chunk.size > FULL_BYTES:  # only before motion: the last record may still be marked to end at rest
                self._flush()
            flags = RESTS_BEFORE * self._rests | ANY_HEIGHT * (not self._height_known)
            self._chunk.knots(spacing, places[first : last + 1], flags)
            self._rests = False
            self._records += 1
            self._knots_since_rest += last - first
            first = last

    def _flush(self) -> None:
        self._body.write(self._chunk.packed())
        self._chunk = MotionBlock()

    def finish(self) -> dict[str, MotorTotal]:
        """Write the file. It has no steps to count: the host makes them."""
        self._stop()
        self._lines_until(np.inf)
        self._wait_until(self._rests_until)
        self._flush()
        replace_atomically(self._target, self._whole())
        self.close()
        return {}

    def _whole(self) -> Iterator[bytes]:
        head = json.dumps(self._header()).encode()
        yield MAGIC + struct.pack("<I", len(head)) + head
        self._body.seek(0)
        while block := self._body.read(BLOCK_BYTES):
            yield block

    def _header(self) -> dict[str, Any]:
        extremes = self._extremes
        return {
            "schema": SCHEMA,
            **self._about,
            "duration_s": 0.0 if self._clock is None else self._clock - self._begin_s,
            "grid_mm": GRID_MM,
            "records": self._records,
            "text_bytes": self._text_bytes,
            "lowest_mm": extremes.lowest.tolist(),
            "highest_mm": extremes.highest.tolist(),
            "peak_velocity_mm_per_s": extremes.speed,
            "peak_acceleration_mm_per_s2": extremes.acceleration,
        }

    def close(self) -> None:
        """Discard the temporary files; `finish` does so itself."""
        self._body.close()


Sink = StepSink | MotionSink
