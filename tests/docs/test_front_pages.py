"""The README and the pages that decide: short, with the patents, and with the numbers of the measured pages."""

from __future__ import annotations

import re

import pytest

from tests.support.docs_runner import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")
DECIDE = (ROOT / "docs" / "SHAPER_OR_FFCOMP.md").read_text(encoding="utf-8")
COMPARISON = (ROOT / "docs" / "COMPARISON.md").read_text(encoding="utf-8")
ACCURACY = (ROOT / "docs" / "ACCURACY.md").read_text(encoding="utf-8")
PRINTS = ("ringing_tower", "lobed_vase", "far_star", "kossel_mks-pwc")
MOST_WORDS = 900
CONTOUR, MEDIAN_10 = 2, 10  # columns of the comparison's tables
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


def compared(print_: str, column: int) -> list[float]:
    """Return a column of the comparison: without compensation, the best fixed shaper, ffcomp."""
    table = rows(COMPARISON, print_)
    chosen = [row for row in table if row[1] in ("no compensation", "**ffcomp**") or "best fixed**" in row[1]]
    assert len(chosen) == 3
    return [float(row[column].split(" ")[0]) for row in chosen]


def rounded(told: float, measured: float) -> bool:
    return abs(told - measured) <= (0.5 if told >= 15 and told == int(told) else 0.05) + 1e-9


def test_the_readme_is_short_and_says_what_it_must() -> None:
    assert len(README.split()) < MOST_WORDS
    for needed in ("patented in places", "not measurements on a printer", "scripts/demo", "scripts/test", ".png"):
        assert needed in README


@pytest.mark.parametrize("print_", PRINTS)
def test_the_page_that_decides_has_the_comparisons_numbers(print_: str) -> None:
    told = row_of(DECIDE, print_)
    assert all(map(rounded, told, compared(print_, CONTOUR))), (told, compared(print_, CONTOUR))


@pytest.mark.parametrize("print_", PRINTS[:3])
def test_the_readme_has_the_accuracys_numbers(print_: str) -> None:
    table = rows(ACCURACY, print_)
    named = {row[1]: float(row[4]) for row in table if len(row) > 4 and re.match(r"[\d.]+$", row[4])}
    shapers = [value for name, value in named.items() if ", best" in name]
    told = row_of(README, print_)
    assert all(map(rounded, told, (named["none"], min(shapers), named["**ffcomp**"]))), (told, named)


def test_the_readmes_printers_that_are_off() -> None:
    each = [compared(print_, MEDIAN_10) for print_ in PRINTS[:3]]
    for cell, values in zip(
        re.findall(r"(\d[\d.]*) to (\d[\d.]*)", next(x for x in README.splitlines() if "10 % off" in x)),
        zip(*each, strict=True),
        strict=True,
    ):
        assert abs(float(cell[0]) - min(values)) <= 0.5 and abs(float(cell[1]) - max(values)) <= 0.5
