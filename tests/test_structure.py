"""scripts/structure counts what it says."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from scripts import weight
from scripts.structure import Checkout, main

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


def test_measures(root: Path) -> None:
    checkout = Checkout(root)
    values = dict(checkout.table())
    assert values["Python files of the product"] == "6"
    assert values["Lines of code: no comment, no docstring, not blank"] == "26"
    assert values["Largest file"] == "20 (ffcomp/search.py)"
    assert values["Names with asked/found/given/own/said/told in 1,000 lines of code"] == f"{4000 / 26:.1f}"
    assert values["Module constants that are numbers; of diagnose"] == "1; 0"
    assert values["Calls with 9 arguments by position, or more"] == "1"
    assert values["Places outside models/ that ask for the kind of machine"] == "1"
    assert values["Pages and words of README and docs"] == "2, 5"
    assert values["Lines of tests"] == "2"
    assert checkout.with_one_importer == {"ffcomp/other.py": "ffcomp.cli.other"}
    assert checkout.named_twice == {
        "compensate": ["ffcomp/cli/other.py", "ffcomp/other.py"],
        "lonely": ["ffcomp/other.py", "ffcomp/table.py"],
    }


def test_what_a_verb_reaches_is_followed_through_dispatch_and_tables(root: Path) -> None:
    values = dict(Checkout(root).table())
    assert values["Definitions on the way of `diagnose`"] == "4 in 2 files"  # not `lonely`
    assert values["Definitions on the way of `compensate`"] == "1 in 1 files"  # not the command line's


def test_commits_are_compared(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def git(*arguments: str) -> None:
        who = ("-c", "user.name=a", "-c", "user.email=a@b.c")
        subprocess.run(["git", "-C", root, *who, *arguments], check=True, capture_output=True)

    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "one")
    (root / "ffcomp/cli/other.py").unlink()
    assert main([str(root), "--compare", "HEAD"]) == 0
    table = capsys.readouterr().out
    assert "| Measure | Before | After |" in table and "| Python files of the product | 6 | 5 |" in table
    assert main([str(root), "--list", "twice"]) == 0
    assert capsys.readouterr().out == "lonely: ffcomp/other.py, ffcomp/table.py\n"


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
