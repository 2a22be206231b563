"""`ffcomp machines`: the machine files there are, what they say, whether that can be right, and new ones.

Results go to stdout, complaints to stderr. Heavy imports wait inside the functions: `--help` stays quick.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from models.machine import FloatArray, Machine

USAGE, BAD_MACHINE = 2, 5  # exit codes, the same for the whole program

app = typer.Typer(help="List, show, check and start machine files.", no_args_is_help=True)

AsJson = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
NameOrPath = Annotated[str, typer.Argument(help="A machine's name, or the path of its TOML file.")]
NewName = Annotated[str, typer.Argument(help="The new machine's name.")]
Output = Annotated[Path | None, typer.Option("-o", "--output", help="Default: your own machine folder.")]
Source = Annotated[str, typer.Option("--from", help="The machine to start from, by name or path.")]


@app.command("list")
def list_machines(as_json: AsJson = False) -> None:
    """The machines that can be asked for by name."""
    from models.machine_file import LIBRARY, machine_paths

    rows = [
        {"name": name, "origin": "library" if path.parent == LIBRARY else "user", "path": str(path)}
        for name, path in machine_paths().items()
    ]
    if as_json:
        _print_json("machines-list", machines=rows)
    else:
        _print_table(["name", "origin", "path"], [[*row.values()] for row in rows])


@app.command("show")
def show_machine(machine: NameOrPath, as_json: AsJson = False) -> None:
    """Every number of a machine with its provenance, and how it vibrates."""
    from models.machine_file import entries, load_machine

    with _machine_errors(as_json):
        loaded = load_machine(machine)
    values, modes = entries(Path(loaded.path)), _modes(loaded)
    if as_json:
        numbers = {e.key: {"value": e.value, "unit": e.unit, "provenance": e.provenance} for e in values}
        _print_json("machine-show", machine=_identity(loaded), values=numbers, modes=modes)
        return
    print(f"{loaded.name}\n{loaded.path}\nsha256 {loaded.sha256}\n")
    rows = [[e.key, _number(e.value), e.unit, e.provenance or "not stated"] for e in values]
    _print_table(["key", "value", "unit", "provenance"], rows)
    print()
    _print_table(["modes at", "Hz (damping ratio)"], [[mode["place"], _mode_text(mode)] for mode in modes])


@app.command("check")
def check_machine(machine: NameOrPath, as_json: AsJson = False) -> None:
    """Find every mistake in a machine file, numbers that disagree, and vibrations that would grow."""
    from models.consistency import inconsistencies, unstable_places
    from models.machine_file import load_machine

    with _machine_errors(as_json):
        loaded = load_machine(machine)
    problems, notes = _instability(unstable_places(loaded)), inconsistencies(loaded)
    if as_json:
        _print_json("machine-check", machine=_identity(loaded), problems=problems, notes=notes)
    for problem in problems:
        print(f"{loaded.path}: {problem}", file=sys.stderr)
    if problems:
        raise typer.Exit(BAD_MACHINE)
    if not as_json:
        print(*(f"note: {note}" for note in notes), _verdict(loaded, notes), sep="\n")


@app.command("new")
def new_machine(name: NewName, output: Output = None, source: Source = "mp-delta-pro") -> None:
    """Start a machine file from one that is there, comments and provenance included. Never overwrites."""
    from models.machine_file import load_machine, starting_text, user_folder

    if Path(name).name != name:
        _refuse(f"{name!r} cannot be a machine's name: it would name a folder. Give the file with --output.")
    with _machine_errors():
        text = starting_text(name, Path(load_machine(source).path))
    path = output or user_folder() / f"{name}.toml"
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        _refuse(f"{path}: this file exists already; give another name or another --output.")
    print(path)


def _refuse(sentence: str) -> None:
    print(sentence, file=sys.stderr)
    raise typer.Exit(USAGE)


@contextmanager
def _machine_errors(as_json: bool = False) -> Iterator[None]:
    """Say what is wrong with a machine file, and leave with its exit code."""
    from models.errors import MachineFileError

    try:
        yield
    except MachineFileError as error:
        print(error, file=sys.stderr)
        if as_json:
            _print_json("machine-error", path=error.path, problems=error.problems)
        raise typer.Exit(BAD_MACHINE) from None


def _identity(machine: Machine) -> dict[str, str]:
    return {"name": machine.name, "sha256": machine.sha256, "path": machine.path}


def _verdict(machine: Machine, notes: Sequence[str]) -> str:
    agreement = f"{len(notes)} numbers disagree with measured ones" if notes else "no numbers disagree"
    return f"{machine.name}: the file is valid, its vibrations decay all over the bed, {agreement}."


def _instability(places: FloatArray) -> list[str]:
    if not len(places):
        return []
    x, y = places[0]
    return [
        f"At {len(places)} places of the bed, the first at X = {x:.1f}, Y = {y:.1f} mm, a vibration of the "
        "model does not decay; give it damping, or the force map 'virtual_work'."
    ]


def _modes(machine: Machine) -> list[dict[str, Any]]:
    """At the centre, and at 80 % of the print radius towards tower A and away from it."""
    import numpy as np

    from models.receptance import modes

    geometry = machine.kinematics
    towards_a = 0.8 * geometry.print_radius_mm / geometry.delta_radii_mm[0] * geometry.towers_mm[0]
    places = {"centre": np.zeros(2), "80 % towards A": towards_a, "80 % away from A": -towards_a}
    found = {place: modes(machine, xy) for place, xy in places.items()}
    return [
        {
            "place": place,
            "position_mm": places[place].tolist(),
            "frequency_hz": mode.frequencies_hz.tolist(),
            "damping_ratio": mode.damping_ratios.tolist(),
        }
        for place, mode in found.items()
    ]


def _mode_text(mode: dict[str, Any]) -> str:
    pairs = zip(mode["frequency_hz"], mode["damping_ratio"], strict=True)
    return ", ".join(f"{frequency:.1f} ({damping:.3f})" for frequency, damping in pairs)


def _number(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_number, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _print_json(schema: str, **result: Any) -> None:
    print(json.dumps({"schema": f"ffcomp-{schema}/1", **result}))


def _print_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Aligned text that stays whole when piped; the last column may be long."""
    lines = [columns, *rows]
    widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
    for line in lines:
        cells = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        print("  ".join(cells).rstrip())
