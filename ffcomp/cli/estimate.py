"""`ffcomp estimate`: estimate how long a print takes, by layer and by feature."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ffcomp.cli.options import AsJson, Figure, Flavor, Offset, StampedMachine, parsed_offset
from ffcomp.request import OUTPUT

if TYPE_CHECKING:
    from rich.console import Console

    from ffcomp.estimate.engine import Estimate
    from ffcomp.estimate.statistics import Statistics, Unknown
    from gcode.container import Source
    from models.machine import Machine

FIGURES = (".png", ".svg", ".pdf")
LINES_TOLD = 4  # of each command whose time is not known


def estimate(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Prints, compensated or not.")],
    machine: StampedMachine = "",
    offset_mm: Offset = "0,0",
    flavor: Flavor = "",
    layers: Annotated[
        bool, typer.Option("--layers", rich_help_panel=OUTPUT, help="Print a row for every layer.")
    ] = False,
    figure: Figure = None,
    as_json: AsJson = False,
) -> None:
    """Estimate how long a print takes, by layer and by feature.

    ffcomp plans the print as the firmware does and adds up the time. No file states how long heating, homing and
    macros take; they are listed, not guessed. A compensated print gets both times, as it is and as it was.

    Example: ffcomp estimate sample_prints/ringing_tower.gcode --machine mp-delta-pro
    """
    from ffcomp.cli.common import exit_codes, print_json

    with exit_codes():
        offset = parsed_offset(offset_mm)
        if figure is not None and len(files) > 1:
            raise typer.BadParameter("--figure is for one file.")
        if figure is not None and figure.suffix not in FIGURES:
            raise typer.BadParameter(f"--figure {figure}: a name that ends in {', '.join(FIGURES)}.")
        results = []
        for found in (each for file in files for each in _estimates(file, machine, flavor, offset)):
            if figure is not None:
                from ffcomp.report.estimate import draw

                draw(found, figure)
            if as_json:
                results.append(found.to_dict())
            else:
                _print(found, layers)
        if as_json:
            print_json(results[0] if len(results) == 1 else {"schema": "ffcomp-estimate-batch/1", "results": results})


def _estimates(file: Path, machine: str, flavor: str, offset: tuple[float, float]) -> Iterator[Estimate]:
    """Of each print that a file holds."""
    from ffcomp.estimate.engine import estimate
    from gcode.container import opened

    with opened(file) as container:
        for name, text in container.prints.items():
            path = f"{file}/{name}" if name else str(file)
            yield estimate(text, path, _machine(text, path, machine), flavor=flavor, offset=offset)


def _machine(text: Source, path: str, name: str) -> Machine:
    """Load the machine asked for, or that of the print's stamp."""
    from ffcomp.cli.machine_files import machine_of
    from ffcomp.estimate.engine import stamp_of
    from models.file import load_machine

    if name:
        return load_machine(name)
    stamp = stamp_of(text)
    if stamp is None:
        raise typer.BadParameter(f"{path} does not say which machine it is for: --machine NAME (ffcomp machines list).")
    return machine_of(stamp, Path(path))


def _print(found: Estimate, every_layer: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    from ffcomp.estimate.engine import seconds
    from ffcomp.estimate.statistics import FILAMENT
    from gcode.metadata import short

    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{found.path} on {found.machine.name}: {_sentence(found)}", markup=False)
    statistics = found.statistics
    whole = found.time_s
    table = Table("", "time", "share", "filament", box=None)
    for kind, spent in _kinds(statistics):
        table.add_row(kind, short(spent), f"{100 * spent / whole:.1f} %", "")
    table.add_row()
    for name, row in sorted(statistics.features.items(), key=lambda item: -seconds(item[1])):
        spent = seconds(row)
        table.add_row(name, short(spent), f"{100 * spent / whole:.1f} %", f"{max(row[FILAMENT], 0.0) / 1e3:.2f} m")
    console.print(table)
    _print_layers(console, found, every_layer)
    for sentence in _unknown(statistics):
        console.print(sentence, markup=False)


def _sentence(found: Estimate) -> str:
    """Print the time, the time before compensation, and the slicer's own estimate."""
    from ffcomp.estimate.engine import seconds
    from gcode.metadata import short

    told = f"{short(found.time_s)} ({found.time_s:.3f} s)"
    if found.original is not None:
        told += f", before compensation {short(seconds(found.original.total))}"
    said = found.statistics.slicer_s
    told += "" if said is None else f"; the slicer says {short(said)}"
    return (
        f"{told}. {found.statistics.filament_mm / 1e3:.2f} m of filament, {found.statistics.retractions} retractions."
    )


def _kinds(statistics: Statistics) -> list[tuple[str, float]]:
    from ffcomp.estimate.statistics import KINDS

    return [(kind, float(spent)) for kind, spent in zip(KINDS, statistics.total, strict=False) if spent]


def _print_layers(console: Console, found: Estimate, every: bool) -> None:
    """All of them, or the longest and the shortest."""
    from rich.table import Table

    from ffcomp.estimate.engine import seconds
    from ffcomp.estimate.statistics import BEFORE
    from gcode.metadata import short

    layers = found.statistics.layers.in_order()
    own = sorted((seconds(layer.row), number) for number, layer in layers if number != BEFORE)
    if not every:
        if own:
            (least, low), (most, high) = own[0], own[-1]
            span = f"{short(least)} (layer {low}) to {short(most)} (layer {high})"
            console.print(f"{len(own)} layers: {span}; --layers tells them all.")
        return
    table = Table("layer", "line", "z mm", "time", *(kind for kind, _ in _kinds(found.statistics)), box=None)
    kinds = [kind for kind, spent in enumerate(found.statistics.total[:5]) if spent]
    for number, layer in layers:
        cells = [f"{layer.row[kind]:.1f}" for kind in kinds]
        name = "before" if number == BEFORE else str(number)
        table.add_row(name, str(layer.line), f"{layer.z_mm:.2f}", f"{seconds(layer.row):.1f} s", *cells)
    console.print(table)


def _unknown(statistics: Statistics) -> list[str]:
    """List commands whose duration no file states, in one sentence."""
    if not statistics.unknown:
        return statistics.warnings
    told = [f"{each.what} ({each.command}, {_lines(each)})" for each in statistics.unknown.values()]
    return [f"Not in the time, for no file tells it: {'; '.join(told)}.", *statistics.warnings]


def _lines(unknown: Unknown) -> str:
    """Where, as far as a sentence can hold it."""
    first, more = ", ".join(map(str, unknown.lines[:LINES_TOLD])), unknown.count - LINES_TOLD
    return f"line{'s' * (unknown.count > 1)} {first}{f' and {more} more' if more > 0 else ''}"
