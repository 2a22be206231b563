"""Files on disk: detect the container from the first bytes, read its prints, write it back with other text.

Kinds: plain text, gzip, a slicer's zip archive (`gcode.archive`), binary G-code (`gcode.bgcode`). A container holds one
print or several.
"""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol

from gcode import text
from gcode.archive import open_archive
from gcode.bgcode import open_bgcode
from gcode.errors import GcodeError, UnsupportedGcode
from gcode.text import BLOCK, ENDS, Source, Text, check_regular, check_text, limited, pieces

_HAS_EXTRA, _HAS_NAME = 4, 8  # bits of the flags (RFC 1952, 2.3.1)
_LEVEL = 6  # that of the gzip command


@dataclass(frozen=True, slots=True)
class Gzip:
    """Hold the one print, and the name and time in the header."""

    prints: Mapping[str, Source]
    name: str
    time_s: int

    def write(self, file: BinaryIO, texts: Iterable[Iterable[bytes]]) -> None:
        """Write the file with this text."""
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
    """Return the packed file's name; empty if the header has none."""
    if not header[3] & _HAS_NAME or header[3] & _HAS_EXTRA:
        return ""
    return header[10:].partition(b"\0")[0].decode("latin-1")


_Open = Callable[[], BinaryIO]  # the file, from its beginning


class Container(Protocol):
    """A file that contains prints."""

    @property
    def prints(self) -> Mapping[str, Source]:
        """Plain G-code by its name within the container; "" where it has none."""

    def write(self, file: BinaryIO, texts: Iterable[Iterable[bytes]]) -> None:
        """Write the same container with other text for each print, in their order, into an empty file."""


@dataclass(frozen=True, slots=True)
class _Plain:
    prints: Mapping[str, Source]

    def write(self, file: BinaryIO, texts: Iterable[Iterable[bytes]]) -> None:
        for lines in texts:
            file.writelines(lines)


@contextmanager
def _open_plain(reopen: _Open, path: str) -> Iterator[Container]:
    with reopen() as file:
        check_text(file.read(ENDS), path)
        content: Source = file.getvalue() if isinstance(file, io.BytesIO) else Path(file.name)
    yield _Plain({"": content})


_KINDS: dict[bytes, Callable[[_Open, str], AbstractContextManager[Container]]] = {
    b"\x1f\x8b": open_gzip,
    b"PK\x03\x04": open_archive,
    b"PK\x05\x06": open_archive,  # an empty one
    b"GCDE": open_bgcode,
}


@contextmanager
def opened(source: bytes | Path, path: str = "") -> Iterator[Container]:
    """Open a file, or its content, as the kind that its first bytes show.

    path : as the user named it, for messages
    """
    if isinstance(source, Path):
        check_regular(source)
        path = path or str(source)

    def reopen() -> BinaryIO:
        return io.BytesIO(source) if isinstance(source, bytes) else open(source, "rb")

    with reopen() as file:
        head = file.read(4)
    kind = next((kind for magic, kind in _KINDS.items() if head.startswith(magic)), _open_plain)
    with kind(reopen, path) as container:
        yield container


@contextmanager
def opened_print(source: Source, plate: int | None = None) -> Iterator[Source]:
    """Open the plain G-code of a file of any kind; a Text or bytes are plain already.

    plate : which print of an archive that holds several
    """
    if not isinstance(source, Path):
        yield source
        return
    with opened(source) as container:
        yield container.prints[_chosen(list(container.prints), plate, str(source))]


def _chosen(names: list[str], plate: int | None, path: str) -> str:
    if plate is None and len(names) == 1:
        return names[0]
    for name in names:
        if plate is not None and name.endswith(f"/plate_{plate}.gcode"):
            return name
    held = ", ".join(names) if any(names) else "one print, and no plates"
    rule = "choose one with --plate N" if plate is None else f"there is no plate {plate}"
    raise UnsupportedGcode(f"The file holds {held}; {rule}.", path=path)


def read_bytes(path: str | Path, plate: int | None = None) -> bytes:
    """Read the plain G-code of a file of any kind; see `opened_print`."""
    with opened_print(Path(path), plate) as source:
        return b"".join(text.blocks(source))


def ends_of(source: Source) -> tuple[bytes, bytes, int]:
    """Read the first and last bytes of a file's G-code, and its size; of the first print if there are several."""
    if not isinstance(source, Path):
        return text.ends(source)
    with opened(source) as container:
        return text.ends(next(iter(container.prints.values())))


def blocks_of(source: Source, block: int = BLOCK) -> Iterator[bytes]:
    """Yield the G-code of a file of any kind, in pieces cut anywhere; see `opened_print`."""
    with opened_print(source) as plain:
        yield from text.blocks(plain, block)
