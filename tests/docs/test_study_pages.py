"""Pages of measured results are what their templates and JSON files make, and every script has a row in a README."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from studies import render


@pytest.mark.parametrize("name", render.PAGES)
def test_a_page_is_what_its_template_and_its_results_make(name: str) -> None:
    page = render.page_of(name).read_text(encoding="utf-8")
    assert page == render.rendered(name), f"python -m studies.render {name}"


def test_no_template_and_no_results_are_left_over() -> None:
    templates = {path.name.removesuffix(".md.jinja") for path in render.TEMPLATES.glob("*.md.jinja")}
    results = {path.stem for path in render.RESULTS.glob("*.json")}
    assert templates == results == set(render.PAGES)


def test_results_are_rounded_and_plain() -> None:
    given = {"a": np.float64(1 / 3), "b": np.arange(2), "c": (math.inf, True), "d": Path("x").name}
    found = render.plain(given)
    assert found == {"a": 0.333333, "b": [0, 1], "c": [None, True], "d": "x"}
    json.dumps(found, allow_nan=False)


def test_a_part_that_is_not_measured_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in ("TEMPLATES", "RESULTS", "REPORTS", "ROOT"):
        monkeypatch.setattr(render, folder, tmp_path)
    monkeypatch.setattr(render, "PAGES", ("one",))
    monkeypatch.setattr(render, "write_page", lambda name: None)
    render.save("one", {"first": 1, "second": 2})
    render.save("one", {"second": 3})
    assert {"first": 1, "second": 3}.items() <= render.results_of("one").items()


def test_missing_values_are_empty_and_missing_names_errors() -> None:
    assert render.formatted(None, ".2f") == "" and render.formatted(0.0071, "+.2%") == "+0.71%"
    with pytest.raises(render.jinja2.UndefinedError):
        render.ENVIRONMENT.from_string("{{ nothing }}").render()


@pytest.mark.parametrize("folder", ["benchmarks", "studies", "validation"])
def test_every_script_has_a_row_in_the_readme_of_its_folder(folder: str) -> None:
    readme = (render.ROOT / folder / "README.md").read_text(encoding="utf-8")
    scripts = [p.stem for p in (render.ROOT / folder).glob("*.py") if "__main__" in p.read_text(encoding="utf-8")]
    assert [name for name in scripts if f"{folder}.{name}" not in readme and f"{folder}/{name}.py" not in readme] == []
