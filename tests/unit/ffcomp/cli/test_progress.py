"""What a search says: lines where nothing moves, a bar on a terminal, nothing if quiet."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from ffcomp.cli.common import quiet
from ffcomp.cli.progress import Progress, SearchProgress
from ffcomp.numerics.stages import Now, Stage
from ffcomp.result import time_left
from ffcomp.serve.messages import progress as page_progress


def on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SLIC3R_PP_HOST", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)


@pytest.mark.parametrize("terminal", [False, True])
def test_a_share_is_a_bar_on_a_terminal_and_lines_elsewhere(
    terminal: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if terminal:
        on_a_terminal(monkeypatch)
    with Progress(10.0, "simulating") as progress:
        progress(1.0)
        progress.phase("drawing", 0.5)
    err = capsys.readouterr().err
    said = ("drawing", "50 %") if terminal else ("ffcomp: 10 %\n", "ffcomp: drawing …\n", "ffcomp: 50 %\n")
    assert all(each in err for each in said), err


def test_the_time_left_is_said_in_round_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, events = 100.0, tmp_path / "events"
    monkeypatch.setattr("ffcomp.cli.progress.time.monotonic", lambda: clock)
    monkeypatch.setenv("FFCOMP_EVENTS", str(events))
    said = []
    with quiet(True):
        shown, sentences = SearchProgress((10.0, 30.0)), (Now("a"), Now("b"), Stage(2, "the rest"))
        for at, sentence in zip((100.0, 105.0, 143.0), sentences, strict=True):
            clock = at
            shown(sentence)
            said.append(page_progress(events, "")[1])
    assert said == ["a", "b, about 35 s left", "the rest, about 75 s left"]
    assert time_left(880.0) == "about 15 min left"


def test_events(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """One in a line of a file; nothing else is printed, and the page says the last one."""
    clock, events = 0.0, tmp_path / "events"
    monkeypatch.setattr("ffcomp.cli.progress.time.monotonic", lambda: clock)
    monkeypatch.setenv("FFCOMP_EVENTS", str(events))
    assert page_progress(events, "compensating") == (None, "compensating")
    with quiet(True), Progress(1.0) as progress:
        progress(0.25)
        assert page_progress(events, "") == (0.25, "compensating")
        clock = 10.0
        progress(0.75)
    assert capsys.readouterr() == ("", "")
    assert json.loads(events.read_text().splitlines()[-1]) == {"stage": "compensating", "share": 0.75, "left_s": 5.0}
    assert page_progress(events, "") == (0.75, "compensating, about 5 s left")
    events.write_text('{"stage": "trying", "share": null, "left_s": 195.0}\n')
    assert page_progress(events, "") == (None, "trying, about 3 min left")


def test_compilation_is_no_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first run compiles before its first report and between two others: 170 s for a tenth of 20 s of work."""
    clock = 0.0
    monkeypatch.setattr("ffcomp.cli.progress.time.monotonic", lambda: clock)
    progress, left = Progress(1.0), []
    for share in range(101):
        clock += 0.2 + 150.0 * (share == 0) + 20.0 * (share == 5)
        left.append(progress.left_s(share / 100))
    assert left[25] is None and left[30] == pytest.approx(70 * 0.2) and left[100] is None
