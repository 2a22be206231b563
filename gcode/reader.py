"""Text → Program: one pass over the lines, following the modal state.

Nearly every line of a print is a plain `G1 X… Y… E…`; `_Reader._run_of_plain_moves` follows runs of them with
the state in local variables (about ten times faster than the general way, which reads everything else).
"""

from __future__ import annotations

import re
from math import isnan
from pathlib import Path

from gcode.arcs import ARC_TOLERANCE_MM, Arc, arc_by_centre, arc_by_radius
from gcode.commands import Effect, apply
from gcode.container import read_bytes
from gcode.dialects import detect_flavor
from gcode.errors import GcodeError, UnsupportedGcode
from gcode.limits import MACHINE_LIMITS, MotionLimits
from gcode.moves import MoveTable
from gcode.program import Event, EventKind, Frame, Program
from gcode.state import DEFAULT_FEED_MM_PER_S, Modal, Vector4
from gcode.words import Command, commands, shown

MOTIONS = frozenset(("G0", "G1", "G2", "G3"))
SETTINGS = frozenset(["G17", "G18", "G19", "G20", "G21", "G40", "G49", "G54", "G80", "G90", "G91", "G94"])
_MOTION_WORDS = {"G0": "XYZEF", "G1": "XYZEF", "G2": "XYZEFIJKR", "G3": "XYZEFIJKR"}
_IGNORED_WORDS = "SPHNO"  # laser power, priorities, endstop flags: they do not change where the nozzle goes
STILL_MM2 = 1e-18  # squared displacement below which nothing moves: 1e-9 mm, as in Klipper

_N = rb"([-+]?\d{1,6}(?:\.\d*)?|[-+]?\.\d+)"
_PLAIN_MOVE = re.compile(
    rb"G[01](?: F%b)?(?: Z%b)?(?: X%b)?(?: Y%b)?(?: Z%b)?(?: E%b)?(?: F%b)?[ \t]*(?:;[^\r\n]*)?[\r\n]*" % ((_N,) * 7)
)
_FEED_ALONE = re.compile(rb"G[01] F%b\s*" % _N)
_PLAIN_STARTS = (b"G1", b"G0")
_QUIET = re.compile(rb"\s*(?:;.*)?", re.DOTALL)


def read_program(
    data: bytes,
    path: str = "",
    *,
    start: tuple[float, float, float] | None = None,
    offset_mm: tuple[float, float] = (0.0, 0.0),
    arc_tolerance_mm: float = ARC_TOLERANCE_MM,
    flavor: str | None = None,
) -> Program:
    """Read a file's bytes.

    Parameters
    ----------
    path : str
        The file's name, for errors.
    start : (x, y, z) mm or None
        Where the nozzle is before the first line; None: not known until the file names a place.
    offset_mm : (x, y) mm
        Added to the toolhead's XY, for prints made for a bed with its origin elsewhere. `Frame.base` leaves
        it out: a writer emits the printer's coordinates. Where G92 names a place, that place keeps its name.
    arc_tolerance_mm : float
        Largest distance between an arc and its chords.
    flavor : str or None
        "klipper", "marlin" or "reprapfirmware"; None: as the file says.

    Raises
    ------
    GcodeError
        A line that cannot be followed, with its number.
    """
    try:
        return _Reader(data, path, start, offset_mm, arc_tolerance_mm, flavor).program()
    except GcodeError as error:
        raise error.located(path) from None


def read_file(
    path: str | Path,
    *,
    start: tuple[float, float, float] | None = None,
    offset_mm: tuple[float, float] = (0.0, 0.0),
    arc_tolerance_mm: float = ARC_TOLERANCE_MM,
    flavor: str | None = None,
) -> Program:
    """Read a plain-text G-code file; see `read_program`."""
    return read_program(
        read_bytes(path),
        str(path),
        start=start,
        offset_mm=offset_mm,
        arc_tolerance_mm=arc_tolerance_mm,
        flavor=flavor,
    )


