"""`ffcomp compare`: evaluate ffcomp and every input shaper on one print."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from ffcomp.cli.compare_quality import (
    EqualQuality,
    hand_over,
    limits_of,
    quickest_request,
    refuse_beside,
    refuse_workers,
)
from ffcomp.cli.faster_options import ChangeSpeed, KeepSpeed, MaxFlow, MinLayerTime
from ffcomp.cli.options import (
    AsJson,
    Flavor,
    Jobs,
    MachineName,
    Offset,
    Plant,
    Plate,
    Quiet,
    Report,
    Scheduler,
    SegmentRate,
    parsed_offset,
)
from ffcomp.request import ACCURACY, OUTPUT, SPEED

if TYPE_CHECKING:
    from ffcomp.compare.engine import Request
    from ffcomp.compare.result import Comparison
    from ffcomp.compare.sampling import Sampling

T = TypeVar("T")
Printed = Annotated[Path, typer.Argument(metavar="FILE", help="Sliced print. It is only read.")]
Mismatch = Annotated[
    str,
    typer.Option(
        metavar="SHARE",
        rich_help_panel=ACCURACY,
        help="Also evaluate on Monte-Carlo plants whose masses, stiffnesses, dampings and drives are all perturbed "
        "by this standard deviation, e.g. 10%.",
    ),
]
Seeds = Annotated[
    int,
    typer.Option(
        metavar="N", rich_help_panel=ACCURACY, min=1, max=1000, help="Number of Monte-Carlo plants of --mismatch."
    ),
]
Layers = Annotated[
    str,
    typer.Option(
        metavar="FIRST:LAST",
        rich_help_panel=SPEED,
        help="Evaluate these layers only, counted from 0, both included: 10:20, 5:, :3.",
    ),
]
Sample = Annotated[
    str,
    typer.Option(
        metavar="SHARE",
        rich_help_panel=SPEED,
        help="Evaluate this share of the time, in slices that stand for it, e.g. 5%. Default: 2 minutes at most.",
    ),
]
Figures = Annotated[
    Path | None,
    typer.Option(metavar="DIR", rich_help_panel=OUTPUT, help="Write every figure as PNG and SVG into this folder."),
]
Quality = Annotated[
    float,
    typer.Option(
        "--quality-um",
        metavar="UM",
        rich_help_panel=ACCURACY,
        min=0.0,
        help="Find the highest acceleration at which each method keeps 99 % of its contour error below this. 0: skip.",
    ),
]
Only = Annotated[
    str,
    typer.Option(
        metavar="NAMES",
        rich_help_panel=SPEED,
        help="Evaluate only these methods beside none and ffcomp, e.g. mzv,ei-calibrated. Shapers: zv, mzv, zvd, ei, "
        "2hump_ei, 3hump_ei, and, compared only when named, zvdd, zvddd (Marlin), smooth_zv, smooth_mzv, smooth_ei, "
        "smooth_2hump_ei, smooth_zvd_ei, smooth_si (Kalico's other branches); each also with -calibrated and "
        "-scheduled; with -z (z shaped too), -carriages (each carriage by itself) or, if smooth, -inverse and "
        "-inverse-z (one mode of x and y inverted), these also with -calibrated; fbs-lti, fbs-robust; all.",
    ),
]


def compare(
    file: Printed,
    machine: MachineName,
    plant: Plant = "",
    mismatch: Mismatch = "",
    seeds: Seeds = 20,
    layers: Layers = "",
    sample: Sample = "",
    report: Report = None,
    figures: Figures = None,
    quality_um: Quality = 25.0,
    only: Only = "",
    equal_quality: EqualQuality = False,
    max_flow_mm3_per_s: MaxFlow = None,
    min_layer_time_s: MinLayerTime = None,
    keep_speed: KeepSpeed = None,
    change_speed: ChangeSpeed = None,
    offset_mm: Offset = "0,0",
    flavor: Flavor = "",
    max_segments_per_second: SegmentRate = 250.0,
    plate: Plate = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = "",
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Compare ffcomp with every input shaper on your print.

    Every method plans its command with --machine and is evaluated on a simulated printer (--plant), never on the
    model that made the command. Shapers get the frequencies of the firmware's own calibration, and the best ones that
    a search finds with the printer known. The table shows the contour error and how fast each method could go.
    With --mismatch, --jobs and --scheduler share the perturbed printers; all else uses every processor as it is.

    Example: ffcomp compare sample_prints/ringing_tower.gcode -m mp-delta-pro --sample 10% --report report.html
    """
    from ffcomp.cli.common import exit_codes, print_json

    request = _request(mismatch, seeds, _sampling(layers, sample), quality_um, only)
    limits = limits_of(max_flow_mm3_per_s, min_layer_time_s, keep_speed, change_speed)
    refuse_beside(equal_quality, request, limits, figures)
    refuse_workers(jobs > 1 or bool(scheduler), equal_quality, request)
    with _ExitWithoutThreads(), exit_codes():
        _check_targets(report, figures)
        given = _Given(file, machine, plant, offset_mm, flavor, max_segments_per_second, plate, quiet)
        if equal_quality:
            from ffcomp.compare.quickest import quickest

            hand_over(_evaluated(given, quickest, quickest_request(request, limits)), report, as_json, quiet)
            return
        from ffcomp.compare.engine import compare as engine
        from ffcomp.compensate.batch import workers

        with workers(jobs, scheduler) as at_once:
            found = _evaluated(given, partial(engine, jobs=at_once), request)
        written = _write(found, report, figures)
        if as_json:
            print_json({**found.to_dict(), "report": _text(report), "figures": [str(path) for path in written]})
        elif not quiet:
            _print(found, report, written)


