"""The firmware's own input shaper: off while a compensated print runs, on again after the print's last segment.

Two compensations disturb each other. The machine file holds the commands that switch the shaper on
(`[firmware] input_shaper`, which an import fills in); a print may hold some of its own.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from ffcomp.compensation.text_stream import Later, Text
from gcode.dialect import DIALECTS
from gcode.dialects import shaper_commands, shaper_off
from gcode.embedded import OURS
from models.machine import Machine

State = Literal["off", "kept", "none", "unknown"]

OFF = "The firmware's input shaper is off during this print and on again at its end. After a cancelled print: {on}."
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
    def warnings(self) -> list[str]:
        """The sentence, if somebody has to act on it."""
        return [self.reason] if self.state == "unknown" else []


def own_shaper(keep: bool | None, machine: Machine, flavor: str) -> OwnShaper:
    """Decide what happens to the firmware's input shaper.

    Parameters
    ----------
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


def with_shaper_off(pieces: Text, shaper: OwnShaper) -> Iterator[bytes | Later]:
    """Switch the firmware's shaper off where our first block opens, and on again after our last line.

    Where the print itself sets the shaper, it is switched off again before the next block, and the print's own setting
    is restored at the end.

    Parameters
    ----------
    pieces : of whole lines
    """
    command = DIALECTS[shaper.flavor].shaper_command
    sets_it = re.compile(rb"(?im)^[ \t]*%b\b[^\n]*(?:\n|\Z)" % command)
    on, is_on, was_off, ending = list(shaper.on), shaper.state == "off", False, b"\n"
    restored = Later()  # after our last line

    def ours(lines: Sequence[bytes]) -> bytes:
        return b"".join(line.rstrip() + OURS + ending for line in lines)

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
                ending = b"\r\n" if text[begin:end].endswith(b"\r\n") else b"\n"
                yield text[:begin]
                if is_on:
                    yield ours(shaper_off(shaper.flavor, on))
                is_on, was_off = False, was_off or is_on
                yield text[begin:end]
                restored.text, restored = b"", Later()
                yield restored
                text = text[end:]
            yield text
            if own:
                at, is_on = own.end(), True
                on.append(own[0])
                yield own[0]
    restored.text = ours(on) if was_off and not is_on else b""
