"""Progress of long work as sentences: some begin a stage, some are temporary."""

from __future__ import annotations

from collections.abc import Callable, Sequence

Progress = Callable[[str], None]
TRUST = 0.15  # of the whole: as much as this counts what such work usually takes, before its own pace is known


class Stage(str):
    """A sentence that begins a stage, numbered from 1; stages may be left out, or come again."""

    number: int

    def __new__(cls, number: int, sentence: str) -> Stage:
        """Make the sentence of a stage."""
        made = super().__new__(cls, sentence)
        made.number = number
        return made


class Now(str):
    """A sentence on the present trial, for a display that replaces it and not for a log."""


class Pace:
    """How long work in stages still takes, from how long its stages took and what they usually take."""

    def __init__(self, usual_s: Sequence[float]) -> None:
        """Keep the seconds that each stage usually takes."""
        self._usual_s, self._number, self._begun_s = list(usual_s), 1, 0.0

    @property
    def stages(self) -> int:
        """Number of stages."""
        return len(self._usual_s)

    def begin(self, number: int, at_s: float) -> None:
        """Note that a stage begins so long after the work has begun."""
        if number > self._number:
            self._number, self._begun_s = number, at_s

    def whole_s(self, now_s: float) -> float:
        """Return how long the whole work takes, as it looks now: no stage is over before it is."""
        usual = sum(self._usual_s)
        before = sum(self._usual_s[: self._number - 1]) / usual
        until = before + self._usual_s[self._number - 1] / usual
        expected = (self._begun_s + TRUST * usual) / (before + TRUST)
        return max(expected, now_s / until, now_s)
