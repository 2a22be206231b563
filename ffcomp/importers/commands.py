"""Configurations made of G-code commands: RepRapFirmware's `config.g`, and Marlin's answer to M503."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from ffcomp.importers.values import Value, plain_number

UNCOMMENTED = re.compile(r'(?:[^";]|"[^"]*"?)*')
# A terminal may have put its own words before the command: a time, `Recv:`, `echo:`.
COMMAND = re.compile(r'(?:[^"]*?[:>\]]\s*)??(?P<code>[GM]\d+(?:\.\d+)?)(?![\d.:])(?P<words>.*)')
WORD = re.compile(r'(?P<letter>[A-Za-z])(?:"(?P<quoted>[^"]*)"|(?P<formula>\{[^}]*\})|(?P<plain>[-+.:\d]*))', re.ASCII)
CONDITION = re.compile(r"\s*(?:if|elif|else|while)\b")


@dataclass(frozen=True)
class Command:
    """One command of a configuration."""

    code: str  # "M92"
    words: Mapping[str, str]  # letter -> the text after it; a formula keeps its braces
    place: str  # file:line
    conditional: bool  # stands under RepRapFirmware's `if` or `while`

    def numbers(self, letter: str, *, above: float = -math.inf) -> list[Value]:
        """Parse the numbers after a letter, with colons between them; none if it is missing or has a formula."""
        text = self.words.get(letter, "")
        if not text or text.startswith("{"):
            return []
        place = f"{self.place}: {self.code} {letter}"
        origin = f"{self.place} {self.code} {letter}"
        return [Value(plain_number(part, place, above=above), "read", origin) for part in text.split(":")]

    def number(self, letter: str, *, above: float = -math.inf) -> Value | None:
        """Parse the first of the numbers after a letter."""
        return next(iter(self.numbers(letter, above=above)), None)


def commands(text: str, name: str) -> Iterator[Command]:
    """Yield the commands of a text; other lines are skipped."""
    block: int | None = None  # how far the condition that is open is indented
    for line_number, line in enumerate(text.split("\n"), 1):
        uncommented = UNCOMMENTED.match(line)
        code = uncommented[0].rstrip() if uncommented else ""
        if not code:
            continue
        indent = len(code) - len(code.lstrip())
        if block is None or indent <= block:
            block = indent if CONDITION.match(code) else None
        if match := COMMAND.match(code.strip()):
            words = {word["letter"].upper(): _text(word) for word in WORD.finditer(match["words"])}
            yield Command(match["code"], words, f"{name}:{line_number}", block is not None)


def _text(word: re.Match[str]) -> str:
    return next(text for text in (word["quoted"], word["formula"], word["plain"]) if text is not None)
