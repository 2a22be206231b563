"""The format of a compensated file: how the original's lines are kept in its comments, and read out of it again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby

from gcode.metadata import Timed, with_time
from gcode.stamp import STAMPS
from gcode.text import whole_lines

OURS = b" ; ffcomp"  # ends every line of ours that is not a move
WAS = b";~"  # before a line of the original that is now a comment: a move, mostly
CUT_SHORT = b";~~"  # the same before a line that does not end in a newline; the newline behind it is ours
TIME_WAS = b"; ffcomp was "  # before a line whose time is ours now: the original's


def joined(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Adjacent pieces as one; lines that tell a time stay apart."""
    for kind, group in groupby(pieces, key=type):
        if kind is Timed:
            yield from group
        elif whole := b"".join(group):
            yield whole


def original(data: bytes) -> bytes:
    """The file as it was before compensation."""
    return b"".join(original_lines(data.splitlines(keepends=True)))


def original_blocks(blocks: Iterable[bytes]) -> Iterator[bytes]:
    """The same of a file that comes in blocks of bytes, cut anywhere."""
    return original_lines(line for part in whole_lines(blocks) for line in part.splitlines(keepends=True))


def original_lines(lines: Iterable[bytes]) -> Iterator[bytes]:
    """The file as it was before compensation (`gcode.metadata`'s stamps left out)."""
    inside, told = False, None
    for line in lines:
        if line.startswith(TIME_WAS):
            told = line[len(TIME_WAS) :].rstrip(b"\r\n")
        elif (kept := noted(line)) is not None:
            yield kept
        elif is_ours(line):
            inside = (inside or not line.startswith(b"G")) and not line.startswith(b"G1 F")
        elif not line.startswith(STAMPS) and not (inside and line.startswith(b"G1 ")):
            yield line if told is None else with_time(line, told)
            told = None


def noted(line: bytes) -> bytes | None:
    """The line of the original that this comment keeps, if it keeps one."""
    if line.startswith(CUT_SHORT):
        return line[len(CUT_SHORT) :].removesuffix(b"\n")
    return line[len(WAS) :] if line.startswith(WAS) else None


def is_ours(line: bytes) -> bool:
    return line.rstrip().endswith(OURS)


def like_ours(line: bytes) -> bool:
    return line.startswith((WAS, TIME_WAS, *STAMPS)) or is_ours(line)
