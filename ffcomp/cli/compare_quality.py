"""`ffcomp compare --equal-quality`: how long the print takes with every method at the same error."""

from __future__ import annotations

from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ffcomp.request import FASTER

if TYPE_CHECKING:
    from ffcomp.compare.engine import Request
    from ffcomp.compare.quickest import QuickestRequest
    from ffcomp.compare.result import Quickest, TimedMethod
    from ffcomp.faster.bound import Bound

EqualQuality = Annotated[
    bool,
    typer.Option(
        "--equal-quality",
        rich_help_panel=FASTER,
        help="Instead of the table: how long the print takes at the same error (--quality-um) with every shaper, each "
        "sped up or slowed down as firmware can, and with ffcomp; and what nothing can be quicker than.",
    ),
]


def limits_of(
    flow: float | None, layer_time_s: float | None, keep_speed: list[str] | None, change_speed: list[str] | None
) -> Bound:
    """Return what every method keeps; the error is filled in by `quickest_request`."""
    from ffcomp.faster.bound import Bound

    return Bound(
        25.0,
        keep_speed=tuple(keep_speed or ()),
        max_flow_mm3_per_s=flow,
        min_layer_time_s=layer_time_s,
        change_speed=tuple(change_speed or ()),
    )


def refuse_beside(equal_quality: bool, request: Request, limits: Bound, figures: Path | None) -> None:
    """Refuse options that say nothing together."""
    from ffcomp.faster.bound import Bound

    if not equal_quality:
        if limits != Bound(25.0):
            raise typer.BadParameter("Limits of a quicker print need --equal-quality.")
        return
    if figures is not None:
        raise typer.BadParameter("--equal-quality has its figures on its page: --report, not --figures.")
    if not request.quality_bound_um:
        raise typer.BadParameter("--equal-quality needs an error that all may have: --quality-um above 0.")


def refuse_workers(asked: bool, equal_quality: bool, request: Request) -> None:
    """Refuse --jobs and --scheduler where they would change nothing."""
    if asked and (equal_quality or not request.seeds):
        raise typer.BadParameter(
            "--jobs and --scheduler share the printers of --mismatch (not those of --equal-quality); "
            "all else uses every processor as it is."
        )


def quickest_request(request: Request, limits: Bound) -> QuickestRequest:
    """Return the request at equal error: the same bound, part of the print and shapers."""
    from dataclasses import replace

    from ffcomp.compare.methods import KINDS
    from ffcomp.compare.quickest import QuickestRequest
    from ffcomp.shapers.smooth import USUAL

    bound = replace(limits, max_error_um=request.quality_bound_um)
    shapers = tuple(name for name in request.only if name in KINDS)
    return QuickestRequest(bound, request.sampling, shapers or USUAL, request.mismatch, request.seeds)


def hand_over(found: Quickest, report: Path | None, as_json: bool, quiet: bool) -> None:
    """Write the page, and print the answer."""
    from ffcomp.cli.common import print_json

    if report is not None:
        from ffcomp.report.quickest.page import write_quickest

        write_quickest(found, report)
    if as_json:
        from ffcomp.report.quickest.words import answer

        said = {"answer": answer(found), "report": None if report is None else str(report)}
        print_json({**found.to_dict(), **said})
    elif not quiet:
        _print(found, report)


def _print(found: Quickest, report: Path | None) -> None:
    from rich.console import Console
    from rich.table import Table

    from ffcomp.report.quickest.words import answer, sentences

    console = Console()
    for sentence in (answer(found), *sentences(found)):
        console.print(sentence, highlight=False, markup=False)
    table = Table("method", box=None, padding=(0, 1, 0, 0))
    for column in ("time, s", "p99", "max", "feeds", "m/s²", *(("off", "worst") if found.mismatch else ())):
        table.add_column(column, justify="right", no_wrap=True)
    for each in (found.sliced, *found.methods.values()):
        table.add_row(*_cells(each), style="bold" if each.name in (found.best_shaper.name, "faster") else "")
    table.add_row("limit of the actuators", f"{found.actuator_limit_s:.0f}")
    console.print(table)
    off = " off, worst: p99 on printers that are off, median and worst." if found.mismatch else ""
    console.print(
        "time: of the whole print ('<': misses the bound even there); p99, max: distance to the path, µm; feeds: times "
        f"the slicer's; m/s²: the acceleration that the firmware is told.{off}",
        highlight=False,
    )
    if report is not None:
        console.print(f"Report: {report}", highlight=False, markup=False)


def _cells(each: TimedMethod) -> list[Any]:
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
