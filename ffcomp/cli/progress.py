"""How far a verb is: on a terminal a bar, elsewhere (a slicer's log) lines, nothing if quiet."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Self

from ffcomp.cli.common import say
from ffcomp.cli.log import note
from ffcomp.numerics.stages import Now, Pace, Stage

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import ProgressColumn, TaskID

ROUND_S = ((60.0, 5.0), (300.0, 15.0), (float("inf"), 60.0))  # up to so many seconds, to multiples of these


def new_bar(*columns: ProgressColumn) -> Bar:
    """Make a bar on stderr that is gone when the work is done."""
    from rich.console import Console
    from rich.progress import Progress

    return Progress(*columns, console=Console(stderr=True), transient=True)


class Shown:
    """A bar for as long as a `with` lasts, where a person looks at a terminal (`live`)."""

    bar: Bar
    task: TaskID

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self.live = not quiet and sys.stderr.isatty() and not os.environ.get("SLIC3R_PP_HOST")
        self.begun = time.monotonic()

    def make(self) -> tuple[Bar, TaskID]:
        """Make the bar, and what it shows."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        if self.live:
            self.bar, self.task = self.make()
            self.bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.live:
            self.bar.stop()


class Progress(Shown):
    """The share of work whose size is known; elsewhere a line a tenth, with the time left."""

    def __init__(self, total_s: float, quiet: bool, what: str = "compensating") -> None:
        super().__init__(quiet)
        self.total_s, self.what = max(total_s, 1e-9), what
        self.tenths = 0

    def make(self) -> tuple[Bar, TaskID]:
        """Make a bar with the share that is done and the time left."""
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

        share = TextColumn("{task.percentage:3.0f} %")
        bar = new_bar(TextColumn("{task.description}"), BarColumn(), share, TimeRemainingColumn())
        return bar, bar.add_task(self.what, total=self.total_s)

    def __call__(self, done_s: float) -> None:
        """Show how much is done."""
        if self.live:
            self.bar.update(self.task, completed=done_s)
            return
        tenth = int(10 * done_s / self.total_s)
        if tenth > self.tenths and not self.quiet:
            self.tenths = tenth
            left = (time.monotonic() - self.begun) * (self.total_s / done_s - 1)
            print(f"ffcomp: {min(10 * tenth, 100)} %, {max(left, 0):.0f} s left", file=sys.stderr)

    def phase(self, what: str, share: float) -> None:
        """Show the current stage in words, and the share of the whole that is done (0 to 1)."""
        if self.live:
            self.bar.update(self.task, completed=share * self.total_s, description=what)
            return
        if what != self.what and not self.quiet:
            self.what = what
            print(f"ffcomp: {what} …", file=sys.stderr)
        self(share * self.total_s)


class SearchProgress(Shown):
    """Take the sentences of a search; nothing is shown if quiet.

    How long it takes depends on what is found: the time left is what is usual, corrected by the stages that are over.
    """

    def __init__(self, quiet: bool, usual_s: Sequence[float], first: str = "reading the recordings") -> None:
        """Take what each stage usually takes, s, and what is done before the first."""
        super().__init__(quiet)
        self.first, self.pace = first, Pace(usual_s)

    def make(self) -> tuple[Bar, TaskID]:
        """Make a bar with the stage, the time left, and what is being tried."""
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

        columns = (BarColumn(20), TextColumn("{task.fields[stage]}"), TimeElapsedColumn(), self._left())
        bar = new_bar(*columns, TextColumn("{task.description}"))
        return bar, bar.add_task(self.first, total=1.0, stage=f"0/{self.pace.stages}")

    def __call__(self, sentence: str) -> None:
        """Show a stage, what is being tried, or a result."""
        now_s = time.monotonic() - self.begun
        if isinstance(sentence, Stage):
            self.pace.begin(sentence.number, now_s)
        if not self.live:
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
