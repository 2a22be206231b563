"""Render pages: one file that opens offline, all text from files escaped, nothing fetched."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.resources import files
from typing import Any

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup, escape

FOLDER = "ffcomp.report"


def rendered(report: str, filters: dict[str, Callable[..., str]], **values: Any) -> bytes:
    """Render one report, `REPORT/report.html.jinja`, with the styles of all pages and its own."""
    environment = Environment(
        loader=FunctionLoader(resource),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"coded": coded} | filters
    css = Markup(resource("page.css") + resource(f"{report}/report.css"))
    template = environment.get_template(f"{report}/report.html.jinja")
    return template.render(css=css, today=datetime.now(UTC).strftime("%Y-%m-%d"), **values).encode()


def resource(name: str) -> str:
    """Read a file of the reports' folder."""
    return files(FOLDER).joinpath(name).read_text(encoding="utf-8")


def tied(sentence: str) -> str:
    """Keep numbers and their units on one line."""
    return re.sub(r"(?<=\d) (?=(%|µm|mm|kg|N|Hz|mm/s|m/s²|s|min|h)\b|%|m/s²)", "\N{NO-BREAK SPACE}", sentence)


def coded(sentence: str) -> Markup:
    """Set what is to be typed, in backticks or an option alone, as code, which CSS keeps on one line."""
    parts = re.split(r"`([^`]+)`|(?<![\w-])(--[a-z][a-z-]*)", sentence)
    pieces = [escape(parts[0])]
    for quoted, option, after in zip(parts[1::3], parts[2::3], parts[3::3], strict=True):
        pieces += [Markup("<code>{}</code>").format(quoted or option), escape(after)]
    return Markup("").join(pieces)
