"""`.bgcode`: binary G-code. Only the G-code and the print time change; other blocks are copied.

The format is libbgcode's (doc/specifications.md): a header, then blocks with a kind, a compression and a checksum. What
is in the blocks of G-code (MeatPack, Heatshrink) is unpacked and packed by the codec of the extra `bgcode`. Its text
has the metadata as comments around the G-code.

MeatPack keeps only comments that have a line of their own. Trailing comments are moved to a line before their command
(`_HELD`), and back again when the file is read. Comments between commands that the codec would take for metadata,
such as `; max_layer_z = 6.2` of a Prusa MK4's end code, are masked (`_MASKED`).
"""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from gcode import bgcode_codec
from gcode.embedded import OURS, TIME_WAS
from gcode.errors import GcodeError, UnsupportedGcode
from gcode.text import ENDS, Source, blocks, check_text, most_unpacked, too_much, whole_lines

HEADER = struct.Struct("<4sLH")  # magic, version, checksum
_BLOCK = struct.Struct("<HHL")  # kind, compression, unpacked size; then the packed size, if there is a compression
GCODE, _PRINTER, _PRINT, _THUMBNAIL = 1, 3, 4, 5  # kinds of blocks
_STORED, _DEFLATED = 0, 1  # compressions
COMPRESSIONS = ("none", "Deflate", "Heatshrink_11_4", "Heatshrink_12_4")
_WAS = b"ffcomp "  # prefix of the key that keeps a changed time's old value
_PARAMETERS_BYTES = {_THUMBNAIL: 6}  # others: 2, their encoding


@dataclass(frozen=True, slots=True)
class Block:
    """One block of a binary G-code file."""

    kind: int
    compression: int
    unpacked: int  # bytes
    encoding: int
    raw: bytes  # the complete block, checksum included
    data: bytes  # still packed


def blocks_of(file: BinaryIO, path: str) -> Iterator[Block]:
    """Yield the blocks of a file that is open at its beginning, each one checked."""
    magic, version, checksum = HEADER.unpack(_exactly(file, HEADER.size, path))
    if magic != b"GCDE" or version != 1 or checksum > 1:
        rule = f"version {version}, checksum type {checksum}; version 1 with CRC32 or none is known"
        raise UnsupportedGcode(f"The file is binary G-code of another kind ({rule}).", path=path)
    number = 0
    while head := file.read(_BLOCK.size):
        number += 1
        yield _block(file, head, 4 * checksum, number, path)


def _block(file: BinaryIO, head: bytes, checksum_bytes: int, number: int, path: str) -> Block:
    head += _exactly(file, _BLOCK.size - len(head), path)
    kind, compression, size = _BLOCK.unpack(head)
    if compression >= len(COMPRESSIONS):
        raise UnsupportedGcode(f"Block {number} is packed in an unknown way ({compression}).", path=path)
    packed = head[4:8] if compression == _STORED else _exactly(file, 4, path)
    head = head if compression == _STORED else head + packed
    parameters = _exactly(file, _PARAMETERS_BYTES.get(kind, 2), path)
    data = _exactly(file, int.from_bytes(packed, "little"), path)
    checksum = _exactly(file, checksum_bytes, path)
    if checksum and zlib.crc32(head + parameters + data) != int.from_bytes(checksum, "little"):
        raise GcodeError(f"The checksum of block {number} is wrong: the file is damaged; copy it again.", path=path)
    encoding = int.from_bytes(parameters[:2], "little")
    return Block(kind, compression, size, encoding, head + parameters + data + checksum, data)


def _exactly(file: BinaryIO, count: int, path: str) -> bytes:
    data = file.read(count)
    if len(data) < count:
        raise GcodeError("The file, binary G-code, is cut short; copy it again.", path=path)
    return data


# -- metadata: lines `key=value` --


def with_metadata(block: Block, change: Callable[[dict[bytes, bytes]], dict[bytes, bytes]]) -> bytes:
    """Return the block with other metadata; the same bytes if nothing changes."""
    before = metadata_of(block)
    after = change(before)
    if before == after:
        return block.raw
    text = b"".join(key + b"=" + value + b"\n" for key, value in after.items())
    data = zlib.compress(text) if block.compression == _DEFLATED else text
    sizes = struct.pack("<L", len(text)) + (struct.pack("<L", len(data)) if block.compression == _DEFLATED else b"")
    raw = struct.pack("<HH", block.kind, block.compression) + sizes + struct.pack("<H", block.encoding) + data
    has_checksum = len(block.raw) > len(raw) - len(data) + len(block.data)
    return raw + struct.pack("<L", zlib.crc32(raw)) if has_checksum else raw


