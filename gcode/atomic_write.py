"""Replace a file so that it is never half written."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from errno import EBUSY, EINVAL
from pathlib import Path
from typing import BinaryIO


@contextmanager
def replacing(path: str | Path) -> Iterator[BinaryIO]:
    """Open a new file that takes the place of `path` at the end: that holds the old or the new content at every moment.

    A symbolic link stays one (the file behind it is replaced), permission bits stay, failures leave nothing.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise OSError(EINVAL, "This is a folder, a pipe or a device; only a file can be written", str(path))
    draft = target.with_name(f".ffcomp-{secrets.token_hex(8)}.tmp")  # short: the target's own name may be the longest
    try:
        with _created(draft, path) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            shutil.copymode(target, draft)
        os.replace(draft, target)
    finally:
        draft.unlink(missing_ok=True)


def _created(draft: Path, path: str | Path) -> BinaryIO:
    try:
        return open(draft, "xb")
    except OSError as error:  # about a name that the user has never heard of
        raise OSError(error.errno, f"It cannot be written: {error.strerror}", str(path)) from None


def unchanged(source: bytes | Path) -> Callable[[], None]:
    """Return a check, to be called later, that a file is still what it is now."""

    def seen() -> tuple[int, ...]:
        now = source.stat() if isinstance(source, Path) else None
        return () if now is None else (now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns)

    before = seen()

    def check() -> None:
        if seen() != before:
            raise OSError(EBUSY, "Something else has changed the file meanwhile; it was left as it is now", str(source))

    return check


def replace_atomically(path: str | Path, data: Iterable[bytes]) -> None:
    """Write `data` in place of the file; see `replacing`."""
    with replacing(path) as file:
        file.writelines(data)
