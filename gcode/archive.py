"""Zip archives of slicers: `.gcode.3mf` with a print for each plate, `.ufp` with one.

G-code is unpacked in memory during reading. When the archive is written, every other member is copied byte for byte:
packed data and dates.
"""

from __future__ import annotations

import hashlib
import re
import stat
import struct
import tempfile
import zlib
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from errno import EINVAL
from itertools import pairwise
from lzma import LZMAError
from typing import BinaryIO
from zipfile import BadZipFile, ZipFile, ZipInfo

from gcode.errors import GcodeError, UnsupportedGcode
from gcode.metadata import slicer_time_s
from gcode.text import BLOCK, Source, Text, blocks, ends, limited, pieces

_GCODE = re.compile(r"/?(Metadata/plate_\d+|3D/model)\.gcode")
_BAD_NAME = re.compile(r"[\\\0]|^[A-Za-z]:|(^|/)\.\.?(/|$)|//")
_BAD = "a name that leads out of it or that no file can have"
_MD5, _MD5_BYTES = re.compile(rb"[0-9a-fA-F]{32}"), 100  # the digits, and what a file may hold around them
_PLATE, _INFO = re.compile(r"plate_(\d+)"), "Metadata/slice_info.config"
_PLATE_INFO = re.compile(rb"<plate>.*?</plate>", re.DOTALL)
_INDEX = re.compile(rb'key="index"\s+value="(\d{1,9})"')
_PREDICTION = re.compile(rb'(key="prediction"\s+value=")(\d{1,12})(?=")')  # s
_HEAD_BYTES = 1 << 16  # BambuStudio and OrcaSlicer state the time within these
_ENCRYPTED = 1  # a bit of the flags
_DAMAGED = (BadZipFile, zlib.error, LZMAError, struct.error, EOFError, RuntimeError, ValueError, OSError)
_RECORD = b"PK\3\4"  # how a record begins (APPNOTE 4.3.7)
_LARGE = 1 << 27  # bytes of a print that may exceed 4 GiB when it is compensated

_Open = Callable[[], BinaryIO]


@dataclass(frozen=True, slots=True)
class Archive:
    """Hold the prints by member name, and for each the member that holds its MD5."""

    prints: Mapping[str, Source]
    checksums: Mapping[str, bytes]
    reopen: _Open

    def write(self, file: BinaryIO, texts: Iterable[Iterable[bytes]]) -> None:
        """Write the archive with these texts in place of its prints."""
        with self.reopen() as packed, ZipFile(packed) as old, tempfile.TemporaryFile() as scratch:
            longer_s: dict[int, int] = {}
            with ZipFile(scratch, "w") as new:
                for (name, print_), lines in zip(self.prints.items(), texts, strict=True):
                    head, _, size = ends(print_)
                    digest, now = _add(new, old.getinfo(name), lines, size)
                    if plate := _PLATE.search(name):
                        longer_s[int(plate[1])] = _time_s(now) - _time_s(head)
                    if name in self.checksums:
                        with new.open(_like(old.getinfo(name + ".md5")), "w") as member:
                            member.write(_with_digest(self.checksums[name], digest))
                if any(longer_s.values()) and _INFO in old.namelist() and old.getinfo(_INFO).file_size <= BLOCK:
                    with new.open(_like(old.getinfo(_INFO)), "w") as member:
                        member.write(_with_predictions(old.read(_INFO), longer_s))
            with ZipFile(scratch) as new, ZipFile(file, "w") as out:
                out.comment = old.comment
                ends_old, ends_new = _ends(old), _ends(new)
                for each in sorted(old.infolist(), key=lambda each: each.header_offset):
                    if found := new.NameToInfo.get(each.filename):
                        _copy(scratch, found, ends_new[found.header_offset], out)
                    else:
                        _copy(packed, each, ends_old[each.header_offset], out)


@contextmanager
def open_archive(reopen: _Open, path: str) -> Iterator[Archive]:
    """Open a slicer's archive."""
    with _damage_as_error(path), reopen() as file, ZipFile(file) as archive:
        members = {each.filename: each for each in archive.infolist()}
        _check(archive.infolist(), path)
        _check_records(archive, file)
        names = [name for name in members if _GCODE.fullmatch(name)]
        if not names:
            raise UnsupportedGcode(_no_gcode(members), path=path)
        checksums = {}
        for name in names:
            if name + ".md5" in members:
                with archive.open(name + ".md5") as member:
                    checksums[name] = member.read(_MD5_BYTES)
    prints = {name: _print(reopen, members[name], f"{path}/{name}") for name in names}
    for name, checksum in checksums.items():
        _check_digest(prints[name], checksum, f"{path}/{name}")
    yield Archive(prints, checksums, reopen)


# -- reading --


def _print(reopen: _Open, member: ZipInfo, path: str) -> Text:
    def unpacked() -> Iterator[bytes]:
        return limited(_unpacked(reopen, member.filename, path), member.compress_size, path)

    return Text.read(unpacked, path)


def _unpacked(reopen: _Open, name: str, path: str) -> Generator[bytes, None, None]:
    with _damage_as_error(path), reopen() as file, ZipFile(file) as archive, archive.open(name) as member:
        yield from pieces(member)


