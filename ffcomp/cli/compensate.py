"""`ffcomp compensate`: the main job, by hand or as a slicer's post-processing script, and what it says at the end."""

from __future__ import annotations

import os
import shlex
import sys
from contextlib import closing
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from ffcomp.cli.command import Shown, verb
from ffcomp.cli.common import fail, print_json, say, say_assumed, tell
from ffcomp.cli.log import note
from ffcomp.cli.progress import Progress
from ffcomp.compensation.request import CompensateFilesRequest, CompensateOptions, CompensateRequest

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ffcomp.api.compensation import Compensation
    from ffcomp.compensation.job import Options
    from ffcomp.compensation.result import FileResult, QuickerPrint
    from ffcomp.integrations.slicer import Call
    from ffcomp.metrics import Track
    from ffcomp.simulation.expectation import Expectation
    from models.machine import Machine


@verb
def compensate(request: CompensateFilesRequest, shown: Shown) -> None:
    """Compensate a print for your printer's vibration.

    ffcomp plans the print as the firmware does, computes the carriage paths and inverts the machine's vibration model
    along them. Lines that are not moves pass through byte for byte.

    As a slicer's post-processing script, use the full path of ffcomp followed by: compensate --machine NAME. The
    slicer adds the file. See: ffcomp integrations. Every run is logged: ffcomp --log-path.

    Example: ffcomp compensate sample_prints/ringing_tower.gcode --machine mp-delta-pro -o out.gcode
    """
    from ffcomp.cli.machine_files import remember
    from ffcomp.compensation.batch import targets_of
    from ffcomp.compensation.job import Options
    from ffcomp.integrations.slicer import read_call
    from models.file import load_machine

    targets = targets_of(request)
    machine, call = load_machine(str(request.machine)), read_call(os.environ)
    remember(machine)
    say_assumed([machine], shown.quiet)
    advice = _advice(request, machine, call)
    if len(request.files) == 1:
        _compensate_one(request, shown, machine, targets[0], call, advice)
        return
    for sentence in advice:
        say(f"ffcomp: {sentence}", shown.quiet)
    results = _compensate_all(request, shown, machine, targets, Options.of(request, machine, call.bed))
    if shown.as_json:
        failed = sum(each.failure is not None for each in results)
        objects = [each.to_dict() for each in results]
        print_json(
            {
                "schema": "ffcomp-compensate-batch/1",
                "results": objects,  # [] ffcomp-compensate/1 or FAILED: in the order of the files
                "failed": failed,  # whole number: how many files were not compensated
            }
        )
    for each in results:
        if each.failure is not None:
            raise SystemExit(each.failure.exit_code)


def _advice(request: CompensateFilesRequest, machine: Machine, call: Call) -> list[str]:
    """Collect warnings about the slicer's settings, and about an offset that does not suit its bed."""
    from ffcomp.integrations.slicer import bed_of, bed_warning, call_warnings

    files, offset = request.files, request.offset_mm
    warnings = call_warnings(call)
    bed = call.bed or (bed_of(files[0]) if len(files) == 1 else None)  # several may be for several beds
    return warnings if bed is None or offset is None else warnings + bed_warning(bed, machine, offset)


def _compensate_one(
    request: CompensateFilesRequest,
    shown: Shown,
    machine: Machine,
    target: Path | None,
    call: Call,
    advice: list[str],
) -> None:
    """Compensate a single file. The user never sees the name of a slicer's temporary file, but that of the output."""
    from ffcomp.api.compensation import compensate_print

    (file,), name = request.files, os.environ.get("SLIC3R_PP_OUTPUT_NAME", "")
    options = {each.name: getattr(request, each.name) for each in fields(CompensateOptions)}
    with Progress(1.0, shown.quiet) as progress:
        one = CompensateRequest(file, machine, target, progress, **options)
        done = compensate_print(one, name, advice, call.bed)
    if done.file.already:
        say(done.file.already, shown.quiet)
    else:
        _report(done, shown.quiet)
    if shown.as_json:
        print_json(done.to_dict())


def _compensate_all(
    request: CompensateFilesRequest,
    shown: Shown,
    machine: Machine,
    targets: list[Path] | list[None],
    options: Options,
) -> list[FileResult]:
    """Compensate several files; return their results in the order of the files."""
    from ffcomp.compensation.batch import compensate_files, size_of
    from ffcomp.errors import interrupts_restored
    from gcode.atomic_write import drafts_noted, replaced_since

    files, noted = request.files, drafts_noted()
    results: list[FileResult] = []
    with Progress(sum(map(size_of, files)), shown.quiet) as progress:
        work = compensate_files(
            files,
            machine,
            options,
            targets=targets,
            jobs=request.jobs,
            scheduler=request.scheduler,
            progress=progress,
        )
        try:
            with interrupts_restored(), closing(work):
                results.extend(work)
        except KeyboardInterrupt:
            done = len(replaced_since(noted))
            fail(f"Interrupted; {done} of {len(files)} files are done, the others as they were.", 130)
    results.sort(key=lambda each: each.number)
    _report_all(results, shown.quiet)
    return results


