"""Mark a compensated file as one: who has compensated it, for which machine, and shifted by how much."""

from __future__ import annotations

import re
from dataclasses import dataclass

STAMP_REACH = 1 << 20  # bytes at either end in which a stamp is looked for
WITHOUT_ORIGINAL = b"; ffcomp original=none"  # of a file that does not hold the moves it was made of
STAMPS = b"; Processed by ffcomp", b"; ffcomp offset_mm=", WITHOUT_ORIGINAL  # how these lines begin

_STAMP = re.compile(
    rb"^; Processed by ffcomp v(\S+), machine (.*) sha256:([0-9a-f]+), flavor (\w+)[ \t]*\r?$", re.MULTILINE
)


@dataclass(frozen=True, slots=True)
class Stamp:
    """Who has compensated a file, and for what."""

    version: str
    machine: str
    sha256: str  # the first digits of the machine file's hash
    flavor: str


def stamp_line(version: str, machine: str, sha256: str, flavor: str) -> bytes:
    """Return the comment line for head and tail of a compensated file."""
    name = " ".join(machine.split())
    return f"; Processed by ffcomp v{version}, machine {name} sha256:{sha256[:8]}, flavor {flavor}\n".encode()


def find_stamp(head: bytes, tail: bytes) -> Stamp | None:
    """Find the stamp in the beginning or the end of a file."""
    match = _STAMP.search(head) or _STAMP.search(tail)
    return Stamp(*(part.decode("utf-8", "replace") for part in match.groups())) if match else None


def already_processed(data: bytes) -> Stamp | None:
    """Return the stamp of an earlier run, if there is one."""
    return find_stamp(data[:STAMP_REACH], data[-STAMP_REACH:])


def offset_line(offset: tuple[float, float]) -> bytes:
    """Says what was added to every position, so that the original can be laid over the result; empty for nothing."""
    return b"; ffcomp offset_mm=%.6g,%.6g\n" % offset if any(offset) else b""


def find_offset(head: bytes) -> tuple[float, float]:
    """Read the offset that `offset_line` wrote; zero if it wrote none."""
    found = re.search(rb"^; ffcomp offset_mm=([-+.\de]+),([-+.\de]+)", head, re.MULTILINE)
    return (float(found[1]), float(found[2])) if found else (0.0, 0.0)


def holds_original(head: bytes) -> bool:
    """Tell whether a compensated file, which begins like this, holds the file that it was made of."""
    return not any(line.startswith(WITHOUT_ORIGINAL) for line in head.splitlines())
