"""Show how a search goes: on a terminal a bar of its stages and what is being tried, elsewhere a line a result."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING

from ffcomp.cli.common import say
from ffcomp.cli.log import note
from ffcomp.numerics.stages import Now, Pace, Stage

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

ROUND_S = ((60.0, 5.0), (300.0, 15.0), (float("inf"), 60.0))  # up to so many seconds, to multiples of these


class SearchProgress:
    """Take the sentences of a search; nothing is shown if quiet.

    How long it takes depends on what is found: the time left is what is usual, corrected by the stages that are over.
    """

    def __init__(self, quiet: bool, usual_s: Sequence[float], first: str = "reading the recordings") -> None:
        """Take what each stage usually takes, s, and what is done before the first."""
        self.quiet, self.first, self.pace = quiet, first, Pace(usual_s)
        self.live = sys.stderr.isatty() and not os.environ.get("SLIC3R_PP_HOST")
        self.begun = time.monotonic()

    def __enter__(self) -> SearchProgress:
        if self.live and not self.quiet:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            columns = (BarColumn(20), TextColumn("{task.fields[stage]}"), TimeElapsedColumn(), self._left())
            self.bar = Progress(
                *columns, TextColumn("{task.description}"), console=Console(stderr=True), transient=True
            )
            self.bar.start()
            self.task = self.bar.add_task(self.first, total=1.0, stage=f"0/{self.pace.stages}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.live and not self.quiet:
            self.bar.stop()

    def __call__(self, sentence: str) -> None:
        """Show a stage, what is being tried, or a result."""
        now_s = time.monotonic() - self.begun
        if isinstance(sentence, Stage):
            self.pace.begin(sentence.number, now_s)
        if not self.live or self.quiet:
            if not isinstance(sentence, Now):
                say(f"ffcomp: {sentence}", self.quiet)
            return
        done = now_s / max(self.pace.whole_s(now_s), 1e-9)
        if isinstance(sentence, Stage):
            note(f"ffcomp: {sentence}")
            stage = f"{sentence.number}/{self.pace.stages}"
            self.bar.update(self.task, completed=done, stage=stage, description=str(sentence), refresh=True)
        elif isinstance(sentence, Now):
            self.bar.update(self.task, completed=done, description=str(sentence), refresh=True)
        else:
            note(f"ffcomp: {sentence}")
            self.bar.console.print(f"ffcomp: {sentence}", markup=False, highlight=False)

    def left(self) -> str:
        """Return the time left in words: `about 40 s left`."""
        now_s = time.monotonic() - self.begun
        left_s = self.pace.whole_s(now_s) - now_s
        step = next(step for most, step in ROUND_S if left_s < most)
        seconds = max(step * round(left_s / step), step)
        return f"about {seconds:.0f} s left" if seconds < 120 else f"about {seconds / 60:.0f} min left"

    def _left(self) -> ProgressColumn:
        from rich.progress import ProgressColumn, Task
        from rich.text import Text

        left = self.left

        class Left(ProgressColumn):
            """The time left, told anew each time that the bar is drawn."""

            def render(self, task: Task) -> Text:
                return Text(left())

        return Left()
