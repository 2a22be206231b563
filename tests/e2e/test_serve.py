"""`ffcomp serve` with real jobs, and visitors who mean no good."""

from __future__ import annotations

import http.client
import json
import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from tests.support.server import MARK, client, command, started, uploaded, wait_for

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
WIGGLE = (EXAMPLES / "wiggle.gcode").read_bytes()


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    with client(tmp_path, monkeypatch) as made:
        yield made


def test_a_print_comes_back_compensated_with_its_picture(page: Any) -> None:
    job = wait_for(page, started(page, "compensate", [uploaded(page, "a.gcode", WIGGLE)], machine="kossel"))
    assert job["state"] == "done", job["error"]
    assert job["outputs"] == ["a.gcode", "panel.svg", "picture.svg", "report.html"]
    assert "(assumed)" in job["answer"]["headline"]
    assert job["answer"]["warnings"][0].startswith("The modes of kossel are assumed")
    got = page.get(f"/api/jobs/{job['id']}/files/a.gcode")
    assert b"; Processed by ffcomp" in got.content and "attachment" in got.headers["content-disposition"]
    seen = page.get(f"/api/jobs/{job['id']}/files/picture.svg?view=1")
    assert b"<svg" in seen.content and seen.headers["content-type"].startswith("image/svg+xml")
    assert seen.headers["content-security-policy"].startswith("sandbox")
    assert page.post(f"/api/jobs/{job['id']}/remove", json={}).status_code == 200
    assert page.get(f"/api/jobs/{job['id']}/files/a.gcode").status_code == 404
    assert not any(page.server.runner.kept.folder.iterdir())


def test_a_configuration_becomes_a_machine_of_ones_own(page: Any) -> None:
    config = (EXAMPLES / "printer.cfg").read_bytes()
    for name in ("my-delta", "my-delta-2"):  # the second time: never overwritten
        id_ = started(page, "import", [uploaded(page, "printer.cfg", config)], options={"name": "my-delta"})
        job = wait_for(page, id_)
        assert job["state"] == "done" and job["kept"] == name
    own = [each["name"] for each in page.get("/api/state").json()["machines"] if each["own"]]
    assert own == ["my-delta", "my-delta-2"]
    job = wait_for(page, started(page, "import", [uploaded(page, "printer.cfg", b"[printer]\nkinematics: polar\n")]))
    assert job["state"] == "failed" and "polar" in job["error"]


def test_moves_are_planned_and_their_captures_find_the_plan(page: Any) -> None:
    options = {"at": "110,110", "seconds": 2, "repeats": 1}
    plan = wait_for(page, started(page, "plan", machine="ender-3", options=options))
    assert plan["state"] == "done" and plan["outputs"] == ["moves.gcode", "moves.json"]
    id_ = started(
        page, "diagnose", [uploaded(page, "adxl345-x-1.csv", b"no,capture\n1,2\n")], machine="ender-3", plan=plan["id"]
    )
    job = wait_for(page, id_)
    assert job["inputs"] == ["adxl345-x-1.csv", "moves.json"] and job["state"] == "failed"
    assert "adxl345-x-1.csv" in job["error"]
    log = page.get(f"/api/jobs/{id_}/log").text
    assert job["error"].splitlines()[-1] in log
    assert page.post(f"/api/jobs/{id_}/keep", json={"name": "better"}).status_code == 404  # it has made no machine


# -- visitors who mean no good --


