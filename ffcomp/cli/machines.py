"""`ffcomp machines`: the machine files there are, what they say, whether that can be right, and new ones.

Results go to stdout, complaints to stderr. Heavy imports wait inside the functions: `--help` stays quick.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ffcomp.cli.command import Json, group, verb
from ffcomp.cli.common import print_json
from ffcomp.cli.machines_import import import_machine
from ffcomp.errors import explain
from ffcomp.request import MACHINE, OUTPUT, Argument, Option, Request

if TYPE_CHECKING:
    from models.arrays import FloatArray
    from models.checks import Extreme, PhysicsChecks, Quantity
    from models.file import Difference
    from models.machine import Machine

KINDS = ("delta", "corexy", "cartesian")  # in the order of the list
UNREADABLE = "?"  # `ffcomp machines check` says why
USAGE, BAD_MACHINE = 2, 5  # exit codes, the same for the whole program


@verb
def list_machines(shown: Json) -> None:
    """List the machines that have a name: deltas, CoreXY machines, cartesian ones."""
    from models.finding import named_machines

    rows = named_machines()
    if shown.as_json:
        _print_json("machines-list", machines=rows)
        return
    rows.sort(key=lambda row: KINDS.index(row.kinematics) if row.kinematics in KINDS else len(KINDS))
    cells = [[row.name, row.kinematics or UNREADABLE, row.origin, row.printer or UNREADABLE] for row in rows]
    _print_table(("name", "kinematics", "origin", "printer"), cells)


@dataclass(frozen=True)
class MachineRequest(Request):
    """A machine file to be looked at."""

    machine: Annotated[str, Argument("A machine's name or the path of its TOML file.", metavar="MACHINE")]


@verb
def show_machine(request: MachineRequest, shown: Json) -> None:
    """Show every parameter of a machine with its provenance, and its modes."""
    from models.file import entries, load_plant
    from models.machine import assumed_modes, sources

    with _machine_errors(shown.as_json):
        loaded = load_plant(request.machine)
    values, modes, named = entries(Path(loaded.path)), _modes(loaded), sources(loaded)
    if shown.as_json:
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
    _print_table(["modes at", "Hz (damping ratio)"], [[mode.place, _mode_text(mode)] for mode in modes])
    if assumed := assumed_modes(loaded):
        print(f"\n{assumed}")


@verb
def check_machine(request: MachineRequest, shown: Json) -> None:
    """Check a machine file: mistakes, redundant parameters that disagree, stability and passivity."""
    from ffcomp.importers.builder import still_assumed
    from models.checks import check_physics, redundancy_problems, redundant_quantities, unstable_positions
    from models.file import load_plant

    with _machine_errors(shown.as_json):
        loaded = load_plant(request.machine)
    if not loaded.vibration.position_dependent:
        _check_axes(loaded, _instability(unstable_positions(loaded)), shown.as_json)
        return
    quantities, sound = redundant_quantities(loaded), check_physics(loaded)
    disagreements = redundancy_problems(loaded)
    problems, notes = _instability(unstable_positions(loaded)), [*disagreements, *_energy_notes(loaded, sound)]
    notes += [*_assumed(loaded), *still_assumed(loaded.provenance, loaded.flavor)]
    if shown.as_json:
        consistency = [_quantity_json(quantity) for quantity in quantities]
        result = {"problems": problems, "notes": notes, "consistency": consistency, "soundness": asdict(sound)}
        _print_json("machine-check", machine=_identity(loaded), **result)
    for problem in problems:
        print(f"{loaded.path}: {problem}", file=sys.stderr)
    if problems:
        raise SystemExit(BAD_MACHINE)
    if not shown.as_json:
        _print_consistency(quantities)
        _print_soundness(sound)
        print(*(f"note: {note}" for note in notes), _verdict(loaded, sound, len(disagreements)), sep="\n")


def _check_axes(machine: Machine, problems: list[str], as_json: bool) -> None:
    """Modes of straight axes: no forces, so no energy to keep account of."""
    from ffcomp.importers.builder import still_assumed

    notes = [*_assumed(machine), *still_assumed(machine.provenance, machine.flavor)]
    if as_json:
        _print_json("machine-check", machine=_identity(machine), problems=problems, notes=notes)
    for problem in problems:
        print(f"{machine.path}: {problem}", file=sys.stderr)
    if problems:
        raise SystemExit(BAD_MACHINE)
    if not as_json:
        verdict = f"{machine.name}: the file is valid, and its vibrations decay."
        print(*(f"note: {note}" for note in notes), verdict, sep="\n")


@dataclass(frozen=True)
class NewMachineRequest(Request):
    """A machine file to be made of another one."""

    name: Annotated[str, Argument("Name of the new machine.", metavar="NAME")]
    output: Annotated[
        Path | None,
        Option("File to write. Default: in your own machine folder.", OUTPUT, "--output", "-o", metavar="FILE"),
    ] = None
    source: Annotated[str, Option("Machine to copy: a name or a path.", MACHINE, "--from", metavar="NAME")] = (
        "mp-delta-pro"
    )


@verb
def new_machine(request: NewMachineRequest) -> None:
    """Create a machine file as a copy of another one. Never overwrites."""
    from models.file import load_machine, starting_text
    from models.finding import user_folder

    if Path(request.name).name != request.name:
        _refuse(f"{request.name!r} cannot be a machine's name: it would name a folder. Give the file with --output.")
    with _machine_errors():
        text = starting_text(request.name, Path(load_machine(request.source).path))
    path = request.output or user_folder() / f"{request.name}.toml"
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        _refuse(f"{path}: this file exists already; give another name or another --output.")
    print(path)


def _refuse(sentence: str) -> None:
    print(sentence, file=sys.stderr)
    raise SystemExit(USAGE)


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
        raise SystemExit(explain(error)[1]) from None


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


@dataclass(frozen=True)
class ModesAt:
    """The modes at one place."""

    place: str
    position_mm: FloatArray  # (2,)
    frequency_hz: FloatArray
    damping_ratio: FloatArray


def _modes(machine: Machine) -> list[ModesAt]:
    """Return the modes at the positions that show how they change over the bed."""
    modes = {place: (xy, machine.vibration.modes_at(xy)) for place, xy in machine.kinematics.sample_positions.items()}
    return [ModesAt(place, xy, each.frequencies_hz, each.damping_ratios) for place, (xy, each) in modes.items()]


def _mode_text(modes: ModesAt) -> str:
    pairs = zip(modes.frequency_hz.tolist(), modes.damping_ratio.tolist(), strict=True)
    return ", ".join(f"{frequency:.1f} ({damping:.3f})" for frequency, damping in pairs)


def _number(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(map(_number, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _print_json(schema: str, **result: Any) -> None:
    print_json({"schema": f"ffcomp-{schema}/1", **result})


def _print_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Aligned text that stays whole when piped; the last column may be long."""
    lines = [columns, *rows]
    widths = [max(map(len, cells)) for cells in zip(*lines, strict=True)]
    for line in lines:
        cells = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        print("  ".join(cells).rstrip())


