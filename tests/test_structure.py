"""scripts/structure counts what it says."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts import weight

FILES = {
    "gcode/__init__.py": "",
    "models/effects.py": "KERNELS = {'x': 1.5}\nNAME = 'x2'\n",
    "ffcomp/search.py": (
        '"""Text with found and told."""\n\nfrom functools import singledispatch\nfrom ffcomp import table\n\n\n'
        "def diagnose(told_plan):\n    # found\n    found = problem_of(told_plan)\n    return found\n\n\n"
        "@singledispatch\ndef problem_of(x):\n    return x\n\n\n"
        "@problem_of.register(int)\ndef _(x):\n    return table.SOLVERS['a'](x, 1, 2, 3, 4, 5, 6, 7, 8)\n"
    ),
    "ffcomp/table.py": (
        "def solve(*x):\n    return isinstance(x, DeltaGeometry)\n\n\n"
        "def lonely():\n    pass\n\n\nSOLVERS = {'a': solve}\n"
    ),
    "ffcomp/other.py": (
        "from ffcomp.table import SOLVERS\n\n\ndef lonely():\n    pass\n\n\ndef compensate():\n    pass\n"
    ),
    "ffcomp/cli/other.py": "import ffcomp.other\n\n\ndef compensate():\n    pass\n",
    "README.md": "three words here\n",
    "docs/a.md": "two words\n",
    "tests/test_a.py": "\n\n",
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
    assert f"ffcomp = {sum(FILES[f'ffcomp/{n}.py'].count(chr(10)) for n in ('search', 'table', 'other'))}\n" in lowered
