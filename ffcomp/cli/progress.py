"""Progress of a verb: a bar on a terminal, lines elsewhere (a slicer's log), nothing if quiet.

The environment variable FFCOMP_EVENTS names a file for programs: each line is an `Event`, and nothing is printed.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from statistics import median_low
from types import TracebackType
from typing import TYPE_CHECKING, Self

from ffcomp.cli.common import is_quiet, report
from ffcomp.cli.log import note
from ffcomp.numerics.stages import Now, Pace, Stage
from ffcomp.result import time_left

if TYPE_CHECKING:
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

STEADY_S = 5.0  # of work before the first estimate of the time left
RECENT = 200  # reports that the pace is taken from
STALL = 4.0  # times the usual pace: a report that took longer waited for a compiler, and does not count


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


class Progress:
    """Progress of work of known size: a bar during a `with` block, or a line after each tenth, with the time left."""

    bar: Bar
    task: TaskID

    def __init__(self, total_s: float, what: str = "compensating") -> None:
        self.live = not is_quiet() and sys.stderr.isatty() and not os.environ.get("SLIC3R_PP_HOST")
        self.total_s, self.what = max(total_s, 1e-9), what
        self.tenths = 0
        self.last: tuple[float, float] | None = None  # time and work done at the last report
        self.recent: deque[tuple[float, float]] = deque(maxlen=RECENT)  # time and work since the report before

    def __enter__(self) -> Self:
        if self.live:
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as RichProgress

            texts = [TextColumn(text) for text in ("{task.percentage:3.0f} %", "{task.fields[left]}{task.description}")]
            columns = BarColumn(20), texts[0], TimeElapsedColumn(), texts[1]
            self.bar = RichProgress(*columns, console=Console(stderr=True), transient=True)
            self.task = self.bar.add_task(self.what, total=1.0, left="")
            self.bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.live:
            self.bar.stop()

    def show(self, what: str, share: float, left_s: float | None) -> bool:
        """Show the stage on the bar, or report it to a program; return whether there was either."""
        if not self.live:
            return Event(what, min(share, 1.0), left_s).write()
        left = "" if left_s is None else f"{time_left(left_s)}: "
        self.bar.update(self.task, completed=share, description=what, left=left, refresh=True)
        return True

    def left_s(self, done_s: float) -> float | None:
        """Return the time left by the pace of the last reports, without compilation; None: unknown, or done."""
        now = time.monotonic()
        since, before = self.last or (now, done_s)
        if done_s > before:
            self.recent.append((now - since, done_s - before))
        if self.last is None or done_s > before:
            self.last = now, done_s
        usual = median_low([took / work for took, work in self.recent] or [0.0])
        steady = [(took, work) for took, work in self.recent if took <= STALL * usual * work]
        took, work = map(sum, zip(*steady, strict=True)) if steady else (0.0, 0.0)
        return None if took < STEADY_S or done_s >= self.total_s else took / work * (self.total_s - done_s)

    def __call__(self, done_s: float) -> None:
        """Show how much is done."""
        left_s, tenth = self.left_s(done_s), int(10 * done_s / self.total_s)
        if not self.show(self.what, done_s / self.total_s, left_s) and tenth > self.tenths:
            self.tenths = tenth
            self.line(f"{min(10 * tenth, 100)} %{'' if left_s is None else f', {time_left(left_s)}'}")

    def phase(self, what: str, share: float) -> None:
        """Show the current stage in words, and the share of all work that is done (0 to 1)."""
        if what != self.what:
            self.what = what
            if not self.show(what, share, None):
                self.line(f"{what} …")
        self(share * self.total_s)

    def line(self, text: str) -> None:
        """Print a line, unless it is quiet; the log does without."""
        if not is_quiet():
            print(f"ffcomp: {text}", file=sys.stderr)


class SearchProgress(Progress):
    """Progress of a search, from its sentences; nothing is shown if quiet.

    The duration depends on the findings: the time left is the usual one, corrected by the pace of the finished stages.
    """

    def __init__(self, usual_s: Sequence[float], first: str = "reading the recordings") -> None:
        """Take the usual time of each stage in s, and the name of the work before the first."""
        super().__init__(1.0, first)
        self.pace, self.begun = Pace(usual_s), time.monotonic()

    def __call__(self, sentence: str | float) -> None:
        """Show a stage, a trial or a result."""
        now_s, passing = time.monotonic() - self.begun, isinstance(sentence, Stage | Now)
        if isinstance(sentence, Stage):
            self.pace.begin(sentence.number, now_s)
            self.what = f"{sentence.number}/{self.pace.stages} "
        whole_s = max(self.pace.whole_s(now_s), 1e-9)
        if passing or not self.live:
            stage = self.what if self.live else ""
            self.show(f"{stage}{sentence}", now_s / whole_s, whole_s - now_s if now_s >= STEADY_S else None)
        else:
            self.bar.console.print(f"ffcomp: {sentence}", markup=False, highlight=False)
        if not isinstance(sentence, Now):
            note(f"ffcomp: {sentence}") if self.live else report(str(sentence))
