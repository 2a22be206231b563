"""No verb writes over what it reads, over what exists, or where nothing can be written."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffcomp.cli.app import app
from tests.support.cli import CliRunner


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("diagnose a.csv -m kossel -o a.csv", "a.csv is read as well; give another --output."),
        ("diagnose a.csv -m kossel -o old.toml", "old.toml exists already; give another --output, or --force."),
        ("diagnose a.csv -m kossel -o none/b.toml", "b.toml: --output names a file in a folder that exists."),
        ("record plan -m kossel -o p.gcode", "p.json exists already; give another -o, or --force."),
        (
            "record join a.csv --plan p.json -m kossel --output-dir .",
            ".: the captures are there; give another --output-dir.",
        ),
        ("diagnose a.csv -m kossel -o b.toml --trace b.toml", "b.toml is named twice; give another --"),
        ("gap a.csv -m kossel --report old.toml", "old.toml: --report writes a page; end its name in .html."),
        ("record join a.csv --plan p.json -m kossel --output-dir old.toml", "old.toml: --output-dir names a folder."),
        ("compensate a/x.gcode b/x.gcode -m kossel --output-dir c", "would both be written to c/x.gcode"),
        ("compensate a/x.gcode b/x.gcode -m kossel --output-dir b", "b/x.gcode, which is read as well, would be"),
    ],
)
def test_a_target_is_refused_before_the_work(
    words: str, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("a.csv", "old.toml", "p.json", "a/x.gcode", "b/x.gcode"):
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text("kept", encoding="utf-8")
    answer = CliRunner().invoke(app, words.split())
    assert answer.exit_code == 2 and sentence in answer.stderr, answer.stderr
    assert {path.read_text(encoding="utf-8") for path in Path().rglob("*.*")} == {"kept"}
