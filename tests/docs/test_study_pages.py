"""Pages of measured results are what their templates and JSON files make, and every script has a row in a README."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

import numpy as np
import pytest

from benchmarks import speed
from models.effects.catalogue import CATALOGUE, effects_of
from scripts.pages import effects
from scripts.site_pages import SOURCES, indented, with_sources
from studies import render
from tests.support.docs_runner import ROOT


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


# ---- benchmarks ----


SMALL = [speed.ROOT / "docs" / "examples" / "print.gcode"]


@pytest.mark.parametrize("name", ["prints", "where", "read", "steps"])
def test_every_section_has_a_row_with_its_numbers(name: str) -> None:
    head, *rows = speed.SECTIONS[name](SMALL, 1)
    assert rows and all(len(row) == len(head) for row in rows)
    assert all(float(cell) > 0.0 for row in rows for cell in row[1:] if isinstance(cell, float))


def test_a_print_is_repeated_between_its_own_beginning_and_end() -> None:
    a, b = speed.LAYER + b"\na\n", speed.LAYER + b"\nb\n"
    begin, end = b"begin\n", speed.END + b"\nend\n"
    assert b"".join(speed.repeated(begin + a + b + end, 3)) == begin + a + b + a + end


# ---- site ----


PAGE = re.compile(r"([\w/-]+\.md)$", re.MULTILINE)


def test_every_page_has_one_place() -> None:
    _, _, nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")  # a key of its own
    named = PAGE.findall(nav)
    pages = [path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")]
    assert sorted(named) == sorted(pages), "give each page one line under `nav` of mkdocs.yml"


def test_links_out_of_the_pages_lead_to_the_sources() -> None:
    page = PurePosixPath("tutorials/a.md")
    text = "[a](../SAFETY.md#b), [c](../../README.md#d), [e](../examples/print.gcode), [f](https://g.h), ![i](j.png)"
    told = text.replace("../../README", SOURCES + "README").replace("../examples", SOURCES + "docs/examples")
    assert with_sources(text, page) == told


def test_what_belongs_to_an_item_is_indented_by_four() -> None:
    text = "one:\n- a\n  b\n- c\n\n  ```\n  d\n    e\n  ```\n\n  f\n- g\n\nend\n  h\n\n1. i\n   j\n"
    told = "one:\n\n- a\n    b\n- c\n\n    ```\n    d\n      e\n    ```\n\n    f\n\n- g\n\nend\n  h\n\n1. i\n    j\n"
    assert indented(text) == told


# ---- effects page ----


DOCS = Path(__file__).parents[2] / "docs"
LARGEST_BYTES = 40_000


def test_every_effect_has_its_small_figure_and_no_figure_is_left_over() -> None:
    figures = {path.stem: path for path in (DOCS / "effects").glob("*.png")}
    assert set(figures) == set(effects_of()) >= set(effects.SHOWN)
    assert max(path.stat().st_size for path in figures.values()) < LARGEST_BYTES


@pytest.mark.parametrize("name", ["coulomb_friction", "effector_mass", "cogging", "sensor_gain", "arm_geometry"])
def test_a_figure_shows_the_effect(name: str) -> None:
    """One of each kind of view: the curve with the effect is another one by more than a tenth of a percent."""
    shown = effects.SHOWN[name]
    without, with_it = (shown.panels[0].draw(m) for m in effects.machines(CATALOGUE[name], shown))
    np.testing.assert_array_equal(without.x, with_it.x)
    assert np.abs(with_it.y - without.y).max() > 1e-3 * max(float(np.abs(without.y).max()), 1.0)


# ---- front pages ----


README = (ROOT / "README.md").read_text(encoding="utf-8")
DECIDE = (ROOT / "docs" / "SHAPER_OR_FFCOMP.md").read_text(encoding="utf-8")
COMPARISON = (ROOT / "studies" / "reports" / "comparison.md").read_text(encoding="utf-8")
PRINTS = ("ringing_tower", "lobed_vase", "far_star", "kossel_mks-pwc")
Row = list[str]


def rows(page: str, title: str) -> list[Row]:
    """Return the cells of the tables of one section."""
    section = re.split(r"^##+ ", page, flags=re.MULTILINE)
    found = next(each for each in section if each.startswith(title))
    return [[cell.strip() for cell in line.split("|")[0:]] for line in found.splitlines() if line.startswith("|")]


def row_of(page: str, text: str) -> list[float]:
    """Return the numbers of the row of a page whose first cell holds a text."""
    line = next(line for line in page.splitlines() if line.startswith("| ") and text in line.split("|")[1])
    cells = [re.match(r"\W*(\d+(?:\.\d+)?)", cell) for cell in line.split("|")[2:5]]
    return [float(cell[1]) for cell in cells if cell]


def compared(print_: str) -> list[float]:
    """Return what the comparison's first tables say: without compensation, the best rival, ffcomp."""
    table = [
        line.split(" | ") for line in COMPARISON.partition("## ")[0].splitlines() if line.startswith(f"| {print_} |")
    ]
    assert len(table) == 1
    none, _, best, _, ours = table[0][2:7]
    return [float(none), float(best), float(ours)]


def medians_10(print_: str) -> list[float]:
    """Return the medians of printers that are 10 % off: the best rival, ffcomp."""
    (row,) = [row for row in rows(COMPARISON, print_) if row[1] == "10%"]
    return [float(cell.split(",")[0]) for cell in row[2:4]]


def rounded(told: float, measured: float) -> bool:
    return abs(told - measured) <= (0.5 if told >= 15 and told == int(told) else 0.05) + 1e-9


@pytest.mark.parametrize("print_", PRINTS)
def test_the_page_that_decides_has_the_comparisons_numbers(print_: str) -> None:
    told = row_of(DECIDE, print_)
    assert all(map(rounded, told, compared(print_))), (told, compared(print_))


@pytest.mark.parametrize("print_", PRINTS[:3])
def test_the_readme_has_the_same_numbers(print_: str) -> None:
    told = row_of(README, print_)
    assert all(map(rounded, told, compared(print_))), (told, compared(print_))


def test_one_print_has_one_number_on_every_page() -> None:
    """The range that explains how it works; and no page of the accuracy has contour errors of its own."""
    page = (ROOT / "docs" / "explanation" / "how_it_works.md").read_text(encoding="utf-8").replace("\n", " ")
    told = re.search(r"leaves ([\d.]+) to ([\d.]+) µm rms, ffcomp ([\d.]+) to ([\d.]+)\.", page)
    assert told
    _, shapers, ours = zip(*map(compared, PRINTS[:3]), strict=True)
    for least, most, measured in ((told[1], told[2], shapers), (told[3], told[4], ours)):
        assert rounded(float(least), min(measured)) and rounded(float(most), max(measured))
    accuracy = (ROOT / "docs" / "ACCURACY.md").read_text(encoding="utf-8")
    assert not re.search(r"^\| print .*contour", accuracy, flags=re.MULTILINE)


def test_the_readmes_printers_that_are_off() -> None:
    line = next(line for line in README.splitlines() if "10 % off" in line)
    told = [float(cell) for cell in re.findall(r"\d+(?:\.\d+)?", line.split("|", 3)[3])[:2]]
    assert all(map(rounded, told, medians_10(PRINTS[0]))), (told, medians_10(PRINTS[0]))