class _Reader:
    """The state of one pass: the modal state, and the tables that grow."""

    def __init__(
        self,
        data: bytes,
        path: str,
        start: tuple[float, float, float] | None,
        offset: tuple[float, float],
        arc_tolerance: float,
        flavor: str | None,
    ) -> None:
        self.path, self.arc_tolerance = path, arc_tolerance
        self.lines = data.splitlines(keepends=True)
        self.modal = Modal(offset=offset, flavor=flavor or detect_flavor(self.lines))
        self.table = MoveTable()
        if start is not None:
            self.modal.position[:3] = start
            self.table.jumps[0] = list(self.modal.position)
        self.events: list[Event] = []
        self.frames: list[Frame] = []
        self.frame_numbers: dict[Frame, int] = {}
        self.feed_frames: dict[tuple[int, bytes], int] = {}  # (frame, F word) → the frame after it
        self.frame = self._frame_number()
        self.limits: list[MotionLimits] = [MACHINE_LIMITS]
        self.limit_numbers: dict[MotionLimits, int] = {MACHINE_LIMITS: 0}
        self.limit = 0
        self.warnings: dict[str, str] = {}  # what it is about → sentence

    def program(self) -> Program:
        at = 0
        while at < len(self.lines):
            after = self._run_of_plain_moves(at) if self.lines[at][:2] in _PLAIN_STARTS else at
            if after == at:
                self._line(at)
            at = max(after, at + 1)
        moves = self.table.moves(self.frames, self.limits)
        return Program(self.path, self.lines, moves, self.events, self.frames, list(self.warnings.values()))

    # -- the fast way --

    def _run_of_plain_moves(self, at: int) -> int:
        """Follow `G0`/`G1` lines in the usual form from line `at`; returns the first that needs more care."""
        modal, lines, table = self.modal, self.lines, self.table
        match_plain, ends_extend = _PLAIN_MOVE.fullmatch, table.ends.extend
        add_line, add_frame, add_limit = table.lines.append, table.frames.append, table.limits.append
        limit, frame = self.limit, self.frame
        relative, relative_e = not modal.is_absolute(0), not modal.is_absolute(3)
        unit, unit_e = modal.scale(0), modal.scale(3)
        base_x, base_y, base_z, base_e = (a + b for a, b in zip(modal.base, modal.shift, strict=True))
        x, y, z, e = modal.position
        first, last = at, len(lines)
        while at < last:
            match = match_plain(lines[at])
            if match is None:
                break
            early_f, early_z, to_x, to_y, late_z, to_e, late_f = match.groups()
            if (early_f and late_f) or (early_z and late_z):
                break
            to_z = early_z or late_z
            new_x = x if to_x is None else float(to_x) * unit + (x if relative else base_x)
            new_y = y if to_y is None else float(to_y) * unit + (y if relative else base_y)
            new_z = z if to_z is None else float(to_z) * unit + (z if relative else base_z)
            new_e = e if to_e is None else float(to_e) * unit_e + (e if relative_e else base_e)
            dx, dy, dz, de = new_x - x, new_y - y, new_z - z, new_e - e
            if not dx * dx + dy * dy + dz * dz + de * de > STILL_MM2:  # still, or from or to an unknown place
                break
            if early_f or late_f:
                frame = self._frame_for_feed(early_f or late_f, at)
            x, y, z, e = new_x, new_y, new_z, new_e
            ends_extend((x, y, z, e))
            add_line(at)
            add_frame(frame)
            add_limit(limit)
            at += 1
        if at > first:
            modal.position = [x, y, z, e]
            modal.motion = lines[at - 1][:2].decode()
            self._warn_of_default_feed(first)
        return at

    def _frame_for_feed(self, number: bytes, at: int) -> int:
        """The present frame with another speed; prints use few speeds many times, so pairs are remembered."""
        key = self.frame, number
        known = self.feed_frames.get(key)
        if known is None:
            self.modal.set_feed({"F": float(number)}, at + 1)
            known = self.feed_frames[key] = self._frame_number()
        self.modal.feed = self.frames[known].feed_mm_per_s
        self.frame = known
        return known

    # -- the general way --

    def _line(self, at: int) -> None:
        if _QUIET.fullmatch(self.lines[at]):
            self._event(at, Effect(EventKind.PASS))
            return
        if feed := _FEED_ALONE.fullmatch(self.lines[at]):
            self._feed_alone(at, feed.group(1))
            return
        said = commands(self.lines[at], at + 1)
        if len(said) > 1:
            self._settings(at, said)
        elif said and (said[0].name in MOTIONS or not said[0].name):
            self._motion(at, said[0])
        else:
            self._command(at, said)

    def _feed_alone(self, at: int, number: bytes) -> None:
        self.modal.motion = self.lines[at][:2].decode()
        self._frame_for_feed(number, at)
        self._travel(at, self.modal.position[:], None)

    def _settings(self, at: int, said: list[Command]) -> None:
        """`G17 G21 G90` on one line; a move among them could not be replaced without losing the rest."""
        names = [command.name for command in said]
        if not SETTINGS.issuperset(names):
            rule = "only modes (G17, G21, G90, …) may share a line"
            raise UnsupportedGcode(f"The line holds {' and '.join(names)}; {rule}.", at + 1)
        self._warn("several", at, f"{' '.join(names)} share a line, of which Klipper and Marlin obey only the first")
        for command in said:
            apply(self.modal, command)
        self._settle()
        self._event(at, Effect(EventKind.PASS))

    def _command(self, at: int, said: list[Command]) -> None:
        before = self.modal.position[:]
        effect = apply(self.modal, said[0]) if said else Effect(EventKind.PASS)
        if effect.warning:
            self._warn(said[0].name, at, effect.warning)
        if self.modal.position != before:
            self.table.jumps[len(self.table.lines)] = self.modal.position[:]
        self._settle()
        self._event(at, effect)

    def _motion(self, at: int, command: Command) -> None:
        """A move in any form: unusual spelling, arcs, no displacement, unknown places."""
        modal = self.modal
        words = command.numbers()
        modal.motion = command.name or modal.motion or ("G1" if words.keys() == {"F"} else "")
        if not modal.motion:
            raise GcodeError(f"{shown(command.args)} has no command; the first move must say G0 or G1.", at + 1)
        self._check_words(modal.motion, words, at)
        modal.set_feed(words, at + 1)
        self._settle()
        end = modal.target(words)
        arc = modal.motion in ("G2", "G3") and bool(words.keys() & set("XYZIJKR"))
        self._travel(at, end, self._arc(modal.motion, words, end, at) if arc else None)

    def _check_words(self, motion: str, words: dict[str, float], at: int) -> None:
        for letter in words:
            if letter not in _MOTION_WORDS[motion] and letter not in _IGNORED_WORDS:
                rule = f"a move has the words {' '.join(_MOTION_WORDS[motion])}"
                raise GcodeError(f"{motion} has the word {letter}{words[letter]:g}; {rule}.", at + 1)

    def _travel(self, at: int, end: Vector4, arc: Arc | None) -> None:
        start = self.modal.position
        travelled = sum((b - a) ** 2 for a, b in zip(start, end, strict=True))
        self.modal.position = end
        if isnan(travelled):
            self.table.jumps[len(self.table.lines)] = end
            self._event(at, Effect(EventKind.RAW_MOVE))
        elif arc is not None:
            self._chords(at, start, end, arc)
        elif travelled > STILL_MM2:
            self._warn_of_default_feed(at)
            self._move(at, end)
        else:
            self._event(at, Effect(EventKind.PASS))

    def _move(self, at: int, end: Vector4) -> None:
        self.table.ends.extend(end)
        self.table.lines.append(at)
        self.table.frames.append(self.frame)
        self.table.limits.append(self.limit)

    # -- arcs --

    def _arc(self, motion: str, words: dict[str, float], end: Vector4, at: int) -> Arc | None:
        """The circle in the active plane; None where start or end is not known: the move passes through."""
        modal = self.modal
        u, v, _ = modal.arc_axes()
        here, there = (modal.position[u], modal.position[v]), (end[u], end[v])
        if any(isnan(number) for number in (*here, *there)):
            return None
        if "R" in words:
            return arc_by_radius(here, there, words["R"] * modal.unit, motion == "G2", at + 1)
        offset = words.get("IJK"[u], 0.0) * modal.unit, words.get("IJK"[v], 0.0) * modal.unit
        return arc_by_centre(here, there, offset, motion == "G2", at + 1)

    def _chords(self, at: int, start: Vector4, end: Vector4, arc: Arc) -> None:
        """Chords share height and filament evenly: all are equally long."""
        u, v, normal = self.modal.arc_axes()
        point = [0.0] * 4
        self._warn_of_default_feed(at)
        for first, second, share in arc.chords(self.arc_tolerance).tolist():
            point[u], point[v] = first, second
            for axis in (normal, 3):
                point[axis] = start[axis] + (end[axis] - start[axis]) * share
            self._move(at, point)
        self.table.ends[-4:] = end

    # -- book-keeping --

    def _event(self, at: int, effect: Effect) -> None:
        moves = len(self.table.lines)
        self.events.append(Event(at, moves, effect.kind, self.frame, effect.dwell_s, effect.touches_limits))

    def _settle(self) -> None:
        """Give the present frame and limits their numbers."""
        self.frame = self._frame_number()
        limits = self.modal.limits
        if limits is not self.limits[self.limit]:
            self.limit = self.limit_numbers.setdefault(limits, len(self.limits))
            if self.limit == len(self.limits):
                self.limits.append(limits)

    def _frame_number(self) -> int:
        frame = self.modal.frame()
        number = self.frame_numbers.setdefault(frame, len(self.frames))
        if number == len(self.frames):
            self.frames.append(frame)
        return number

    def _warn(self, about: str, at: int, sentence: str) -> None:
        self.warnings.setdefault(about, f"line {at + 1}: {sentence}.")

    def _warn_of_default_feed(self, at: int) -> None:
        if not self.modal.feed_known and "feed" not in self.warnings:
            speed = f"{DEFAULT_FEED_MM_PER_S:g} mm/s are taken until the first F"
            self._warn("feed", at, f"the first move has no speed; {speed}")
