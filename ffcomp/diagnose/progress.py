"""What a search says while it works: sentences, of which some begin a stage and some hold only for now."""

from __future__ import annotations

from collections.abc import Callable

STAGES = 7

Progress = Callable[[str], None]


class Stage(str):
    """A sentence that begins a stage, numbered from 1 to STAGES; stages may be left out, or come again."""

    number: int

    def __new__(cls, number: int, sentence: str) -> Stage:
        """Make the sentence of a stage."""
        made = super().__new__(cls, sentence)
        made.number = number
        return made


class Now(str):
    """A sentence on what is being tried: for a display that replaces it, not for a log."""
