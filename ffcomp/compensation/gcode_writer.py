"""The compensated file, line by line: moves become segments, and other lines pass through at their move's time.

Our segments stand in blocks. A block opens with the limits our segments need and closes with the limits (and the feed)
the file had, before anything that moves by itself: homing, macros, waits. Each move that we replace stays in the file
as a comment `;~` at its place, so the original can be read out of the result again (`original_lines`).
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import partial
from itertools import pairwise
from math import inf
from operator import itemgetter

import numpy as np

from ffcomp.compensation.gcode_layout import Timeline, tiles, timeline
from ffcomp.compensation.plan import Context, PlannedChunk
from ffcomp.firmware.base import Filament, FileLimits
from ffcomp.firmware.table import FIRMWARES
from ffcomp.inverse.feasible import SolvedSection
from ffcomp.planner.lifts import join_lifts
from ffcomp.planner.lookahead import stops_and_waits
from ffcomp.planner.segment_merging import merge
from ffcomp.planner.segment_timing import TimedSegments
from ffcomp.planner.trajectory import Section
from gcode.embedded import CUT_SHORT, OURS, WAS, joined, like_ours, section_time_line
from gcode.emit import MoveWriter
from gcode.errors import UnsupportedGcode
from gcode.layers import begins_layer
from gcode.metadata import Timed, tells
from gcode.program import Event, EventKind, EventQueue, MotionLimits, note_limits
from models.arrays import FloatArray, IntArray
from models.compiled import kernel

_Place = tuple[float, float, float, float]  # X Y Z E, mm
# a move of the original (index into its lines), another line of it, a line of ours, a limit of the motors
_Line = int | Event | bytes | float
SLACK_MM = 5e-4  # how far from its place the end of a segment may be written, if that takes fewer digits,
SLACK_MM_PER_S = 0.05  # and how much that may change the neighbouring speeds
REFIT_MM = 1e-3  # so near the border no end of a segment is moved from the command that is inside
STILL_MOVE = re.compile(rb"\s*(?:N\d+\s*)?G0*[0-3](?!\d)", re.IGNORECASE)


class GcodeRenderer:
    """Writes the lines of one chunk; `step_output.StepRenderer` has the same methods."""

    def __init__(self, chunk: PlannedChunk, context: Context) -> None:
        model, program = context.model, chunk.planned.program
        self._planned, self._extent, self._kinematics = chunk.planned, chunk.chunk.extent, model.full_machine.kinematics
        self.program, self.settings = program, model.settings
        self.firmware = FIRMWARES[context.flavor].segments(model)
        longest = min(self.settings.merging.longest, self.firmware.longest_s / self.settings.segment_s)
        self.merging = self.settings.merging._replace(longest=longest)
        self.filament = self.firmware.count()
        # which points (n, 3) mm the firmware lets a command go to
        self.inside = partial(self._kinematics.contains, margin_mm=-REFIT_MM)
        self.offset, self.raw_s = context.offset, chunk.raw_s
        self.moves = MoveWriter()
        self.frame = 0
        self.open = False
        self.to_return = chunk.chunk.to_return
        self.move = 0  # the last that was begun: its limits are the file's own
        self.file_limits = dict(chunk.chunk.limits)  # what the file has set of each limit
        self.ending = b"\r\n" if program.lines and program.lines[0].endswith(b"\r\n") else b"\n"
        self.segments = 0
        self.late_s = 0.0  # sum of their delays against their knots
        self.now_s = 0.0  # since the program's beginning
        # the section's tiles, as their lines state them; s since its first knot
        self.written: Sequence[TimedSegments] = []
        self.begun, self.rest = False, 0.0  # whether the run has moved, and for how long it has not, s
        self.section_begin = (0, 0.0)  # line of its first move in the file, from 0; s from knot 0 to its path
        self._events = EventQueue(program.events)
        stops, waits = stops_and_waits(program)
        self._at_rest = stops | (waits > 0.0)  # (n,) before each move

    # -- a chunk, in the file's order

    def before(self, section: Section) -> Iterator[bytes]:
        """Write the lines before a section."""
        yield from self._events_before(section.first)

    def section(self, section: Section, solved: SolvedSection) -> Iterator[bytes]:
        """Write the segments of a section, tile by tile, and the lines in it."""
        planned, reference, (begin, end) = self._planned, solved.reference, solved.reference.written
        heights = planned.program.moves.end[section.first : section.last, 2]
        vertices = self._kinematics.drawn_in(solved.solution.vertices, heights)
        inside = self._events.up_to(section.last - 1)
        if self._extent.begin is not None and section is planned.sections[0]:
            # within a block, and within a run, that another writer has begun
            self.open, self.begun, self.move = True, True, self._extent.begin.move
            self.frame = int(planned.program.moves.frame[self.move])
            self._begin_frame([*vertices[begin].tolist(), float(reference.extrusion(begin, begin)[0])])
        for tile in tiles(reference.knots, begin=begin, end=end):
            part = vertices[tile.first : tile.last + 1]
            events = timeline(planned.program, solved.trajectory, solved.section, reference, part, inside, tile)
            if tile.end == end < reference.knots and self._extent.end is not None:
                # where whole steps keep a motion that was slowed down from ending at a knot, the next one resumes here
                t = self._extent.end.time_in(solved.trajectory)
                events.e[np.searchsorted(events.at, end)] = float(solved.trajectory.position(np.array([t]))[0, 3])
            yield from self.tile(section.first, part, events, self._filament_after(section))

    def _filament_after(self, section: Section) -> Filament | None:
        """Return the filament that moves behind a section, if the firmware's queue holds it while the section ends."""
        moves, k = self._planned.program.moves, section.last
        if k >= len(moves) or self._at_rest[k] or np.any(moves.end[k, :3] != moves.start[k, :3]):
            return None
        return Filament(float(moves.end[k, 3] - moves.start[k, 3]), float(moves.speed[k]))

    def sliced(self, section: Section) -> Iterator[bytes]:
        """Write the original lines of a section."""
        if section.travels:
            yield from self.keep(section, self._events.up_to(section.last - 1))
        else:
            yield from self.extrude(section)

    def finish(self) -> Iterator[bytes]:
        """Write the lines after the last section, and restore the file's limits."""
        if self._extent.end is None:
            yield from self._events_before(len(self._planned.program.moves))
            yield from self.close()
        else:
            yield from self._ours(self.filament.naming(self.program.frames[self.frame], self.moves.place[3]))

    def _events_before(self, move: int) -> Iterator[bytes]:
        for event in self._events.up_to(move):
            yield from self.event(event)

    # -- lines between runs

    def event(self, event: Event) -> Iterator[bytes]:
        """Write a line that is not a move of ours, between sections."""
        if event.kind in (EventKind.STOP, EventKind.RAW_MOVE):
            yield from self.close()
        line = self.program.lines[event.line]
        if not line.endswith((b"\n", b"\r")):  # the file's last: a line after it would become part of it
            yield from self.close()
        if like_ours(line):
            yield self._escaped(event)
        elif self.open and STILL_MOVE.match(line):  # a G1 that only sets the feed: ours always say theirs
            yield self._original(event.line)
        elif event.kind is EventKind.RAW_MOVE:
            yield from self._as_sliced(event.line)
        else:
            yield Timed.at(line, self.now_s) if tells(line) or begins_layer(line) else line
        self.now_s += event.dwell_s + self.raw_s.get(event.line, 0.0)
        self.to_return = event.to_return(self.to_return)
        self._take_frame(event.frame)
        if self.open and (command := self.filament.set_by(line)):
            yield from self._filament_count(command, event.move)
        if event.limits is not None:
            note_limits(self.file_limits, event.limits)
            if self.open:
                yield from self._ours(self.firmware.opening(self._file_limits()))

    def _filament_count(self, command: str, move: int) -> Iterator[bytes]:
        frame, place, moves = self.program.frames[self.frame], self.moves.place, self.program.moves
        if command == "G92":
            named = moves.start[move, 3] if move < len(moves) else moves.end[-1, 3]
            self.filament.begin(frame, place[3], place[3] - named)
            self._set_frame(place)
        else:
            yield from self._ours(self.filament.opening(frame))

    def close(self) -> Iterator[bytes]:
        """End a block: the file's limits and feed are in force again."""
        if self.open:
            self.open = False
            yield from self._ours(self.firmware.closing(self._file_limits()))
            yield from self._ours(self.filament.closing(self.program.frames[self.frame], self.moves.place[3]))
            yield self._feed()

    def _feed(self) -> bytes:
        """Return the feed that is in force in the file."""
        frame = self.program.frames[self.frame]
        feed = 60 * frame.feed_mm_per_s / frame.feed_factor / frame.unit_mm
        text = (b"%.3f" % max(feed, 1e-3)).rstrip(b"0").rstrip(b".")  # never an exponent, never zero
        return b"G1 F" + text + OURS + self.ending

    def extrude(self, section: Section) -> Iterator[bytes]:
        """Write a section that moves only the extruder, unchanged but always with its feed."""
        moves, move = self.program.moves, section.first
        yield self._original(int(moves.line[move]))
        yield from self._begin(move)
        x, y, z, e = moves.end[move]
        yield self._finish(self.moves.move(x, y, z, e, float(moves.speed[move])))
        self.now_s += section.end_t - section.begin_t

    def keep(self, section: Section, inside: Iterable[Event]) -> Iterator[bytes]:
        """Write the original lines of a section that travels."""
        moves, lasts_s = self.program.moves, section.end_t - section.begin_t
        lines = dict.fromkeys(moves.line[section.first : section.last].tolist())
        yield section_time_line(self.program.first_line + next(iter(lines)), 0.0) + self.ending
        if self.open:
            yield from self.close()
        else:
            yield self._feed()
        for number, event in sorted(
            [*((k, None) for k in lines), *((each.line, each) for each in inside)], key=itemgetter(0)
        ):
            yield from self._as_sliced(number) if event is None else self.event(event)
        self._take_frame(int(moves.frame[section.last - 1]))
        self.move = section.last - 1
        self.now_s += lasts_s

    def _as_sliced(self, number: int) -> Iterator[bytes]:
        """Write an original move, shifted by the offset."""
        line = self.program.lines[number]
        if any(self.offset):
            yield self._original(number)
            yield self._shifted(line)
        else:
            yield line

    def _shifted(self, line: bytes) -> bytes:
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

    def tile(
        self, first: int, vertices: FloatArray, timeline: Timeline, filament: Filament | None = None
    ) -> Iterator[bytes]:
        """Write a section, or its next tile: many lines in one bytes object, times apart (`joined`).

        Parameters
        ----------
        first : the run's first move
        vertices : (n + 1, 3) mm, columns X Y Z, at the knots of the piece and its context
        timeline : possible ends of segments, and the original's lines between them
        filament : that moves next, without a rest before it
        """
        if timeline.tile.begin == 0:
            yield from self._begin(first)
            self.rest, self.begun = 0.0, False
            self.written = []
            self.section_begin = (self.program.line_of(first) - 1, timeline.lead_s)
        begins = self.moves.place[:3]
        segments, timed = self._segments(first, vertices, timeline, filament)
        lines = sorted([*segments.lines(timeline), *segments.limits()], key=itemgetter(0))
        text: list[bytes] = []
        stated = np.empty_like(segments.points)
        since = 0
        for a, b in pairwise([0, *self._turns(lines), len(lines)]):
            until = lines[b][0] if b < len(lines) else len(segments.e)
            part = segments.part(since, until)
            text += self._segments_and_lines(part, [(k - since, line) for k, line in lines[a:b]], stated[since:until])
            since = until
        self.written = [*self.written, timed._replace(vertices=np.vstack([begins, stated]))]
        yield from joined(text)

    def _segments(
        self, first: int, vertices: FloatArray, timeline: Timeline, filament: Filament | None
    ) -> tuple[_Segments, TimedSegments]:
        """Select the segments of a tile: all where the command bends, few where it runs straight and evenly.

        The second of the two is the same for who executes them.
        """
        s, piece, at = self.settings, timeline.tile, timeline.at
        frame = self.program.frames[int(self.program.moves.frame[first])]
        points = _points(vertices, at, piece.first)
        stay, pinned = np.arange(len(at)), timeline.cut
        if s.joins_lifts:
            stay, pinned = join_lifts(_stated(points, frame.base, frame.unit_mm), timeline.e, timeline.cut)
        of_points = at[stay], points[stay], timeline.e[stay]
        chosen = merge(*of_points, pinned, self.merging)
        chosen, due, points, fixed = self.firmware.ends(*of_points, chosen, pinned, self.inside)
        kept = stay[chosen]
        at, e = due, np.interp(due, at, timeline.e)
        points = _stated(points, frame.base, frame.unit_mm)
        ends = np.zeros(len(at), dtype=np.bool_)
        ends[[0, *at.searchsorted([piece.begin, piece.end]), -1]] = True
        chosen = self.firmware.executed(points, e, fixed, ends)
        at, points, e, kept, fixed = at[chosen], points[chosen], e[chosen], kept[chosen], fixed[chosen]
        due, lasting = at * s.segment_s, np.diff(at) * s.segment_s
        slack = np.minimum(SLACK_MM, SLACK_MM_PER_S * np.minimum(lasting, np.append(lasting[1:], 0.0)))
        slack[fixed[1:]] = 0.0  # another writer may go on from there, and the filament must be exact
        after = filament if piece.end == piece.last else None
        feed, most, speeds = self.firmware.speeds(points, e, lasting, self._file_limits(), after)
        begin, end = at.searchsorted([piece.begin, piece.end]).tolist()
        timed = TimedSegments(due, points, speeds).part(begin, end)
        late_s = np.where(speeds.duration > 0.0, speeds.duration - lasting, 0.0)  # of whole steps some are early
        self.late_s += float(late_s[begin:end].sum())
        lasting += late_s
        segments = _Segments(kept[:-1], points[1:], e[1:], feed, most, lasting, slack)
        return segments.part(begin, end), timed

    def _turns(self, lines: list[tuple[int, _Line]]) -> Iterator[int]:
        frame = self.frame
        for k, (_, line) in enumerate(lines):
            if isinstance(line, Event) and (line.frame != frame or self.filament.set_by(self.program.lines[line.line])):
                frame = line.frame
                yield k

    def _segments_and_lines(
        self, segments: _Segments, lines: list[tuple[int, _Line]], stated: FloatArray
    ) -> list[bytes]:
        """Return segments with the lines between them; only the first line may change how numbers are written.

        stated : (n, 3) mm, filled in with where the lines say that the segments end
        """
        passed = [self.now_s, *(self.now_s + np.cumsum(segments.lasting)).tolist()]
        before = bisect_right(lines, 0, key=itemgetter(0))
        text = [piece for _, line in lines[:before] for piece in self._line(line)]
        each = (segments.points, segments.e, segments.speeds, segments.lasting, segments.slack)
        block, ends = self.moves.block(*each, stated)
        starts, done = [0, *ends.tolist()], 0
        begun = self._begun(ends, segments.lasting)
        lines = lines[before:]
        for k, line in sorted([*lines, *begun], key=itemgetter(0)) if begun else lines:
            if starts[k] > done:
                text.append(self._finish(block[done : starts[k]]))
                done = starts[k]
            self.now_s = passed[k]
            text += self._line(line)
        text.append(self._finish(block[done:]))
        self.now_s = passed[-1]
        return text

    def _begun(self, ends: IntArray, lasting: FloatArray) -> list[tuple[int, bytes]]:
        """State before the section's first segment with a line when it begins; the nozzle has not moved before.

        ends : (n,) where each segment's line ends;  lasting : (n,) s
        """
        written = np.diff(ends, prepend=0) > 0
        self.segments += int(np.count_nonzero(written))
        if self.begun:
            return []
        first = int(written.argmax()) if written.any() else len(written)
        self.rest += float(lasting[:first].sum())
        if first == len(written):
            return []
        self.begun, (line, lead_s) = True, self.section_begin
        return [(first, section_time_line(line, self.rest - lead_s) + self.ending)]

    def _line(self, line: _Line) -> Iterable[bytes]:
        if isinstance(line, int):
            return (self._original(line),)
        if isinstance(line, float):
            return self._ours(self.firmware.paced(line, self.program.frames[self.frame].unit_mm))
        return (line,) if isinstance(line, bytes) else self.event(line)

    def _file_limits(self) -> FileLimits:
        moves = self.program.moves
        columns = (moves.velocity_limit, moves.acceleration, moves.square_corner_velocity, moves.minimum_cruise_ratio)
        at_move = MotionLimits(*(column.item(self.move) for column in columns))
        return FileLimits(at_move, self.file_limits, self.program.frames[self.frame].unit_mm)

    def _begin(self, move: int) -> Iterator[bytes]:
        moves = self.program.moves
        self.move = move
        if not self.open:
            self.open = True
            self.frame = int(moves.frame[move])
            self._begin_frame(moves.start[move].tolist())
            if self.to_return:  # at travel speed after a macro that left the nozzle elsewhere, or an excluded object
                yield from self._ours(self.moves.here(float(moves.speed[move])))
            self.to_return = False
            yield from self._ours(self.filament.opening(self.program.frames[self.frame]))
            yield from self._ours(self.firmware.opening(self._file_limits()))
        self._take_frame(int(moves.frame[move]))

    def _original(self, line: int) -> bytes:
        """Keep a line of the original as a comment, if the file shall hold its original."""
        text = self.program.lines[line]
        if not self.settings.writer.embed:
            return b""
        return WAS + text if text.endswith(b"\n") else CUT_SHORT + text + b"\n"

    def _escaped(self, event: Event) -> bytes:
        """Keep a line of the original that would be taken for one of ours as a comment."""
        line = self.program.lines[event.line]
        if not line.lstrip().startswith(b";"):
            rule = "only files that ffcomp has compensated have such lines, and this one has lost its stamp"
            number = self.program.first_line + event.line + 1
            raise UnsupportedGcode(f"The line ends in '{OURS.decode().strip()}'; {rule}.", number, self.program.path)
        return self._original(event.line) or line

    def _take_frame(self, frame: int) -> None:
        if frame != self.frame:
            self.frame = frame
            if self.open:
                self._set_frame(self.moves.place)

    def _begin_frame(self, place: Sequence[float]) -> None:
        self.filament.begin(self.program.frames[self.frame], place[3])
        self._set_frame(place)

    def _set_frame(self, place: Sequence[float]) -> None:
        frame = self.program.frames[self.frame]
        self.moves.reset(self.filament.frame(frame), place[:3], place[3])

    def _ours(self, lines: Iterable[bytes]) -> Iterator[bytes]:
        for line in lines:
            yield line.rstrip(b"\n") + OURS + self.ending

    def _finish(self, line: bytes) -> bytes:
        return line if self.ending == b"\n" else line.replace(b"\n", self.ending)


