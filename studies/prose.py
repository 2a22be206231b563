"""Pages that scripts write: numbers have any length, so lines are filled at the end."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

WIDTH = 120
AS_IT_IS = ("|", "#", "!", "    ", "- ")


def filled(lines: Iterable[str]) -> str:
    """The page's text, with every paragraph filled anew; tables, headings, pictures, code and lists stay."""
    blocks = "\n".join(lines).strip().split("\n\n")
    return "\n\n".join(_filled(block.strip("\n")) for block in blocks) + "\n"


def _filled(block: str) -> str:
    if any(line.startswith(AS_IT_IS) for line in block.splitlines()):
        return block
    return textwrap.fill(" ".join(block.split()), WIDTH, break_long_words=False, break_on_hyphens=False)
