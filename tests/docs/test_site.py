"""The site: every page has a place in it, and pages written for GitHub come out right."""

from __future__ import annotations

import re
from pathlib import PurePosixPath

from scripts.site_pages import SOURCES, indented, with_sources
from tests.support.docs_runner import ROOT

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
