"""`ffcomp compare`: evaluate ffcomp and every input shaper on one print."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ffcomp.cli.command import Shown, verb
from ffcomp.cli.common import exit_codes, print_json, say
from ffcomp.cli.progress import Progress
from ffcomp.comparison.request import CompareRequest
from ffcomp.errors import RequestError
from ffcomp.options import REPORT
from ffcomp.request import OUTPUT, Option, Request

if TYPE_CHECKING:
    from ffcomp.comparison.result import Comparison


@dataclass(frozen=True, kw_only=True)
class Pages(Request):
    """What is written of a comparison."""

    report: Annotated[Path | None, REPORT] = None
    figures: Annotated[
        Path | None, Option("Write every figure as PNG and SVG into this folder.", OUTPUT, metavar="DIR")
    ] = None


@verb
def compare(request: CompareRequest, pages: Pages, shown: Shown) -> None:
    """Compare ffcomp with every input shaper on your print.

    Every method plans its command with --machine and is evaluated on a simulated printer (--plant), never on the
    model that made the command. Shapers get the frequencies of the firmware's own calibration, and the best ones that
    a search finds with the printer known. The table shows the contour error and how fast each method could go.
    With --mismatch, --jobs and --scheduler share the perturbed printers; all else uses every processor as it is.

    Example: ffcomp compare sample_prints/ringing_tower.gcode -m mp-delta-pro --sample 10% --report report.html
    """
    if (request.jobs > 1 or request.scheduler) and not request.mismatch:
        raise RequestError(
            "--jobs and --scheduler share the printers of --mismatch; all else uses every processor as it is."
        )
    _check_targets(pages.report, pages.figures)

    from ffcomp.api.comparison import compare_print

    with _ExitWithoutThreads(), exit_codes(), Progress(1.0, shown.quiet, "comparing") as progress:
        comparison = compare_print(replace(request, progress=progress.phase), partial(_note, quiet=shown.quiet))
    written = _write(comparison, pages)
    if shown.as_json:
        names = {
            "report": _text(pages.report),  # text or null: the page that was written
            "figures": [str(path) for path in written],  # list of text: the files that were written
        }
        print_json({**comparison.to_dict(), **names})
    elif not shown.quiet:
        _print(comparison, pages.report, written)


def _note(sentence: str, quiet: bool) -> None:
    say(f"ffcomp: {sentence}", quiet)


class _ExitWithoutThreads:
    """Exit at an interruption without waiting for searches that run in threads; nothing of theirs is on disk."""

    def __enter__(self) -> None: ...

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, SystemExit) and error.code == 130:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(130)


def _check_targets(report: Path | None, figures: Path | None) -> None:
    """Refuse, before the work, targets that cannot be written."""
    for path in (report, figures):
        parent = None if path is None else path.resolve().parent
        if parent is not None and not parent.is_dir():
            raise FileNotFoundError(2, "No such folder", str(parent))
    if figures is not None and figures.exists() and not figures.is_dir():
        raise NotADirectoryError(20, "Not a folder", str(figures))
    if report is not None and report.is_dir():
        raise IsADirectoryError(21, "Is a folder, not a file to write", str(report))


def _write(result: Comparison, pages: Pages) -> list[Path]:
    written: list[Path] = []
    figures, report = pages.figures, pages.report
    if figures is not None:
        from ffcomp.report.compare.figures import write_figures

        figures.mkdir(exist_ok=True)
        written = write_figures(result, figures)
    if report is not None:
        from ffcomp.report.compare.html import write_report

        write_report(result, report)
    return written


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)


def _print(result: Comparison, report: Path | None, written: list[Path]) -> None:
    from rich.console import Console
    from rich.table import Table

    from ffcomp.report.compare.sentences import answer, verdict

    console = Console()
    console.print(str(answer(result)), highlight=False, markup=False)
    for sentence in verdict(result):
        console.print(sentence, highlight=False, markup=False)
    table = Table("method", box=None, padding=(0, 1, 0, 0))
    for column in _columns(result):
        table.add_column(column, justify="right", no_wrap=True)
    family = ""
    for method in result.methods.values():
        if family and method.family != family:
            table.add_row()
        family = method.family
        style = "bold" if method.name in (result.compensated, result.best_fixed) else ""
        table.add_row(
            "ffcomp" if method.name == result.compensated else method.name, *_cells(result, method.name), style=style
        )
    console.print(table)
    console.print(_legend(result), highlight=False)
    if report is not None:
        console.print(f"Report: {report}", highlight=False, markup=False)
    if written:
        console.print(f"{len(written)} figures in {written[0].parent}", highlight=False, markup=False)


def _columns(result: Comparison) -> list[str]:
    columns = ["rms", "p99", "max", "track", "ring", "peak"]
    if result.mismatch:
        columns += ["off", "worst"]
    if result.quality_bound_um:
        columns += ["m/s²", "time"]
    return columns


def _legend(result: Comparison) -> str:
    """Explain the columns."""
    from ffcomp.report.compare.words import where_seen

    parts = [
        f"µm. rms, p99, max: distance to the reference path, {where_seen(result)}; track: over all moves at equal "
        "times, constant delay removed, so that it counts what comes late where a limit slows down, and is not off; "
        "ring: what still swings in straight cruise; peak: m/s² asked of a carriage ('!': beyond its limit)."
    ]
    if result.mismatch:
        parts.append("off, worst: contour rms on Monte-Carlo plants, median and worst.")
    if result.quality_bound_um:
        bound = f"{result.quality_bound_um:g} µm"
        parts.append(f"m/s², time: the highest acceleration that keeps p99 below {bound}, and its print time, s.")
    return " ".join(parts)


def _cells(result: Comparison, name: str) -> list[str]:
    from ffcomp.report.compare.words import seen

    method = result.methods[name]
    t, shown, over = method.track, seen(result, method), "" if method.peaks.within_limits else "!"
    cells = [
        f"{shown.contour_rms_um:.2f}",
        f"{shown.contour_p99_um:.1f}",
        f"{shown.contour_max_um:.0f}",
        f"{t.tracking_rms_no_delay_um:.1f}",
        f"{method.residual_rms_um:.1f}",
        f"{method.peaks.acceleration_mm_per_s2 / 1e3:.1f}{over}",
    ]
    if result.mismatch and method.spread is not None:
        cells += [f"{method.spread.median_um:.1f}", f"{method.spread.worst_um:.1f}"]
    if (quality := method.equal_quality) is not None:
        sign = ">" if quality.capped else "" if quality.reached else "<"
        cells += [f"{sign}{quality.acceleration_mm_per_s2 / 1e3:.1f}", f"{quality.print_time_s:.0f}"]
    return cells