@contextmanager
def _damage_as_error(path: str) -> Iterator[None]:
    try:
        yield
    except GcodeError:
        raise
    except _DAMAGED as error:
        if isinstance(error, OSError) and error.errno not in (None, EINVAL):  # EINVAL: sought before the beginning
            raise
        raise GcodeError(f"The zip archive is damaged ({error}); copy or export it again.", path=path) from None


def _check(members: Sequence[ZipInfo], path: str) -> None:
    """Refuse names that no slicer writes, although nothing is ever unpacked to the path that a name gives."""
    rooted = all(each.filename.startswith("/") for each in members)  # .ufp: names of parts, not of files
    for each in members:
        name = each.orig_filename
        if _BAD_NAME.search(name) or (name.startswith("/") and not rooted):
            raise UnsupportedGcode(f"The zip archive holds {name!r}, {_BAD}.", path=path)
        if stat.S_ISLNK(each.external_attr >> 16):
            raise UnsupportedGcode(f"The zip archive holds {name!r}, a symbolic link.", path=path)
        if each.flag_bits & _ENCRYPTED:
            raise UnsupportedGcode(f"The zip archive is encrypted ({name!r}); export it without a password.", path=path)
    counts = Counter(each.filename.casefold() for each in members)
    for each in members:
        if counts[each.filename.casefold()] > 1:
            raise UnsupportedGcode(f"The zip archive holds two members named {each.filename!r}.", path=path)


def _check_records(archive: ZipFile, file: BinaryIO) -> None:
    """Check that the records to copy lie where the directory says, with nothing in between."""
    for place, each in enumerate(sorted(archive.infolist(), key=lambda each: each.header_offset)):
        begins = each.header_offset == 0 if place == 0 else each.header_offset > 0
        file.seek(each.header_offset)
        if not begins or file.read(4) != _RECORD:
            raise BadZipFile(f"{each.filename!r} is not at the position in the directory")


def _no_gcode(names: Iterable[str]) -> str:
    if any(name.endswith(".model") for name in names):
        return "The file is a model or a project (.3mf) that is not sliced: slice it, and export the sliced file."
    return "The file is a zip archive without G-code (Metadata/plate_N.gcode or 3D/model.gcode); export plain G-code."


def _check_digest(print_: Source, checksum: bytes, path: str) -> None:
    digest = hashlib.md5(usedforsecurity=False)
    for block in blocks(print_):
        digest.update(block)
    match = _MD5.search(checksum)
    if match is None or match[0].decode().lower() != digest.hexdigest():
        wrong = checksum.decode("ascii", "replace").strip()
        rule = f"its MD5 is {digest.hexdigest()}, but the archive states {wrong!r}; export it again"
        raise GcodeError(f"The G-code was changed after packing: {rule}.", path=path)


# -- writing --


def _add(new: ZipFile, old: ZipInfo, lines: Iterable[bytes], size: int) -> tuple[str, bytes]:
    """Add a member with this text and the old one's attributes (it had `size` bytes); return its MD5 and its head."""
    digest, head = hashlib.md5(usedforsecurity=False), b""
    with new.open(_like(old), "w", force_zip64=size > _LARGE) as member:  # compensated prints grow tenfold
        for piece in lines:
            digest.update(piece)
            member.write(piece)
            if len(head) < _HEAD_BYTES:
                head += piece[:_HEAD_BYTES]
    return digest.hexdigest(), head


def _time_s(head: bytes) -> int:
    """Read the print time from a print's first lines, whole seconds; zero if they do not state it."""
    return round(slicer_time_s(head[:_HEAD_BYTES].splitlines(keepends=True)) or 0.0)


def _with_predictions(info: bytes, longer_s: Mapping[int, int]) -> bytes:
    """Add to the archive's own predictions how much longer each plate takes."""

    def plate(match: re.Match[bytes]) -> bytes:
        index = _INDEX.search(match[0])
        more = longer_s.get(int(index[1]), 0) if index else 0
        return _PREDICTION.sub(lambda old: old[1] + b"%d" % max(int(old[2]) + more, 0), match[0])

    return _PLATE_INFO.sub(plate, info)


def _like(old: ZipInfo) -> ZipInfo:
    """Make a member with the same name, date, permissions and compression."""
    new = ZipInfo(old.filename, old.date_time)
    for name in ("compress_type", "comment", "extra", "create_system", "internal_attr", "external_attr"):
        setattr(new, name, getattr(old, name))
    return new


def _with_digest(old: bytes, digest: str) -> bytes:
    """Replace the MD5 in the checksum file and keep its case."""
    was = _MD5.search(old)
    upper = was is not None and was[0] == was[0].upper() != was[0].lower()
    return _MD5.sub((digest.upper() if upper else digest).encode(), old, count=1)


def _copy(source: BinaryIO, member: ZipInfo, end: int, new: ZipFile) -> None:
    """Copy a member's record, which ends where the next one begins, without unpacking it."""
    out = new.fp
    assert out is not None
    source.seek(member.header_offset)
    left = end - member.header_offset
    member.header_offset = out.tell()
    while left and (block := source.read(min(left, BLOCK))):
        out.write(block)
        left -= len(block)
    new.filelist.append(member)
    new.NameToInfo[member.filename] = member
    new.start_dir = out.tell()


def _ends(archive: ZipFile) -> dict[int, int]:
    """Return where each record ends, by its beginning."""
    return dict(pairwise([*sorted(each.header_offset for each in archive.infolist()), archive.start_dir]))
