"""The README and the pages that decide: short, with the patents, and with the numbers of the measured pages."""

from __future__ import annotations

import re

import pytest

from tests.support.docs_runner import ROOT

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


def test_the_readmes_printers_that_are_off() -> None:
    line = next(line for line in README.splitlines() if "10 % off" in line)
    told = [float(cell) for cell in re.findall(r"\d+(?:\.\d+)?", line.split("|", 3)[3])[:2]]
    assert all(map(rounded, told, medians_10(PRINTS[0]))), (told, medians_10(PRINTS[0]))
