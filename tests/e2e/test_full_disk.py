"""`ffcomp serve` on a disk that is really full: a small file system of its own, where one may be mounted."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from tests.support import stand_in
from tests.support.server import client, started, uploaded, wait_for

WIGGLE = (Path(__file__).parents[2] / "docs" / "examples" / "wiggle.gcode").read_bytes()
MEGABYTE = 1 << 20
PAGE = 4096


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A file system of 24 MB, none of which the server leaves for others."""
    folder = tmp_path / "work"
    folder.mkdir()
    try:
        subprocess.run(["mount", "-t", "tmpfs", "-o", "size=24m", "none", folder], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("nothing can be mounted here: Linux lets only root do it")
    for place in ("uploads", "runner"):
        monkeypatch.setattr(f"ffcomp.serve.{place}.RESERVE", 0)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


@pytest.fixture
def page(disk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    with client(tmp_path, monkeypatch) as made:
        yield made


def fill(disk: Path) -> Path:
    """Take all that is left."""
    other = disk / "other"
    with open(other, "wb", buffering=0) as file:
        for piece in (MEGABYTE, PAGE):  # the server may be writing, too
            with suppress(OSError):
                while file.write(bytes(piece)):
                    pass
    return other


def test_an_upload_that_meets_the_end_of_the_disk_leaves_nothing(disk: Path, page: Any) -> None:
    def pieces() -> Iterator[bytes]:
        yield b";" * MEGABYTE
        fill(disk)
        yield b";" * 4 * MEGABYTE

    answer = page.post("/api/files", params={"name": "a.gcode"}, content=pieces())
    assert answer.status_code == 507 and "disk is full" in answer.text
    assert [path.name for path in (disk / "uploads").iterdir()] == []
    assert page.get("/api/state").status_code == 200
    (disk / "other").unlink()
    uploaded(page, "a.gcode", WIGGLE)


def test_a_job_that_meets_the_end_fails_with_a_sentence_and_runs_again(
    disk: Path, page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    id_ = started(page, "compensate", [uploaded(page, "a.gcode", WIGGLE)], machine="kossel")
    wait_for(page, id_, "running")
    other = fill(disk)
    job = wait_for(page, id_)
    assert job["state"] == "failed" and "disk is full" in job["error"]
    assert job["outputs"] == [] and page.get(f"/api/jobs/{id_}/log").status_code == 200
    other.unlink()
    monkeypatch.setattr("ffcomp.serve.runner.COMMAND", (sys.executable, "-S", stand_in.__file__))
    assert page.post(f"/api/jobs/{id_}/again", json={}).status_code == 200
    assert wait_for(page, id_)["state"] == "done"
