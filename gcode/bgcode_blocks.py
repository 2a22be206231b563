"""The blocks of binary G-code, as they stand in the file, and the times that some of them say.

The format is libbgcode's (doc/specifications.md): a header, then blocks with a kind, a compression and a checksum.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import BinaryIO

from gcode.errors import GcodeError, UnsupportedGcode

HEADER = struct.Struct("<4sLH")  # magic, version, checksum
_BLOCK = struct.Struct("<HHL")  # kind, compression, unpacked size; then the packed size, if there is a compression
GCODE, _PRINTER, _PRINT, _THUMBNAIL = 1, 3, 4, 5  # kinds of blocks
_STORED, _DEFLATED = 0, 1  # compressions
COMPRESSIONS = ("none", "Deflate", "Heatshrink_11_4", "Heatshrink_12_4")
_WAS = b"ffcomp "  # before the key of a time that was changed, with its old value
_PARAMETERS_BYTES = {_THUMBNAIL: 6}  # others: 2, their encoding


@dataclass(frozen=True, slots=True)
class Block:
    """One block of a binary G-code file."""

    kind: int
    compression: int
    unpacked: int  # bytes
    encoding: int
    raw: bytes  # all of it, checksum included
    data: bytes  # as it is packed


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
    """Return the block with other metadata; as it is, if nothing changes."""
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
    """As far as it can be: the codec says what is wrong with it."""
    try:
        return zlib.decompressobj().decompress(block.data, max(block.unpacked, 1))
    except zlib.error:
        return b""


def first_times(metadata: Mapping[bytes, bytes]) -> dict[bytes, bytes]:
    """As the slicer had them."""
    return {key: metadata.get(_WAS + key, value) for key, value in metadata.items() if not key.startswith(_WAS)}


def with_times(metadata: Mapping[bytes, bytes], times: Mapping[bytes, bytes]) -> dict[bytes, bytes]:
    """With these times instead, and what they were."""
    first = first_times(metadata)
    new = {key: times.get(key, value) for key, value in first.items()}
    return new | {_WAS + key: first[key] for key in new if new[key] != first[key]}
