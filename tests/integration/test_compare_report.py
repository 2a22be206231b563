"""The report of `ffcomp compare`: verdict, figures, page, and the page in a real browser.

The print is invented: squares in three layers, whose corners start decaying waves across the next side. Then every
number in the report has a closed form.
"""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.comparison.result import Comparison, Peaks
from tests.support.browser import Visit, visit
from tests.support.comparison import LAYERS, MACHINE, NASTY, changed, comparison, everything, samples, whole_page


def verdict(found: Comparison) -> list[str]:
    """What was found and what to mind, in the order of importance."""
    said = [sentence for _, sentence in found.facts[len(found.methods) :]]
    return [*said[:2], *found.warnings, *said[2:]]


# ---- words and verdict ---------------------------------------------------------------------------


def test_errors_by_layer_and_feature_are_those_of_the_tiles() -> None:
    found = comparison()
    for own, each in ((found.methods["mzv"], found.methods["mzv"].by_layer), (found.none, found.none.by_feature)):
        errors = list(each.values())
        whole = sum(error.share * error.rms_um**2 for error in errors) ** 0.5
        assert whole == pytest.approx(own.extruding.contour_rms_um) and sum(e.share for e in errors) == pytest.approx(1)
    travel = replace(found.none.samples, extruding=np.zeros(len(samples(1.0).due), dtype=bool))
    assert set(travel.by(travel.layer)) == set(range(LAYERS))


def test_limits_and_warnings_are_in_the_verdict() -> None:
    beyond = Peaks(250.0, 4.5e4, False)
    said = " ".join(verdict(changed(comparison(), "fbs-lpv", peaks=beyond, warnings=("Too fast here.",))))
    assert "45,000 mm/s² (45 m/s²), more than the machine file allows (500 mm/s, 30,000 mm/s² (30 m/s²))" in said
    assert "Too fast here." in said
    assert "Beyond the limits of the carriages" in " ".join(verdict(changed(comparison(), "mzv", peaks=beyond)))
    assert "allows" not in " ".join(verdict(comparison()))


@pytest.mark.parametrize(
    ("method", "share", "said"),
    [
        ("none", 2.0, "ffcomp makes this print worse"),
        ("mzv", 1.2, "is better on this print"),
        ("mzv", 1.0, "is as good on this print"),
        ("mzv", 0.7, "The difference is small: a shaper is enough"),
        ("mzv", 0.2, "Worth it? Yes: "),
    ],
)
def test_the_headline_weighs_ffcomp_against_the_best_shaper(method: str, share: float, said: str) -> None:
    found = comparison()
    errors = replace(found.ours.extruding, contour_rms_um=share * found.rms_um(found.methods[method]))
    headline = changed(found, "fbs-lpv", extruding=errors).headline
    assert headline.startswith("Worth it? ") and said in headline
    beyond = changed(found, "fbs-lpv", extruding=errors, peaks=Peaks(250.0, 4.5e4, False)).headline
    assert "ffcomp asks the carriages for more" in beyond


# ---- figures and page ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("report") / "report.html"
    target.write_bytes(whole_page())
    return target


@pytest.fixture(scope="module")
def nasty_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every text that a file can give is an attack."""
    found = replace(
        everything("folder/<img src=x onerror=alert(1)>.gcode"),
        machine=replace(MACHINE, name=f"$x_1$ {NASTY}", effects={NASTY: {}}),
        plant=replace(MACHINE, name=NASTY, effects={NASTY: {}}),
        features=("other", f"</script>{NASTY}", "$\\frac{"),
        settings={NASTY: NASTY},
    )
    found = changed(found, "mzv", label=f"MZV {NASTY}", tuning=NASTY, warnings=(NASTY,))
    for key, judged in found.methods.items():
        found = changed(found, key, by_feature=dict(zip(found.features[1:], judged.by_feature.values(), strict=True)))
    target = tmp_path_factory.mktemp("nasty") / "report.html"
    found.write_report(target)
    return target


def test_the_page_fetches_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    images = [base64.b64decode(each).decode() for each in re.findall(r"base64,([A-Za-z0-9+/=]+)", text)]
    assert len(images) == 4
    for content in (text, *images):
        fetched = re.findall(r"""(?:src|href)\s*=\s*["']?([^"'\s>]+)|url\(([^)]+)\)|@import""", content)
        assert all(re.match(r"data:|#|$", one or other) for one, other in fetched), fetched
        assert "<script" not in content or content is text


# ---- in a browser --------------------------------------------------------------------------------


def clean(seen: Visit) -> bool:
    return not seen.errors and not seen.requests


@pytest.mark.parametrize("width", [1400, 390])
def test_nothing_is_cut_with_every_table_open(browser: Any, page: Path, width: int) -> None:
    with visit(browser, page, width, 900) as seen:
        seen.page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
        assert seen.page.evaluate("document.documentElement.scrollWidth") <= width
        assert seen.page.locator("img").count() == 4
        assert clean(seen), (seen.errors, seen.requests)


def test_nothing_from_a_file_is_executed(browser: Any, nasty_page: Path) -> None:
    with visit(browser, nasty_page) as seen:
        assert "alert(1)" in seen.page.locator("h1").inner_text()
        assert clean(seen), (seen.errors, seen.requests)
