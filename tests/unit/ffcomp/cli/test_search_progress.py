"""What a search says: lines where nothing moves, a bar on a terminal, nothing if quiet."""

from __future__ import annotations

import sys

import pytest

from ffcomp.cli.search_progress import SearchProgress
from ffcomp.diagnose.progress import STAGES, Now, Stage

SAID = (Stage(3, "screening 21 effects"), Now("fitting effector_mass"), "effector_mass: 1.2 times the noise")


def shown(quiet: bool) -> None:
    with SearchProgress(quiet) as progress:
        for sentence in SAID:
            progress(sentence)


def test_elsewhere_stages_and_results_are_lines(capsys: pytest.CaptureFixture[str]) -> None:
    shown(quiet=False)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [f"ffcomp: {SAID[0]}", f"ffcomp: {SAID[2]}"]


def test_quiet_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    shown(quiet=True)
    assert capsys.readouterr() == ("", "")


def test_on_a_terminal_there_is_a_bar_with_the_stage_and_what_is_tried(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SLIC3R_PP_HOST", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    shown(quiet=False)
    out, err = capsys.readouterr()
    assert out == ""
    assert f"3/{STAGES}" in err and all(sentence in err for sentence in SAID)