# -- diff --


@dataclass(frozen=True)
class DiffMachinesRequest(Request):
    """Two machine files to be compared."""

    old: Annotated[str, Argument("A machine's name or the path of its file.", metavar="OLD")]
    new: Annotated[str, Argument("The machine to compare it with.", metavar="NEW")]


@verb
def diff_machines(request: DiffMachinesRequest, shown: Json) -> None:
    """Show the parameters in which two machine files differ, and both sets of natural frequencies.

    Example: ffcomp machines diff my-delta.toml better.toml
    """
    from models.file import differences, entries, load_machine, mode_changes

    before, after = load_machine(request.old), load_machine(request.new)
    changes = list(differences(entries(Path(before.path)), entries(Path(after.path))))
    frequencies = mode_changes(before, after).tolist()
    if shown.as_json:
        _print_diff_json(before.sha256, after.sha256, changes, frequencies)
    else:
        _print_diff(changes, frequencies)


def _print_diff_json(old: str, new: str, changes: list[Difference], frequencies: list[list[float]]) -> None:
    print_json(
        {
            "schema": "ffcomp-machine-diff/1",
            "old": {"sha256": old},
            "new": {"sha256": new},
            "changes": [asdict(each) for each in changes],
            "frequencies_hz": [
                {
                    "old": before,  # number [Hz]: natural frequencies in the middle of the bed
                    "new": after,  # number [Hz]
                }
                for before, after in frequencies
            ],
        }
    )


def _print_diff(changes: list[Difference], frequencies: list[list[float]]) -> None:
    if not changes:
        print("The two files describe the same machine.")
        return
    for each in changes:
        change = ", ".join(f"{relative:+.1%}" for relative in each.relative)
        note = f"  # {each.provenance}" if each.provenance not in ("", "default") else ""
        change = f" ({change})" if change else ""
        print(f"{each.key}: {_or_nothing(each.old)} → {_or_nothing(each.new)} {each.unit}{change}{note}")
    print("natural frequencies at 0, 0, Hz:", ", ".join(f"{before:.1f} → {after:.1f}" for before, after in frequencies))


def _or_nothing(value: object) -> str:
    return "nothing" if value is None else str(value)


machines = group(
    "machines",
    "List, show, check, create and compare machine files.",
    list_machines,
    show_machine,
    check_machine,
    new_machine,
    import_machine,
    diff_machines,
)
