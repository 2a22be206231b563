"""`ffcomp estimate`: estimate how long a print takes, by layer and by feature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from ffcomp.cli.command import Json, verb
from ffcomp.cli.common import print_json
from ffcomp.errors import RequestError
from ffcomp.estimation.request import EstimateFilesRequest
from ffcomp.options import FIGURE
from ffcomp.request import OUTPUT, Option, Request

if TYPE_CHECKING:
    from rich.console import Console

    from ffcomp.estimation.engine import Estimate
    from ffcomp.estimation.statistics import Statistics, Unknown
    from gcode.container import Source
    from models.machine import Machine

MOST_LINES = 4  # of each command whose time is not known


@dataclass(frozen=True, kw_only=True)
class EstimateShown(Request):
    """What is shown of an estimate."""

    layers: Annotated[bool, Option("Print a row for every layer.", OUTPUT)] = False
    figure: Annotated[Path | None, FIGURE] = None


@verb
def estimate(request: EstimateFilesRequest, details: EstimateShown, shown: Json) -> None:
    """Estimate how long a print takes, by layer and by feature.

    ffcomp plans the print as the firmware does and adds up the time. No file states how long heating, homing and
    macros take; they are listed, not guessed. A compensated print gets both times, as it is and as it was.

    Example: ffcomp estimate sample_prints/ringing_tower.gcode --machine mp-delta-pro
    """
    if details.figure is not None and len(request.files) > 1:
        raise RequestError("--figure is for one file.")
    results = []
    for each in (each for file in request.files for each in _estimates(file, request)):
        if details.figure is not None:
            from ffcomp.report.estimate import draw

            draw(each, details.figure)
        if shown.as_json:
            results.append(each.to_dict())
        else:
            _print(each, details.layers)
    if shown.as_json:
        print_json(
            results[0]
            if len(results) == 1
            else {
                "schema": "ffcomp-estimate-batch/1",
                "results": results,  # [] ffcomp-estimate/1: in the order of the files
            }
        )


def _estimates(file: Path, request: EstimateFilesRequest) -> Iterator[Estimate]:
    """Of each print that a file holds."""
    from ffcomp.estimation.engine import estimate
    from gcode.container import opened

    with opened(file) as container:
        for name, text in container.prints.items():
            path = f"{file}/{name}" if name else str(file)
            machine = _machine(text, path, request.machine)
            yield estimate(text, path, machine, flavor=request.flavor, offset=request.offset_mm)


def _machine(text: Source, path: str, name: str) -> Machine:
    """Load the machine asked for, or that of the print's stamp."""
    from ffcomp.cli.machine_files import machine_of
    from ffcomp.estimation.engine import stamp_of
    from models.file import load_machine

    if name:
        return load_machine(name)
    stamp = stamp_of(text)
    if stamp is None:
        raise RequestError(f"{path} does not say which machine it is for: --machine NAME (ffcomp machines list).")
    return machine_of(stamp, Path(path))


def _print(result: Estimate, every_layer: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    from ffcomp.estimation.engine import seconds
    from ffcomp.estimation.statistics import FILAMENT
    from gcode.metadata import short

    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{result.path} on {result.machine.name}: {_sentence(result)}", markup=False)
    statistics = result.statistics
    whole = result.time_s
    table = Table("", "time", "share", "filament", box=None)
    for kind, spent in _kinds(statistics):
        table.add_row(kind, short(spent), f"{100 * spent / whole:.1f} %", "")
    table.add_row()
    for name, row in sorted(statistics.features.items(), key=lambda item: -seconds(item[1])):
        spent = seconds(row)
        table.add_row(name, short(spent), f"{100 * spent / whole:.1f} %", f"{max(row[FILAMENT], 0.0) / 1e3:.2f} m")
    console.print(table)
    _print_layers(console, result, every_layer)
    for sentence in _unknown(statistics):
        console.print(sentence, markup=False)


def _sentence(result: Estimate) -> str:
    """Print the time, the time before compensation, and the slicer's own estimate."""
    from ffcomp.estimation.engine import seconds
    from gcode.metadata import short

    sentence = f"{short(result.time_s)} ({result.time_s:.3f} s)"
    if result.original is not None:
        sentence += f", before compensation {short(seconds(result.original.total))}"
    numbers = result.statistics
    sentence += "" if numbers.slicer_s is None else f"; the slicer says {short(numbers.slicer_s)}"
    return f"{sentence}. {numbers.filament_mm / 1e3:.2f} m of filament, {numbers.retractions} retractions."


def _kinds(statistics: Statistics) -> list[tuple[str, float]]:
    from ffcomp.estimation.statistics import KINDS

    return [(kind, float(spent)) for kind, spent in zip(KINDS, statistics.total, strict=False) if spent]


def _print_layers(console: Console, result: Estimate, every: bool) -> None:
    """All of them, or the longest and the shortest."""
    from rich.table import Table

    from ffcomp.estimation.engine import seconds
    from ffcomp.estimation.statistics import BEFORE
    from gcode.metadata import short

    layers = result.statistics.layers.in_order()
    times = sorted((seconds(layer.row), number) for number, layer in layers if number != BEFORE)
    if not every:
        if times:
            (least, low), (most, high) = times[0], times[-1]
            span = f"{short(least)} (layer {low}) to {short(most)} (layer {high})"
            console.print(f"{len(times)} layers: {span}; --layers tells them all.")
        return
    table = Table("layer", "line", "z mm", "time", *(kind for kind, _ in _kinds(result.statistics)), box=None)
    kinds = [kind for kind, spent in enumerate(result.statistics.total[:5]) if spent]
    for number, layer in layers:
        cells = [f"{layer.row[kind]:.1f}" for kind in kinds]
        name = "before" if number == BEFORE else str(number)
        table.add_row(name, str(layer.line), f"{layer.z_mm:.2f}", f"{seconds(layer.row):.1f} s", *cells)
    console.print(table)


def _unknown(statistics: Statistics) -> list[str]:
    """List commands whose duration no file states, in one sentence."""
    if not statistics.unknown:
        return statistics.warnings
    commands = [f"{each.what} ({each.command}, {_lines(each)})" for each in statistics.unknown.values()]
    return [f"Not in the time, for no file tells it: {'; '.join(commands)}.", *statistics.warnings]


def _lines(unknown: Unknown) -> str:
    """Where, as far as a sentence can hold it."""
    first, more = ", ".join(map(str, unknown.lines[:MOST_LINES])), unknown.count - MOST_LINES
    return f"line{'s' * (unknown.count > 1)} {first}{f' and {more} more' if more > 0 else ''}"