class _ExitWithoutThreads:
    """Exit at an interruption without waiting for searches that run in threads; nothing of theirs is on disk."""

    def __enter__(self) -> None: ...

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, SystemExit) and error.code == 130:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(130)


def _share(text: str, option: str) -> float:
    """`10%` or `0.1`."""
    try:
        value = float(text[:-1]) / 100 if text.endswith("%") else float(text)
    except ValueError:
        raise typer.BadParameter(f"{option} {text!r}: a share such as 10% or 0.1.") from None
    if not 0.0 < value <= 1.0:
        raise typer.BadParameter(f"{option} {text}: a share above 0 and up to 100%.")
    return value


def _sampling(layers: str, sample: str) -> Sampling:
    from ffcomp.compare.sampling import Sampling

    first, colon, last = layers.partition(":")
    try:
        begin = int(first) if first else 0
        end = (int(last) if last else None) if colon else (begin if layers else None)
    except ValueError:
        raise typer.BadParameter(
            f"--layers {layers!r}: two layer numbers with a colon between them, e.g. 10:20."
        ) from None
    if begin < 0 or (end is not None and end < begin):
        raise typer.BadParameter(f"--layers {layers}: the first layer is 0, and the last must not be before the first.")
    return Sampling(begin, end, _share(sample, "--sample") if sample else None)


def _request(mismatch: str, seeds: int, sampling: Sampling, quality_um: float, only: str) -> Request:
    from ffcomp.compare.engine import Request, names

    off = _share(mismatch, "--mismatch") if mismatch else 0.0
    if off > 0.3:
        raise typer.BadParameter(f"--mismatch {mismatch}: up to 30 %; beyond it drawn masses come near to zero.")
    request = Request(sampling, off, seeds if off else 0, quality_um, tuple(filter(None, only.split(","))))
    try:
        names(request)
    except ValueError as error:
        raise typer.BadParameter(f"--only {only}: {error}") from None
    return request


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


@dataclass(frozen=True, slots=True)
class _Given:
    """What is compared."""

    file: Path
    machine: str
    plant: str
    offset: str
    flavor: str
    rate: float
    plate: int | None
    quiet: bool