def metadata_of(block: Block) -> dict[bytes, bytes]:
    """Read a metadata block."""
    if block.compression not in (_STORED, _DEFLATED) or block.kind not in (_PRINTER, _PRINT):
        return {}
    text = block.data if block.compression == _STORED else _inflated(block)
    pairs = (line.partition(b"=") for line in text.split(b"\n") if line)
    return {key: value for key, _, value in pairs}


def _inflated(block: Block) -> bytes:
    """Decompress a block as far as possible; the codec reports errors."""
    try:
        return zlib.decompressobj().decompress(block.data, max(block.unpacked, 1))
    except zlib.error:
        return b""


def first_times(metadata: Mapping[bytes, bytes]) -> dict[bytes, bytes]:
    """Return the metadata with the slicer's own times."""
    return {key: metadata.get(_WAS + key, value) for key, value in metadata.items() if not key.startswith(_WAS)}


def with_times(metadata: Mapping[bytes, bytes], times: Mapping[bytes, bytes]) -> dict[bytes, bytes]:
    """Return the metadata with these times, and the old ones under other keys."""
    first = first_times(metadata)
    new = {key: times.get(key, value) for key, value in first.items()}
    return new | {_WAS + key: first[key] for key in new if new[key] != first[key]}


_Open = Callable[[], BinaryIO]

_HELD = b";ffcomp|"  # before a comment that belongs to the end of the next line
_MASKED = b";ffcomp="  # before a comment that looks like a line of metadata
_METADATA = re.compile(rb"; [^=\r\n]+ = ")
_INLINE = re.compile(rb"([^;\r\n]*[^;\s])([ \t]*;[^\r\n]*)(\r?\n?)")
_TIME = b"; estimated "  # before a time
_PLAIN = 0  # encoding of G-code; others are MeatPack
_REFUSED = 3  # exit code of the codec
_PATIENCE_S, _SLOWEST_BYTES_PER_S = 30, 100_000  # time limit of the codec; it is a hundred times faster

# -- the codec --


def _converted(source: Path, target: Path, path: str, options: Mapping[str, str] | None = None) -> None:
    """Run the codec. `options` are for packing (see `gcode.bgcode_codec`); None unpacks."""
    arguments, size = [] if options is None else [json.dumps(options)], source.stat().st_size
    words = [str(source), str(target), str(most_unpacked(size)), *arguments]
    patience_s = _PATIENCE_S + size // _SLOWEST_BYTES_PER_S
    command = [sys.executable, "-P", bgcode_codec.__file__, *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=patience_s, check=False)
    except subprocess.TimeoutExpired:
        raise GcodeError(f"The codec of binary G-code did not finish within {patience_s} s.", path=path) from None
    if done.returncode:
        why = done.stdout.strip() if done.returncode == _REFUSED else f"the codec failed (exit {done.returncode})"
        raise GcodeError(f"The binary G-code cannot be converted: {why}.", path=path)


# -- the container --


@dataclass(frozen=True, slots=True)
class Bgcode:
    """Hold the one print as text in a temporary file."""

    prints: Mapping[str, Source]
    reopen: _Open
    path: str

    def write(self, file: BinaryIO, texts: Iterable[Iterable[bytes]]) -> None:
        """Write the file with this text in place of its print."""
        (lines,) = texts
        with TemporaryDirectory() as folder, self.reopen() as old:
            text, packed = Path(folder, "text"), Path(folder, "packed")
            packing = self._packing()
            introduced = _introduced(_masked(_without_old_times(lines)))
            _write(text, introduced if packing["encoding"] == "none" else _apart(introduced))
            _converted(text, packed, self.path, packing)
            _check_kept(text, packed, Path(folder, "again"), self.path)
            with open(packed, "rb") as new:
                file.writelines(_spliced(old, new, self.path))

    def _packing(self) -> dict[str, str]:
        """Return the packing options of the file, with comments kept: they contain the original."""
        with self.reopen() as file:
            _, _, checksum = HEADER.unpack(file.read(HEADER.size))
            file.seek(0)
            first = next(block for block in blocks_of(file, self.path) if block.kind == GCODE)
        return {
            "compression": COMPRESSIONS[first.compression],
            "encoding": "none" if first.encoding == _PLAIN else "MeatPackComments",
            "checksum": "CRC32" if checksum else "none",
        }


