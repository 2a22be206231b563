"""The page of `ffcomp serve` in a browser: every flow, at a desk and on a phone, and nothing from elsewhere."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ffcomp.cli.app import app
from models.finding import user_folder
from tests.support import stand_in
from tests.support.browser import Visit, hard_to_read, visit
from tests.support.cli import CliRunner
from tests.support.server import client, started, uploaded, wait_for

READY = ".machines optgroup"
PRINT = Path(__file__).parents[2] / "docs" / "examples" / "wiggle.gcode"
WAIT_MS = 60_000


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs that take no time."""
    monkeypatch.setattr("ffcomp.serve.runner.COMMAND", (sys.executable, "-S", stand_in.__file__))


@pytest.fixture
def warm(tmp_path: Path) -> None:
    """Everything is compiled that a print needs, as after `ffcomp warmup`."""
    words = ["compensate", str(PRINT), "-m", "kossel", "-o", str(tmp_path / "warm.gcode"), "-q"]
    assert CliRunner().invoke(app, words).exit_code == 0


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    with client(tmp_path, monkeypatch) as made:
        yield made


def address(server: Any) -> str:
    return str(server.base_url)


def attached(seen: Visit, selector: str) -> None:
    seen.page.wait_for_selector(selector, state="attached", timeout=WAIT_MS)


def card(kind: str, state: str = "done") -> str:
    return f".job[data-kind={kind}][data-state={state}]"


def drop(seen: Visit, place: str, *files: Path | tuple[str, bytes]) -> None:
    given = [each if isinstance(each, Path) else payload(*each) for each in files]
    seen.page.locator(f"#drop-{place} input").set_input_files(given)


def payload(name: str, content: bytes) -> dict[str, Any]:
    return {"name": name, "mimeType": "application/octet-stream", "buffer": content}


def check(seen: Visit, server: Any, width: int) -> None:
    """Nothing went wrong, came from elsewhere, or is cut."""
    assert seen.errors == [] and seen.requests == []
    assert seen.page.evaluate("document.documentElement.scrollWidth") <= width


def test_from_nothing_to_a_compensated_print_in_five_clicks_and_two_minutes(
    warm: None, browser: Any, server: Any, tmp_path: Path
) -> None:
    begin, times = time.monotonic(), {}
    with visit(browser, address(server)) as seen:
        attached(seen, READY)
        with seen.page.expect_file_chooser() as chooser:
            seen.page.click("#drop-prints")  # 1
        chooser.value.set_files(PRINT)
        seen.page.click(".machines")  # 2
        seen.page.select_option(".machines", "kossel")  # 3
        times["chosen"] = time.monotonic() - begin
        seen.page.click("[data-job=compensate]")  # 4
        seen.page.wait_for_selector(".job[data-kind=compensate]")
        seen.page.reload()  # and what runs goes on
        seen.page.wait_for_selector(card("compensate"), timeout=120_000)
        times["compensated"] = time.monotonic() - begin
        with seen.page.expect_download() as download:
            seen.page.click("text=Download the print")  # 5
        download.value.save_as(tmp_path / "out.gcode")
        times["downloaded"] = time.monotonic() - begin
        assert b"; Processed by ffcomp" in (tmp_path / "out.gcode").read_bytes()
        assert download.value.suggested_filename == PRINT.name
        assert "xpected contour error" in seen.page.inner_text(card("compensate"))
        assert seen.page.evaluate("document.querySelector('.job img').naturalWidth") > 500
        check(seen, server, 1200)
    print({name: round(seconds, 1) for name, seconds in times.items()})
    assert times["downloaded"] < 120.0, times


def test_each_way_to_know_my_machine_takes_six_clicks_at_most(
    quick: None, browser: Any, server: Any, tmp_path: Path
) -> None:
    clicks = [0]
    with visit(browser, address(server), 390) as seen:
        attached(seen, READY)
        seen.page.select_option(".machines", "kossel")

        def click(selector: str) -> None:
            seen.page.click(selector, timeout=WAIT_MS)
            clicks[0] += 1

        def choose(place: str, *files: tuple[str, bytes]) -> None:
            with seen.page.expect_file_chooser() as chooser:
                click(f"#drop-{place}")
            chooser.value.set_files([payload(*each) for each in files])

        def downloaded(kind: str) -> None:
            with seen.page.expect_download():
                click(f"{card(kind)} >> text=Download moves.gcode")

        def kept(kind: str) -> int:
            assert clicks[0] < 6
            click(f"{card(kind)} >> text=Keep as my machine")
            seen.page.wait_for_selector(f"{card(kind)} >> text=Kept and chosen", timeout=WAIT_MS)
            taken, clicks[0] = clicks[0], 0
            click("#tab-measure")
            return taken

        click("#tab-measure")
        click("[data-job=excite]")
        downloaded("excite")
        choose("captures", ("adxl345-a-1.csv", b"1"), ("adxl345-b-1.csv", b"2"))
        click("[data-job=fit]:enabled")
        assert kept("fit") == 6
        fit = seen.page.locator(card("fit"))
        assert fit.locator("img").evaluate("(each) => each.naturalWidth") == 640
        assert "The model explains 9 of 9 responses." in fit.inner_text()
        assert "carriage.number_3" not in fit.inner_text() and "Open the report" in fit.inner_text()
        assert not re.search(
            r"ffcomp (identify|machines) |--[a-z]", seen.page.inner_text("main")
        )  # nothing is to be typed
        click("[data-job=page]")
        downloaded("page")
        assert seen.page.is_disabled("[data-job=scan]")
        choose("pictures", ("page.jpg", b"1"))
        click("[data-job=scan]:enabled")
        assert kept("scan") == 6
        seen.page.fill("[name=x_hz]", "48")
        click("[data-job=ringing]")
        assert kept("ringing") == 3
        choose("captures", ("recorded.gcode", b"G28"))  # beside the captures of before
        click("[data-job=update]:enabled")
        assert seen.page.is_disabled("[data-job=fit]")
        assert kept("update") == 4
        assert "5 % of their motion is unexplained" in seen.page.inner_text(card("update"))
        check(seen, server, 390)
    name = "kossel" + 4 * "-measured"
    assert (user_folder() / f"{name}.updates.jsonl").read_text() == "{}\n"  # the history goes with the file


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_are_readable_and_every_field_has_a_name(scheme: str, quick: None, browser: Any, server: Any) -> None:
    wait_for(server, started(server, "compensate", [uploaded(server, "a.gcode", b"G28")], machine="kossel"))
    wait_for(server, started(server, "compensate", [uploaded(server, "a.gcode", b"bad")], machine="kossel"))
    with visit(browser, address(server)) as seen:
        seen.page.emulate_media(color_scheme=scheme)
        seen.page.wait_for_selector(card("compensate"))
        low = hard_to_read(seen)
        low.pop("Compare with input shapers", None)  # what cannot be used yet is paler, as everywhere
        assert not {text: value for text, value in low.items() if text != "Compensate"}
        nameless = """[...document.querySelectorAll("input, select, button")].filter(
            (e) => !e.labels?.length && !e.textContent.trim() && !e.ariaLabel).length"""
        assert seen.page.evaluate(nameless) == 0
