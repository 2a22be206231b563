"""The compensated file, line by line: what is not ours passes through at its move's time, moves become segments.

Our segments stand in blocks. A block opens with the limits our segments need and closes with the limits (and the feed)
the file had, before anything that moves by itself: homing, macros, waits. Each move that we replace stays in the file
as a comment `;~` at its place, so the original can be read out of the result again (`original_lines`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from ffcomp.invert.settings import Settings
from ffcomp.marks import Mark, Timeline
from ffcomp.played import merge, played
from gcode.dialects import KLIPPER, close_limits, open_limits
from gcode.emit import MoveWriter
from gcode.limits import MotionLimits
from gcode.program import Event, EventKind, Frame, Program

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

OURS = b" ; ffcomp"  # ends every line of ours that is not a move
WAS = b";~"  # before a move of the original
STILL_MOVE = re.compile(rb"\s*(?:N\d+\s*)?G0*[0-3](?!\d)", re.IGNORECASE)


class Writer:
    """Turns runs and events, given in the file's order, into lines."""

    def __init__(
        self,
        program: Program,
        flavor: str,
        own: MotionLimits,
        settings: Settings,
        offset: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.program, self.flavor, self.own, self.settings = program, flavor, own, settings
        self.offset = offset
        self.moves = MoveWriter()
        self.at: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)  # mm, X Y Z E, where the file has the toolhead
        self.frame = 0
        self.open = False
        self.in_force = MotionLimits()
        self.said: dict[bytes, bytes] = {}
        self.ending = b"\r\n" if program.lines and program.lines[0].endswith(b"\r\n") else b"\n"
        self.segments = 0

    # -- what is not a run

    def event(self, event: Event) -> Iterator[bytes]:
        """A line that is not a move of ours, between runs."""
        if event.kind in (EventKind.STOP, EventKind.RAW_MOVE):
            yield from self.close()
        line = self.program.lines[event.line]
        if self.open and STILL_MOVE.match(line):  # a G1 that only sets the feed: ours always say theirs
            yield from self._original(event.line)
        elif event.kind is EventKind.RAW_MOVE and any(self.offset):
            yield from self._original(event.line)
            yield self._shifted(line)
        else:
            yield line
        self._take_frame(event.frame)
        if event.touches_limits:
            self._remember(line)
        if self.open and event.touches_limits:
            yield from self._limits(self._opening())

    def close(self) -> Iterator[bytes]:
        """End a block: the file's limits and feed are in force again."""
        if self.open:
            self.open = False
            yield from self._limits(self._closing())
            frame = self.program.frames[self.frame]
            feed = 60 * frame.feed_mm_per_s / frame.feed_factor / frame.unit_mm
            yield b"G1 F%.6g" % feed + OURS + self.ending

    def extrude(self, move: int) -> Iterator[bytes]:
        """An extruder-only move, as it was but for its feed, which is always said."""
        moves = self.program.moves
        yield from self._original(int(moves.line[move]))
        yield from self._begin(move)
        x, y, z, e = moves.end[move]
        yield self._finish(self._to(x, y, z, e, float(moves.speed[move])))

    def _shifted(self, line: bytes) -> bytes:
        """A move that the firmware plans itself, to where the offset puts it."""
        frame = self.program.frames[self.frame]
        code = line.partition(b";")[0].strip()
        if not frame.absolute:
            return code + OURS + self.ending
        shift = {b"X": self.offset[0] / frame.unit_mm, b"Y": self.offset[1] / frame.unit_mm}

        def moved(word: re.Match[bytes]) -> bytes:
            axis = word[1].upper()
            return axis + (b"%.4f" % (float(word[2]) + shift[axis])).rstrip(b"0").rstrip(b".")

        return re.sub(rb"([XYxy])\s*([-+]?\d*\.?\d+)", moved, code) + OURS + self.ending

    # -- a run

    def run(self, first: int, vertices: FloatArray, line_up: Timeline) -> Iterator[bytes]:
        """The segments of one run.

        Parameters
        ----------
        first : the run's first move
        vertices : (n + 1, 3) mm, columns X Y Z, at the run's knots
        line_up : the points at which segments may end, and the original's lines between them
        """
        yield from self._begin(first)
        knots = np.arange(len(vertices), dtype=np.float64)
        points = np.stack([np.interp(line_up.at, knots, axis) for axis in vertices.T], axis=1)
        points = _rounded(points, self.program.frames[int(self.program.moves.frame[first])])
        kept = self._enough(points, line_up)
        points, e, lasting = points[kept], line_up.e[kept], np.diff(line_up.at[kept]) * self.settings.segment_s
        speeds = played(points, np.diff(e), lasting, self.settings.output).cruise
        waiting, rest, begun = iter(line_up.marks), 0.0, False
        mark = next(waiting, None)
        columns = (kept[:-1], points[1:], e[1:], speeds, lasting)
        for point, (x, y, z), filament, speed, duration in zip(*(c.tolist() for c in columns), strict=True):
            while mark is not None and mark.point <= point:
                yield from self._mark(mark)
                mark = next(waiting, None)
            line = self._to(x, y, z, filament, speed)
            if not line:
                rest += duration
                continue
            if rest and begun:
                yield b"G4 P%.6g" % (1e3 * rest) + OURS + self.ending
            rest, begun = 0.0, True
            self.segments += 1
            yield self._finish(line)
        while mark is not None:
            yield from self._mark(mark)
            mark = next(waiting, None)

    def _enough(self, points: FloatArray, line_up: Timeline) -> IntArray:
        """The points worth writing: all where the command bends, few where it runs straight and evenly."""
        s = self.settings
        pinned = np.zeros(len(points), dtype=np.bool_)
        pinned[[mark.point for mark in line_up.marks]] = True
        return merge(line_up.at, points, line_up.e, pinned, 1e-3 * s.merge_um, s.longest_merged_s / s.segment_s)

    def _begin(self, move: int) -> Iterator[bytes]:
        """Open a block if none is open, and take over the state at `move`."""
        moves = self.program.moves
        self.in_force = MotionLimits(
            float(moves.velocity_limit[move]),
            float(moves.acceleration[move]),
            float(moves.square_corner_velocity[move]),
            float(moves.minimum_cruise_ratio[move]),
        )
        if not self.open:
            self.open = True
            yield from self._limits(self._opening())
            self.frame = int(moves.frame[move])
            self.at = tuple(moves.start[move].tolist())
            self._tell_frame()
        self._take_frame(int(moves.frame[move]))

    def _mark(self, mark: Mark) -> Iterator[bytes]:
        if mark.event is None:
            yield from self._original(mark.line)
        else:
            yield from self.event(mark.event)

    def _original(self, line: int) -> Iterator[bytes]:
        text = self.program.lines[line]
        yield WAS + text if text.endswith(b"\n") else WAS + text + self.ending

    def _take_frame(self, frame: int) -> None:
        if frame != self.frame:
            self.frame = frame
            if self.open:
                self.at = self.moves.place
                self._tell_frame()

    def _tell_frame(self) -> None:
        self.moves.reset(self.program.frames[self.frame], self.at[:3], self.at[3])

    def _to(self, x: float, y: float, z: float, e: float, speed: float) -> bytes:
        self.at = (x, y, z, e)
        return self.moves.move(x, y, z, e, speed)

    def _remember(self, line: bytes) -> None:
        """The file's last word on each limit: a command with other letters sets other limits."""
        code = line.partition(b";")[0].strip()
        letters = b"".join(sorted(set(re.findall(rb"[A-Z]", code.upper()))))
        self.said[code.split()[0].upper() + letters] = code

    def _closing(self) -> list[bytes]:
        """The limits that the file has set, over the machine's own."""
        if self.flavor == KLIPPER:
            return close_limits(self.flavor, _first_known(self.in_force, self.own))
        return [*close_limits(self.flavor, self.own), *self.said.values()]

    def _opening(self) -> list[bytes]:
        o = self.settings.output
        return open_limits(
            self.flavor, o.velocity_mm_per_s, o.acceleration_mm_per_s2, o.square_corner_velocity_mm_per_s
        )

    def _limits(self, lines: Iterable[bytes]) -> Iterator[bytes]:
        for line in lines:
            yield line.rstrip(b"\n") + OURS + self.ending

    def _finish(self, line: bytes) -> bytes:
        return line if self.ending == b"\n" else line.replace(b"\n", self.ending)


