"""The format of a compensated file: its stamp, the original lines kept in comments, and the start time of each section.

Every line that ffcomp adds is a segment (`G1 ...`), ends in OURS, or begins with TIME_WAS or a stamp. Every line of the
original is there: unchanged, as a comment WAS, or, if its print time changed, in a comment TIME_WAS. With `--no-embed`
there are no such comments, and the head has a line WITHOUT_ORIGINAL.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

from gcode.dialect import DIALECTS
from gcode.errors import UnsupportedGcode
from gcode.metadata import Timed, with_time
from gcode.text import whole_lines

STAMP_REACH = 1 << 20  # bytes at either end that are searched for a stamp
WITHOUT_ORIGINAL = b"; ffcomp original=none"  # in a file without the original moves
FORECAST = b"; ffcomp forecast="  # in the tail: the predicted errors, one JSON object
SHAPER = b"; ffcomp shaper="  # in the head: the print is as sliced, through this shaper of the firmware
STAMPS = b"; Processed by ffcomp", b"; ffcomp offset_mm=", FORECAST, SHAPER, WITHOUT_ORIGINAL  # how these lines begin
_OF_SHAPER = tuple({each.shaper_command for each in DIALECTS.values()})

_STAMP = re.compile(
    rb"^; Processed by ffcomp v(\S+), machine (.*) sha256:([0-9a-f]+), flavor (\w+)[ \t]*\r?$", re.MULTILINE
)


@dataclass(frozen=True, slots=True)
class Stamp:
    """The version, machine and flavor that a file was compensated with."""

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
    """Return a comment with the offset added to every position; empty for zero."""
    return b"; ffcomp offset_mm=%.6g,%.6g\n" % offset if any(offset) else b""


def find_offset(head: bytes) -> tuple[float, float]:
    """Read the offset that `offset_line` wrote; zero if it wrote none."""
    match = re.search(rb"^; ffcomp offset_mm=([-+.\de]+),([-+.\de]+)", head, re.MULTILINE)
    return (float(match[1]), float(match[2])) if match else (0.0, 0.0)


def shaper_line(kind: str, hz: tuple[float, float]) -> bytes:
    """Return a comment with the shaper of a print as sliced, and its frequencies for x and y."""
    return SHAPER + b"%b,%.6g,%.6g\n" % (kind.encode(), *hz)


def find_shaper(head: bytes) -> tuple[str, tuple[float, float]] | None:
    """Read the shaper that `shaper_line` wrote; None: the moves are ffcomp's own."""
    match = re.search(rb"^; ffcomp shaper=(\w+),([.\d]+),([.\d]+)", head, re.MULTILINE)
    return (match[1].decode(), (float(match[2]), float(match[3]))) if match else None


def find_forecast_text(tail: bytes) -> bytes:
    """Return the forecast in a file's tail; empty: there is none."""
    begin = tail.rfind(b"\n" + FORECAST)
    return b"" if begin < 0 else tail[begin + 1 + len(FORECAST) :].split(b"\n", 1)[0].rstrip()


def holds_original(head: bytes) -> bool:
    """Whether a compensated file with this head contains its original."""
    return not any(line.startswith(WITHOUT_ORIGINAL) for line in head.splitlines())


OURS = b" ; ffcomp"  # ends every line of ours that is not a move
WAS = b";~"  # before a line of the original that is now a comment, usually a move
CUT_SHORT = b";~~"  # the same before a line that does not end in a newline; the newline behind it is ours
NOT_HELD = (
    "The file was compensated with --no-embed and does not contain its original. Use the slicer's file, or "
    "compensate it again without --no-embed."
)
TIME_WAS = b"; ffcomp was "  # before the original line, where ours has another time

_SECTION = re.compile(rb";section line=(\d+) t=(-?[\d.]+(?:e-?\d+)?) ; ffcomp")


class SectionTime(NamedTuple):
    """When a section (rest to rest) of the original begins, on its own clock and on the compensated file's."""

    at: int  # index among the compensated file's lines: the next segment after this line is the section's first
    line: int  # index among the original's lines: of the section's first move
    t: float  # s from the beginning of the section's path to that of the segment; negative: the segment begins first


def section_time_line(line: int, t: float) -> bytes:
    """Return the comment before a section's first segment; see `SectionTime`."""
    seconds = (b"%.7f" % t).rstrip(b"0").rstrip(b".")
    return b";section line=%d t=" % (line + 1) + (b"0" if seconds == b"-0" else seconds) + OURS


def section_times(lines: Iterable[bytes]) -> list[SectionTime]:
    """Read when each section of the original begins, from all lines of a compensated file."""
    matches = ((at, _SECTION.match(line)) for at, line in enumerate(lines) if line.startswith(b";section "))
    return [SectionTime(at, int(match[1]) - 1, float(match[2])) for at, match in matches if match]


def joined(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Join adjacent pieces; lines with a print time stay separate."""
    for kind, group in groupby(pieces, key=type):
        if kind is Timed:
            yield from group
        elif whole := b"".join(group):
            yield whole


def original(data: bytes) -> bytes:
    """Restore the original file."""
    return b"".join(original_lines(data.splitlines(keepends=True)))


def original_blocks(blocks: Iterable[bytes]) -> Iterator[bytes]:
    """Restore a file that comes in blocks of bytes, cut anywhere."""
    return original_lines(line for part in whole_lines(blocks) for line in part.splitlines(keepends=True))


def original_lines(lines: Iterable[bytes]) -> Iterator[bytes]:
    """Restore the original lines, without stamps; UnsupportedGcode if the file does not contain its original."""
    inside, time, stamps = False, None, 0
    for line in lines:
        stamps += line.startswith(STAMPS[0])
        if line.startswith(WITHOUT_ORIGINAL):
            raise UnsupportedGcode(NOT_HELD)
        if line.startswith(TIME_WAS):
            time = line[len(TIME_WAS) :].rstrip(b"\r\n")
        elif (kept := noted(line)) is not None:
            yield kept
        elif is_ours(line):
            if line.startswith(_OF_SHAPER):  # it opens no block
                continue
            inside = (inside or not line.startswith(b"G")) and not line.startswith(b"G1 F")
        elif not line.startswith(STAMPS) and not (inside and line.startswith(b"G1 ")):
            yield line if time is None else with_time(line, time)
            time = None
    if stamps == 1:  # of two, the first and the last line of ours
        raise UnsupportedGcode("The compensated file is cut short: the stamp at one end is missing. Copy it again.")


def noted(line: bytes) -> bytes | None:
    """Return the original line that this comment contains, if any."""
    if line.startswith(CUT_SHORT):
        return line[len(CUT_SHORT) :].removesuffix(b"\n")
    return line[len(WAS) :] if line.startswith(WAS) else None


def is_ours(line: bytes) -> bool:
    """Whether ffcomp added this line."""
    return line.rstrip().endswith(OURS)


def like_ours(line: bytes) -> bool:
    """Whether a line of the original looks like one of ours."""
    return line.startswith((WAS, TIME_WAS, *STAMPS)) or is_ours(line)
