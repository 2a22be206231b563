"""What a verb answers, said once: the terminal, `--json`, the page of `ffcomp serve` and Python show the same words.

A verb's result is a frozen dataclass that inherits from `Result` and says what it has found as properties.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

from ffcomp.errors import RequestError, missing_extras_explained
from ffcomp.numerics.serialise import json_object, to_json
from gcode.atomic_write import replace_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Fact = tuple[str, str]  # a name and a value with its unit


@dataclass(frozen=True, slots=True)
class Answer:
    """The part of a result that people read."""

    headline: str = ""  # the finding in a sentence
    facts: Sequence[Fact] = ()  # list of lists of text: pairs of a name and a value with its unit
    warnings: Sequence[str] = ()  # sentences: whatever is unknown, unproven or not compensated, with the remedy
    next_steps: Sequence[str] = ()  # sentences: what to do next

    def lines(self) -> Iterator[str]:
        """Return it as text: the warnings first, a line for each fact."""
        yield from (f"Warning: {each}" for each in self.warnings)
        if self.headline:
            yield self.headline
        width = max((len(name) for name, _ in self.facts), default=0)
        yield from (f"  {name:{width}}  {value}" for name, value in self.facts)
        yield from self.next_steps


def clock(seconds: float) -> str:
    """Return a duration as people say it."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def time_left(seconds: float) -> str:
    """Say the time left in round numbers: `about 40 s left`."""
    step = 5.0 if seconds < 60.0 else 15.0 if seconds < 300.0 else 60.0
    rounded = max(step * round(seconds / step), step)
    return f"about {rounded:.0f} s left" if rounded < 120 else f"about {rounded / 60:.0f} min left"


def named(place: str) -> Callable[..., Any]:
    """Import a function that is named `module:function`."""
    module, _, function = place.partition(":")
    return cast("Callable[..., Any]", getattr(import_module(module), function))


class Result:
    """The result of a verb."""

    schema: ClassVar[str] = ""  # of the JSON object, whose other keys are `json_keys`
    json_keys: ClassVar[Mapping[str, str]] = {}
    # figures: by name, the module and the function that draws it, `module:function`
    drawn_by: ClassVar[Mapping[str, str]] = {}
    title: ClassVar[str] = ""  # of its page
    page_by: ClassVar[str] = "ffcomp.report.page:plain"  # the function that makes a Page of it, `module:function`

    @property
    def headline(self) -> str:
        """The finding in a sentence."""
        return ""

    @property
    def facts(self) -> Sequence[Fact]:
        """Pairs of a name and a value with its unit."""
        return ()

    @property
    def warnings(self) -> Sequence[str]:
        """Sentences: whatever is unknown, unproven or not compensated, with the remedy."""
        return ()

    @property
    def warning_lines(self) -> Sequence[str]:
        """The warnings, shortened to what a person will read."""
        return self.warnings

    @property
    def next_steps(self) -> Sequence[str]:
        """Sentences: what to do next."""
        return ()

    @property
    def failure(self) -> Exception | None:
        """The error that ends the command after this answer; None: success."""
        return None

    @property
    def answer(self) -> Answer:
        """What people are shown, wherever they look."""
        return Answer(self.headline, self.facts, self.warning_lines, self.next_steps)

    def figures(self) -> Sequence[str]:
        """Return the names of the figures that `plot` draws."""
        return tuple(self.drawn_by)

    @missing_extras_explained()
    def plot(self, name: str = "", **options: Any) -> Figure:
        """Draw a figure with Matplotlib.

        Parameters
        ----------
        name : one of `figures()`; empty: the first
        options : of the function that draws it

        Raises
        ------
        RequestError
            If there is no such figure.
        """
        names = self.figures()
        if name not in ("", *names) or not names:
            raise RequestError(f"There is no figure {name!r} of this result, but {', '.join(names) or 'none'}.")
        figure: Figure = named(self.drawn_by[name or names[0]])(self, **options)
        return figure

    @missing_extras_explained()
    def write_figure(self, path: str | Path, name: str = "", **options: Any) -> None:
        """Write a figure of `plot`; the suffix of the path names the format."""
        named("ffcomp.report.drawing:write_figure")(self.plot(name, **options), Path(path))

    @missing_extras_explained()
    def write_report(self, path: str | Path) -> None:
        """Write the answer and its figures as one HTML page that opens offline."""
        replace_atomically(Path(path), [named(self.page_by)(self).html(self.answer)])

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object that `--json` prints."""
        return {"schema": self.schema, **json_object(self), "answer": to_json(self.answer)}

    def objects(self) -> Sequence[dict[str, Any]]:
        """Return the JSON objects that `--json` prints, one a line."""
        return [self.to_dict()]

    def __repr__(self) -> str:
        """Return the headline."""
        return f"<{type(self).__name__}: {self.headline}>"

    def _repr_html_(self) -> str:
        """Return the answer as HTML, for notebooks."""
        facts = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in self.facts)
        others = "".join(f"<li>{escape(each)}</li>" for each in (*self.warning_lines, *self.next_steps))
        return f"<p><b>{escape(self.headline)}</b></p><table>{facts}</table><ul>{others}</ul>"
