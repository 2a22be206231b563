"""The page of `ffcomp compare` in a browser: the table at any width, and its colours."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.browser import chromium, hard_to_read, visit
from tests.support.comparison import whole_page


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
