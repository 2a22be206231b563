"""The page of every report: headline, facts, figures and tables in one file that opens offline and fetches nothing."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup, escape

from ffcomp.report.drawing import Drawing, svg
from ffcomp.result import Answer


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
    tables: Sequence[Table] = ()
    sentences: Sequence[str] = ()
    code: str = ""  # text to copy
    folded: bool = False  # opened by a click


def page(answer: Answer, title: str, about: Sequence[str], sections: Sequence[Section]) -> bytes:
    """Render a report.

    Parameters
    ----------
    answer : of the verb: the same words as in the terminal and JSON
    title : the print or the machine
    about : short facts below the title
    sections : after the answer
    """
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {"said": said, "picture": picture}
    template = environment.from_string(resource("page.html.jinja"))
    css = Markup(resource("page.css"))
    return template.render(css=css, answer=answer, title=title, about=about, sections=sections).encode()


def resource(name: str) -> str:
    """Read a file of this package."""
    return files("ffcomp.report").joinpath(name).read_text(encoding="utf-8")


def picture(drawing: Drawing) -> str:
    """Return a drawing as the address of an image inside the page."""
    return f"data:image/svg+xml;base64,{base64.b64encode(svg(drawing)).decode('ascii')}"


def said(sentence: str) -> Markup:
    """Keep numbers and their units on one line, and set commands, in backticks or an option alone, as code."""
    tied = re.sub(r"(?<=\d) (?=(%|µm|mm|kg|N|Hz|mm/s|m/s²|s|min|h)\b|%|m/s²)", "\N{NO-BREAK SPACE}", sentence)
    parts = re.split(r"`([^`]+)`|(?<![\w-])(--[a-z][a-z-]*)", tied)
    pieces = [escape(parts[0])]
    for quoted, option, after in zip(parts[1::3], parts[2::3], parts[3::3], strict=True):
        pieces += [Markup("<code>{}</code>").format(quoted or option), escape(after)]
    return Markup("").join(pieces)
