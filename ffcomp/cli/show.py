"""`ffcomp show`: look at a compensated print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ffcomp.cli.options import AsJson, Plate, StampedMachine, check_choice
from ffcomp.request import OUTPUT


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
    gcode_preview: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            rich_help_panel=OUTPUT,
            help="Also write a small G-code for the viewers of slicers and hosts: lines are coloured, as features, by "
            "their contour error. Not for printing.",
        ),
    ] = None,
    preview_of: Annotated[
        str,
        typer.Option(
            metavar="WHICH",
            rich_help_panel=OUTPUT,
            help="Whose error --gcode-preview shows: compensated or original.",
        ),
    ] = "compensated",
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
        check_choice("--preview-of", preview_of, ("compensated", "original"))
        if gcode_preview is not None and gcode_preview.resolve() == file.resolve():
            raise typer.BadParameter(f"{gcode_preview}: --gcode-preview names another file than the print.")
        picture = output_file or file.with_name(file.name + ".png")
        result = _show(file, picture, machine, z_mm, plate, gcode_preview, preview_of)
        if as_json:
            print_json(result)
        else:
            print(result["verdict"])
            print(*(result[key] for key in ("picture", "gcode_preview") if key in result), sep="\n")
        if open_it:
            open_picture(result["picture"])


def open_picture(picture: str) -> None:
    """Open the picture with the program that the desktop has for it; without one the picture is there all the same."""
    from ffcomp.cli.common import say

    if typer.launch(picture) != 0:
        say(f"ffcomp: no program here opens pictures; look at {picture} yourself.")


def _show(
    file: Path,
    picture: Path,
    machine_name: str,
    z_mm: float | None,
    plate: int | None,
    gcode: Path | None,
    which: str,
) -> dict[str, Any]:
    from dataclasses import asdict

    from ffcomp.cli.common import say_assumed
    from ffcomp.cli.machine_files import machine_of
    from ffcomp.errors import NothingToDo
    from ffcomp.report.show import draw, numbers, verdict
    from ffcomp.simulate.gcode_preview import gcode_preview
    from ffcomp.simulate.preview import preview
    from ffcomp.version import __version__
    from gcode.atomic_write import replace_atomically
    from gcode.container import read_bytes
    from gcode.embedded import STAMP_REACH, already_processed, find_offset
    from models.file import load_machine
    from models.machine import identity

    data = read_bytes(file, plate)
    stamp = already_processed(data)
    if stamp is None:
        raise NothingToDo(f"{file}: not compensated by ffcomp; first: ffcomp compensate {file} --machine NAME.")
    machine = load_machine(machine_name) if machine_name else machine_of(stamp, file)
    say_assumed([machine])
    offset = find_offset(data[:STAMP_REACH])
    seen = preview(data, str(file), machine, offset, stamp.flavor)
    footer = (
        f"design model of {machine.name}, machine file sha256 {machine.sha256[:8]}; planned as the firmware does; "
        f"ffcomp v{__version__}"
    )
    if gcode is not None and (made := seen.original) is not None:
        shown = (seen.before, made.before_due) if which == "original" else (seen.after, made.after_due)
        replace_atomically(gcode, gcode_preview(made, *shown, offset))
    draw(seen, f"{file.name} on {machine.name}", footer, picture, z_mm)
    return {
        "schema": "ffcomp-show/1",
        "input": str(file),
        "machine": identity(machine),
        "picture": str(picture),
        **({} if gcode is None else {"gcode_preview": str(gcode)}),
        "verdict": verdict(seen),
        "contour_um": {"uncompensated": asdict(numbers(seen.before)), "compensated": asdict(numbers(seen.after))},
    }
