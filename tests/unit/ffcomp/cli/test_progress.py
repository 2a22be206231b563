"""What a search says: lines where nothing moves, a bar on a terminal, nothing if quiet."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from ffcomp.cli.common import quiet
from ffcomp.cli.progress import Progress, SearchProgress
from ffcomp.diagnosis.diagnosis import USUAL_S
from ffcomp.numerics.stages import Now, Pace, Stage
from ffcomp.serve.messages import progress as page_progress

SAID = (Stage(3, "screening 21 effects"), Now("fitting effector_mass"), "effector_mass: 1.2 times the noise")


def shown(hidden: bool) -> None:
    with quiet(hidden), SearchProgress(USUAL_S) as progress:
        for sentence in SAID:
            progress(sentence)


def test_elsewhere_stages_and_results_are_lines(capsys: pytest.CaptureFixture[str]) -> None:
    shown(hidden=False)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [f"ffcomp: {SAID[0]}", f"ffcomp: {SAID[2]}"]


def test_quiet_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    shown(hidden=True)
    assert capsys.readouterr() == ("", "")


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


def test_on_a_terminal_there_is_a_bar_with_the_stage_and_what_is_tried(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    on_a_terminal(monkeypatch)
    shown(hidden=False)
    out, err = capsys.readouterr()
    assert out == ""
    assert f"3/{len(USUAL_S)}" in err and all(sentence in err for sentence in SAID)


def test_the_time_left_is_what_is_usual_then_what_the_stages_before_took() -> None:
    pace = Pace((10.0, 10.0, 20.0))
    assert pace.whole_s(0.0) == pytest.approx(40.0) and pace.whole_s(4.0) == pytest.approx(40.0)
    pace.begin(2, 20.0)  # twice as long as usual
    assert 60.0 < pace.whole_s(20.0) < 80.0
    pace.begin(3, 40.0)
    assert 70.0 < pace.whole_s(40.0) < 80.0
    assert pace.whole_s(90.0) == 90.0  # it takes longer than expected: no time below zero is left
    pace.begin(1, 95.0)  # a stage that comes again changes nothing
    assert pace.whole_s(95.0) == 95.0
    assert Pace((1.0, 3.0)).whole_s(8.0) == pytest.approx(32.0)  # the first quarter is not over yet


def test_the_time_left_is_said_in_round_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = 100.0
    monkeypatch.setattr("ffcomp.cli.progress.time.monotonic", lambda: clock)
    shown = SearchProgress((10.0, 30.0))
    assert shown.left() == ""
    clock = 105.0
    assert shown.left() == "about 35 s left"
    clock = 100.0 + 43.0
    shown(Stage(2, "the rest"))
    assert shown.left() == "about 75 s left"
    long = SearchProgress((500.0, 400.0))
    clock += 20.0
    assert long.left() == "about 15 min left"


def test_the_time_left_is_the_pace_since_the_first_share(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Compiling comes before the first share, and nothing is promised before 5 s of steady work."""
    clock = 0.0
    monkeypatch.setattr("ffcomp.cli.progress.time.monotonic", lambda: clock)
    with Progress(1.0) as progress:
        clock = 60.0
        for share in (0.1, 0.2, 0.6):
            progress(share)
            clock += 3.0
    assert capsys.readouterr().err.splitlines() == ["ffcomp: 10 %", "ffcomp: 20 %", "ffcomp: 60 %, 5 s left"]


def test_programs_read_events(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
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
    assert page_progress(events, "") == (0.75, "compensating, 5 s left")
