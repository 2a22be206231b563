"""A server of `ffcomp serve` for tests: in this process, with folders of its own, or as the command on a free port."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

MARK = {"X-ffcomp": "1"}


def own_folders(folder: Path) -> dict[str, str]:
    """The environment in which machine files and data lie below a folder."""
    return {"HOME": str(folder), "XDG_CONFIG_HOME": str(folder / "config"), "XDG_DATA_HOME": str(folder / "data")}


@contextmanager
def client(folder: Path, patch: pytest.MonkeyPatch, **settings: Any) -> Iterator[Any]:
    """A client of a server that runs in a thread; `client.server` is the server."""
    import httpx
    import uvicorn

    from ffcomp.serve.app import Server
    from ffcomp.serve.settings import ServeSettings

    for name, value in own_folders(folder).items():
        patch.setenv(name, value)
    server = Server(ServeSettings(folder=folder / "work", **settings))
    with socket.create_server(("127.0.0.1", 0), backlog=128) as door:
        running = uvicorn.Server(uvicorn.Config(server.app(), log_level="warning", ws="none"))
        thread = threading.Thread(target=running.run, args=([door],))
        thread.start()
        with httpx.Client(base_url=f"http://localhost:{door.getsockname()[1]}", headers=MARK, timeout=60.0) as client:
            client.server = server  # type: ignore[attr-defined]
            yield client
        running.should_exit = True
        thread.join(20)


def uploaded(client: Any, name: str, content: bytes) -> str:
    """The id of a file that the server has taken."""
    answer = client.post("/api/files", params={"name": name}, content=content)
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def started(client: Any, kind: str, files: list[str] = [], **asked: Any) -> str:  # noqa: B006 (only read)
    """The id of a job that was queued."""
    answer = client.post("/api/jobs", json={"kind": kind, "files": files} | asked)
    assert answer.status_code == 200, answer.text
    return str(answer.json()["id"])


def job_of(client: Any, id_: str) -> dict[str, Any]:
    return next(job for job in client.get("/api/state").json()["jobs"] if job["id"] == id_)


def wait_for(client: Any, id_: str, *states: str, seconds: float = 300.0) -> dict[str, Any]:
    """The job, once it is in one of these states; `done` or `failed` if none is named."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        job = job_of(client, id_)
        if job["state"] in (states or ("done", "failed")):
            return job
        time.sleep(0.05)
    raise AssertionError(f"after {seconds} s: {job}")


@contextmanager
def command(folder: Path, *words: str, environment: Mapping[str, str] | None = None) -> Iterator[tuple[str, int]]:
    """`ffcomp serve` as a process on a free port: its address, token included, and the process's number."""
    given = {"FFCOMP_LOG": "off", "PYTHONPATH": ":".join(sys.path), **(environment or {})}
    process = subprocess.Popen(
        [sys.executable, "-m", "ffcomp", "serve", "--port", "0", "--folder", str(folder / "work"), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | own_folders(folder) | given,
        text=True,
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline().strip()
        assert re.match(r"https?://", line), line
        yield line, process.pid
    finally:
        process.terminate()
        process.wait(20)
        process.stdout.close() if process.stdout else None
