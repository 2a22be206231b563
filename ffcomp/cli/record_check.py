"""`ffcomp record check`: a health check of seconds, compared with the machine file and with earlier checks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ffcomp.cli.options import AsJson, CaptureAxes, Figure, Force, MachineName, MovesPlanFile, Quiet
from ffcomp.cli.record import Chips, FirmwareName, ShaperBack, write_plan
from ffcomp.request import OUTPUT

if TYPE_CHECKING:
    from ffcomp.check.result import CheckResult

Captures = Annotated[
    list[Path] | None,
    typer.Argument(metavar="[CAPTURES...]", help="Captures of the check's G-code. None: write that G-code with -o."),
]
GcodeOutput = Annotated[
    Path | None,
    typer.Option(
        "--output-file",
        "-o",
        metavar="FILE",
        rich_help_panel=OUTPUT,
        help="G-code to write. The plan is written beside it (.json).",
    ),
]
HistoryFile = Annotated[
    Path | None,
    typer.Option(
        "--history",
        metavar="FILE",
        rich_help_panel=OUTPUT,
        help="Earlier checks; this one is added. Default: beside the machine file, .checks.jsonl.",
    ),
]


def check(
    machine: MachineName,
    captures: Captures = None,
    output_file: GcodeOutput = None,
    plan: MovesPlanFile = None,
    history: HistoryFile = None,
    flavor: FirmwareName = "",
    chip: Chips = None,
    shaper: ShaperBack = "",
    axes_map: CaptureAxes = None,
    figure: Figure = None,
    force: Force = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Check in half a minute whether the printer moves as last time, and if not, what changed.

    First write the G-code with -o, as ffcomp record plan --for check does, and run it whenever you want to know. Then
    give its captures with --plan: they are compared with the machine file and with the earlier checks.

    Example: ffcomp record check captures/*.csv --plan check.json -m my-delta.toml
    """
    if bool(captures) == bool(output_file):
        raise typer.BadParameter("Either -o check.gcode, to write the G-code; or its captures, with --plan check.json.")
    if output_file is not None:
        options = {"flavor": flavor, "chip": chip, "shaper": shaper}
        write_plan(as_json, machine=machine, output=output_file, purpose="check", **options)
    elif plan is None:
        raise typer.BadParameter("Captures need --plan: the .json file that was written beside the check's G-code.")
    elif figure is not None and figure.exists() and not force:
        raise typer.BadParameter(f"{figure} exists already; give another --figure, or --force.")
    else:
        _compare(machine, captures or [], plan, history or _beside(machine), figure, axes_map, as_json, quiet)


def _beside(machine: str) -> Path:
    """Return the usual history: beside the machine file, or here for a machine of the library."""
    given = Path(machine)
    return given.with_suffix(".checks.jsonl") if given.is_file() else Path(f"{given.name}.checks.jsonl")


def _compare(
    machine: str,
    captures: list[Path],
    plan: Path,
    history: Path,
    figure: Path | None,
    axes_map: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    from ffcomp.cli.common import exit_codes, print_json, say

    with exit_codes():
        from datetime import datetime

        from ffcomp.check.history import read_history, write_history
        from ffcomp.check.result import check_result
        from ffcomp.record.axes import turn_of
        from ffcomp.record.join import join_captures
        from ffcomp.record.plan import load_plan
        from models.file import load_machine

        made, loaded, before = load_plan(plan), load_machine(machine), read_history(history)
        joined = join_captures(captures, made, loaded, turn_of(axes_map), lambda text: say(f"ffcomp: {text}", quiet))
        joined = joined.with_accelerations
        for refused in joined.refused if joined.joined else ():
            say(f"ffcomp: left out {refused.file}: {refused.why}", quiet)
        for sentence in joined.notes(made, loaded):
            say(f"ffcomp: {sentence}", quiet)
        joined.check()
        found = check_result(joined, made, loaded, before, datetime.now().isoformat(timespec="minutes"))
        checks = before if found.known else [*before, found.check]
        if not found.known:
            write_history(history, checks)
        if figure is not None:
            from ffcomp.report.check import draw_checks

            draw_checks(checks, loaded.name, figure)
        if as_json:
            print_json(found.to_dict(loaded.name, history))
        else:
            _print(found, plan, machine, history)


def _print(found: CheckResult, plan: Path, machine: str, history: Path) -> None:
    from ffcomp.check.result import against_file, to_do

    print(found.verdict.said)
    if found.since_first is not None:
        print(f"But since the first check: {found.since_first.said}")
    print(against_file(found))
    for each in found.experiments:
        then = "" if each.difference is None else f", {100 * each.difference:.1f} % from the last check"
        print(f"  {each.name}: {100 * each.gap:.1f} % from the machine file{then}; noise {100 * each.noise:.1f} %")
    for sentence in (*found.notes, *to_do(found, "CAPTURES", str(plan), machine)):
        print(sentence)
    if not found.known:
        print(f"Added to {history}.")
