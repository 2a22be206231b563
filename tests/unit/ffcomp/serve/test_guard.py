"""Who may ask: names of the server, origins, the token, and what browsers may do with the answers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from ffcomp.serve.guard import known_host, matches, policy, refusal, token_of
from ffcomp.serve.settings import ServeSettings, is_local, kept_token
from tests.support.server import MARK, client

SETTINGS = ServeSettings(Path("."), names=("printer.lan",))


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "", "127.0.0.1.nip.io:8017", "printer"])
def test_a_name_that_somebody_lets_point_here_does_not_pass(host: str) -> None:
    assert not known_host(host, SETTINGS)
    refused = refusal("GET", {"host": host}, SETTINGS)
    assert refused is not None and refused[0] == 421


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        (MARK, None),
        (MARK | {"origin": "http://localhost:8017"}, None),
        (MARK | {"origin": "http://evil.example"}, 403),
        (MARK | {"origin": "null"}, 403),
        (MARK | {"origin": "http://localhost:9999"}, 403),
        ({}, 403),
        ({"origin": "http://localhost:8017"}, 403),
    ],
)
def test_only_the_own_page_changes_anything(headers: dict[str, str], status: int | None) -> None:
    lower = {key.lower(): value for key, value in headers.items()} | {"host": "localhost:8017"}
    refused = refusal("POST", lower, SETTINGS)
    assert (refused[0] if refused else None) == status


def test_the_token_comes_as_a_cookie_or_a_header() -> None:
    assert token_of({"authorization": "Bearer abc"}) == "abc"
    assert token_of({"cookie": "a=b; ffcomp_token=abc"}) == "abc"
    assert token_of({"cookie": "ffcomp_token"}) == "" == token_of({})
    asked = replace(SETTINGS, token="abc")
    assert matches("abc", asked) and not matches("", asked) and not matches("ä", asked)


def test_the_token_is_made_once_and_nobody_else_reads_it(tmp_path: Path) -> None:
    token = kept_token(tmp_path / "work")
    assert len(token) >= 32 and kept_token(tmp_path / "work") == token
    assert (tmp_path / "work" / "token").stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    ("host", "local"), [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False)]
)
def test_a_token_is_asked_for_where_others_reach_the_server(host: str, local: bool) -> None:
    assert is_local(host) == local


def test_no_other_page_frames_it_and_reports_are_kept_apart() -> None:
    assert "default-src 'none'" in policy("/") and "unsafe" not in policy("/")
    report = policy("/api/jobs/0/files/report.html")
    assert report.startswith("sandbox allow-scripts") and "allow-same-origin" not in report
    assert all("frame-ancestors 'self'" in each for each in (policy("/"), report))


def test_every_answer_of_a_server_is_guarded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with client(tmp_path, monkeypatch) as page:
        answer = page.get("/")
        assert answer.status_code == 200 and answer.headers["x-content-type-options"] == "nosniff"
        assert page.get("/", headers={"Host": "evil.example"}).status_code == 421
        assert page.post("/api/jobs", json={}, headers={"Origin": "http://evil.example"}).status_code == 403
        assert page.options("/api/jobs", headers={"Origin": "http://evil.example"}).status_code == 403


def test_a_visitor_needs_the_token_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with client(tmp_path, monkeypatch, host="0.0.0.0", token="secret") as page:
        assert page.get("/").status_code == 401 == page.get("/api/state").status_code
        assert page.get("/?token=wrong").status_code == 401 == page.get("/api/state?token=secret").status_code
        entered = page.get("/?token=secret", follow_redirects=False)
        assert entered.status_code == 303 and entered.headers["location"] == "/"
        cookie = entered.headers["set-cookie"]
        assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
        assert page.get("/api/state").status_code == 200  # the client keeps cookies
        page.cookies.clear()
        assert page.get("/api/state", headers={"Authorization": "Bearer secret"}).status_code == 200
