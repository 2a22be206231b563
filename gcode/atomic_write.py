"""Replace a file so that it is never half written."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from errno import EBUSY, EINVAL
from pathlib import Path
from typing import BinaryIO, NamedTuple


class _Draft(NamedTuple):
    """A file that is about to replace another."""

    name: str  # of the file to replace, as the caller gave it
    target: Path
    device: int
    inode: int

    @property
    def in_place(self) -> bool:
        """Whether the replacement is done: the target is this file."""
        try:
            status = self.target.stat()
        except OSError:
            return False
        return (status.st_dev, status.st_ino) == (self.device, self.inode)


_drafts: list[_Draft] = []


def drafts_noted() -> int:
    """Return how many replacements have begun, for `replaced_since`."""
    return len(_drafts)


def replaced_since(noted: int) -> list[str]:
    """Return the names of the files replaced since then; correct even after an interrupt at any point."""
    return list(dict.fromkeys(draft.name for draft in _drafts[noted:] if draft.in_place))


@contextmanager
def replacing(path: str | Path) -> Iterator[BinaryIO]:
    """Open a new file that replaces `path` on exit, so that `path` always has either the old or the new content.

    A symbolic link stays a link (its target is replaced), permissions are kept, and a failure leaves no file behind.
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
            made = os.fstat(file.fileno())
        if target.exists():
            shutil.copymode(target, draft)
        _drafts.append(_Draft(str(path), target, made.st_dev, made.st_ino))
        os.replace(draft, target)
    finally:
        with suppress(OSError):  # why it could not be written matters more
            draft.unlink(missing_ok=True)


def _created(draft: Path, path: str | Path) -> BinaryIO:
    try:
        return open(draft, "xb")
    except OSError as error:  # it names the draft, which the user does not know
        raise OSError(error.errno, f"It cannot be written: {error.strerror}", str(path)) from None


def unchanged(source: bytes | Path) -> Callable[[], None]:
    """Return a check, to be called later, that a file has not changed since."""

    def seen() -> tuple[int, ...]:
        now = source.stat() if isinstance(source, Path) else None
        return () if now is None else (now.st_dev, now.st_ino, now.st_size, now.st_mtime_ns)

    before = seen()

    def check() -> None:
        if seen() != before:
            raise OSError(EBUSY, "Another program changed the file; ffcomp did not overwrite it", str(source))

    return check


def replace_atomically(path: str | Path, data: Iterable[bytes]) -> None:
    """Write `data` in place of the file; see `replacing`."""
    with replacing(path) as file:
        file.writelines(data)
