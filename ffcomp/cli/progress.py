"""Progress of a verb: a bar on a terminal, lines elsewhere (a slicer's log), nothing if quiet.

The environment variable FFCOMP_EVENTS names a file for programs: each line is an `Event`, and nothing is printed.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Self

from ffcomp.cli.common import is_quiet, report
from ffcomp.cli.log import note
from ffcomp.numerics.stages import Now, Pace, Stage

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import ProgressColumn, TaskID

STEADY_S = 5.0  # of work before the first estimate of the time left
ROUND_S = ((60.0, 5.0), (300.0, 15.0), (float("inf"), 60.0))  # time left below the first is rounded to the second


@dataclass(frozen=True, slots=True)
class Event:
    """Progress of a verb for programs: a JSON line of FFCOMP_EVENTS."""

    stage: str  # current work, in words
    share: float | None = None  # of the work that is done, 0 to 1; None: unknown
    left_s: float | None = None  # time left, s; None: unknown so far

    def write(self) -> bool:
        """Append it to the file of FFCOMP_EVENTS; return whether there is one. A full disk stops no work."""
        path = os.environ.get("FFCOMP_EVENTS", "")
        if path:
            with suppress(OSError), open(path, "a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(self), ensure_ascii=False) + "\n")
        return bool(path)


def new_bar(*columns: ProgressColumn) -> Bar:
    """Make a bar on stderr that disappears when the work is done."""
    from rich.console import Console
    from rich.progress import Progress

    return Progress(*columns, console=Console(stderr=True), transient=True)


class Shown:
    """A bar during a `with` block, if stderr is a terminal (`live`)."""

    bar: Bar
    task: TaskID

    def __init__(self) -> None:
        self.live = not is_quiet() and sys.stderr.isatty() and not os.environ.get("SLIC3R_PP_HOST")
        self.begun = time.monotonic()

    def make(self) -> tuple[Bar, TaskID]:
        """Make the bar and its task."""
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
    """Progress of work of known size: a bar, or a line after each tenth, with the time left."""

    def __init__(self, total_s: float, what: str = "compensating") -> None:
        super().__init__()
        self.total_s, self.what = max(total_s, 1e-9), what
        self.tenths = 0
        self.steady: tuple[float, float] | None = None  # time and work done at the first report

    def make(self) -> tuple[Bar, TaskID]:
        """Make a bar with the share that is done and the time left."""
        from rich.progress import BarColumn, TextColumn

        share, left = TextColumn("{task.percentage:3.0f} %"), TextColumn("{task.fields[left]}")
        bar = new_bar(TextColumn("{task.description}"), BarColumn(), share, left)
        return bar, bar.add_task(self.what, total=self.total_s, left="")

    def left_s(self, done_s: float) -> float | None:
        """Return the time left by the pace since the first report, which leaves out compilation."""
        now = time.monotonic()
        self.steady = self.steady or (now, done_s)
        since, before = self.steady
        if now - since < STEADY_S or done_s <= before:
            return None
        return (now - since) * max(self.total_s - done_s, 0.0) / (done_s - before)

    def __call__(self, done_s: float) -> None:
        """Show how much is done."""
        left_s, tenth = self.left_s(done_s), int(10 * done_s / self.total_s)
        left = "" if left_s is None else f", {left_s:.0f} s left"
        if self.live:
            self.bar.update(self.task, completed=done_s, left=left.removeprefix(", "))
        elif not Event(self.what, min(done_s / self.total_s, 1.0), left_s).write() and tenth > self.tenths:
            self.tenths = tenth
            if not is_quiet():
                print(f"ffcomp: {min(10 * tenth, 100)} %{left}", file=sys.stderr)

    def phase(self, what: str, share: float) -> None:
        """Show the current stage in words, and the share of all work that is done (0 to 1)."""
        if self.live:
            self.bar.update(self.task, completed=share * self.total_s, description=what)
            return
        if what != self.what:
            self.what = what
            if not Event(what, share).write() and not is_quiet():
                print(f"ffcomp: {what} …", file=sys.stderr)
        self(share * self.total_s)


class SearchProgress(Shown):
    """Progress of a search, from its sentences; nothing is shown if quiet.

    The duration depends on the findings: the time left is the usual one, corrected by the pace of the finished stages.
    """

    def __init__(self, usual_s: Sequence[float], first: str = "reading the recordings") -> None:
        """Take the usual time of each stage in s, and the name of the work before the first."""
        super().__init__()
        self.first, self.pace = first, Pace(usual_s)

    def make(self) -> tuple[Bar, TaskID]:
        """Make a bar with the stage, the time left and the current trial."""
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

        columns = (BarColumn(20), TextColumn("{task.fields[stage]}"), TimeElapsedColumn(), self._left())
        bar = new_bar(*columns, TextColumn("{task.description}"))
        return bar, bar.add_task(self.first, total=1.0, stage=f"0/{self.pace.stages}")

    def __call__(self, sentence: str) -> None:
        """Show a stage, a trial or a result."""
        now_s = time.monotonic() - self.begun
        if isinstance(sentence, Stage):
            self.pace.begin(sentence.number, now_s)
        done = now_s / max(self.pace.whole_s(now_s), 1e-9)
        if not self.live:
            Event(str(sentence), done, self.pace.whole_s(now_s) - now_s if now_s > STEADY_S else None).write()
            if not isinstance(sentence, Now):
                report(f"ffcomp: {sentence}")
            return
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
        """Return the time left in words: `about 40 s left`; nothing at the beginning."""
        now_s = time.monotonic() - self.begun
        if now_s < STEADY_S:
            return ""
        left_s = self.pace.whole_s(now_s) - now_s
        step = next(step for most, step in ROUND_S if left_s < most)
        seconds = max(step * round(left_s / step), step)
        return f"about {seconds:.0f} s left" if seconds < 120 else f"about {seconds / 60:.0f} min left"

    def _left(self) -> ProgressColumn:
        from rich.progress import ProgressColumn, Task
        from rich.text import Text

        left = self.left

        class Left(ProgressColumn):
            """The time left, computed each time that the bar is drawn."""

            def render(self, task: Task) -> Text:
                return Text(left())

        return Left()