@pytest.mark.parametrize(
    "path",
    [
        "/../../../etc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/api/jobs/../../etc/files/passwd",
        "/api/jobs/..%2f..%2f..%2fetc/files/passwd",
        "/api/jobs/{id}/files/..%2fjob.json",
        "/api/jobs/{id}/files/%2e%2e%2fin%2fa.gcode",
        "/api/jobs/{id}/files//etc/passwd",
        "/api/jobs/{id}/files/job.json",
        "/page/../app.py",
        "/token",
    ],
)
def test_no_path_of_a_visitor_leads_to_a_file(path: str, page: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ffcomp.serve.runner.COMMAND", ("false",))
    id_ = started(page, "compensate", [uploaded(page, "a.gcode", b"secret")], machine="kossel")
    wait_for(page, id_)
    address = urlsplit(str(page.base_url))
    plain = http.client.HTTPConnection(str(address.hostname), address.port)  # sends a path as it is
    plain.request("GET", path.format(id=id_))
    answer = plain.getresponse()
    body = answer.read()
    plain.close()
    assert answer.status == 404 and b"root:" not in body and b"secret" not in body


@pytest.mark.parametrize(("name", "line"), [("printer.cfg", "[include {}]"), ("config.g", 'M98 P"{}"')])
def test_a_configuration_reads_no_other_file_of_the_server(name: str, line: str, page: Any, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("[printer]\nhush: 42\nM92 hush42\n")
    config = (EXAMPLES / name).read_bytes()
    text = b"".join(line.format(each).encode() + b"\n" for each in (secret, "../../../../../secret", "*/../*"))
    job = wait_for(page, started(page, "import", [uploaded(page, name, config + b"\n" + text)]))
    told = json.dumps(job) + page.get(f"/api/jobs/{job['id']}/log").text
    assert job["state"] == "done" and "hush" not in told, told
    assert "nly this file is read" in told


@pytest.mark.parametrize(
    ("path", "asked", "status", "words"),
    [
        ("/api/jobs", {"kind": "compensate"}, 400, "needs a file"),
        ("/api/jobs", {"kind": "compensate", "files": "a"}, 400, "must be a list"),
        ("/api/jobs", {"kind": "import", "files": 2}, 400, "one file at a time"),
        ("/api/jobs", {"kind": "diagnose", "files": 2, "machine": "kossel"}, 400, "the same name"),
        ("/api/jobs", {"kind": "diagnose", "files": 1, "machine": "none-such"}, 400, "no machine 'none-such'"),
        ("/api/jobs", {"kind": "diagnose", "files": 1, "machine": "kossel", "name": "m.json"}, 400, "not dropped"),
        ("/api/jobs", {"kind": "plan", "machine": "kossel", "options": []}, 400, "must be an object"),
        ("/api/jobs", ["no", "object"], 400, "not a JSON object"),
        ("/api/jobs", {"kind": "x" * 70_000}, 413, "too large"),
        ("/api/jobs/{id}/dance", {}, 404, "no such action"),
        ("/api/jobs/0123456789abcdef/again", {}, 404, "no such job"),
        ("/api/jobs/{id}/keep", {"name": "../x"}, 400, "letters, digits"),
        ("/api/jobs/{id}/keep", {"name": "kossel"}, 409, "already"),
        ("/api/files?name=a.gcode", None, 400, "a.gcode is empty"),
    ],
)
def test_a_request_that_makes_no_sense_is_answered_with_a_sentence(
    path: str, asked: Any, status: int, words: str, page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ffcomp.serve.runner.COMMAND", ("false",))
    id_ = started(page, "plan", machine="kossel")
    if isinstance(asked, dict) and isinstance(asked.get("files"), int):
        name = asked.get("name", "a.csv")
        asked = {**asked, "files": [uploaded(page, name, b"1\n") for _ in range(asked["files"])]}
    answer = page.post(path.format(id=id_), **({} if asked is None else {"json": asked}))
    assert answer.status_code == status and words in answer.json()["error"]


def resident_mb(status: Path) -> float:
    """Largest memory that a process has had, MB."""
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="only Linux tells a process's largest memory")
def test_fifty_uploads_at_once_and_one_without_end_take_little_memory(tmp_path: Path) -> None:
    with command(tmp_path, "--largest-mb", "60") as (address, pid):
        status = Path(f"/proc/{pid}/status")
        assert post(address, "/api/files?name=first.gcode", [b"G28\n"])[0] == 201
        before = resident_mb(status)
        piece = b"G1 X1 Y1\n" * 7000
        with ThreadPoolExecutor(50) as many:
            answers = list(many.map(lambda k: post(address, f"/api/files?name={k}.gcode", [piece] * 32), range(50)))
        assert [code for code, _ in answers] == [201] * 50  # 100 MB in all
        assert len({json.loads(body)["id"] for _, body in answers}) == 50
        code, body = post(address, "/api/files?name=endless.gcode", (piece for _ in range(8000)))  # 500 MB
        assert code in (413, 0) and (code == 0 or b"larger than 60 MB" in body)  # 0: it hung up while more was sent
        assert post(address, "/api/files?name=last.gcode", [b"G28\n"])[0] == 201
        assert resident_mb(status) < before + 60.0
        assert sum(path.stat().st_size for path in (tmp_path / "work").rglob("*") if path.is_file()) < 110e6


def post(address: str, path: str, pieces: Any) -> tuple[int, bytes]:
    """Status and body of an answer; 0 where the connection was closed before."""
    parts = urlsplit(address)
    plain = http.client.HTTPConnection(str(parts.hostname), parts.port, timeout=60)
    try:
        plain.request("POST", path, body=iter(pieces), headers=MARK, encode_chunked=True)
        answer = plain.getresponse()
        return answer.status, answer.read()
    except OSError:
        return 0, b""
    finally:
        plain.close()


# -- the command --


def test_reached_from_elsewhere_it_prints_a_token_that_opens_it(tmp_path: Path) -> None:
    with command(tmp_path, "--host", "0.0.0.0") as (address, _):
        parts = urlsplit(address)
        assert parts.query.startswith("token=") and len(parts.query) > 30
        plain = http.client.HTTPConnection("127.0.0.1", parts.port, timeout=30)
        found = {}
        for path in ("/", f"/?{parts.query}"):
            plain.request("GET", path)
            answer = plain.getresponse()
            answer.read()
            found[path] = answer.status
        plain.close()
        assert list(found.values()) == [401, 303]


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")
def test_ctrl_c_ends_it_well_and_takes_its_workers_along(tmp_path: Path) -> None:
    with command(tmp_path) as (address, pid):
        id_ = json.loads(post(address, "/api/files?name=a.gcode", [WIGGLE * 400])[1])["id"]
        body = json.dumps({"kind": "compensate", "files": [id_], "machine": "kossel"}).encode()
        assert post(address, "/api/jobs", [body])[0] == 200
        job = tmp_path / "work" / "jobs" / next((tmp_path / "work" / "jobs").iterdir()).name / "job.json"
        until = time.monotonic() + 20.0
        while not (worker := json.loads(job.read_text())["pid"]):
            assert time.monotonic() < until
            time.sleep(0.05)
        os.kill(pid, signal.SIGINT)
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
        with pytest.raises(OSError):  # noqa: PT011 (no such process)
            os.kill(worker, 0)
    assert json.loads(job.read_text())["state"] == "failed"
