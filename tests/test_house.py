"""The house rules: who may import whom, what stays light, and that the README's commands exist."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("gcode", "models", "ffcomp")
FORBIDDEN = {
    "gcode": {"models", "ffcomp", "scipy", "matplotlib", "typer", "rich", "pydantic"},
    "models": {"gcode", "ffcomp", "matplotlib", "typer", "rich"},
    "ffcomp": set[str](),
}
ONLY_IN = {
    "matplotlib": ("ffcomp/report/", "ffcomp/api/"),
    "rich": "ffcomp/cli/",
    "typer": "ffcomp/cli/",
    "pydantic": "models/",
}
HEAVY = ("numpy", "scipy", "numba", "matplotlib", "pydantic", "control", "osqp", "cvxpy")


def imports_of(path: Path) -> set[str]:
    """Names of the top-level packages that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(str(node.module).split(".")[0])
    return found


FILES = sorted(p for package in PACKAGES for p in (ROOT / package).rglob("*.py"))


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_one_way(path: Path) -> None:
    name = path.relative_to(ROOT).as_posix()
    found = imports_of(path)
    assert not found & FORBIDDEN[name.split("/")[0]]
    assert not found & {"klippy", "kalico"}, "GPL: only ever a process of its own"
    for library, place in ONLY_IN.items():
        assert library not in found or name.startswith(place), f"{library} belongs into {place}"


@pytest.mark.parametrize("module", ["ffcomp", "ffcomp.cli.app"])
def test_what_starts_first_stays_light(module: str) -> None:
    code = f"import sys, {module}; print(*[m for m in {HEAVY!r} if m in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert answer.stdout.split() == []


def test_the_readme_names_commands_that_exist() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for script in ("scripts/demo", "scripts/test"):
        assert script in text
        assert (ROOT / script).stat().st_mode & 0o100
    verbs = set(re.findall(r"^ffcomp (\w+)", text, re.MULTILINE))
    answer = subprocess.run(
        [sys.executable, "-c", "from ffcomp.cli.app import main; main()", "--help"],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    assert verbs and all(verb in answer.stdout for verb in verbs)
    for link in re.findall(r"\]\(((?!http)[^)]+)\)", text):
        assert (ROOT / link).exists(), link


def test_ci_runs_the_readmes_test_command() -> None:
    assert "\nscripts/test\n" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