def _rounded(vertices: FloatArray, frame: Frame) -> FloatArray:
    """The vertices as the file will state them: 4 decimals in the file's own coordinates and unit."""
    base, unit = np.array(frame.base[:3]), frame.unit_mm
    decimals = 4 if unit == 1.0 else 6
    return np.round((vertices - base) / unit, decimals) * unit + base


def _first_known(file: MotionLimits, own: MotionLimits) -> MotionLimits:
    """The file's limits, and the machine's own where the file has set none."""
    pairs = ((getattr(file, name), getattr(own, name)) for name in MotionLimits.__dataclass_fields__)
    return MotionLimits(*(mine if theirs != theirs else theirs for theirs, mine in pairs))


def original(data: bytes) -> bytes:
    """The file as it was before compensation."""
    return b"".join(original_lines(data.splitlines(keepends=True)))


def original_lines(lines: Iterable[bytes]) -> Iterator[bytes]:
    """The file as it was before compensation (`gcode.metadata`'s stamps left out)."""
    inside = False
    for line in lines:
        ours = line.rstrip().endswith(OURS)
        if ours:
            inside = (inside or not line.startswith(b"G")) and not line.startswith(b"G1 F")
        elif line.startswith(WAS):
            yield line[len(WAS) :]
        elif line.startswith((b"; Processed by ffcomp", b"; ffcomp offset_mm=")):
            continue  # the stamp
        elif inside and line.startswith(b"G1 "):
            continue
        else:
            yield line
