"""Show how a search goes: on a terminal a bar of its stages and what is being tried, elsewhere a line a result."""

from __future__ import annotations

import os
import sys
from types import TracebackType

from ffcomp.cli.common import say
from ffcomp.cli.log import note
from ffcomp.diagnose.progress import STAGES, Now, Stage


class SearchProgress:
    """Take the sentences of a search; nothing is shown if quiet.

    How long it takes depends on what is found, so the time that has passed is shown, not what is left.
    """

    def __init__(self, quiet: bool) -> None:
        self.quiet = quiet
        self.live = sys.stderr.isatty() and not os.environ.get("SLIC3R_PP_HOST")

    def __enter__(self) -> SearchProgress:
        if self.live and not self.quiet:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            columns = (BarColumn(20), TextColumn("{task.fields[stage]}"), TimeElapsedColumn())
            self.bar = Progress(
                *columns, TextColumn("{task.description}"), console=Console(stderr=True), transient=True
            )
            self.bar.start()
            self.task = self.bar.add_task("reading the recordings", total=STAGES, stage=f"0/{STAGES}")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.live and not self.quiet:
            self.bar.stop()

    def __call__(self, sentence: str) -> None:
        """Show a stage, what is being tried, or a result."""
        if not self.live or self.quiet:
            if not isinstance(sentence, Now):
                say(f"ffcomp: {sentence}", self.quiet)
        elif isinstance(sentence, Stage):
            done = sentence.number - 1
            note(f"ffcomp: {sentence}")
            self.bar.update(
                self.task, completed=done, stage=f"{sentence.number}/{STAGES}", description=str(sentence), refresh=True
            )
        elif isinstance(sentence, Now):
            self.bar.update(self.task, description=str(sentence), refresh=True)
        else:
            note(f"ffcomp: {sentence}")
            self.bar.console.print(f"ffcomp: {sentence}", markup=False, highlight=False)
