"""What comments say about the whole print: its time, and that ffcomp has been here."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

# -- the stamp -------------------------------------------------------------------------------------------------

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


# -- the time --------------------------------------------------------------------------------------------------

_UNITS = {"d": 86400, "h": 3600, "m": 60, "s": 1}
_SPELLED = {"day": 86400, "hour": 3600, "minute": 60, "second": 1}
_DURATION = re.compile(rb"([\d.]+)\s*(d|h|m|s)")


def _parse(text: bytes) -> float:
    """`1h 2m 3s`, `1 hour 2 minutes` or plain seconds, s."""
    parts = _DURATION.findall(text)
    return sum(float(n) * _UNITS[unit.decode()] for n, unit in parts) if parts else float(text)


def _short(seconds: float) -> str:
    return _spell(seconds, [(f"{unit}", unit_s) for unit, unit_s in _UNITS.items()]) or "0s"


def _long(seconds: float) -> str:
    """Simplify3D's words, in whole minutes."""
    minutes = round(seconds / 60) * 60
    parts = [(n, word) for n, word in _counts(minutes, _SPELLED) if n]
    return " ".join(f"{n} {word}{'s' * (n != 1)}" for n, word in parts) or "0 minutes"


def _spell(seconds: float, units: list[tuple[str, int]]) -> str:
    return " ".join(f"{n}{unit}" for n, unit in _counts(seconds, dict(units)) if n)


def _counts(seconds: float, units: dict[str, int]) -> list[tuple[int, str]]:
    left, counts = round(seconds), []
    for unit, unit_s in units.items():
        counts.append((left // unit_s, unit))
        left %= unit_s
    return counts