@dataclass(frozen=True, slots=True)
class _Segments:
    """n segments that are written, and the timeline points where they begin."""

    begins: IntArray  # (n,) index into Timeline.at
    points: FloatArray  # (n, 3) mm, columns X Y Z, their ends
    e: FloatArray  # (n,) mm of filament at their ends
    speeds: FloatArray  # (n,) mm/s
    most: FloatArray  # (n,) mm/s of the motors, inf: their limits in the header
    lasting: FloatArray  # (n,) s
    slack: FloatArray  # (n,) mm, how far from its end it may be written

    def part(self, begin: int, end: int) -> _Segments:
        s = slice(begin, end)
        return _Segments(*(getattr(self, each.name)[s] for each in fields(self)))

    def limits(self) -> list[tuple[int, _Line]]:
        """Return the motors' limits with the segment that each stands before: a line may raise them between two."""
        most = np.append(self.most, inf)
        limited = np.concatenate([[False], self.most < inf, [False]])
        return [(k, most.item(k)) for k in np.flatnonzero(limited[1:] | limited[:-1]).tolist()]

    def lines(self, timeline: Timeline) -> list[tuple[int, _Line]]:
        """Return the original's lines that go out among them, each with the segment it stands before.

        An event stands at its point, or else at the nearer of the ends around it, by filament and then by time. A move,
        which is a comment, stands before the segment that it is part of.
        """
        piece, at, e = timeline.tile, timeline.at, timeline.e
        place = at[timeline.point]
        within = (place >= piece.begin) & ((place < piece.end) | (piece.end == piece.last))
        points, is_event = timeline.point[within], timeline.event[within] >= 0
        last = len(self.begins)
        ends = np.append(self.begins, np.searchsorted(at, piece.end))
        before = np.searchsorted(ends, points, side="right") - 1
        behind, ahead = ends[before], ends[np.minimum(before + 1, last)]
        farther = np.abs(e[ahead] - e[points]) - np.abs(e[behind] - e[points])
        is_later = (farther < 0.0) | ((farther == 0.0) & (at[ahead] - at[points] < at[points] - at[behind]))
        before = np.where(is_event, before + (is_later & (behind != points)), np.minimum(before, last - 1))
        before = np.maximum.accumulate(before)  # a move without length that ends the run stays behind the last event
        columns = (before, timeline.line[within], timeline.event[within])
        return [
            (k, timeline.events[n] if n >= 0 else line)
            for k, line, n in zip(*(c.tolist() for c in columns), strict=True)
        ]


@kernel
def _points(vertices: FloatArray, at: FloatArray, first: int) -> FloatArray:
    """Return the command at the points : (m, 3) mm.

    vertices : (n + 1, 3) mm at the knots from `first` on;  at : (m,) in knots
    """
    points = np.empty((len(at), 3))
    for k in range(len(at)):
        knot = int(at[k])
        f = at[k] - knot
        for i in range(3):
            place = vertices[knot - first, i]
            if f > 0.0:
                place += f * (vertices[knot + 1 - first, i] - place)
            points[k, i] = place
    return points


def _stated(points: FloatArray, base: _Place, unit: float) -> FloatArray:
    """Round points (m, 3) mm to what the file can state, 4 decimals in its own coordinates and unit.

    base : X Y Z E, mm;  unit : mm
    """
    counts = 1e4 if unit == 1.0 else 1e6
    origin = np.array(base[:3])
    return np.asarray(np.rint((points - origin) / unit * counts) / counts * unit + origin)
