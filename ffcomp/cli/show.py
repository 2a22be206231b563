"""`ffcomp show`: look at a compensated print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ffcomp.cli.help import OUTPUT
from ffcomp.cli.options import AsJson, Plate, StampedMachine


def show(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Compensated print.")],
    output_file: Annotated[
        Path | None,
        typer.Option(
            "--output-file",
            "-o",
            metavar="FILE",
            rich_help_panel=OUTPUT,
            help="Picture: .png, .svg or .pdf. Default: FILE.png.",
        ),
    ] = None,
    machine: StampedMachine = "",
    z_mm: Annotated[
        float | None,
        typer.Option(
            metavar="MM", rich_help_panel=OUTPUT, help="Height of the layer. Default: where outer walls vibrate most."
        ),
    ] = None,
    plate: Plate = None,
    open_it: Annotated[
        bool, typer.Option("--open", rich_help_panel=OUTPUT, help="Open the picture when it is made.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Draw a compensated print: reference, uncompensated and compensated path.

    ffcomp simulates both prints with the design model. The picture and its numbers come from these simulations.

    Example: ffcomp show out.gcode
    """
    from ffcomp.cli.common import exit_codes, print_json

    with exit_codes():
        result = _show(file, output_file or file.with_name(file.name + ".png"), machine, z_mm, plate)
        if as_json:
            print_json(result)
        else:
            print(result["verdict"])
            print(result["picture"])
        if open_it:
            open_picture(result["picture"])


def open_picture(picture: str) -> None:
    """Open the picture with the program that the desktop has for it; without one the picture is there all the same."""
    from ffcomp.cli.common import say

    if typer.launch(picture) != 0:
        say(f"ffcomp: no program here opens pictures; look at {picture} yourself.")


def _show(file: Path, picture: Path, machine_name: str, z_mm: float | None, plate: int | None) -> dict[str, Any]:
    from dataclasses import asdict

    from ffcomp.cli.common import say_assumed
    from ffcomp.cli.machine_files import machine_of
    from ffcomp.errors import NothingToDo
    from ffcomp.report.show import draw, numbers, verdict
    from ffcomp.simulate.preview import preview
    from ffcomp.version import __version__
    from gcode.container import read_bytes
    from gcode.stamp import STAMP_REACH, already_processed, find_offset
    from models.file import load_machine
    from models.provenance import identity

    data = read_bytes(file, plate)
    stamp = already_processed(data)
    if stamp is None:
        raise NothingToDo(f"{file}: not compensated by ffcomp; first: ffcomp compensate {file} --machine NAME.")
    machine = load_machine(machine_name) if machine_name else machine_of(stamp, file)
    say_assumed([machine])
    seen = preview(data, str(file), machine, find_offset(data[:STAMP_REACH]), stamp.flavor)
    footer = (
        f"design model of {machine.name}, machine file sha256 {machine.sha256[:8]}; planned as the firmware does; "
        f"ffcomp v{__version__}"
    )
    draw(seen, f"{file.name} on {machine.name}", footer, picture, z_mm)
    return {
        "schema": "ffcomp-show/1",
        "input": str(file),
        "machine": identity(machine),
        "picture": str(picture),
        "verdict": verdict(seen),
        "contour_um": {"uncompensated": asdict(numbers(seen.before)), "compensated": asdict(numbers(seen.after))},
    }
