"""The page of `ffcomp compare` in a browser: the table at any width, and its colours."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.report import drawing as style
from models.arrays import FloatArray
from tests.support.browser import chromium, contrast, hard_to_read, linear, visit
from tests.support.comparison import whole_page

METHODS = (style.BEFORE, style.AFTER, style.SHAPER, style.CALIBRATED, style.BEYOND)
LINES = 3.0  # least contrast with the ground of what is no word (WCAG 2.1)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("compare") / "report.html"
    target.write_bytes(whole_page())
    return target


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as running:
        yield running


@pytest.mark.parametrize("width", [1400, 390])
def test_nothing_is_cut_with_every_table_open(browser: Any, page: Path, width: int) -> None:
    with visit(browser, page, width, 900) as seen:
        seen.page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
        assert seen.page.evaluate("document.documentElement.scrollWidth") <= width
        assert seen.page.locator("img").count() == 7


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_are_readable(browser: Any, page: Path, scheme: str) -> None:
    with visit(browser, page) as seen:
        seen.page.emulate_media(color_scheme=scheme)
        assert not hard_to_read(seen)


# ---- colours -------------------------------------------------------------------------------------


def oklab(colour: Any) -> FloatArray:
    """Björn Ottosson's Oklab (2020), in which equal distances look equally far apart."""
    cones = [
        [0.41222147, 0.53633254, 0.05144599],
        [0.2119035, 0.6806995, 0.10739696],
        [0.08830246, 0.28171884, 0.6299787],
    ]
    lab = [
        [0.21045426, 0.79361779, -0.00407205],
        [1.9779985, -2.42859221, 0.45059371],
        [0.02590404, 0.78277177, -0.80867577],
    ]
    return np.asarray(np.array(lab) @ np.cbrt(np.array(cones) @ linear(colour)))


@pytest.mark.parametrize("on_dark", [False, True])
def test_no_colour_means_two_things_and_every_line_shows(on_dark: bool) -> None:
    own = [style.ON_DARK[each] if on_dark else each for each in METHODS]
    ground = style.ON_DARK[style.PAPER] if on_dark else style.PAPER
    assert min(contrast(each, ground) for each in own) >= LINES
    assert min(float(np.linalg.norm(oklab(a) - oklab(b))) for a, b in combinations(own, 2)) > 0.1


def test_an_error_has_a_colour_of_its_own_and_stands_out_the_more_the_worse_it_is() -> None:
    ramp = [style.error_colours()(k / 20) for k in range(21)]
    assert min(contrast(each, style.PAPER) for each in ramp) >= LINES
    assert min(float(np.linalg.norm(oklab(a) - oklab(b))) for a in METHODS for b in ramp) > 0.1
    steps = [contrast(each, style.PAPER) for each in ramp]
    assert steps == sorted(steps)  # for the colour-blind too
