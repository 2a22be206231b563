"""The page of every report: headline, facts, figures and tables in one file that opens offline and fetches nothing."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from ffcomp.report.drawing import Drawing, panels, svg
from ffcomp.result import Answer, Result
from ffcomp.version import __version__


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text; numbers are formatted by the verb."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page."""

    title: str
    drawings: Sequence[Drawing] = ()
    figures: Sequence[Figure] = ()  # with a title of their own
    tables: Sequence[Table] = ()
    sentences: Sequence[str] = ()
    code: str = ""  # text to copy
    folded: bool = False  # opened by a click


@dataclass(frozen=True, slots=True)
class Page:
    """A page: title, answer of a verb, drawings, figures and tables."""

    title: str  # the print or the machine
    about: Sequence[str] = ()  # short facts below the title
    sections: Sequence[Section] = ()
    answer: Answer | None = None  # in place of the result's own: names of files without their folders

    def html(self, answer: Answer) -> bytes:
        """Render it; the answer has the same words as in the terminal and JSON."""
        environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
        environment.filters |= {"said": said, "svg": svg, "panels": panels, "address": address}
        template = environment.from_string(resource("page.html.jinja"))
        about = [*self.about, f"ffcomp {__version__}"]
        shown = self.answer or answer
        return template.render(css=Markup(resource("page.css")), answer=shown, page=self, about=about).encode()


def plain(result: Result) -> Page:
    """Return the page of a verb that has no sections of its own: its figures."""
    figures = [result.plot(name) for name in result.figures()]
    title = result.title or result.schema.removeprefix("ffcomp-").partition("/")[0].replace("-", " ").capitalize()
    return Page(title, sections=[Section("", figures=figures)] if figures else [])


def resource(name: str) -> str:
    """Read a file of this package."""
    return files("ffcomp.report").joinpath(name).read_text(encoding="utf-8")


def address(image: bytes) -> str:
    """Return the address of an SVG image inside the page."""
    return f"data:image/svg+xml;base64,{base64.b64encode(image).decode('ascii')}"


def said(sentence: str) -> Markup:
    """Keep numbers and their units on one line, and set commands, in backticks or an option alone, as code."""
    tied = re.sub(r"(?<=\d) (?=(%|µm|mm|kg|N|Hz|mm/s|m/s²|s|min|h)\b|%|m/s²)", "\N{NO-BREAK SPACE}", sentence)
    parts = re.split(r"`([^`]+)`|(?<![\w-])(--[a-z][a-z-]*)", tied)
    pieces = [escape(parts[0])]
    for quoted, option, after in zip(parts[1::3], parts[2::3], parts[3::3], strict=True):
        pieces += [Markup("<code>{}</code>").format(quoted or option), escape(after)]
    return Markup("").join(pieces)
