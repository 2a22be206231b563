"""`ffcomp compare`: evaluate ffcomp and every input shaper on one print."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

from ffcomp.cli.command import Shown, verb
from ffcomp.cli.common import exit_codes, print_json, say
from ffcomp.cli.progress import Progress
from ffcomp.comparison.request import CompareRequest
from ffcomp.errors import RequestError
from ffcomp.options import CHANGE_SPEED, KEEP_SPEED, MAX_FLOW, MIN_LAYER_TIME, REPORT
from ffcomp.request import FASTER, OUTPUT, Option, Request

if TYPE_CHECKING:
    from ffcomp.comparison import engine
    from ffcomp.comparison.quickest import QuickestRequest
    from ffcomp.comparison.result import Comparison, Quickest, TimedMethod


@dataclass(frozen=True, kw_only=True)
class Pages(Request):
    """What is written of a comparison."""

    report: Annotated[Path | None, REPORT] = None
    figures: Annotated[
        Path | None, Option("Write every figure as PNG and SVG into this folder.", OUTPUT, metavar="DIR")
    ] = None


@dataclass(frozen=True, kw_only=True)
class EqualQuality(Request):
    """Whether every method prints as quickly as it can at the same error, and what all keep."""

    equal_quality: Annotated[
        bool,
        Option(
            "Instead of the table: how long the print takes at the same error (--quality-um) with every shaper, each "
            "sped up or slowed down as firmware can, and with ffcomp; and what nothing can be quicker than.",
            FASTER,
        ),
    ] = False
    max_flow_mm3_per_s: Annotated[float | None, MAX_FLOW] = None
    min_layer_time_s: Annotated[float | None, MIN_LAYER_TIME] = None
    keep_speed: Annotated[tuple[str, ...], KEEP_SPEED] = ()
    change_speed: Annotated[tuple[str, ...], CHANGE_SPEED] = ()

    def check(self) -> None:
        """Check that limits belong to a quicker print."""
        limits = (self.max_flow_mm3_per_s, self.min_layer_time_s, self.keep_speed, self.change_speed)
        if not self.equal_quality and limits != (None, None, (), ()):
            raise RequestError("Limits of a quicker print need --equal-quality.")


@verb
def compare(request: CompareRequest, quality: EqualQuality, pages: Pages, shown: Shown) -> None:
    """Compare ffcomp with every input shaper on your print.

    Every method plans its command with --machine and is evaluated on a simulated printer (--plant), never on the
    model that made the command. Shapers get the frequencies of the firmware's own calibration, and the best ones that
    a search finds with the printer known. The table shows the contour error and how fast each method could go.
    With --mismatch, --jobs and --scheduler share the perturbed printers; all else uses every processor as it is.

    Example: ffcomp compare sample_prints/ringing_tower.gcode -m mp-delta-pro --sample 10% --report report.html
    """
    _refuse_beside(request, quality, pages.figures)
    _check_targets(pages.report, pages.figures)

    from ffcomp.api.comparison import comparison_options, evaluate_print

    options = comparison_options(request)
    tell = partial(_note, quiet=shown.quiet)
    with _ExitWithoutThreads(), exit_codes(), Progress(1.0, shown.quiet, "comparing") as progress:
        request = replace(request, progress=progress.phase)
        if quality.equal_quality:
            from ffcomp.comparison.quickest import quickest

            result = evaluate_print(request, quickest, _quickest_request(options, quality), tell)
        else:
            from ffcomp.comparison.engine import compare as engine_compare
            from ffcomp.compensation.batch import workers

            with workers(request.jobs, request.scheduler) as at_once:
                comparison = evaluate_print(request, partial(engine_compare, jobs=at_once), options, tell)
    if quality.equal_quality:
        _report_quickest(result, pages.report, shown.as_json, shown.quiet)
        return
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


def _refuse_beside(request: CompareRequest, quality: EqualQuality, figures: Path | None) -> None:
    """Refuse options that say nothing together."""
    if quality.equal_quality and figures is not None:
        raise RequestError("--equal-quality has its figures on its page: --report, not --figures.")
    if quality.equal_quality and not request.quality_um:
        raise RequestError("--equal-quality needs an error that all may have: --quality-um above 0.")
    if (request.jobs > 1 or request.scheduler) and (quality.equal_quality or not request.mismatch):
        raise RequestError(
            "--jobs and --scheduler share the printers of --mismatch (not those of --equal-quality); "
            "all else uses every processor as it is."
        )


def _quickest_request(options: engine.Request, quality: EqualQuality) -> QuickestRequest:
    """Return the request at equal error: the same bound, part of the print and shapers."""
    from ffcomp.comparison.quickest import QuickestRequest
    from ffcomp.faster.bound import Bound
    from ffcomp.shapers.smooth import SHAPERS, USUAL

    bound = Bound(
        options.quality_bound_um,
        keep_speed=quality.keep_speed,
        max_flow_mm3_per_s=quality.max_flow_mm3_per_s,
        min_layer_time_s=quality.min_layer_time_s,
        change_speed=quality.change_speed,
    )
    shapers = tuple(name for name in options.only if name in SHAPERS)
    return QuickestRequest(bound, options.sampling, shapers or USUAL, options.mismatch, options.seeds)


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


# -- the same error with every method --


def _report_quickest(result: Quickest, report: Path | None, as_json: bool, quiet: bool) -> None:
    """Write the page, and print the answer."""
    if report is not None:
        from ffcomp.report.quickest.page import write_quickest

        write_quickest(result, report)
    if as_json:
        from ffcomp.report.quickest.words import answer

        print_json(
            {
                **result.to_dict(),
                "answer": answer(result),  # a sentence
                "report": _text(report),  # text or null: the page that was written
            }
        )
    elif not quiet:
        _print_quickest(result, report)


def _print_quickest(result: Quickest, report: Path | None) -> None:
    from rich.console import Console
    from rich.table import Table

    from ffcomp.report.quickest.words import answer, sentences

    console = Console()
    for sentence in (answer(result), *sentences(result)):
        console.print(sentence, highlight=False, markup=False)
    table = Table("method", box=None, padding=(0, 1, 0, 0))
    for column in ("time, s", "p99", "max", "feeds", "m/s²", *(("off", "worst") if result.mismatch else ())):
        table.add_column(column, justify="right", no_wrap=True)
    for each in (result.sliced, *result.methods.values()):
        table.add_row(*_quickest_cells(each), style="bold" if each.name in (result.best_shaper.name, "faster") else "")
    table.add_row("limit of the actuators", f"{result.actuator_limit_s:.0f}")
    console.print(table)
    off = " off, worst: p99 on printers that are off, median and worst." if result.mismatch else ""
    console.print(
        "time: of the whole print ('<': misses the bound even there); p99, max: distance to the path, µm; feeds: times "
        f"the slicer's; m/s²: the acceleration that the firmware is told.{off}",
        highlight=False,
    )
    if report is not None:
        console.print(f"Report: {report}", highlight=False, markup=False)


def _quickest_cells(each: TimedMethod) -> list[Any]:
    sign = "" if each.reached or each.name == "sliced" else "<"
    off = each.off_p99_um
    return [
        each.label,
        f"{sign}{each.print_time_s:.0f}",
        f"{each.contour_p99_um:.1f}",
        f"{each.contour_max_um:.0f}",
        "" if each.feed is None else f"×{each.feed:g}",
        "" if each.acceleration_mm_per_s2 is None else f"{each.acceleration_mm_per_s2 / 1e3:.1f}",
        *((f"{median(off):.1f}", f"{max(off):.1f}") if off else ()),
    ]
