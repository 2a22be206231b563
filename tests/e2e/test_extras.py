"""What only an extra installs: it is missed at once, in one sentence with the command, and nobody else needs it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import ffcomp
from ffcomp.cli.app import app
from ffcomp.errors import EXTRAS, FfcompError
from tests.support.cli import CliRunner
from tests.support.docs_runner import ROOT

EXAMPLES = ROOT / "docs" / "examples"


@pytest.mark.parametrize(
    "words",
    [
        ["estimate", str(EXAMPLES / "print.gcode"), "-m", "kossel", "--report", "a.html"],
        ["frf", "-m", "kossel", "--figure", "a.png"],
    ],
    ids=lambda words: words[0],
)
def test_a_missing_package_is_said_at_once(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ffcomp.cli.common.find_spec", lambda package: None)
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1
    assert "Figures and pages need Matplotlib: pip install 'ffcomp[plot]'" in result.output


def test_a_picture_without_its_package_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the verb itself finds it missing."""
    done = tmp_path / "out.gcode"
    made = ["compensate", str(EXAMPLES / "wiggle.gcode"), "-m", "kossel", "-o", str(done), "--quiet"]
    assert CliRunner().invoke(app, made).exit_code == 0
    for module in [name for name in sys.modules if name.startswith("ffcomp.report.show")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = CliRunner().invoke(app, ["show", str(done)])
    assert result.exit_code == 1 and "pip install 'ffcomp[plot]'" in result.output


def test_python_says_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    found = ffcomp.frf("kossel", [(0.0, 0.0)])
    for module in [name for name in sys.modules if name.startswith("ffcomp.report.model")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(FfcompError, match=r"pip install 'ffcomp\[plot\]'"):
        found.plot()
    with pytest.raises(FfcompError, match=r"pip install 'ffcomp\[control\]'"):
        found.to_control()


def test_other_verbs_do_without(tmp_path: Path) -> None:
    """Compensate, simulate and estimate load no package of an extra, but for numba, which a checkout has anyway."""
    code = f"""
import sys
for name in {sorted(set(EXTRAS) - {"numba"})}: sys.modules[name] = None
import ffcomp
ffcomp.compensate({str(EXAMPLES / "wiggle.gcode")!r}, "kossel", {str(tmp_path / "out.gcode")!r})
ffcomp.estimate({str(tmp_path / "out.gcode")!r}, "kossel")
import ffcomp.api.measurements, ffcomp.diagnosis, ffcomp.identification
import ffcomp.cli.compare, ffcomp.comparison.result
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