@contextmanager
def open_bgcode(reopen: _Open, path: str) -> Iterator[Bgcode]:
    """Open a binary G-code file."""
    with reopen() as file:
        sizes = [(block.kind, block.unpacked, len(block.raw)) for block in blocks_of(file, path)]
    if not any(kind == GCODE for kind, _, _ in sizes):
        raise UnsupportedGcode("The file is binary G-code without a block of G-code.", path=path)
    size = sum(packed for _, _, packed in sizes)
    if 2 * sum(unpacked for _, unpacked, _ in sizes) > most_unpacked(size):  # MeatPack halves
        raise too_much(size, path)
    if find_spec("pybgcode") is None:
        rule = "to read it, pip install 'ffcomp[bgcode]'"
        slicer = "or switch 'Supports binary G-code' off in the slicer's printer settings"
        raise UnsupportedGcode(f"The file is binary G-code; {rule}, {slicer}.", path=path)
    with TemporaryDirectory() as folder:
        packed, plain, text = (Path(folder, name) for name in ("packed", "plain", "text"))
        with reopen() as file:
            _write(packed, _first(file, path))
        _converted(packed, plain, path)
        packed.unlink()
        _write(text, _together(blocks(plain)))
        plain.unlink()
        with open(text, "rb") as file:
            check_text(file.read(ENDS), path)
        yield Bgcode({"": text}, reopen, path)


def _first(file: BinaryIO, path: str) -> Iterator[bytes]:
    """Yield the file with the slicer's own times."""
    yield file.read(HEADER.size)
    file.seek(0)
    for block in blocks_of(file, path):
        yield with_metadata(block, first_times)


def _spliced(old: BinaryIO, new: BinaryIO, path: str) -> Iterator[bytes]:
    """Yield the old file with the new one's G-code and times."""
    times: dict[bytes, bytes] = {}
    for block in blocks_of(new, path):
        times |= {key: value for key, value in metadata_of(block).items() if key.startswith(b"estimated ")}
    new.seek(0)
    yield old.read(HEADER.size)
    old.seek(0)
    before = True
    for block in blocks_of(old, path):
        if block.kind != GCODE:
            yield with_metadata(block, lambda metadata: with_times(metadata, times))
        elif before:
            yield from (each.raw for each in blocks_of(new, path) if each.kind == GCODE)
            before = False


def _write(target: Path, pieces: Iterable[bytes]) -> None:
    with open(target, "wb") as file:
        file.writelines(pieces)


# -- text as the codec keeps it --


def _lines(pieces: Iterable[bytes]) -> Iterator[bytes]:
    for part in whole_lines(pieces):
        yield from part.splitlines(keepends=True)


def _introduced(lines: Iterator[bytes]) -> Iterator[bytes]:
    """Add a PrusaSlicer header, the only producer that the codec accepts; the line is removed again."""
    yield b"; generated by PrusaSlicer 2.8.0 on 2000-01-01 at 00:00:00 UTC\n"
    first = next(lines, b"")
    if not first.startswith(b"; generated by "):
        yield first
    yield from lines


def _without_old_times(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Leave out the comments with old times: the metadata keeps them."""
    old = b""
    for line in _lines(pieces):
        if line.startswith(TIME_WAS):
            old = line
            continue
        if old and not line.startswith(_TIME):
            yield old
        old = b""
        yield line


def _masked(lines: Iterable[bytes]) -> Iterator[bytes]:
    """Mask comments that look like metadata between the print's commands; real metadata is before and after them."""
    begun, waiting = False, list[bytes]()
    for line in lines:
        if not line.startswith((b";", b"\r", b"\n")) and not line.rstrip().endswith(OURS):
            yield from (_MASKED + each if _METADATA.match(each) else each for each in waiting)
            yield line
            begun, waiting = True, []
        elif begun and (waiting or _METADATA.match(line)):
            waiting.append(line)
        else:
            yield line
    yield from waiting


def _apart(lines: Iterable[bytes]) -> Iterator[bytes]:
    """Put each comment on a line of its own."""
    for line in lines:
        if b";" in line and (match := _INLINE.fullmatch(line)):
            yield _HELD + match[2] + b"\n"
            line = match[1] + match[3]
        yield line


def _together(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Move each comment back to where it was."""
    held = b""
    for line in _lines(pieces):
        if line.startswith(_HELD):
            held = line[len(_HELD) :].rstrip(b"\r\n")
            continue
        line = line.removeprefix(_MASKED)
        if held:
            code = line.rstrip(b"\r\n")
            line, held = code + held + line[len(code) :], b""
        yield line


def _check_kept(text: Path, packed: Path, again: Path, path: str) -> None:
    """Read back what was packed: no command may be lost or altered."""
    _converted(packed, again, path)
    for written, read_back in zip_longest(_commands(text), _commands(again)):
        if written != read_back:
            raise UnsupportedGcode(
                f"The codec of binary G-code would make {read_back!r} of the line {written!r}.", path=path
            )


def _commands(text: Path) -> Iterator[bytes]:
    """Yield the lines that matter: without slicers' comments, which begin with a blank and which the codec reorders."""
    stripped = (line.strip() for line in _lines(blocks(text)))
    return (line for line in stripped if line.strip(b";") and not line.startswith(b"; "))
