"""`.gcode.gz`: one print, compressed by gzip. It is unpacked as it is read and packed as it is written."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import BinaryIO

from gcode.errors import GcodeError
from gcode.text import BLOCK, Source, Text, limited, pieces

_HAS_EXTRA, _HAS_NAME = 4, 8  # bits of the flags (RFC 1952, 2.3.1)
_LEVEL = 6  # that of the gzip command


@dataclass(frozen=True, slots=True)
class Gzip:
    """Hold the one print, and the name and time of the packed file as the header says them."""

    prints: Mapping[str, Source]
    name: str
    time_s: int

    def write(self, file: BinaryIO, texts: Iterable[Iterable[bytes]]) -> None:
        """Write the file anew with this text."""
        (lines,) = texts
        with (
            gzip.GzipFile(self.name, "wb", _LEVEL, file, self.time_s) as packed,
            io.BufferedWriter(packed, BLOCK) as out,
        ):
            out.writelines(lines)


@contextmanager
def open_gzip(reopen: Callable[[], BinaryIO], path: str) -> Iterator[Gzip]:
    """Open a file compressed by gzip."""
    with reopen() as file:
        header = file.read(1 << 10)
        size = file.seek(0, io.SEEK_END)

    def blocks() -> Iterator[bytes]:
        return limited(_unpacked(reopen, path), size, path)

    yield Gzip({"": Text.read(blocks, path)}, _name(header), int.from_bytes(header[4:8], "little"))


def _unpacked(reopen: Callable[[], BinaryIO], path: str) -> Generator[bytes, None, None]:
    with reopen() as file, gzip.GzipFile(fileobj=file) as unpacked:
        try:
            yield from pieces(unpacked)
        except EOFError:
            raise GcodeError("The file, compressed by gzip, is cut short; copy it again.", path=path) from None
        except (gzip.BadGzipFile, zlib.error) as error:
            raise GcodeError(f"The file, compressed by gzip, is damaged ({error}); copy it again.", path=path) from None


def _name(header: bytes) -> str:
    """Return the packed file's name; empty if the header says none."""
    if not header[3] & _HAS_NAME or header[3] & _HAS_EXTRA:
        return ""
    return header[10:].partition(b"\0")[0].decode("latin-1")
