"""The firmware's own input shaper: off while a compensated print runs, on again after the print's last segment.

Two compensations disturb each other. The machine file holds the commands that switch the shaper on
(`[firmware] input_shaper`, which an import fills in); a print may hold some of its own. Where the shaper is expected to
leave less than our command, the print goes out as sliced and sets it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

from ffcomp.compensation.text_stream import Later, Text
from ffcomp.shapers import DAMPING_RATIO
from ffcomp.simulation.command import Tuned
from gcode.dialect import DIALECTS
from gcode.dialects import shaper_commands, shaper_off, shaper_on
from gcode.embedded import OURS, WAS, like_ours
from models.machine import Machine

State = Literal["off", "set", "kept", "none", "unknown"]

OFF = "The firmware's input shaper is off during this print and on again at its end. After a cancelled print: {on}."
SET = (
    "The firmware's input shaper is {name} during this print, and as before at its end. After a cancelled print: {on}. "
    "ffcomp's own command: --robust on."
)
STAYS_OFF = (
    "The firmware's input shaper is switched off and stays off after the print: the machine file has no "
    "input_shaper in [firmware] to switch it on again."
)
KEPT = "The firmware's input shaper is unchanged (--keep-shaper): if it is on, two compensations disturb each other."
UNKNOWN = (
    "The machine file does not state whether the firmware has an input shaper, which must be off. Import the printer's "
    "configuration, or set input_shaper in [firmware] (none: []). With --no-keep-shaper the print switches it off."
)


@dataclass(frozen=True, slots=True)
class OwnShaper:
    """What happens to the firmware's input shaper during a print."""

    state: State
    reason: str  # a sentence; empty: there is no shaper
    flavor: str
    on: tuple[bytes, ...] = ()  # lines that switch it on as the firmware has it

    @property
    def command(self) -> bytes:
        """The firmware's command that sets it."""
        return DIALECTS[self.flavor].shaper_command

    @property
    def warnings(self) -> list[str]:
        """The sentence, if somebody has to act on it."""
        return [self.reason] if self.state == "unknown" else []


def own_shaper(keep: bool | None, machine: Machine, flavor: str) -> OwnShaper:
    """Decide what happens to the firmware's input shaper.

    keep : True: leave it alone; False: switch it off, known or not; None: switch it off if the machine file has one
    flavor : of the print's firmware
    """
    lines = shaper_commands(flavor, machine.input_shaper)
    on = tuple(f"{line}\n".encode() for line in lines or ())
    if keep:
        return OwnShaper("kept", KEPT, flavor)
    if on:
        return OwnShaper("off", OFF.format(on=", ".join(lines or ())), flavor, on)
    if keep is False:
        return OwnShaper("off", STAYS_OFF, flavor)
    return OwnShaper("unknown", UNKNOWN, flavor) if lines is None else OwnShaper("none", "", flavor)


def shaper_set(shaper: OwnShaper, tuned: Tuned) -> OwnShaper:
    """Set a shaper for a print as sliced, in place of the firmware's own setting."""
    on = ", ".join(line.decode().rstrip() for line in shaper.on)
    return replace(shaper, state="set", reason=SET.format(name=tuned.name, on=on))


def with_shaper_set(parts: Iterable[bytes], shaper: OwnShaper, tuned: Tuned) -> Iterator[bytes]:
    """Yield a print, from parts of whole lines, as sliced: the shaper is set before its first move.

    It is set again where the print sets one of its own, and restored after the last line as the print would have it.
    """
    moves, sets_it = lines_of(rb"G[ \t]*0*[0-3]"), lines_of(shaper.command)
    setting = shaper_on(shaper.flavor, tuned.kind, tuned.hz, DAMPING_RATIO)
    on, begun, kept = list(shaper.on), False, b""
    for line in (line for part in parts for line in part.splitlines(keepends=True)):
        yield kept
        if not begun and moves.match(line):
            begun = True
            yield ours(setting, line)
        kept = WAS + line if like_ours(line) else line
        if (own := sets_it.match(line)) and own["ends"]:  # the last line of a print stands, if nothing ends it
            on.append(own["bare"])
            kept += ours(setting if begun else (), line)
    back = ours([*shaper_off(shaper.flavor, on), *on], kept)
    yield kept + back if kept.endswith((b"\n", b"\r")) else back + kept


def lines_of(command: bytes) -> re.Pattern[bytes]:
    """Find lines with a command: `bare` without a line number, and how each `ends`."""
    return re.compile(rb"(?im)^[ \t]*(?:N\d+[ \t]*)?(?P<bare>%b(?![\d._])[^\r\n]*)(?P<ends>[\r\n]+|\Z)" % command)


def ours(lines: Iterable[bytes], like: bytes = b"") -> bytes:
    """Mark lines as ours; they end like another one."""
    ending = b"\r\n" if like.endswith(b"\r\n") else b"\n"
    return b"".join(line.rstrip() + OURS + ending for line in lines)


def with_shaper_off(pieces: Text, shaper: OwnShaper) -> Iterator[bytes | Later]:
    """Switch the firmware's shaper off where our first block opens, and on again after our last line.

    Where the print itself sets the shaper, it is switched off again before the next block, and the print's own setting
    is restored at the end.

    pieces : of whole lines
    """
    command, sets_it = shaper.command, lines_of(shaper.command)
    on, is_on, was_off, last = list(shaper.on), shaper.state == "off", False, b""
    restored = Later()  # after our last line
    for piece in pieces:
        if isinstance(piece, Later):
            yield piece
            continue
        at = 0
        for own in [*(sets_it.finditer(piece) if command in piece.upper() else ()), None]:
            text = piece[at : own.start() if own else len(piece)]
            if OURS in text:
                begin = text.rfind(b"\n", 0, text.find(OURS)) + 1
                end = text.find(b"\n", text.rfind(OURS)) + 1 or len(text)
                last = text[begin:end]
                yield text[:begin]
                if is_on:
                    yield ours(shaper_off(shaper.flavor, on), last)
                is_on, was_off = False, was_off or is_on
                yield last
                restored.text, restored = b"", Later()
                yield restored
                text = text[end:]
            yield text
            if own:
                at, is_on = own.end(), True
                on.append(own["bare"])
                yield own[0]
    restored.text = ours(on, last) if was_off else b""