# -- several files --


def _report_all(results: list[FileResult], quiet: bool) -> None:
    """Print a table and the failures on stderr; only the failures if quiet."""
    from rich.console import Console
    from rich.table import Column, Table

    from ffcomp.compensation.statistics import shortened

    done = [(each.file, each.done) for each in results if each.done is not None]
    for warning, files in _by_warning([(file, one.warnings) for file, one in done]).items():
        note(f"ffcomp: {_names(files)}: {warning}")
    if not quiet:
        by_line = _by_warning([(file, one.warning_lines) for file, one in done])
        for line in shortened([f"{_names(files)}: {line}" for line, files in by_line.items()]):
            tell(f"ffcomp: {line}")
        table = Table(Column("file", overflow="fold"), "print time", "contour rms", "seconds")
        for each in results:
            table.add_row(str(each.file), *_cells(each))
        Console(stderr=True).print(table)
    for each in results:
        if each.failure is not None:
            say(f"{each.failure.trace}ffcomp: {each.failure.sentence}")


def _by_warning(of_files: list[tuple[Path, list[str]]]) -> dict[str, list[Path]]:
    """Each warning once, of those that differ in numbers only the first, with its files; most files first."""
    from ffcomp.compensation.statistics import cause_of

    files: dict[str, list[Path]] = {}
    first: dict[str, str] = {}
    for file, warnings in of_files:
        for warning in warnings:
            files.setdefault(first.setdefault(cause_of(warning), warning), []).append(file)
    return dict(sorted(files.items(), key=lambda each: -len(each[1])))


def _names(files: list[Path]) -> str:
    return str(files[0]) if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"


def _cells(outcome: FileResult) -> tuple[str, ...]:
    """Print time and predicted error before → after, and what it took."""
    from ffcomp.compensation.statistics import ENOUGH

    if outcome.done is None:
        return "failed: see below", "", ""
    if outcome.done.already:
        return "already processed", "", ""
    result = outcome.done.result
    numbers, share = result.statistics, result.statistics.shares.path
    time = f"{numbers.original_print_time_s:.1f} → {numbers.print_time_s:.1f} s"
    rms = " → ".join(f"{track.contour_rms_um:.1f}" for track in result.predicted.values())
    of_part = "" if share >= ENOUGH else f" of {_percent(share)}"
    return time, f"{rms} µm{of_part}" if rms else "", f"{outcome.seconds:.1f}"


# -- one file --


def _report(done: Compensation, quiet: bool) -> None:
    """Print warnings, the predicted gain and the cost on stderr."""
    from ffcomp.compensation.statistics import MOST_LINES, shortened
    from ffcomp.faster.bound import limits_in_words
    from models.machine import assumed_modes

    for warning in done.file.warnings:
        note(f"ffcomp: {warning}")
    assumed = assumed_modes(done.machine) is not None  # which has its line already: five lines altogether
    for line in shortened(done.file.warning_lines, MOST_LINES - assumed):
        tell(f"ffcomp: {line}", quiet)
    result, numbers = done.file.result, done.file.result.statistics
    if result.predicted:
        rms = [f"{name} {track.contour_rms_um:.2f} µm" for name, track in result.predicted.items()]
        note(f"predicted contour error, rms: {', '.join(rms)}")
        if result.forecast.expected is not None:
            say(result.forecast.expected.headline, quiet)
        if not quiet:
            _print_table(result.predicted, result.forecast.expected)
            if line := late_line(sum(each.seconds for each in numbers.slowed)):
                print(f"ffcomp: {line}", file=sys.stderr)
    say(result.flavor.reason, quiet)
    if result.placement.reason not in done.file.warnings:
        say(result.placement.reason, quiet)
    say(result.robust.reason, quiet)
    if result.shaper and result.shaper.reason not in done.file.warnings:
        say(result.shaper.reason, quiet)
    if result.faster is not None:
        say(faster_line(result.faster), quiet)
        say(limits_in_words(result.faster.limited_by), quiet)
        if line := uncertainty_line(done.machine):
            say(line, quiet)
    segments = f" in {numbers.segments} segments" if result.steps is None else ""
    speed = numbers.print_time_s / max(result.compute_time_s, 1e-9)
    say(
        f"{numbers.moves} moves, {numbers.print_time_s:.1f} s of print (was {numbers.original_print_time_s:.1f} s)"
        f"{segments}; {result.compute_time_s:.1f} s, {speed:.0f} times faster than printing.",
        quiet,
    )
    path, filament = _percent(numbers.shares.path), _percent(numbers.shares.filament)
    say(f"Compensated: {path} of the path, {filament} of the filament.", quiet)
    if times := numbers.settlings:
        waits = "waits once" if times == 1 else f"waits {times} times"
        why = "so that what the firmware moves by itself has stopped ringing when extrusion begins"
        say(f"The nozzle {waits}, {numbers.settling_s:.2g} s in all, {why}.", quiet)
    _report_next(done, quiet)


