"""Files on disk: what their first bytes say they are, and replacing one so that it is never half written."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterable
from pathlib import Path

from gcode.errors import GcodeError, UnsupportedGcode

_FOREIGN = {
    b"GCDE": "binary G-code; switch 'Supports binary G-code' off in the slicer's printer settings",
    b"PK\x03\x04": "a zip archive (.3mf, .ufp); export plain G-code instead",
    b"\x1f\x8b": "compressed by gzip; unpack it first",
}


def read_bytes(path: str | Path) -> bytes:
    """The bytes of a plain-text G-code file; anything else is refused by what it is."""
    data = Path(path).read_bytes()
    for magic, what in _FOREIGN.items():
        if data.startswith(magic):
            raise UnsupportedGcode(f"The file is {what}.", path=str(path))
    if not data.strip():
        raise GcodeError("The file is empty; there is nothing to compensate.", path=str(path))
    return data


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
