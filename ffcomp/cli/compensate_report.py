"""What `ffcomp compensate` says when it is done: on stderr, for people, and in the log."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from ffcomp.cli.common import say, tell
from ffcomp.cli.log import note
from ffcomp.compensate.result import FileResult
from ffcomp.compensate.statistics import ENOUGH, cause_of, shortened
from ffcomp.faster.bound import limits_in_words


def report_all(file_results: list[FileResult], quiet: bool) -> None:
    """Print a table and the failures on stderr; only the failures if quiet."""
    for warning, files in _warnings(file_results, "warnings").items():
        note(f"ffcomp: {_about(files)}: {warning}")
    if not quiet:
        lines = [f"{_about(files)}: {line}" for line, files in _warnings(file_results, "warning_lines").items()]
        for line in shortened(lines):
            tell(f"ffcomp: {line}")
        table = Table(Column("file", overflow="fold"), "print time", "contour rms", "seconds")
        for file_result in file_results:
            table.add_row(str(file_result.file), *_cells(file_result))
        Console(stderr=True).print(table)
    for file_result in file_results:
        if file_result.failure is not None:
            say(f"{file_result.failure.trace}ffcomp: {file_result.failure.sentence}")


def _warnings(file_results: list[FileResult], key: str) -> dict[str, list[Path]]:
    """Each once, of those that differ in numbers only the first, with the files that it is about; most files first."""
    found: dict[str, list[Path]] = {}
    first: dict[str, str] = {}
    for file_result in file_results:
        for warning in file_result.result.get(key, ()):
            found.setdefault(first.setdefault(cause_of(warning), warning), []).append(file_result.file)
    return dict(sorted(found.items(), key=lambda each: -len(each[1])))


def _about(files: list[Path]) -> str:
    return str(files[0]) if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"


def _cells(file_result: FileResult) -> tuple[str, ...]:
    """Print time and predicted error before → after, and what it took."""
    result = file_result.result
    if file_result.failure is not None:
        return "failed: see below", "", ""
    if "already" in result:
        return "already processed", "", ""
    time = f"{result['original_print_time_s']:.1f} → {result['print_time_s']:.1f} s"
    rms = [f"{track['contour_rms_um']:.1f}" for track in result["predicted"].values()]
    share = result["compensated_share"]["path"]
    of_part = "" if share >= ENOUGH else f" of {_percent(share)}"
    return time, f"{' → '.join(rms)} µm{of_part}" if rms else "", f"{file_result.seconds:.1f}"


def report(result: dict[str, Any], machine_path: str, quiet: bool) -> None:
    """Print the predicted gain and the cost on stderr."""
    if result["predicted"]:
        rms = [f"{name} {track['contour_rms_um']:.2f} µm" for name, track in result["predicted"].items()]
        note(f"predicted contour error, rms: {', '.join(rms)}")
        if not quiet:
            _table(result["predicted"])
    say(result["flavor_reason"], quiet)
    if result["offset_reason"] not in result["warnings"]:
        say(result["offset_reason"], quiet)
    say(result["robust_reason"], quiet)
    if "faster" in result:
        say(faster_line(result["faster"]), quiet)
        say(limits_in_words(result["faster"]["limited_by"]), quiet)
        for each in result["faster"].get("if_known", ()):
            say(_if_known(each), quiet)
    segments = "" if "steps" in result else f" in {result['segments']} segments"
    speed = result["print_time_s"] / max(result["compute_time_s"], 1e-9)
    say(
        f"{result['moves']} moves, {result['print_time_s']:.1f} s of print "
        f"(was {result['original_print_time_s']:.1f} s){segments}; "
        f"{result['compute_time_s']:.1f} s, {speed:.0f} times faster than printing.",
        quiet,
    )
    share = result["compensated_share"]
    say(f"Compensated: {_percent(share['path'])} of the path, {_percent(share['filament'])} of the filament.", quiet)
    if times := result["settling"]["times"]:
        waits = "waits once" if times == 1 else f"waits {times} times"
        why = "so that what the firmware moves by itself has stopped ringing when extrusion begins"
        say(f"The nozzle {waits}, {result['settling']['seconds']:.2g} s in all, {why}.", quiet)
    if not result.get("original_embedded", True):
        say("The original is not in the file (--no-embed): keep the sliced one, for ffcomp restore cannot.", quiet)
    if result.get("steps") == {}:
        say(f"Play it: FFCOMP_PRINT FILE={Path(_place(result) or 'FILE').name} (docs/HOST.md).", quiet)
        return
    if "steps" in result:
        told = ", ".join(f"{motor.upper()} {total['steps']}" for motor, total in result["steps"].items())
        say(f"Steps: {told}.", quiet)
    if place := _place(result):
        verb = "simulate" if "steps" in result else "show"
        say(f"Look at it: ffcomp {verb} {place}{_machine(machine_path, verb)}", quiet)


def _percent(share: float) -> str:
    """Return a share in per cent, and 100 only if nothing is missing."""
    return "100 %" if share == 1.0 else f"{min(100 * share, 99.9):.1f} %"


def _machine(path: str, verb: str) -> str:
    """Return the option that the next command needs; `show` finds machines that have a name."""
    from models.file import machine_paths

    names = [name for name, known in machine_paths().items() if str(known) == path]
    if names:
        return "" if verb == "show" else f" -m {names[0]}"
    return f" -m {shlex.quote(path)}"


def _place(result: dict[str, Any]) -> str:
    """Where the user will find the output; nothing if it goes to another host, or nowhere."""
    if "SLIC3R_PP_HOST" not in os.environ or result["output"] != result["input"]:
        return result["output"] or ""
    to_file = os.environ["SLIC3R_PP_HOST"] == "File"
    return os.environ.get("SLIC3R_PP_OUTPUT_NAME", "") if to_file else ""


def _table(predicted: dict[str, dict[str, float]]) -> None:
    table = Table(Column(no_wrap=True), "tracking rms", "without delay", "contour rms", "contour p99", "peak command")
    for name, track in predicted.items():
        table.add_row(
            name,
            f"{track['tracking_rms_um']:.1f} µm",
            f"{track['tracking_rms_no_delay_um']:.1f} µm",
            f"{track['contour_rms_um']:.2f} µm",
            f"{track['contour_p99_um']:.1f} µm",
            f"{track['peak_command_acceleration_mm_per_s2'] / 1e3:.1f} m/s²",
        )
    Console(stderr=True).print(table)


SLOWER = (
    "That is no gain: as it was sliced, printers as uncertain as the machine file's [uncertainty] says would break the "
    "bound. Measure yours (ffcomp identify), or allow a larger error; --if-known 2% tells what knowing it better is "
    "worth."
)


def faster_line(faster: dict[str, Any]) -> str:
    """Say in a line what the bound has given."""
    was, now, least = (faster[key] for key in ("original_print_time_s", "print_time_s", "actuator_limit_s"))
    error = faster["contour_p99_um"]
    limits = faster["limited_by"]
    slower = f" {SLOWER}" if now >= was and max(limits, key=lambda name: limits[name]) == "error_bound" else ""
    seen = (
        "" if error is None else f", predicted contour error p99 {error:.1f} µm, max {faster['contour_max_um']:.1f} µm"
    )
    share = 100 * (now / was - 1)
    return f"Faster: {was:.1f} → {now:.1f} s ({share:+.0f} %; nothing can be quicker than {least:.1f} s){seen}.{slower}"


def _if_known(known: dict[str, float]) -> str:
    sd, seconds = known["relative_sd"], known["print_time_s"]
    return f"With the machine known to {100 * sd:.3g} %: {seconds:.1f} s, by slices that stand for the print."
