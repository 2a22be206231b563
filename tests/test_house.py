"""What starts first stays light, and the README's commands exist. Who may import whom: `lint-imports`."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.conftest import TESTS, is_slow

ROOT = Path(__file__).parents[1]
HEAVY = ("numpy", "scipy", "numba", "matplotlib", "pydantic", "control", "cvxpy")


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


def test_each_deliberate_fault_can_be_made_and_its_tests_exist() -> None:
    for fault in tomllib.loads((ROOT / "scripts" / "faults.toml").read_text(encoding="utf-8"))["fault"]:
        assert (ROOT / fault["file"]).read_text(encoding="utf-8").count(fault["old"]) == 1, fault
        paths = [word for word in fault["tests"].split() if word.startswith("tests/")]
        assert paths and all((ROOT / path.partition("::")[0]).exists() for path in paths), fault


def test_every_package_has_a_test_in_each_quick_run() -> None:
    """Files that import it and are not among SLOW of tests/conftest.py."""
    quick = [path.read_text(encoding="utf-8") for path in TESTS.rglob("test_*.py") if not is_slow(path)]
    packages = [path.parent.name for path in (ROOT / "ffcomp").glob("*/__init__.py")]
    assert len(packages) > 15
    without = [name for name in packages if not any(f"from ffcomp.{name}" in text for text in quick)]
    assert without == ["api"]  # its names are those of ffcomp: test_public.py


def test_compiled_loops_have_no_default_arguments() -> None:
    """With one, the wheel whose loops are compiled ahead cannot be built."""
    default = re.compile(r"^@(?:kernel|fast_kernel|compiled)\b.*\ndef (\w+)\([^)]*=", re.MULTILINE)
    texts = [p.read_text("utf-8") for package in ("ffcomp", "gcode", "models") for p in (ROOT / package).rglob("*.py")]
    assert default.findall("".join([*texts, "@kernel\ndef f(x: float, cut: float = 1.0) -> float:\n"])) == ["f"]
