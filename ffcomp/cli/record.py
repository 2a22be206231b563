"""`ffcomp record`: moves for the printer's own sensor, captures joined with their command, and a check of seconds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ffcomp.cli.command import Shown, group, verb
from ffcomp.cli.common import print_json, say
from ffcomp.errors import RequestError
from ffcomp.record.request import CheckRequest, JoinRequest, PlanRequest, PrintRequest

if TYPE_CHECKING:
    from ffcomp.check.compare import CheckResult
    from ffcomp.record.plan import Plan
    from ffcomp.record.planning import PlanResult
    from ffcomp.record.result import JoinResult


@verb
def plan(request: PlanRequest, shown: Shown) -> None:
    """Write the G-code of moves that are worth recording.

    For diagnose, at most 12 experiments and 5 minutes: hard zigzags, slow reversals, loops and multisines at several
    places, each made twice. For identify, a periodic excitation of each carriage or axis by itself. For check, half a
    minute in the middle of the bed. The capture commands are inside. For scan, no sensor is needed: a page to print, of
    which ffcomp identify scan reads a picture. With --print, a print is recorded while it prints;
    nothing is repeated then, and ffcomp diagnose needs --without-repeats.

    Example: ffcomp record plan -m mp-delta-pro -o moves.gcode
    """
    from ffcomp.record.planning import plan_recording

    report_plan(plan_recording(request), shown.as_json)


def report_plan(result: PlanResult, as_json: bool) -> None:
    """Describe the file and the next steps."""
    if as_json:
        print_json(result.to_dict())
        return
    from rich.console import Console
    from rich.table import Table

    console = Console()
    if result.plan.page is not None:
        for sentence in _page_sentences(result):
            console.print(sentence, highlight=False, soft_wrap=True)
        return
    peaks = [result.peaks(each) for each in result.plan.experiments]
    columns = ("carriage mm/s", "m/s²", "nozzle mm/s", "m/s²") if peaks[0] else ("s",)
    table = Table("ffcomp-", "at, mm", *columns, "microstep error")
    for each, peak in zip(result.plan.experiments, peaks, strict=True):
        cells = [f"{each.duration_s:.1f}"]
        if peak is not None:
            carriage = peak.carriage_velocity_mm_per_s, peak.carriage_acceleration_mm_per_s2 / 1e3
            nozzle = peak.nozzle_velocity_mm_per_s, peak.nozzle_acceleration_mm_per_s2 / 1e3
            cells = [text for v, a in (carriage, nozzle) for text in (f"{v:.0f}", f"{a:.1f}")]
        table.add_row(
            each.name.removeprefix("ffcomp-"),
            "{:g}, {:g}".format(*each.position_mm),
            *cells,
            f"{100 * each.rounding:.0f} %",
        )
    console.print(table)
    for sentence in _sentences(result):
        console.print(sentence, highlight=False, soft_wrap=True)


def _page_sentences(result: PlanResult) -> Iterator[str]:
    from ffcomp.record.page import twins

    strokes, minutes = len(twins(result.plan)), result.plan.duration_s / 60
    yield f"{result.output}: a page of {strokes} strokes, {minutes:.0f} min. Print it, and keep {result.plan_file}."
    yield from result.firmware.restores()
    yield "Scan it at 600 dpi or more, or photograph all of it straight from above, in even light, without flash."
    yield f"Then: {result.next}"


def _sentences(result: PlanResult) -> Iterator[str]:
    plan, minutes = result.plan, result.plan.duration_s / 60
    yield from (f"warning: {warning}" for warning in result.warnings)
    often = f", {plan.repeats} times each" if plan.repeats > 1 else ""
    yield f"{result.output}: {len(plan.experiments)} experiments{often}, {minutes:.1f} min recorded."
    if places := result.missing_places_mm:
        options = " ".join(f"--at {x:g},{y:g}" for x, y in places)
        yield f"Places that would tell more: {options} (or --at line-of-action)."
    yield from result.firmware.restores()
    if result.firmware.records:
        yield f"Bring back the captures, {len(result.captures)} for each accelerometer, and keep {result.plan_file}."
    else:
        yield f"This firmware records nothing: record all of it with a sensor of your own, and keep {result.plan_file}."
    yield f"Then: {result.next}"


@verb
def join(request: JoinRequest, shown: Shown) -> None:
    """Join captures with their commands: one measured run for each experiment and repeat.

    Klipper's and Kalico's captures are on the clock of the motion already. Others are aligned with it below 20 Hz. What
    cannot be joined is named with its reason; exit code 5 if nothing could be.

    Example: ffcomp record join captures/*.csv --plan moves.json -m my-delta.toml -o runs/
    """
    _join(request, request.plan, shown)


@verb
def print_captures(request: PrintRequest, shown: Shown) -> None:
    """Join captures that were made during a print with the print's own motion: one measured run for each.

    The print, compensated or not, holds the commands of the captures: as ffcomp record plan --print writes them, or as
    your slicer puts them between layers (ACCELEROMETER_MEASURE, or M956, and a rest of 0.2 s or more inside, before and
    after the moves). Whatever takes a plan of captures with --plan takes such a print too.

    Example: ffcomp record print recorded.gcode captures/*.csv -m my-delta.toml -o runs/
    """
    _join(request, request.print_file, shown)


def _join(request: JoinRequest | PrintRequest, plan_file: Path, shown: Shown) -> None:
    from ffcomp.record.axes import turn_of
    from ffcomp.record.join import join_captures
    from ffcomp.record.prints import plan_of
    from ffcomp.record.result import recording_lines
    from gcode.atomic_write import replace_atomically
    from models.file import load_machine

    machine = load_machine(request.machine)
    plan = plan_of(plan_file, machine)
    result = join_captures(
        request.captures, plan, machine, turn_of(request.axes_map), lambda text: say(f"ffcomp: {text}", shown.quiet)
    )
    targets = [request.output / f"{each.name}.csv" for each in result.joined]
    if taken := [path for path in targets if path.exists() and not request.force]:
        raise RequestError(f"{taken[0]} exists already; give another --output, or --force.")
    if targets:
        request.output.mkdir(parents=True, exist_ok=True)
    for each, path in zip(result.joined, targets, strict=True):
        replace_atomically(path, recording_lines(each.recording))
    if shown.as_json:
        print_json(result.to_dict([str(path) for path in targets]))
    else:
        _report_join(result, request, plan, machine.vibration.diagnosable)
    for sentence in result.notes(plan, machine):
        say(f"ffcomp: {sentence}", shown.quiet)
    result.check()


def _report_join(result: JoinResult, request: JoinRequest | PrintRequest, plan: Plan, diagnosable: bool) -> None:
    for each in result.joined:
        clock = each.clock
        print(
            f"{each.name}: offset {clock.offset_s:.6f} ± {clock.offset_sd_s:.6f} s, ratio {clock.ratio:.6f}, "
            f"correlation below 20 Hz {clock.correlation:.3f}"
        )
    for refused in result.refused:
        print(f"refused: {refused.file}: {refused.why}")
    if result.joined:
        axes = f"; axes {result.joined[0].axes_map}" if result.joined[0].axes_map else ""
        executions = len({(each.experiment, each.repeat) for each in result.joined})
        print(f"{executions} of {len(plan.runs())} executions joined in {request.output}{axes}.")
        if diagnosable:
            once = "" if plan.repeats > 1 else " --without-repeats"
            print(f"Then: ffcomp diagnose {request.output}/*.csv -m {request.machine}{once}")


@verb
def check(request: CheckRequest, shown: Shown) -> None:
    """Check in half a minute whether the printer moves as last time, and if not, what changed.

    First write the G-code with -o, as ffcomp record plan --for check does, and run it whenever you want to know. Then
    give its captures with --plan: they are compared with the machine file and with the earlier checks.

    Example: ffcomp record check captures/*.csv --plan check.json -m my-delta.toml
    """
    if request.output is not None:
        from ffcomp.record.planning import plan_recording

        same = {name: getattr(request, name) for name in ("machine", "output", "flavor", "chip")}
        report_plan(plan_recording(PlanRequest(purpose="check", **same)), shown.as_json)
    else:
        _compare(request, shown)


def _compare(request: CheckRequest, shown: Shown) -> None:
    from datetime import datetime

    from ffcomp.check.compare import check_result
    from ffcomp.check.history import read_history, write_history
    from ffcomp.record.axes import turn_of
    from ffcomp.record.join import join_captures
    from ffcomp.record.plan import load_plan
    from models.file import load_machine

    assert request.plan is not None
    plan, machine = load_plan(request.plan), load_machine(request.machine)
    earlier = read_history(request.history_file)
    turn = turn_of(request.axes_map)
    joined = join_captures(
        request.captures, plan, machine, turn, lambda text: say(f"ffcomp: {text}", shown.quiet)
    ).with_accelerations
    for refused in joined.refused if joined.joined else ():
        say(f"ffcomp: left out {refused.file}: {refused.why}", shown.quiet)
    for sentence in joined.notes(plan, machine):
        say(f"ffcomp: {sentence}", shown.quiet)
    joined.check()
    result = check_result(joined, plan, machine, earlier, datetime.now().isoformat(timespec="minutes"))
    checks = earlier if result.known else [*earlier, result.check]
    if not result.known:
        write_history(request.history_file, checks)
    if request.figure is not None:
        from ffcomp.report.check import checks_figure
        from ffcomp.report.drawing import write_figure

        write_figure(checks_figure(checks, machine.name), request.figure, dpi=130)
    if shown.as_json:
        print_json(result.to_dict(machine.name, request.history_file))
    else:
        _report_check(result, request)


def _report_check(result: CheckResult, request: CheckRequest) -> None:
    from ffcomp.check.compare import against_file, to_do

    print(result.verdict.message)
    if result.since_first is not None:
        print(f"But since the first check: {result.since_first.message}")
    print(against_file(result))
    for each in result.experiments:
        then = "" if each.difference is None else f", {100 * each.difference:.1f} % from the last check"
        print(f"  {each.name}: {100 * each.gap:.1f} % from the machine file{then}; noise {100 * each.noise:.1f} %")
    for sentence in (*result.notes, *to_do(result, "CAPTURES", str(request.plan), request.machine)):
        print(sentence)
    if not result.known:
        print(f"Added to {request.history_file}.")


record = group(
    "record",
    """Record the printer's vibrations with its own accelerometer.

    First ffcomp record plan, then run its G-code, then give the captures to ffcomp diagnose with --plan; or keep them
    as measured runs with ffcomp record join.
    """,
    plan,
    join,
    print_captures,
    check,
)
