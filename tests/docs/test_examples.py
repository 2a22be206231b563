"""Every example of every page: it runs, ends and prints as the page says; what cannot run here says why."""

from __future__ import annotations

import json
import re
import tomllib
from functools import cache
from itertools import pairwise
from pathlib import Path

import pytest

from scripts.pages import gallery
from tests.support.docs_runner import (
    COMMANDS,
    ROOT,
    Block,
    blocks_of,
    commands_of,
    environment,
    lay_out,
    matches,
    pages,
    run_block,
    usage_error,
)

BLOCKS = [block for page in pages() for block in blocks_of(page)]
RUN = [page for page in pages() if any(block.is_example for block in blocks_of(page))]
BAR = re.compile(r"(?<!\\)\|")
LINK = re.compile(r"\]\((?!https?:|mailto:)([^)\s#]*)#?([^)\s]*)\)")  # a file, a heading, or both


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("page", RUN, ids=name)
def test_examples_run_in_order(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lay_out(tmp_path)
    monkeypatch.chdir(tmp_path)
    for key, value in environment(tmp_path).items():
        monkeypatch.setenv(key, value)
    for block in blocks_of(page):
        if block.is_example:
            run_block(block)


def test_commands_that_are_not_run_exist() -> None:
    """A verb or an option that was renamed is found out here."""
    told = [(b.place, c.text) for b in BLOCKS if b.language in COMMANDS and b.not_run for c in commands_of(b)]
    read = [(place, text, usage_error(text)) for place, text in told if text.startswith("ffcomp ")]
    wrong = [f"{place}: {text}: {error}" for place, text, error in read if error]
    assert not wrong, "\n".join(wrong)


def test_no_command_hides_in_another_kind_of_block() -> None:
    """They stand in blocks named sh or console, which are run; `text` is for what is no command, such as a synopsis."""
    hidden = [
        f"{block.place}: {line}"
        for block in BLOCKS
        if block.language not in (*COMMANDS, "python", "text")
        for line in block.lines
        if re.match(r"(\$ )?ffcomp \w+ ", line.strip())
    ]
    assert not hidden, "\n".join(hidden)


def test_data_examples_can_be_read() -> None:
    readers = {"json": json.loads, "toml": tomllib.loads}
    for block in BLOCKS:
        if block.language in readers and not block.not_run:
            try:
                readers[block.language](block.text)
            except ValueError as error:
                pytest.fail(f"{block.place}: {error}")


def test_links_lead_somewhere() -> None:
    broken = [
        f"{name(page)}: {target}#{heading}"
        for page in pages()
        for target, heading in LINK.findall(page.read_text(encoding="utf-8"))
        if not leads_somewhere(page.parent / target if target else page, heading)
    ]
    assert not broken, "\n".join(broken)


def leads_somewhere(target: Path, heading: str) -> bool:
    return target.exists() and (not heading or heading in anchors(target))


@cache
def anchors(page: Path) -> set[str]:
    """What GitHub calls the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_tables_have_as_many_rules_as_headings() -> None:
    """Otherwise a page shows the text of a table and no table."""
    wrong = [
        f"{name(page)}:{number}"
        for page in pages()
        for number, (head, rule) in enumerate(pairwise(page.read_text(encoding="utf-8").splitlines()), 1)
        if re.fullmatch(r"\|(\s*:?-+:?\s*\|)+", rule) and len(BAR.findall(head)) != len(BAR.findall(rule))
    ]
    assert not wrong, "\n".join(wrong)


def test_the_gallery_is_what_its_script_makes() -> None:
    """Each picture of the folder is made by the script, small, and shown."""
    shown = (ROOT / "docs" / "TROUBLESHOOTING.md").read_text(encoding="utf-8")
    pictures = sorted(gallery.GALLERY.glob("*.png"))
    assert [picture.stem for picture in pictures] == sorted(gallery.MADE)
    for picture in pictures:
        assert picture.stat().st_size <= gallery.LARGEST_BYTES, picture.name
        assert f"(gallery/{picture.name})" in shown, picture.name


# ---- the runner itself ---------------------------------------------------------------------------


def block(text: str, language: str = "console") -> Block:
    return Block(ROOT / "README.md", 1, language, text.splitlines(), "")


def test_a_wrong_quote_is_found() -> None:
    run_block(block("$ ffcomp machines list\n22 machines: 7 delta, 8 corexy, 7 cartesian.\nkossel  delta, …, …"))
    with pytest.raises(AssertionError, match="quotes 'there is no such line'"):
        run_block(block("$ ffcomp machines list\nthere is no such line\n"))


@pytest.mark.parametrize(
    ("quoted", "actual", "same"),
    [
        ("rms 2.20 µm", "rms  2.21 µm", True),  # one unit of the last digit
        ("rms 2.20 µm", "rms 2.26 µm", False),
        ("rms 130 µm", "rms 131.9 µm", True),  # two percent
        ("rms 130 µm", "rms 133 µm", False),
        ("took … s", "took 31.2 s", True),
        ("took … s", "took 31.2 s.", False),
    ],
)
def test_quoted_numbers_may_round_otherwise(quoted: str, actual: str, same: bool) -> None:
    assert matches(quoted, actual) is same
