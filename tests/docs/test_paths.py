"""Every file and module that README, CONTRIBUTING or a page of docs names exists."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name

import pytest

from tests.support.docs_runner import ROOT, pages

FOLDERS = ("gcode", "models", "ffcomp", "tests", "validation", "studies", "benchmarks", "scripts", "docs")
PATH = re.compile(rf"(?<![\w./-])((?:{'|'.join(FOLDERS)})/[\w./-]*\w)")
PROGRAM = re.compile(r"`(\w+\.py)`")
MODULE = re.compile(r"`((?:gcode|models|ffcomp|validation|studies|benchmarks)(?:\.\w+)+)(?:\([^`]*\))?`")
NAMED = re.compile(r"`(\w+)`(?: and `(\w+)`)?\s+in\s+`([\w/]+\.py)`")  # `TABLE` in `folder/file.py`
FILES = (".cmd", ".log", ".log.1", ".py", ".toml")  # of names that look like modules
FENCED = re.compile(r"^ *```.*?^ *```", re.MULTILINE | re.DOTALL)  # examples run
LINK = re.compile(r"\]\([^)]*\)")  # links are followed elsewhere
PLACEHOLDER = "NAME"
INSTALLED = {"ffcomp.py", "Ffcomp.py"}  # names in the folders of slicers
PAGES = [*pages(), *(ROOT / name for name in ("CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md"))]


def prose(page: Path) -> str:
    """Return a page without its examples and the targets of its links."""
    return LINK.sub("]", FENCED.sub("", page.read_text(encoding="utf-8")))


def is_there(dotted: str) -> bool:
    """Tell whether a dotted name is a module, or something in one."""
    try:
        resolve_name(dotted)
    except (ImportError, AttributeError):
        return False
    return True


@pytest.fixture(scope="module")
def programs() -> set[str]:
    """Names of all Python files of the project."""
    return {path.name for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_files_that_are_named_exist(page: Path, programs: set[str]) -> None:
    text = prose(page)
    missing = {path for path in PATH.findall(text) if PLACEHOLDER not in path and not (ROOT / path).exists()}
    missing |= set(PROGRAM.findall(text)) - programs - INSTALLED
    assert not missing, sorted(missing)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_modules_that_are_named_exist(page: Path) -> None:
    import_module("ffcomp")
    named = {name for name in MODULE.findall(prose(page)) if not name.endswith(FILES)}
    missing = sorted(name for name in named if not is_there(name))
    assert not missing, missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_names_in_files_that_are_named_exist(page: Path) -> None:
    told = [(name, file) for *names, file in NAMED.findall(prose(page)) for name in names if name]
    missing = [
        f"{name} in {file}"
        for name, file in told
        if "/" in file and not re.search(rf"\b{name}\b", (ROOT / file).read_text(encoding="utf-8"))
    ]
    assert not missing, missing


def test_the_newcomers_page_names_tables() -> None:
    assert len(NAMED.findall(prose(ROOT / "docs" / "where_do_I_change.md"))) > 15
