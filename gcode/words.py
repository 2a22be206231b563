"""One line of G-code as commands and words. Nothing here changes a byte: the line stays in `Program.lines`.

A line is `N12 G1 X10.5 Y2*71 ; comment`, `G0X-5Y0(note)`, `X5.2 Y0.2` (the motion command of the last move
again), or a Klipper command `SET_VELOCITY_LIMIT ACCEL=3000`. Words are parsed only on demand:
most M codes pass through unread, so their text (`M117 Layer 3`) can be anything.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import reduce
from math import nan
from operator import xor

from gcode.errors import GcodeError

LARGEST_NUMBER = 1e6  # mm: beyond a kilometre it is certainly a slicer's error

NUMBERED = re.compile(rb"\s*[Nn]\s*\d+")
_ROUND_COMMENT = re.compile(rb"\([^)]*\)?")
_LEADING_COMMENTS = re.compile(rb"(?:\s|\([^)]*\)?)*")
_EXTENDED = re.compile(rb"(@?(?:[A-Za-z_]{2}\w*|[A-Za-z]\w*_\w*))(?!\S)")
_CODE = re.compile(rb"([GgMm])\s*(\d+)(?:\.(\d*))?")
_TOOL = re.compile(rb"[Tt]\s*(-?\d+|\?)(?![\w.])")
_OTHER_CODE = re.compile(rb"([DHLPQSdhlpqs])\s*(\d+)(?![\w.])")  # the Prusa XL parks its tool with P0
_BARE_WORD = re.compile(rb"[XYZEFIJKRABCUVWxyzefijkrabcuvw]\s*[-+.\d]")
_WORD = re.compile(rb"\s*([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))?")
_EXPONENT = re.compile(rb"[A-Z]\s*[-+]?[\d.]+e[-+]?\d")
_LOOSE_WORD = re.compile(rb"([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))(?![\d._{])")
_FIELD = re.compile(r"(?<!\w)([A-Za-z_]\w*+)\s*+=\s*(\"[^\"]*\"|'[^']*'|\S*)")


@dataclass(frozen=True, slots=True)
class Command:
    """One command: `name` in its canonical form, the rest unparsed."""

    name: str  # G1 (also for G01), G38.2, M104, T0, SET_VELOCITY_LIMIT; "" for a line of bare words
    args: bytes  # the text after the name, without checksum and `;` comment
    line: int  # 1-based, for error sentences

    def numbers(self) -> dict[str, float]:
        """Return the words `X1.5 Y-2E.3` as {"X": 1.5, "Y": -2.0, "E": 0.3}; every word needs a number."""
        text, name, line = without_round_comments(self.args).strip(), self.name, self.line
        if _EXPONENT.search(text):
            raise GcodeError(f"{name} has an exponent in {shown(text)}; G-code numbers are plain decimals.", line)
        values: dict[str, float] = {}
        at = 0
        while at < len(text):
            match = _WORD.match(text, at)
            if match is None:
                raise GcodeError(f"{name} has {shown(text[at:])}, which is not a word (a letter and a number).", line)
            letter, number = match.group(1).decode().upper(), match.group(2)
            if number is None:
                raise GcodeError(f"{name} has the word {letter} without a number; every word needs one.", line)
            if letter in values:
                raise GcodeError(f"{name} has the word {letter} twice; each word may appear once.", line)
            values[letter] = value = float(number)
            if abs(value) > LARGEST_NUMBER:
                rule = f"numbers reach ±{LARGEST_NUMBER:,.0f}"
                raise GcodeError(f"{letter}{value:g} is out of range; {rule}.", line)
            at = match.end()
        return values

    def settings(self) -> dict[str, float]:
        """Return the words that have a number, the last of each letter; unreadable ones are left out.

        For commands that only set something: no move depends on their other words.
        """
        pairs = _LOOSE_WORD.findall(without_round_comments(self.args))
        values = {letter.decode().upper(): float(number) for letter, number in pairs}
        return {letter: value for letter, value in values.items() if abs(value) <= LARGEST_NUMBER}

    def letters(self) -> set[str]:
        """Return the letters of the words, values ignored."""
        return {word.decode().upper() for word in re.findall(rb"[A-Za-z]", without_round_comments(self.args))}

    def fields(self) -> dict[str, str]:
        """Return the `KEY=VALUE` pairs of a Klipper command, keys in capitals, quotes taken off."""
        pairs = _FIELD.findall(self.args.decode("utf-8", "replace"))
        return {key.upper(): value.strip("\"'") for key, value in pairs}

    def field_numbers(self) -> dict[str, float]:
        """Return the `KEY=VALUE` pairs whose value is a number that a printer can use; others are left out."""
        values = {key: _number(text) for key, text in self.fields().items()}
        return {key: value for key, value in values.items() if abs(value) <= LARGEST_NUMBER}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return nan


def comment(line: bytes) -> bytes:
    """Return the text after the first semicolon, without the line ending."""
    return line.partition(b";")[2].rstrip(b"\r\n")


def without_round_comments(text: bytes) -> bytes:
    """`G1 X1 (to the left) Y2` → `G1 X1  Y2`; an open bracket comments out the rest of the line."""
    return _ROUND_COMMENT.sub(b" ", text) if b"(" in text else text


def shown(text: bytes) -> str:
    """Return a piece of the file, short and printable, to quote in errors."""
    readable = text[:40].decode("latin-1")
    return repr(readable + "…" if len(text) > 40 else readable)


def commands(line: bytes, number: int) -> list[Command]:
    """Return the commands of one line: none for blank lines and comments, several for `G17 G21 G90`."""
    text = _without_number(line.partition(b";")[0], number)
    text = _LEADING_COMMENTS.sub(b"", text, count=1).strip()
    if not text or text == b"%":  # % frames a program on paper tape; some CAM programs still write it
        return []
    return _commands(text, number)


def _commands(text: bytes, number: int) -> list[Command]:
    if extended := _EXTENDED.match(text):
        return [Command(extended.group(1).decode().upper(), text[extended.end() :], number)]
    if tool := _TOOL.match(text):
        return [Command("T" + tool.group(1).decode(), text[tool.end() :], number)]
    if other := _OTHER_CODE.match(text):
        return [Command(other.group(1).decode().upper() + other.group(2).decode(), text[other.end() :], number)]
    if _CODE.match(text):
        return [_coded(piece, number) for piece in _pieces(text)]
    if _BARE_WORD.match(text):
        return [Command("", text, number)]
    rule = "a command starts with G, M or T and a number, an axis word, or a macro's name"
    raise GcodeError(f"{shown(text)} cannot be read as a command; {rule}.", number)


def _pieces(text: bytes) -> list[bytes]:
    """Cut before each further G or M; an M code keeps its whole line because its text can be anything."""
    if text[:1] in b"Mm" or b'"' in text:
        return [text]
    text = without_round_comments(text)
    cuts = [match.start() for match in _CODE.finditer(text)]
    return [text[start:end] for start, end in zip(cuts, [*cuts[1:], len(text)], strict=True)]


def _coded(text: bytes, number: int) -> Command:
    match = _CODE.match(text)
    assert match is not None
    letter, whole, part = match.groups()
    fraction = (part or b"").rstrip(b"0")
    name = f"{letter.decode().upper()}{int(whole)}" + (f".{fraction.decode()}" if fraction else "")
    return Command(name, text[match.end() :], number)


def _without_number(text: bytes, number: int) -> bytes:
    """Strip `N12` and `*71`; a wrong checksum is an error, because a host would reject it."""
    text = text.lstrip(b"\xef\xbb\xbf")  # a UTF-8 byte order mark
    match = NUMBERED.match(text)
    if match is None:
        return text
    body, star, stated = text.partition(b"*")
    if star:
        _check(body.lstrip(), stated.strip(), number)
    return body[match.end() :]


def _check(body: bytes, stated: bytes, number: int) -> None:
    actual = reduce(xor, body, 0)
    if not stated.isdigit() or int(stated) != actual:
        rule = f"the XOR of the bytes before the star is {actual}"
        raise GcodeError(f"The checksum *{stated.decode('latin-1')[:10]} is wrong; {rule}.", number)
