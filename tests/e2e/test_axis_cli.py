"""An axis by itself from the command line: gap, diagnose with its report, and what refuses it."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path

import pytest

from ffcomp.cli.app import app
from tests.support.axis import write_axis
from tests.support.cli import CliRunner


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("axis")
    write_axis(made)
    return made


def run(*words: str | Path) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(word) for word in words])
    return result.exit_code, result.stdout, result.stderr


def test_an_axis_is_diagnosed_and_its_better_file_closes_the_gap(folder: Path) -> None:
    runs, better, report = sorted(folder.glob("push-*.csv")), folder / "better.toml", folder / "r.html"
    said = run("diagnose", *runs, "-m", folder / "slide.toml", "-o", better, "--report", report, "--json", "--force")
    assert said[0] == 0, said[2]
    answer = json.loads(said[1])
    assert [each["name"] for each in answer["effects"]] == ["coulomb_friction"]
    assert answer["left_out"] == "windows"
    assert answer["effects"][0]["parameters"]["force_n"]["value"] == pytest.approx(4.0, rel=0.05)
    page = unescape(report.read_text())
    assert "By window of time" in page and "Where they differ" in page
    gaps = [run("gap", *runs, "-m", file, "--json", "-r", report)[1] for file in (folder / "slide.toml", better)]
    assert report.read_text().count("data:image/svg") >= 4
    before, after = (json.loads(each)["nrms"] for each in gaps)
    assert 0.2 * before > after == pytest.approx(answer["gap"]["after"], rel=0.01)  # the file is what was fitted


def test_its_file_is_checked_and_shown_and_a_free_axis_may_rest_anywhere(folder: Path, tmp_path: Path) -> None:
    code, said, _ = run("machines", "check", folder / "slide.toml")
    assert (code, said.strip()) == (0, "slide: the file is valid, and its vibrations decay.")
    assert "axis.mass_kg" in run("machines", "show", folder / "slide.toml")[1]
    growing = tmp_path / "growing.toml"
    text = (folder / "slide.toml").read_text()
    growing.write_text(re.sub(r"(damping_n_s_per_m\s*=\s*)\S+", r"\g<1>-1.0", text))
    assert run("machines", "check", growing)[0] == 5
