"""What comments say about the whole print: its time, and that ffcomp has been here."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

# -- the stamp --

_STAMP = re.compile(
    rb"^; Processed by ffcomp v(\S+), machine (.*) sha256:([0-9a-f]+), flavor (\w+)[ \t]*\r?$", re.MULTILINE
)


@dataclass(frozen=True, slots=True)
class Stamp:
    version: str
    machine: str
    sha256: str  # the first digits of the machine file's hash
    flavor: str


def stamp_line(version: str, machine: str, sha256: str, flavor: str) -> bytes:
    """The comment line for head and tail of a compensated file."""
    name = " ".join(machine.split())
    return f"; Processed by ffcomp v{version}, machine {name} sha256:{sha256[:8]}, flavor {flavor}\n".encode()


def find_stamp(head: bytes, tail: bytes) -> Stamp | None:
    """The stamp in the beginning or the end of a file."""
    match = _STAMP.search(head) or _STAMP.search(tail)
    return Stamp(*(part.decode("utf-8", "replace") for part in match.groups())) if match else None


# -- the time --

_SHORT_UNITS = {"d": 86400, "h": 3600, "m": 60, "s": 1}
_LONG_UNITS = {"day": 86400, "hour": 3600, "minute": 60}
_PART = re.compile(rb"([\d.]+)\s*([dhms])")


def _seconds(text: bytes) -> float:
    """`1h 2m 3s`, `1 hour 2 minutes` or plain seconds, s."""
    parts = _PART.findall(text)
    return sum(float(n) * _SHORT_UNITS[unit.decode()] for n, unit in parts) if parts else float(text)


def _counts(seconds: float, units: dict[str, int]) -> list[tuple[int, str]]:
    """How many of each unit, largest first, those that are zero left out."""
    left, counts = round(seconds / min(units.values())) * min(units.values()), []
    for unit, unit_s in units.items():
        counts.append((left // unit_s, unit))
        left %= unit_s
    return [(n, unit) for n, unit in counts if n]


def _short(seconds: float) -> str:
    return " ".join(f"{n}{unit}" for n, unit in _counts(seconds, _SHORT_UNITS)) or "0s"


def _long(seconds: float) -> str:
    return " ".join(f"{n} {unit}{'s' * (n > 1)}" for n, unit in _counts(seconds, _LONG_UNITS)) or "0 minutes"


def _whole(seconds: float) -> str:
    return str(round(seconds))


_DURATION = rb"((?:\d+d ?)?(?:\d+h ?)?(?:\d+m ?)?(?:[\d.]+s)?)"
_TIMES: list[tuple[re.Pattern[bytes], Callable[[float], str]]] = [  # the print's time stands in group 2
    (
        re.compile(rb"(; estimated printing time \((?:normal|silent) mode\) = )" + _DURATION + rb"(\s*)"),
        _short,
    ),
    (re.compile(rb"(;.*total estimated time: )" + _DURATION + rb"(\s*)"), _short),
    (re.compile(rb"(;TIME:)(\d+)(\s*)"), _whole),
    (re.compile(rb"(;Print Time: )(\d+)(\s*)"), _whole),
    (re.compile(rb"(;   Build time: )([\w ]+?)(\s*)"), _long),
]
_PROGRESS = re.compile(rb"(M73 .*?\b[RS])(\d+)(.*)", re.DOTALL)  # minutes left; S: silent mode


def slicer_time_s(lines: Iterable[bytes]) -> float | None:
    """The print time as the slicer states it, s; None when it does not."""
    for line in lines:
        if line.startswith(b";") and (match := _time(line)):
            return _seconds(match[0].group(2))
    return None


def scale_time(line: bytes, ratio: float) -> bytes:
    """The line for a print that takes `ratio` times as long; other lines come back as they are."""
    if line.startswith(b";") and (found := _time(line)):
        match, spell = found
        return match.group(1) + spell(_seconds(match.group(2)) * ratio).encode() + match.group(3)
    if left := _PROGRESS.fullmatch(line):
        return left.group(1) + b"%d" % round(int(left.group(2)) * ratio) + left.group(3)
    return line


def _time(line: bytes) -> tuple[re.Match[bytes], Callable[[float], str]] | None:
    for pattern, spell in _TIMES:
        if (match := pattern.fullmatch(line)) and match.group(2):
            return match, spell
    return None
