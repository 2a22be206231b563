"""Render the reports of measured results: a template and a JSON file make a page.

    python -m studies.render PAGE ...     write these pages; without a name, list them
    python -m studies.render --all        write all
    python -m studies.render --check      fail if a page is not what its template and its results make

A study measures, writes `studies/results/NAME.json` and renders its page. The words stand in
`studies/templates/NAME.md.jinja`, the numbers in the JSON file, and a test holds every page to both.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import platform
import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jinja2

ROOT = Path(__file__).parents[1]
STUDIES = ROOT / "studies"
DATA = Path(os.environ.get("FFCOMP_DATA", ROOT.parent / "shared" / "data"))  # of others, not part of the project
TEMPLATES, RESULTS, REPORTS = STUDIES / "templates", STUDIES / "results", STUDIES / "reports"
SUMMARIES = {"accuracy": "docs/ACCURACY.md"}
"""Pages that every user may want to read; the others are reports beside the studies."""
PAGES = tuple(sorted(path.name.removesuffix(".md.jinja") for path in TEMPLATES.glob("*.md.jinja")))
WIDTH = 120  # of a line of a paragraph
DIGITS = 6  # significant ones in a result


def formatted(value: Any, spec: str) -> str:
    """Format a value by a specification of Python's, such as `.2f` or `+.1%`; a missing one is empty."""
    return "" if value is None else format(value, spec)


def filled(text: str) -> str:
    """Fill the lines of a paragraph anew: numbers have any length."""
    return textwrap.fill(" ".join(text.split()), WIDTH, break_long_words=False, break_on_hyphens=False) + "\n"


ENVIRONMENT = jinja2.Environment(
    loader=jinja2.FileSystemLoader(TEMPLATES),
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
ENVIRONMENT.filters["fmt"] = formatted
ENVIRONMENT.filters["fill"] = filled


def page_of(name: str) -> Path:
    """Return the path of a page."""
    return ROOT / SUMMARIES[name] if name in SUMMARIES else REPORTS / f"{name}.md"


def results_of(name: str) -> dict[str, Any]:
    """Read what was measured for a page."""
    loaded: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return loaded


def rendered(name: str) -> str:
    """Render a page from its template and its results."""
    return ENVIRONMENT.get_template(f"{name}.md.jinja").render(results_of(name))


def write_page(name: str) -> None:
    """Render a page into its file."""
    page_of(name).write_text(rendered(name), encoding="utf-8")


def save(name: str, results: Mapping[str, Any]) -> None:
    """Write the results of a study, with the version of Python that measured them, and render their page.

    Keys that the file has and `results` has not stay as they are: a study may measure a part.
    """
    path = RESULTS / f"{name}.json"
    before = results_of(name) if path.exists() else {}
    values = before | plain(dict(results)) | {"python": platform.python_version()}
    path.write_text(json.dumps(values, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    write_page(name)
    print(f"{path.relative_to(ROOT)} and {page_of(name).relative_to(ROOT)} are written.", file=sys.stderr)


def plain(value: Any) -> Any:
    """Turn dataclasses, arrays and numpy's numbers into what JSON has, rounded to six significant digits."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.asdict(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return value


def stale() -> list[str]:
    """Name the pages that differ from what their templates and results make."""
    return [name for name in PAGES if page_of(name).read_text(encoding="utf-8") != rendered(name)]


def main() -> None:
    """Write or check pages."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", nargs="*", metavar="PAGE", help=", ".join(PAGES))
    parser.add_argument("--all", action="store_true", help="write all pages")
    parser.add_argument("--check", action="store_true", help="fail if a page is not what it should be")
    options = parser.parse_args()
    if unknown := set(options.pages) - set(PAGES):
        parser.error(f"no such page: {', '.join(sorted(unknown))}; there are {', '.join(PAGES)}")
    if options.check:
        if found := stale():
            sys.exit(
                f"Not what template and results make: {', '.join(found)}. Write with python -m studies.render --all"
            )
        return
    for name in PAGES if options.all else options.pages:
        write_page(name)
    if not (options.all or options.pages):
        print(*(f"{name}: {page_of(name).relative_to(ROOT)}" for name in PAGES), sep="\n")


if __name__ == "__main__":
    main()
