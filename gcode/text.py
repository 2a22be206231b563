"""Plain G-code text, from any source: its ends, its blocks, and checks that it is G-code."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from errno import EINVAL
from gzip import GzipFile
from pathlib import Path
from typing import IO

from gcode.errors import GcodeError, UnsupportedGcode

ENDS, BLOCK, PART_BYTES = 1 << 20, 1 << 20, 1 << 20  # bytes

# A long print packs to a fifth; no slicer's file comes near this ratio.
UNPACKED_RATIO, UNPACKED_LEAST = 100, 64 << 20  # times the packed size; bytes that are allowed in any case

BOM = b"\xef\xbb\xbf"  # of UTF-8: some editors write it before the first line
_FOREIGN = {
    b"\xff\xfe": "text in UTF-16, which no firmware reads; save it as UTF-8",
    b"\xfe\xff": "text in UTF-16, which no firmware reads; save it as UTF-8",
    b"\x89PNG": "a picture (PNG); export a sliced print",
    b"\xff\xd8\xff": "a picture (JPEG); export a sliced print",
    b"\x7fELF": "a program (ELF); export a sliced print",
    b"MZ": "a program (Windows); export a sliced print",
    b"%PDF": "a document (PDF); export a sliced print",
    b"GCDE": "binary G-code within another container; unpack it first",
    b"PK\x03\x04": "a zip archive within another container; unpack it first",
    b"\x1f\x8b": "compressed twice by gzip; unpack it once",
}


@dataclass(frozen=True, slots=True)
class Text:
    """Text that is unpacked each time it is read, so that it needs neither memory nor disk."""

    blocks: Callable[[], Iterator[bytes]]
    head: bytes
    tail: bytes
    size: int  # bytes

    @classmethod
    def read(cls, blocks: Callable[[], Iterator[bytes]], path: str) -> Text:
        """Read the whole text once, to find damage before anything else is done."""
        head, tail, size = b"", b"", 0
        for block in blocks():
            head += block[: ENDS - len(head)]
            tail = (tail + block)[-ENDS:]
            size += len(block)
        check_text(head, path)
        return cls(blocks, head, tail, size)


Source = bytes | Path | Text


def ends(source: Source) -> tuple[bytes, bytes, int]:
    """Read the first and the last bytes of plain G-code, and its size."""
    if isinstance(source, bytes):
        return source[:ENDS], source[-ENDS:], len(source)
    if isinstance(source, Text):
        return source.head, source.tail, source.size
    with open(source, "rb") as file:
        head = file.read(ENDS)
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - ENDS, 0))
        return head, file.read(), size


def blocks(source: Source, block: int = BLOCK) -> Iterator[bytes]:
    """Yield plain G-code in pieces cut anywhere."""
    if isinstance(source, bytes):
        yield from (source[at : at + block] for at in range(0, len(source), block))
    elif isinstance(source, Text):
        yield from source.blocks()
    else:
        with open(source, "rb") as file:
            yield from pieces(file, block)


def pieces(file: IO[bytes] | GzipFile, block: int = BLOCK) -> Iterator[bytes]:
    """Yield the rest of an open file."""
    while piece := file.read(block):
        yield piece


def limited(unpacked: Generator[bytes, None, None], packed_bytes: int, path: str) -> Iterator[bytes]:
    """Pass blocks on up to the size of a possible print: a malicious archive can fill any disk."""
    most, size = most_unpacked(packed_bytes), 0
    with closing(unpacked):
        for block in unpacked:
            size += len(block)
            if size > most:
                raise too_much(packed_bytes, path)
            yield block


def most_unpacked(packed_bytes: int) -> int:
    """Return how many bytes a packed file may unpack to."""
    return max(UNPACKED_RATIO * packed_bytes, UNPACKED_LEAST)


def too_much(packed_bytes: int, path: str) -> GcodeError:
    """Return the error of a file that unpacks to more than a print can be."""
    most = f"more than {most_unpacked(packed_bytes) >> 20} MiB"
    return GcodeError(f"The file's {packed_bytes} bytes unpack to {most}; no sliced print does that.", path=path)


def check_text(head: bytes, path: str) -> None:
    """Refuse a file whose first bytes show that it is not G-code."""
    for magic, what in _FOREIGN.items():
        if head.startswith(magic):
            raise UnsupportedGcode(f"The file is {what}.", 1, path)
    if head.startswith(b"solid") and b"facet normal" in head[:1000]:
        raise UnsupportedGcode("The file is a model (STL); slice it first.", 1, path)
    if (zero := head.find(b"\0")) >= 0:
        rule = "The file is not text: it contains zero bytes; export a sliced print."
        raise UnsupportedGcode(rule, head.count(b"\n", 0, zero) + 1, path)
    if not head.removeprefix(BOM).strip():
        raise GcodeError("The file is empty; there is nothing to compensate.", 1, path)


def check_regular(path: Path) -> None:
    """Refuse a pipe: it could block for ever, and cannot be read twice."""
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):  # opening a folder raises its own error
        raise OSError(EINVAL, "This is a pipe or a device; G-code is read only from files", str(path))


def raw_blocks(path: Path) -> Iterator[bytes]:
    """Yield the raw bytes of a file, in pieces cut anywhere."""
    check_regular(path)
    with open(path, "rb") as file:
        yield from pieces(file)


def whole_lines(blocks: Iterable[bytes], part_bytes: int = PART_BYTES) -> Iterator[bytes]:
    r"""Yield parts of about `part_bytes`, cut after a \n, \r\n or \r; longer if a line is longer."""
    pending, searched = bytearray(), 0
    for piece in _shorter(blocks, part_bytes):
        pending += piece
        if len(pending) < part_bytes:
            continue
        # a last \r may be half of a \r\n
        cut = max(pending.rfind(b"\n", searched), pending.rfind(b"\r", searched, len(pending) - 1)) + 1
        if cut:
            yield bytes(pending[:cut])
            del pending[:cut]
        searched = max(0, len(pending) - 1)
    if pending:
        yield bytes(pending)


def _shorter(blocks: Iterable[bytes], longest: int) -> Iterator[bytes]:
    for block in blocks:
        if len(block) <= longest:
            yield block
        else:
            yield from (block[at : at + longest] for at in range(0, len(block), longest))