def _evaluated(given: _Given, engine: Callable[..., T], request: Any) -> T:
    """Call an engine of `ffcomp/compare` with what the command line says."""
    from ffcomp.cli.common import Progress, say
    from ffcomp.inverse.settings import settings_for
    from gcode.container import read_bytes
    from gcode.embedded import STAMP_REACH, already_processed, find_offset, original
    from models.file import load_machine

    data, believed = read_bytes(given.file, given.plate), load_machine(given.machine)
    shift, true = parsed_offset(given.offset), load_machine(given.plant) if given.plant else None
    if already_processed(data) is not None:
        say(
            f"ffcomp: {given.file} is compensated already: what is compared is the original that it holds.", given.quiet
        )
        shift = shift if any(shift) else find_offset(data[:STAMP_REACH])
        data = original(data)
    options: dict[str, Any] = {"offset": shift, "flavor": given.flavor}
    with Progress(1.0, given.quiet, "comparing") as progress:
        options["settings"] = settings_for(believed, given.rate)
        return engine(data, str(given.file), believed, true, request, progress=progress.phase, **options)


def _write(found: Comparison, report: Path | None, figures: Path | None) -> list[Path]:
    written: list[Path] = []
    if figures is not None:
        from ffcomp.report.compare.figures import write_figures

        figures.mkdir(exist_ok=True)
        written = write_figures(found, figures)
    if report is not None:
        from ffcomp.report.compare.html import write_report

        write_report(found, report)
    return written


def _text(path: Path | None) -> str | None:
    return None if path is None else str(path)


def _print(found: Comparison, report: Path | None, written: list[Path]) -> None:
    from rich.console import Console
    from rich.table import Table

    from ffcomp.report.compare.sentences import answer, verdict

    console = Console()
    console.print(str(answer(found)), highlight=False, markup=False)
    for sentence in verdict(found):
        console.print(sentence, highlight=False, markup=False)
    table = Table("method", box=None, padding=(0, 1, 0, 0))
    for column in _columns(found):
        table.add_column(column, justify="right", no_wrap=True)
    family = ""
    for method in found.methods.values():
        if family and method.family != family:
            table.add_row()
        family = method.family
        style = "bold" if method.name in (found.compensated, found.best_fixed) else ""
        table.add_row(
            "ffcomp" if method.name == found.compensated else method.name, *_cells(found, method.name), style=style
        )
    console.print(table)
    console.print(_legend(found), highlight=False)
    if report is not None:
        console.print(f"Report: {report}", highlight=False, markup=False)
    if written:
        console.print(f"{len(written)} figures in {written[0].parent}", highlight=False, markup=False)


def _columns(found: Comparison) -> list[str]:
    columns = ["rms", "p99", "max", "track", "ring", "peak"]
    if found.mismatch:
        columns += ["off", "worst"]
    if found.quality_bound_um:
        columns += ["m/s²", "time"]
    return columns


def _legend(found: Comparison) -> str:
    """Explain the columns."""
    from ffcomp.report.compare.words import where_seen

    parts = [
        f"µm. rms, p99, max: distance to the reference path, {where_seen(found)}; track: over all moves at equal "
        "times, constant delay removed; ring: what still swings in straight cruise; peak: m/s² asked of a carriage "
        "('!': beyond its limit)."
    ]
    if found.mismatch:
        parts.append("off, worst: contour rms on Monte-Carlo plants, median and worst.")
    if found.quality_bound_um:
        bound = f"{found.quality_bound_um:g} µm"
        parts.append(f"m/s², time: the highest acceleration that keeps p99 below {bound}, and its print time, s.")
    return " ".join(parts)


def _cells(found: Comparison, name: str) -> list[str]:
    from ffcomp.report.compare.words import seen

    method = found.methods[name]
    t, shown, over = method.track, seen(found, method), "" if method.peaks.within_limits else "!"
    cells = [
        f"{shown.contour_rms_um:.2f}",
        f"{shown.contour_p99_um:.1f}",
        f"{shown.contour_max_um:.0f}",
        f"{t.tracking_rms_no_delay_um:.1f}",
        f"{method.residual_rms_um:.1f}",
        f"{method.peaks.acceleration_mm_per_s2 / 1e3:.1f}{over}",
    ]
    if found.mismatch and method.spread is not None:
        cells += [f"{method.spread.median_um:.1f}", f"{method.spread.worst_um:.1f}"]
    if (quality := method.equal_quality) is not None:
        sign = ">" if quality.capped else "" if quality.reached else "<"
        cells += [f"{sign}{quality.acceleration_mm_per_s2 / 1e3:.1f}", f"{quality.print_time_s:.0f}"]
    return cells
