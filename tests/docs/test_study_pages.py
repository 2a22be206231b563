"""Pages of measured results are what their templates and JSON files make, and every script has a row in a README."""

from __future__ import annotations

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


@pytest.mark.parametrize("folder", ["benchmarks", "studies", "validation"])
def test_every_script_has_a_row_in_the_readme_of_its_folder(folder: str) -> None:
    readme = (render.ROOT / folder / "README.md").read_text(encoding="utf-8")
    scripts = [p.stem for p in (render.ROOT / folder).glob("*.py") if "__main__" in p.read_text(encoding="utf-8")]
    assert [name for name in scripts if f"{folder}.{name}" not in readme and f"{folder}/{name}.py" not in readme] == []
