"""scripts/weight.py lowers limits, and never raises one."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts import weight

FILES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "models/effects.py", "ffcomp/search.py")


def test_a_package_over_its_limit_fails_and_is_never_raised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in FILES:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("two = 2\nlines = 2\n", encoding="utf-8")
    limits = tmp_path / "weight.toml"
    monkeypatch.setattr(weight, "ROOT", tmp_path)
    monkeypatch.setattr(weight, "LIMITS", limits)
    limits.write_text("[lines]\nmodels = 1\nffcomp = 99\n[words]\n", encoding="utf-8")
    assert weight.main(["--lower"]) == 1
    assert "models: 2 lines, limit 1 (+1)." in capsys.readouterr().out
    lowered = limits.read_text(encoding="utf-8")
    assert "models = 1\n" in lowered
    assert "ffcomp = 2\n" in lowered
