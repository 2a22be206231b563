"""scripts/structure counts what it says."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts import weight

FILES = {
    "models/effects.py": "KERNELS = {'x': 1.5}\nNAME = 'x2'\n",
    "ffcomp/search.py": "def diagnose(plan):\n    return plan\n",
    "ffcomp/cli/other.py": "import ffcomp.search\n",
    "docs/a.md": "two words\n",
    "tests/test_a.py": "\n\n",
    "README.md": "three words here\n",
}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


def test_a_package_over_its_limit_fails_and_is_never_raised(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    limits = root / "docs" / "weight.toml"
    for page in ("CONTRIBUTING.md", "CHANGELOG.md"):
        (root / page).touch()
    monkeypatch.setattr(weight, "ROOT", root)
    monkeypatch.setattr(weight, "LIMITS", limits)
    limits.write_text("[lines]\nmodels = 1\nffcomp = 99\n[words]\n", encoding="utf-8")
    assert weight.main(["--lower"]) == 1
    assert "models: 2 lines, limit 1 (+1)." in capsys.readouterr().out
    lowered = limits.read_text(encoding="utf-8")
    assert "models = 1\n" in lowered
    assert "ffcomp = 2\n" in lowered
