"""Uploads: written piece by piece, within the limits, under names that the server chooses."""

from __future__ import annotations

import json
import os
import re
import secrets
import shutil
import time
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from errno import EDQUOT, ENOSPC
from pathlib import Path

from ffcomp.serve.settings import MEGABYTE, RESERVE, ServeSettings

ID = re.compile(r"[0-9a-f]{16}")
LONGEST_NAME = 120
CHECK_EVERY = 8 * MEGABYTE  # bytes after which the disk's free space is looked at again
UPLOAD_AGE_S = 24 * 3600.0  # a file that no job has taken by then is removed


class Refused(Exception):
    """A request that cannot be met: a status of HTTP and one sentence."""

    def __init__(self, status: int, sentence: str) -> None:
        self.status, self.sentence = status, sentence
        super().__init__(sentence)


@dataclass(frozen=True, slots=True)
class Upload:
    """One complete upload."""

    id: str
    name: str
    bytes: int


def new_id() -> str:
    """Return a name for a folder that nobody can guess."""
    return secrets.token_hex(8)


def safe_name(name: str) -> str:
    """Return the last part of a name, of letters that no file system or command line takes for anything else."""
    last = re.split(r"[/\\]", name)[-1]
    kept = re.sub(r"[^\w.,=+ -]", "_", last).strip(" .-")
    if len(kept) > LONGEST_NAME:  # keep the suffix
        kept = kept[: LONGEST_NAME - 20] + kept[-20:]
    return kept or "file"


def is_full(error: BaseException) -> bool:
    """Return whether an error means that the disk is full."""
    return isinstance(error, OSError) and error.errno in (ENOSPC, EDQUOT)


class Uploads:
    """The files of one server that no job has taken yet."""

    def __init__(self, settings: ServeSettings) -> None:
        self.settings = settings
        self.folder = settings.folder / "uploads"
        self.folder.mkdir(parents=True, exist_ok=True)

    async def take(self, name: str, pieces: AsyncIterator[bytes]) -> Upload:
        """Write a file as it comes; nothing is left of one that is refused.

        Raises Refused if it is larger than allowed, or the disk or the server's folder is full.
        """
        self.check_room()
        id_, size, checked = new_id(), 0, 0
        place = self.folder / id_
        try:
            place.mkdir()
            with open(place / safe_name(name), "xb") as file:
                async for piece in pieces:
                    size += len(piece)
                    if size > self.settings.largest_bytes:
                        most = self.settings.largest_bytes // MEGABYTE
                        raise Refused(413, f"{safe_name(name)} is larger than {most} MB, the most that is taken here.")
                    if size - checked > CHECK_EVERY:
                        checked = size
                        self.check_disk()
                    file.write(piece)
            if size == 0:
                raise Refused(400, f"{safe_name(name)} is empty.")
            upload = Upload(id_, safe_name(name), size)
            (self.folder / f"{id_}.json").write_text(json.dumps(asdict(upload)), encoding="utf-8")
            return upload
        except BaseException as error:
            self.remove(id_)
            if is_full(error):
                raise Refused(507, "The disk is full: nothing of the file was kept.") from None
            raise

    def find(self, id_: str) -> tuple[Upload, Path]:
        """Return a file that has come in, by its id; Refused if there is none."""
        try:
            if not ID.fullmatch(id_):
                raise ValueError(id_)
            upload = Upload(**json.loads((self.folder / f"{id_}.json").read_text(encoding="utf-8")))
            return upload, self.folder / id_ / upload.name
        except (OSError, ValueError, TypeError):
            raise Refused(404, "There is no such file any more: drop it again.") from None

    def remove(self, id_: str) -> None:
        """Remove a file and its record."""
        shutil.rmtree(self.folder / id_, ignore_errors=True)
        (self.folder / f"{id_}.json").unlink(missing_ok=True)

    def clean(self, now: float | None = None) -> None:
        """Remove files that no job has used for a day."""
        oldest = (now or time.time()) - UPLOAD_AGE_S
        for path in list(self.folder.iterdir()):
            with suppress(FileNotFoundError):  # removed with the one before
                if ID.fullmatch(path.stem) and path.stat().st_mtime < oldest:
                    self.remove(path.stem)

    def check_room(self) -> None:
        """Refuse where the disk or the folder is full."""
        self.check_disk()
        if _bytes_in(self.settings.folder) > self.settings.room_bytes:
            most = self.settings.room_bytes // MEGABYTE
            raise Refused(507, f"The server's folder holds its {most} MB: remove work that is done.")

    def check_disk(self) -> None:
        """Refuse where the disk is nearly full."""
        if shutil.disk_usage(self.settings.folder).free < RESERVE:
            raise Refused(507, f"Less than {RESERVE // MEGABYTE} MB are free on the disk: remove work that is done.")


def _bytes_in(folder: Path) -> int:
    """Return the size of all files below a folder, while others come and go."""
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with suppress(FileNotFoundError):
                total += os.stat(os.path.join(place, name)).st_size
    return total
