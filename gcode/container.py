"""Files on disk: what their first bytes say they are, and replacing one so that it is never half written."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

from gcode.errors import GcodeError, UnsupportedGcode

ENDS, BLOCK = 1 << 20, 1 << 20  # bytes

_FOREIGN = {
    b"GCDE": "binary G-code; switch 'Supports binary G-code' off in the slicer's printer settings",
    b"PK\x03\x04": "a zip archive (.3mf, .ufp); export plain G-code instead",
    b"\x1f\x8b": "compressed by gzip; unpack it first",
}


def read_bytes(path: str | Path) -> bytes:
    """The bytes of a plain-text G-code file; anything else is refused by what it is."""
    data = Path(path).read_bytes()
    _check(data, str(path))
    return data


def ends_of(source: bytes | Path, reach: int = ENDS) -> tuple[bytes, bytes, int]:
    """The first and the last bytes of a plain-text G-code file, or of its content, and its size."""
    if isinstance(source, bytes):
        return source[:reach], source[-reach:], len(source)
    with open(source, "rb") as file:
        head = file.read(reach)
        _check(head, str(source))
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - reach, 0))
        return head, file.read(), size


def blocks_of(source: bytes | Path, block: int = BLOCK) -> Iterator[bytes]:
    """A file, or its content, in pieces cut anywhere."""
    if isinstance(source, bytes):
        yield from (source[at : at + block] for at in range(0, len(source), block))
        return
    with open(source, "rb") as file:
        while piece := file.read(block):
            yield piece


def _check(head: bytes, path: str) -> None:
    for magic, what in _FOREIGN.items():
        if head.startswith(magic):
            raise UnsupportedGcode(f"The file is {what}.", path=path)
    if not head.strip():
        raise GcodeError("The file is empty; there is nothing to compensate.", path=path)


def replace_atomically(path: str | Path, data: Iterable[bytes]) -> None:
    """Write `data` in place of the file, which holds the old or the new content at every moment.

    A symbolic link stays one (the file behind it is replaced), permission bits stay, failures leave nothing.
    """
    target = Path(path).resolve()
    draft = target.with_name(f".{target.name[:200]}.{secrets.token_hex(4)}.tmp")
    try:
        _write_through(draft, data)
        if target.exists():
            shutil.copymode(target, draft)
        os.replace(draft, target)
    finally:
        draft.unlink(missing_ok=True)


def _write_through(path: Path, data: Iterable[bytes]) -> None:
    with open(path, "xb") as file:
        file.writelines(data)
        file.flush()
        os.fsync(file.fileno())
