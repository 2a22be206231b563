"""`ffcomp machines`: the machine files there are, what they say, whether that can be right, and new ones.

Results go to stdout, complaints to stderr. Heavy imports wait inside the functions: `--help` stays quick.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ffcomp.cli.machines_diff import diff_machines
from ffcomp.cli.machines_effort import effort
from ffcomp.cli.machines_import import import_machine
from ffcomp.cli.options import AsJson
from ffcomp.request import MACHINE, OUTPUT

if TYPE_CHECKING:
    from models.arrays import FloatArray
    from models.checks import Extreme, PhysicsChecks, Quantity
    from models.machine import Machine

KINDS = ("delta", "corexy", "cartesian")  # in the order of the list
UNREADABLE = "?"  # `ffcomp machines check` says why
USAGE, BAD_MACHINE = 2, 5  # exit codes, the same for the whole program

app = typer.Typer(help="List, show, check, create and compare machine files.", no_args_is_help=True)

NameOrPath = Annotated[str, typer.Argument(metavar="MACHINE", help="A machine's name or the path of its TOML file.")]
NewName = Annotated[str, typer.Argument(metavar="NAME", help="Name of the new machine.")]
Output = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        metavar="FILE",
        rich_help_panel=OUTPUT,
        help="File to write. Default: in your own machine folder.",
    ),
]
Source = Annotated[
    str,
    typer.Option("--from", metavar="NAME", rich_help_panel=MACHINE, help="Machine to copy: a name or a path."),
]


@app.command("list")
def list_machines(as_json: AsJson = False) -> None:
    """List the machines that have a name: deltas, CoreXY machines, cartesian ones."""
    from models.finding import LIBRARY, glance, machine_paths

    rows: list[dict[str, str | None]] = []
    for name, path in machine_paths().items():
        kind, printer = glance(path)
        origin = "library" if path.parent == LIBRARY else "user"
        rows.append({"name": name, "origin": origin, "path": str(path), "kinematics": kind, "printer": printer})
    if as_json:
        _print_json("machines-list", machines=rows)
        return
    rows.sort(key=lambda row: KINDS.index(row["kinematics"]) if row["kinematics"] in KINDS else len(KINDS))
    columns = ("name", "kinematics", "origin", "printer")
    _print_table(columns, [[row[column] or UNREADABLE for column in columns] for row in rows])


@app.command("show")
def show_machine(machine: NameOrPath, as_json: AsJson = False) -> None:
    """Show every parameter of a machine with its provenance, and its modes."""
    from models.file import entries, load_machine
    from models.machine import assumed_modes, sources

    with _machine_errors(as_json):
        loaded = load_machine(machine)
    values, modes, named = entries(Path(loaded.path)), _modes(loaded), sources(loaded)
    if as_json:
        numbers = {e.key: {"value": e.value, "unit": e.unit, "provenance": e.provenance} for e in values}
        _print_json("machine-show", machine=_identity(loaded), values=numbers, modes=modes, sources=named)
        return
    print(f"{loaded.name}\n{loaded.path}\nsha256 {loaded.sha256}\n")
    rows = [[e.key, _number(e.value), e.unit, e.provenance or "not stated"] for e in values]
    _print_table(["key", "value", "unit", "provenance"], rows)
    print()
    if named:
        _print_table(["source", "address"], [[*each] for each in named.items()])
        print()
    _print_table(["modes at", "Hz (damping ratio)"], [[mode["place"], _mode_text(mode)] for mode in modes])
    if assumed := assumed_modes(loaded):
        print(f"\n{assumed}")


@app.command("check")
def check_machine(machine: NameOrPath, as_json: AsJson = False) -> None:
    """Check a machine file: mistakes, redundant parameters that disagree, stability and passivity."""
    from ffcomp.importers.builder import still_assumed
    from models.checks import check_physics, redundancy_problems, redundant_quantities, unstable_positions
    from models.file import load_machine

    with _machine_errors(as_json):
        loaded = load_machine(machine)
    if not loaded.vibration.position_dependent:
        _check_axes(loaded, _instability(unstable_positions(loaded)), as_json)
        return
    quantities, sound = redundant_quantities(loaded), check_physics(loaded)
    disagreements = redundancy_problems(loaded)
    problems, notes = _instability(unstable_positions(loaded)), [*disagreements, *_energy_notes(loaded, sound)]
    notes += [*_assumed(loaded), *still_assumed(loaded.provenance)]
    if as_json:
        consistency = [_quantity_json(quantity) for quantity in quantities]
        found = {"problems": problems, "notes": notes, "consistency": consistency, "soundness": asdict(sound)}
        _print_json("machine-check", machine=_identity(loaded), **found)
    for problem in problems:
        print(f"{loaded.path}: {problem}", file=sys.stderr)
    if problems:
        raise typer.Exit(BAD_MACHINE)
    if not as_json:
        _print_consistency(quantities)
        _print_soundness(sound)
        print(*(f"note: {note}" for note in notes), _verdict(loaded, sound, len(disagreements)), sep="\n")


def _check_axes(machine: Machine, problems: list[str], as_json: bool) -> None:
    """Modes of straight axes: no forces, so no energy to keep account of."""
    from ffcomp.importers.builder import still_assumed

    notes = [*_assumed(machine), *still_assumed(machine.provenance)]
    if as_json:
        _print_json("machine-check", machine=_identity(machine), problems=problems, notes=notes)
    for problem in problems:
        print(f"{machine.path}: {problem}", file=sys.stderr)
    if problems:
        raise typer.Exit(BAD_MACHINE)
    if not as_json:
        verdict = f"{machine.name}: the file is valid, and its vibrations decay."
        print(*(f"note: {note}" for note in notes), verdict, sep="\n")


@app.command("new")
def new_machine(name: NewName, output: Output = None, source: Source = "mp-delta-pro") -> None:
    """Create a machine file as a copy of another one. Never overwrites."""
    from models.file import load_machine, starting_text
    from models.finding import user_folder

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


app.command("import")(import_machine)
app.command("diff")(diff_machines)
app.command("effort")(effort)


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


def _assumed(machine: Machine) -> list[str]:
    from models.machine import assumed_modes

    sentence = assumed_modes(machine)
    return [] if sentence is None else [sentence]


def _identity(machine: Machine) -> dict[str, str | None]:
    from models.machine import identity

    return {**identity(machine), "path": machine.path}


def _verdict(machine: Machine, sound: PhysicsChecks, disagreements: int) -> str:
    agreement = f"{disagreements} numbers disagree with measured ones" if disagreements else "no numbers disagree"
    energy = "it makes no energy" if sound.is_passive else "it can make energy"
    return f"{machine.name}: the file is valid, its vibrations decay all over the bed, {energy}, {agreement}."


def _quantity_json(quantity: Quantity) -> dict[str, Any]:
    return {
        "key": quantity.key,
        "unit": quantity.unit,
        "of_file": quantity.of_file,
        "file_uses": quantity.the_file_uses,
        "values": [
            {"equation": way.equation, "value": way.value, "difference_percent": 100 * way.difference}
            for way in quantity.others
        ],
        "spread_percent": 100 * quantity.spread,
    }


def _print_consistency(quantities: Sequence[Quantity]) -> None:
    """Each number that can be had in more than one way: all of them, and how far apart."""
    if not quantities:
        print("Nothing in [provenance.measured] to compare the numbers with.\n")
        return
    for quantity in quantities:
        print(f"{quantity.key}, {quantity.unit}: spread {100 * quantity.spread:.1f} %")
        rows = [["the file", f"{quantity.of_file:.4g}", "", quantity.the_file_uses]]
        for way in quantity.others:
            equation, _, formula = way.equation.partition(": ")
            rows.append([equation, f"{way.value:.4g}", f"{100 * way.difference:+z.1f} %", formula])
        _print_table(["  by", "value", "difference", "from"], [["  " + row[0], *row[1:]] for row in rows])
        print()


def _print_soundness(sound: PhysicsChecks) -> None:
    load = f"{sound.least_load.value:.3f} to {sound.most_load.value:.3f}"
    rows = [
        ["slowest decay", f"{sound.growth_per_s.value:.1f} 1/s", _where(sound.growth_per_s)],
        ["passive: smallest dissipation", _percent(sound.dissipation), _where(sound.dissipation)],
        ["reciprocal: largest skew part of Y", _percent(sound.asymmetry), _where(sound.asymmetry)],
        ["largest skew part of the load", _percent(sound.load_asymmetry), _where(sound.load_asymmetry)],
        ["load against virtual work's", load, f"{_where(sound.least_load)}; {_where(sound.most_load)}"],
    ]
    _print_table(["the model over the bed", "worst", "where"], rows)
    print()


def _percent(extreme: Extreme) -> str:
    return f"{100 * extreme.value:.2g} %"


def _where(extreme: Extreme) -> str:
    place = f"X = {extreme.x_mm:.0f}, Y = {extreme.y_mm:.0f} mm"
    return place if extreme.frequency_hz is None else f"{place}, {extreme.frequency_hz:.0f} Hz"


def _energy_notes(machine: Machine, sound: PhysicsChecks) -> list[str]:
    """Describe the energy that the force map creates; none by virtual work."""
    from models.kinds import delta_vibration

    force_map, notes = f"The force map {delta_vibration(machine).effector.force_map!r}", []
    if not sound.is_reciprocal:
        notes.append(
            f"{force_map} is not reciprocal: the skew part of the carriages' receptance is up to "
            f"{_percent(sound.asymmetry)} of it, at {_where(sound.asymmetry)}; the carriages feel "
            f"{sound.least_load.value:.2f} to {sound.most_load.value:.2f} of the effector that virtual work gives them."
        )
    if not sound.is_passive:
        notes.append(
            f"{force_map} is not passive: at {_where(sound.dissipation)} a force can get out up to "
            f"{_percent(replace(sound.dissipation, value=-sound.dissipation.value))} of the power it moves, "
            "from nowhere; compensate with 'virtual_work'."
        )
    return notes


def _instability(places: FloatArray) -> list[str]:
    if not len(places):
        return []
    x, y = places[0]
    return [
        f"At {len(places)} places of the bed, the first at X = {x:.1f}, Y = {y:.1f} mm, a vibration of the "
        "model does not decay; give it damping, or the force map 'virtual_work'."
    ]


def _modes(machine: Machine) -> list[dict[str, Any]]:
    """Return the modes at the positions that show how they change over the bed."""
    places = machine.kinematics.sample_positions
    found = {place: machine.vibration.modes_at(xy) for place, xy in places.items()}
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
