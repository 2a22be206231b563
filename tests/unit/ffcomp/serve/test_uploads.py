"""Files that come in: their names, their limits, full disks, and nothing left of what is refused."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import AsyncIterator
from errno import ENOSPC
from pathlib import Path
from typing import Any

import pytest
from anyio.from_thread import start_blocking_portal

from ffcomp.serve.settings import MEGABYTE, ServeSettings
from ffcomp.serve.uploads import Refused, Upload, Uploads, safe_name


async def pieces(*content: bytes) -> AsyncIterator[bytes]:
    for each in content:
        yield each


def take(uploads: Uploads, name: str, *content: bytes) -> Upload:
    with start_blocking_portal() as own:  # the browser of another test may hold the loop of this thread
        return own.call(uploads.take, name, pieces(*content))


def held(uploads: Uploads) -> list[str]:
    return sorted(path.name for path in uploads.folder.rglob("*"))


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ("print.gcode", "print.gcode"),
        ("../../etc/passwd", "passwd"),
        ("C:\\Windows\\system.ini", "system.ini"),
        ("..", "file"),
        ("a\0b\n.gcode", "a_b_.gcode"),
        ("raw_data_axis=1.000,-1.000.csv", "raw_data_axis=1.000,-1.000.csv"),
        ("x" * 300 + ".gcode", "x" * 114 + ".gcode"),
    ],
)
def test_a_name_is_only_ever_a_name(given: str, kept: str) -> None:
    assert safe_name(given) == kept
    assert "/" not in safe_name(given) and len(safe_name(given)) <= 120


def test_a_file_comes_in_whole_and_is_found_by_its_id(tmp_path: Path) -> None:
    uploads = Uploads(ServeSettings(tmp_path))
    upload = take(uploads, "../a.gcode", b"G28\n", b"G1 X1\n")
    found, path = uploads.find(upload.id)
    assert found == upload and path.read_bytes() == b"G28\nG1 X1\n"
    assert path.is_relative_to(tmp_path) and upload.bytes == 10


@pytest.mark.parametrize("id_", ["..", "../jobs", "", "0" * 16, "0123456789abcdeg", "/etc/passwd"])
def test_what_is_no_id_finds_nothing(id_: str, tmp_path: Path) -> None:
    with pytest.raises(Refused, match="no such file"):
        Uploads(ServeSettings(tmp_path)).find(id_)


def test_too_large_a_file_is_refused_while_it_comes_and_leaves_nothing(tmp_path: Path) -> None:
    uploads, sent = Uploads(ServeSettings(tmp_path, largest_bytes=MEGABYTE)), []

    async def endless() -> AsyncIterator[bytes]:
        while True:
            sent.append(1)
            yield bytes(1 << 16)

    with pytest.raises(Refused, match="larger than 1 MB") as refused, start_blocking_portal() as own:
        own.call(uploads.take, "a.gcode", endless())
    assert refused.value.status == 413 and len(sent) == 17 and held(uploads) == []


def test_a_disk_that_fills_up_is_said_and_nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    uploads = Uploads(ServeSettings(tmp_path))

    async def fails() -> AsyncIterator[bytes]:
        yield b"G28\n"
        raise OSError(ENOSPC, os.strerror(ENOSPC))

    with pytest.raises(Refused, match="disk is full") as refused, start_blocking_portal() as own:
        own.call(uploads.take, "a.gcode", fails())
    assert refused.value.status == 507 and held(uploads) == []


def test_the_last_of_the_disk_is_never_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    uploads = Uploads(ServeSettings(tmp_path))
    free: Any = iter([10_000 * MEGABYTE, 10_000 * MEGABYTE, 200 * MEGABYTE])
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr("shutil.disk_usage", lambda path: usage._replace(free=next(free)))
    with pytest.raises(Refused, match="MB are free"):
        take(uploads, "a.gcode", *[bytes(MEGABYTE)] * 20)
    assert held(uploads) == []


def test_a_full_folder_takes_no_more(tmp_path: Path) -> None:
    uploads = Uploads(ServeSettings(tmp_path, room_bytes=100))
    take(uploads, "a.gcode", bytes(200))
    with pytest.raises(Refused, match="folder holds"):
        take(uploads, "b.gcode", b"G28")


def test_what_no_job_has_taken_is_removed_after_a_day(tmp_path: Path) -> None:
    uploads = Uploads(ServeSettings(tmp_path))
    take(uploads, "a.gcode", b"G28")
    uploads.clean()
    assert len(held(uploads)) == 3
    uploads.clean(time.time() + 25 * 3600.0)
    assert held(uploads) == []
