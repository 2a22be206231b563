"""Text → Program: one pass over the lines, following the modal state, over the whole file or part by part.

Nearly every line of a print is a plain `G1 X… Y… E…` or a comment. `gcode.fast_scan` follows runs of them straight from
the bytes, about thirty times faster than the general reader, which handles everything else.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, pairwise
from math import hypot, isnan, nan
from typing import TypedDict, Unpack

import numpy as np

from gcode import dialects
from gcode.arcs import Arc, arc_by_centre, arc_by_radius
from gcode.commands import MOVED, PASS, Effect, apply
from gcode.dialect import DIALECTS, BareWords
from gcode.errors import GcodeError, UnsupportedGcode
from gcode.fast_scan import STILL_MM2, ByteArray, Cursor, EventTable, Modes, MoveTable, follow
from gcode.program import EventKind, LimitCommand, ModalState, Program, RawMove, limits_in_effect
from gcode.state import DEFAULT_FEED_MM_PER_S, Modal, Vector4
from gcode.text import BOM, PART_BYTES, whole_lines
from gcode.words import NUMBERED, Command, commands, shown

MOTIONS = frozenset(("G0", "G1", "G2", "G3"))
SETTINGS = frozenset(["G17", "G18", "G19", "G20", "G21", "G40", "G49", "G54", "G80", "G90", "G91", "G94", "M82", "M83"])
_MOTION_WORDS = {"G0": "XYZEF", "G1": "XYZEF", "G2": "XYZEFIJKR", "G3": "XYZEFIJKR"}
_FOLLOWED_BY_NOBODY = "ABCUVWGMT"  # unsupported axes, and other commands
_ARC_WORDS = frozenset("XYZIJKR")
_IGNORED_WORDS = "SPHNO"  # laser power, priorities, endstop flags: they do not affect the path
_QUIET_STARTS = (b"G1", b"G0", b";", b"\n", b"\r", b" ", b"\t")
_FEEDS_AT_A_TIME = 4096
_LINES_AHEAD, _BYTES_AHEAD = 2000, 1 << 16  # searched to find out whether E is relative
_NAMED = 6  # codes that a warning lists
_M_CODE = re.compile(r"M\d+(\.\d+)?")


class Reading(TypedDict, total=False):
    """How a file is read."""

    start: tuple[float, float, float] | None
    """Position before the first line, mm; None: unknown until the file names one."""
    offset_mm: tuple[float, float]
    """Added to the toolhead's XY, mm, for prints made for a bed with its origin elsewhere. `ModalState.base` does not
    include it: a writer emits the printer's coordinates. A position named by G92 keeps its name."""
    returns: Iterable[str]
    """Macros that return the nozzle to its position, in addition to the known ones."""
    filament_change_s: float
    """Duration of a filament change."""
    arc_chords: Callable[[str, float, float], int]
    """How many chords a firmware makes of an arc, by its name, the arc's length, mm, and turn, rad."""
    cut: Callable[[Program], Program] | None
    """Cuts moves as the firmware does , if it does; lines are unchanged."""


def read_program(data: bytes, path: str = "", *, flavor: str | None = None, **settings: Unpack[Reading]) -> Program:
    """Read a file's bytes; GcodeError for a line that cannot be followed, with its number.

    path : the file's name, for errors
    flavor : "klipper", "marlin" or "reprapfirmware"; None: detect it
    """
    return _Reader(path, flavor or dialects.flavor_sign([data]).flavor, **settings).program(data)


def read_parts(
    blocks: Iterable[bytes], path: str = "", *, flavor: str, part_bytes: int = PART_BYTES, **settings: Unpack[Reading]
) -> Iterator[Program]:
    """Read a file of any length in parts: consecutive programs that together equal `read_program`'s.

    Each part has its own lines, moves, events, frames and warnings, with indices from its own beginning;
    `Program.first_line` is its position in the file. Its first frame is the one in force there. Errors and warnings use
    the file's line numbers. A file without lines has no parts.

    blocks : the file in bytes of any sizes, cut anywhere: `iter(lambda: file.read(1 << 20), b"")`
    flavor : "klipper", "marlin" or "reprapfirmware"; `gcode.dialects.sign_by_ends` finds it without the whole file
    part_bytes : size of a part, but for the rest of its last line; 1 MiB are some 30,000 lines

    Errors are those of `read_program`, raised when their part is read.
    """
    reader = _Reader(path, flavor, **settings)
    parts = chain(whole_lines(blocks, part_bytes), [b""])
    for data, ahead in pairwise(parts):
        yield reader.program(data, ahead[:_BYTES_AHEAD])