def _report_next(done: Compensation, quiet: bool) -> None:
    """Say what can be done with the output."""
    result, place = done.file.result, _place(done.file.path, done.file.output)
    if result.steps is None and not result.embedded:
        say("The original is not in the file (--no-embed): keep the sliced one, for ffcomp restore cannot.", quiet)
    if result.steps is not None and not result.steps:
        say(f"Play it: FFCOMP_PRINT FILE={Path(place or 'FILE').name} (docs/HOST.md).", quiet)
        return
    if result.steps:
        steps = ", ".join(f"{motor.upper()} {total.steps}" for motor, total in result.steps.items())
        say(f"Steps: {steps}.", quiet)
    expected = result.forecast.expected
    if expected is not None and expected.next_step:
        say(expected.next_step, quiet)
    if place:
        next_verb = "simulate" if result.steps else "show"
        say(f"Look at it: ffcomp {next_verb} {place}{_machine_option(done.machine.path, next_verb)}", quiet)


def _percent(share: float) -> str:
    """Return a share in per cent, and 100 only if nothing is missing."""
    return "100 %" if share == 1.0 else f"{min(100 * share, 99.9):.1f} %"


def _machine_option(path: str, next_verb: str) -> str:
    """Return the option that the next command needs; `show` finds machines that have a name."""
    from models.file import machine_paths

    names = [name for name, known in machine_paths().items() if str(known) == path]
    if names:
        return "" if next_verb == "show" else f" -m {names[0]}"
    return f" -m {shlex.quote(path)}"


def _place(file: str, output: str | None) -> str:
    """Return where the user will find the output; nothing if it goes to another host, or nowhere."""
    if "SLIC3R_PP_HOST" not in os.environ or output != file:
        return output or ""
    to_file = os.environ["SLIC3R_PP_HOST"] == "File"
    return os.environ.get("SLIC3R_PP_OUTPUT_NAME", "") if to_file else ""


def _print_table(predicted: Mapping[str, Track], expected: Expectation | None) -> None:
    from rich.console import Console
    from rich.table import Column, Table

    of_others = [] if expected is None else ["expected rms"]
    table = Table(Column(no_wrap=True), "tracking rms", "contour rms", *of_others, "contour p99", "peak command")
    for name, track in predicted.items():
        errors = [] if expected is None else [f"{getattr(expected, name).expected_um:.2f} µm"]
        table.add_row(
            name,
            f"{track.tracking_rms_um:.1f} µm",
            f"{track.contour_rms_um:.2f} µm",
            *errors,
            f"{track.contour_p99_um:.1f} µm",
            f"{track.peak_command_acceleration_mm_per_s2 / 1e3:.1f} m/s²",
        )
    Console(stderr=True).print(table)


def late_line(seconds: float) -> str:
    """Say what slower places do to errors at equal times; empty: there are none."""
    if not seconds:
        return ""
    late = f"{1e3 * seconds:.0f} ms" if seconds < 1.0 else f"{seconds:.1f} s"
    return (
        f"Tracking counts as an error that the nozzle comes up to {late} later where the print was slowed down; the "
        "part does not show that. What is off the path is the contour error."
    )


def uncertainty_line(machine: Machine) -> str:
    """Say which uncertainty a bound rests on where the machine file states none; empty: it states some."""
    from models.schema.documents import DEFAULT_UNCERTAINTY

    if machine.uncertainty != {"default": DEFAULT_UNCERTAINTY}:
        return ""
    return (
        f"The bound is for printers of which every number is off by {100 * DEFAULT_UNCERTAINTY:g} % (standard "
        "deviation): the machine file's [uncertainty] says nothing else."
    )


NO_GAIN = (
    "That is no gain: as it was sliced, printers as uncertain as the machine file's [uncertainty] says would break the "
    "bound. Measure yours (ffcomp identify), or allow a larger error."
)


def faster_line(quicker: QuickerPrint) -> str:
    """Say in a line what the bound has brought."""
    was, now, least = quicker.original_print_time_s, quicker.print_time_s, quicker.actuator_limit_s
    limits, p99 = quicker.limited_by, quicker.contour_p99_um
    slower = now >= was and max(limits, key=lambda name: limits[name]) == "error_bound"
    error = "" if p99 is None else f", predicted contour error p99 {p99:.1f} µm, max {quicker.contour_max_um:.1f} µm"
    line = (
        f"Faster: {was:.1f} → {now:.1f} s ({100 * (now / was - 1):+.0f} %; nothing can be quicker than {least:.1f} s)"
    )
    return f"{line}{error}.{f' {NO_GAIN}' if slower else ''}"