class _Reader:
    """The modal state, which continues from part to part, and the tables of the present part."""

    def __init__(self, path: str, flavor: str, **settings: Unpack[Reading]) -> None:
        self.path, self.cut = path, settings.get("cut")
        self.arc_chords = settings.get("arc_chords", lambda flavor, length, turn: 1)
        self.modal = Modal(offset=settings.get("offset_mm", (0.0, 0.0)), dialect=DIALECTS[flavor])
        self.modal.returns = frozenset(map(str.upper, settings.get("returns", ())))
        self.modal.filament_change_s = settings.get("filament_change_s", 0.0)
        if (start := settings.get("start")) is not None:
            self.modal.position[:3] = [float(coordinate) for coordinate in start]
        self.warned: set[str] = set()  # subjects of earlier warnings
        self.lost: tuple[int, str] = (0, "")  # line and command that made the position unknown
        self.unknown: dict[str, int] = {}  # unknown codes of this part, and the line of each
        self.e_is_settled = False  # whether E's mode is known, by a command or by the numbers
        self.g90_keeps_m83: bool | None = None  # in Marlin's forks; None: not known yet
        self.first_line = 0
        self.limit_commands: dict[str, LimitCommand] = {}  # in effect before the part
        self.lines: list[bytes] = []
        self.ahead = b""
        self.modes: Modes | None = None  # None: compute again, because a command may have changed them
        self.new_feeds = np.empty(_FEEDS_AT_A_TIME)

    def program(self, data: bytes, ahead: bytes = b"") -> Program:
        """Read the next part of the file; `ahead` is the beginning of the rest."""
        self.ahead = ahead
        settled = self._settle_filament(data)
        if self.g90_keeps_m83 is None and dialects.BAMBU in data:
            self.g90_keeps_m83 = True
        self._begin(data)
        self.warnings += settled
        try:
            self._follow(data)
        except GcodeError as error:
            raise error.located(self.path) from None
        self._warn_of_unknown_codes()
        frame_of_state = np.array(self.states, dtype=np.int64)
        frames = list(self.frames)
        moves = self.moves.moves(frame_of_state, frames, list(self.limits))
        events = self.events.events(frame_of_state)
        whole = (self.path, self.lines, moves, events, frames, self.warnings, self.first_line)
        program = Program(*whole, self.modal.dialect.name, self.limit_commands)
        self.limit_commands = limits_in_effect(program, self.limit_commands)
        return program if self.cut is None else self.cut(program)

    def _settle_filament(self, data: bytes) -> list[str]:
        """If no line sets E's mode, infer it from the numbers: the start macro has set it."""
        if self.e_is_settled:
            return []
        relative = dialects.filament_is_relative(data)
        self.e_is_settled = relative is not None or dialects.FILAMENT_MODE.search(data) is not None
        if not relative:
            return []
        self.modal.set_e_mode(absolute=False)
        self.modes = None
        rule = "its numbers do not grow, so they are read as relative"
        return [f"line {self.first_line + 1}: no M82 or M83 sets how E counts; {rule}."]

    def _begin(self, data: bytes) -> None:
        self.first_line += len(self.lines)
        self.lines = data.splitlines(keepends=True)
        self.moves = MoveTable(len(self.lines), self.modal.position)
        self.events = EventTable(np.empty((len(self.lines), 3), dtype=np.int64))
        self.frames: dict[ModalState, int] = {}  # and their numbers
        self.states = [self._frame()]  # frames in force one after another; the last is in force now
        self.limits = {self.modal.limits: 0}
        self.limit = 0  # the number of those in force
        self.warnings: list[str] = []

    def _follow(self, data: bytes) -> None:
        text = np.frombuffer(data + b"\n", dtype=np.uint8)
        at = byte = 0
        while at < len(self.lines):
            stuck = True
            if self.lines[at].startswith(_QUIET_STARTS):
                at, byte, stuck = self._quiet_lines(text, at, byte)
            if stuck:
                self._line(at)
                byte += len(self.lines[at])
                at += 1

    # -- the fast way --

    def _quiet_lines(self, text: ByteArray, at: int, byte: int) -> tuple[int, int, bool]:
        """Follow plain lines from line `at`; returns the next line, its byte, and whether that is `stuck`."""
        modal, first_move, states = self.modal, self.moves.count, len(self.states)
        self.moves.make_room(len(self.lines) - at)
        feed = modal.feed if modal.feed_known else nan
        counts = byte, at, first_move, self.events.count, states, states - 1
        x, y, z, e = modal.position
        here = Cursor(*counts, x, y, z, e, feed, motion=-1, stuck=False)
        tables = self.moves.ends, self.moves.rows, self.events.rows, self.new_feeds
        self.modes = self.modes or _modes(modal)
        there = Cursor._make(follow(text, here, self.modes, self.limit, *tables))
        if there.moves > first_move and not modal.feed_known:
            line, state, _ = self.moves.rows[first_move].tolist()
            if state < states:
                self._warn_of_default_feed(line)
        if there.feeds > here.feeds:
            self._take_feeds(self.new_feeds[: there.feeds - here.feeds].tolist(), there)
        self.moves.count, self.events.count = there.moves, there.events
        modal.position = [there.x, there.y, there.z, there.e]
        if there.motion >= 0:
            modal.motion = f"G{there.motion}"
        return there.line, there.byte, there.stuck

    def _take_feeds(self, feeds: list[float], there: Cursor) -> None:
        """Add a state for each feed; the last one is in force."""
        modal = self.modal
        modal.feed_known = True
        for modal.feed in feeds:
            self.states.append(self._frame())
        modal.feed = there.feed
        self.states.append(self.states[there.state])

    # -- the general way --

    def _line(self, at: int) -> None:
        line = self.lines[at] if self._number(at) > 1 else self.lines[at].removeprefix(BOM)
        line_commands = commands(line, self._number(at))
        if NUMBERED.match(line):
            rule = "a host that checks line numbers stops at the first replaced move"
            self._warn("numbers", at, f"the line has a number, but ffcomp writes lines without; {rule}")
        if len(line_commands) > 1:
            self._settings(at, line_commands)
        elif not line_commands:
            self._event(at, PASS)
        elif line_commands[0].name in MOTIONS or not line_commands[0].name:
            self._motion(at, line_commands[0])
        else:
            self._command(at, line_commands[0])

    def _settings(self, at: int, line_commands: list[Command]) -> None:
        """`G17 G21 G90` on one line: RepRapFirmware obeys all, Klipper and Marlin only the first.

        A move among them cannot be replaced without losing the rest, so the line passes through unchanged.
        """
        names = [command.name for command in line_commands]
        self._warn("several", at, f"{' '.join(names)} share a line; Klipper and Marlin obey only the first")
        self.modes = None
        obeyed = line_commands if self.modal.dialect.obeys_whole_line else line_commands[:1]
        if SETTINGS.issuperset(command.name for command in obeyed):
            for command in obeyed:
                apply(self.modal, command)
            self._settle()
            self._event(at, PASS)
        elif obeyed[0].name == "G53" or (len(obeyed) == 1 and obeyed[0].name not in MOTIONS):
            self._command(at, obeyed[0])
        else:
            rule = "only modes (G17, G21, G90, …) may share a line"
            raise UnsupportedGcode(f"The line holds {' and '.join(names)}; {rule}.", self._number(at))

    def _command(self, at: int, command: Command) -> None:
        self.modes = None
        before = self.modal.position
        effect = apply(self.modal, command)
        if command.name == "G90" and self.modal.dialect.g90_sets_e and self.modal.relative_e_stated:
            self._settle_e_after_g90(at)
        if effect.warning:
            self._warn(command.name, at, effect.warning)
        if effect.unknown and command.name not in self.warned:
            self.warned.add(command.name)
            self.unknown[command.name] = at
        if self.modal.position is not before:
            self.lost = self._number(at), command.name
            self.moves.jumps[self.moves.count] = self.modal.position[:]
        self._settle()
        self._event(at, effect)

    def _settle_e_after_g90(self, at: int) -> None:
        """Decide what G90 after M83 means: Marlin 2 makes E absolute with it, Marlin 1, Prusa's and Bambu's do not.

        The numbers after it decide; if they are too few, Marlin 2 is assumed.
        """
        if self.g90_keeps_m83 is None:
            ahead = b"".join([*self.lines[at + 1 : at + 1 + _LINES_AHEAD], self.ahead])
            self.g90_keeps_m83 = dialects.filament_is_relative(ahead, until_stated=True)
            if self.g90_keeps_m83 is not None:
                how = "do not grow, so E is relative" if self.g90_keeps_m83 else "grow: absolute"
                rule = "Marlin 2 makes E absolute by G90, older ones keep M83"
                self._warn("G90", at, f"no M82 or M83 after this G90 sets how E counts; {rule}; the numbers {how}")
        self.modal.absolute_e = not self.g90_keeps_m83

    def _motion(self, at: int, command: Command) -> None:
        """Follow a move in any form: unusual spelling, arcs, no displacement, unknown positions."""
        modal = self.modal
        bare = modal.dialect.bare_words
        if not command.name and bare is not BareWords.REPEAT:
            self._warn("bare", at, f"{shown(command.args)} has no command; {bare.value}")
        if not command.name and bare is BareWords.REJECTED:
            self._event(at, PASS)
            return
        words = command.numbers()
        modal.motion = command.name or modal.motion or ("G1" if words.keys() == {"F"} else "")
        if not modal.motion:
            rule = "the first move must say G0 or G1"
            raise GcodeError(f"{shown(command.args)} has no command; {rule}.", self._number(at))
        self._check_words(modal.motion, words, at)
        modal.set_feed(words, self._number(at))
        self._settle()
        if elsewhere := self._ends_elsewhere(words):
            modal.forget()
            self.lost = self._number(at), f"{modal.motion} {elsewhere}{words[elsewhere]:g}"
            self._event(at, MOVED)
            return
        end, z_is_followed = modal.target(words), modal.z_known or "Z" not in words or not modal.is_absolute(2)
        if any(isnan(number) for number in (*modal.position, *end)) or not z_is_followed:
            self._pass_through(at, words)
            return
        arc = modal.motion in ("G2", "G3") and not _ARC_WORDS.isdisjoint(words)
        self._travel(at, end, self._arc(modal.motion, words, modal.position, end, at) if arc else None)

    def _ends_elsewhere(self, words: dict[str, float]) -> str:
        """Return the word that makes a move's end known to the firmware only.

        H: towards an endstop or with single motors; R of RepRapFirmware's G0 and G1: from a saved position.
        """
        if words.get("H"):
            return "H"
        from_kept = "R" in words and self.modal.motion in ("G0", "G1") and self.modal.dialect.kept_positions
        return "R" if from_kept else ""

    def _pass_through(self, at: int, words: dict[str, float]) -> None:
        """Let the firmware plan a move from or to an unknown position."""
        modal, limits = self.modal, self.modal.limits
        before = modal.position[:3] if modal.z_known else [*modal.position[:2], nan]
        start, end = modal.pass_through(words)
        self.modes = None
        self.moves.jumps[self.moves.count] = modal.position[:]
        axes = tuple(k for k in range(3) if before[k] != modal.position[k])  # NaN is unlike itself
        way = self._raw_length(start, end, words, at), end[3] - start[3], modal.feed
        within = limits.velocity, limits.acceleration, limits.square_corner_velocity
        raw = RawMove(tuple(start), tuple(end), *way, *within, self.lost, axes)
        self._settle()
        self._event(at, Effect(EventKind.RAW_MOVE, moves_itself=True, raw=raw))

    def _raw_length(self, start: Vector4, end: Vector4, words: dict[str, float], at: int) -> float:
        """Return the length over the axes known at both ends, mm."""
        known = [b - a for a, b in zip(start[:3], end[:3], strict=True) if not isnan(b - a)]
        straight = hypot(*known)
        if self.modal.motion not in ("G2", "G3") or _ARC_WORDS.isdisjoint(words) or len(known) < 3:
            return straight
        try:
            arc = self._arc(self.modal.motion, words, start, end, at)
        except GcodeError:
            return straight
        return abs(arc.sweep) * arc.radii[0]

    def _check_words(self, motion: str, words: dict[str, float], at: int) -> None:
        for letter in words:
            kept_place = letter == "R" and self.modal.dialect.kept_positions
            if letter not in _MOTION_WORDS[motion] and letter not in _IGNORED_WORDS and not kept_place:
                rule = f"a move has the words {' '.join(_MOTION_WORDS[motion])}"
                problem = f"{motion} has the word {letter}{words[letter]:g}"
                if letter in _FOLLOWED_BY_NOBODY:
                    raise GcodeError(f"{problem}; {rule}.", self._number(at))
                self._warn(motion + letter, at, f"{problem}, which firmware ignores; {rule}")

    def _travel(self, at: int, end: Vector4, arc: Arc | None) -> None:
        start = self.modal.position
        travelled = sum((b - a) ** 2 for a, b in zip(start, end, strict=True))
        self.modal.position = end
        if arc is not None:
            self._chords(at, start, end, arc)
        elif travelled > STILL_MM2:
            self._warn_of_default_feed(at)
            self.moves.add(at, len(self.states) - 1, self.limit, end)
        else:
            self._event(at, PASS)

    # -- arcs --

    def _arc(self, motion: str, words: dict[str, float], start: Vector4, end: Vector4, at: int) -> Arc:
        """Return the circle in the active plane."""
        modal = self.modal
        u, v, _ = modal.plane
        here, there = (start[u], start[v]), (end[u], end[v])
        if "R" in words:
            return arc_by_radius(here, there, words["R"] * modal.unit, motion == "G2", self._number(at))
        offset = words.get("IJK"[u], 0.0) * modal.unit, words.get("IJK"[v], 0.0) * modal.unit
        return arc_by_centre(here, there, offset, motion == "G2", self._number(at))

    def _chords(self, at: int, start: Vector4, end: Vector4, arc: Arc) -> None:
        """Add an arc's chords; height and filament are spread evenly because all are equally long."""
        u, v, normal = self.modal.plane
        length = hypot(arc.sweep * arc.radii[0], end[normal] - start[normal])
        chords = arc.chords(multiple_of=self.arc_chords(self.modal.dialect.name, length, abs(arc.sweep)))
        points = np.empty((len(chords), 4))
        points[:, (u, v)] = chords[:, :2]
        points[:, normal] = start[normal] + (end[normal] - start[normal]) * chords[:, 2]
        points[:, 3] = start[3] + (end[3] - start[3]) * chords[:, 2]
        points[-1] = end
        self._warn_of_default_feed(at)
        self.moves.add(at, len(self.states) - 1, self.limit, points)

    # -- book-keeping --

    def _number(self, at: int) -> int:
        """Return the number of a line in the file, from 1."""
        return self.first_line + at + 1

    def _event(self, at: int, effect: Effect) -> None:
        self.events.add(at, self.moves.count, len(self.states) - 1, effect)

    def _settle(self) -> None:
        """Assign numbers to the present frame and limits."""
        frame = self._frame()
        if frame != self.states[-1]:
            self.states.append(frame)
        self.limit = self.limits.setdefault(self.modal.limits, len(self.limits))

    def _frame(self) -> int:
        """Return the number of the present frame."""
        return self.frames.setdefault(self.modal.frame(), len(self.frames))

    def _warn(self, about: str, at: int, sentence: str) -> None:
        if about not in self.warned:
            self.warned.add(about)
            self.warnings.append(f"line {self._number(at)}: {sentence}.")

    def _warn_of_unknown_codes(self) -> None:
        """Warn once of all codes that are new in this part, and once of those that may move."""
        still = {name: at for name, at in self.unknown.items() if _M_CODE.fullmatch(name)}
        moving = {name: at for name, at in self.unknown.items() if name not in still}
        self.unknown = {}
        if still:
            self._warn(f"unknown {still}", min(still.values()), f"{_are(still)} not known; the motion stops for them")
        if moving:
            rule = "the motion stops, and nothing is compensated until the file names a position again"
            self._warn(f"unknown {moving}", min(moving.values()), f"{_are(moving)} not known and may move; {rule}")

    def _warn_of_default_feed(self, at: int) -> None:
        if not self.modal.feed_known:
            speed = f"{DEFAULT_FEED_MM_PER_S:g} mm/s is assumed until the first F"
            self._warn("feed", at, f"the first move has no speed; {speed}")


def _are(names: Iterable[str]) -> str:
    """`M1 is`, `M1 and M2 are`, `M1, M2 and 7 more are`."""
    first, more = list(names)[:_NAMED], len(list(names)) - _NAMED
    if more > 0:
        return f"{', '.join(first)} and {more} more are"
    return f"{', '.join(first[:-1])} and {first[-1]} are" if len(first) > 1 else f"{first[0]} is"


def _modes(modal: Modal) -> Modes:
    x, y, z, e = (base + shift for base, shift in zip(modal.base, modal.shift, strict=True))
    z = z if modal.z_known else nan  # an absolute Z from an unknown height needs the general reader
    relative, relative_e = not modal.is_absolute(0), not modal.is_absolute(3)
    return Modes(x, y, z, e, relative, relative_e, modal.scale(0), modal.scale(3), modal.feed_factor)
