"""`ffcomp machines import`: a printer's own configuration, made into a machine file."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from ffcomp.cli.command import Json, verb
from ffcomp.importers.request import ImportMachineRequest

if TYPE_CHECKING:
    from ffcomp.importers.builder import MachineDraft
    from ffcomp.importers.values import Value

INCOMPLETE = 5  # the file was written, but it is no machine file yet


@verb
def import_machine(request: ImportMachineRequest, shown: Json) -> None:
    """Import a Klipper, Kalico, RepRapFirmware or Marlin configuration. Overwrites only what it left incomplete.

    ffcomp states the source of each parameter, which ones are assumed, and which are still missing. The file's
    content decides its kind, not its name.

    Example: ffcomp machines import printer.cfg -o my-printer.toml
    """
    from ffcomp.cli.common import fail, print_json
    from ffcomp.importers.builder import build_draft, machine_text, read_printer_config
    from models.file import check_text, find_machine
    from models.finding import user_folder

    config = read_printer_config(request.file, request.kinematics, request.alone)
    path = request.output or user_folder() / f"{request.file.stem}.toml"
    made = build_draft(config, path.stem, None if request.like is None else find_machine(request.like))
    text = machine_text(made, request.file)
    if made.is_complete:
        check_text(text, str(request.file))
    _write(text, path)
    model_hz = _loudest_hz(path) if made.is_complete and made.config.shaper_hz else None
    if shown.as_json:
        print_json(_as_json(made, path, model_hz))
    else:
        _print(made, path, model_hz)
    if not made.is_complete:
        fail(f"{path} is not complete: fill in {', '.join(made.missing)}.", INCOMPLETE)


def _write(text: str, path: Path) -> None:
    from ffcomp.cli.common import fail
    from ffcomp.importers.builder import is_incomplete

    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("w" if is_incomplete(path) else "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        fail(f"{path}: this file exists already; give another --output.", 2)


def _loudest_hz(path: Path) -> float:
    """Of the machine that was written, in the middle of its bed: the lower of what is loudest along x and y."""
    import numpy as np

    from ffcomp.shapers.apply import dominant_frequencies
    from models.file import load_machine

    machine = load_machine(path)
    return float(dominant_frequencies(machine, np.array([machine.kinematics.centre_mm])).min())


def _as_json(made: MachineDraft, path: Path, model_hz: float | None) -> dict[str, object]:
    from dataclasses import asdict

    return {
        "schema": "ffcomp-machine-import/1",
        "machine": str(path),  # the file that was written
        "name": made.name,
        "firmware": made.config.firmware,  # what the configuration is of
        "kinematics": made.config.kinematics,  # delta, cartesian or corexy
        "like": made.like,  # text or null: the library machine whose vibration numbers were taken
        "complete": made.is_complete,  # true or false: false: the file lacks numbers, and the exit code is 5
        "values": {key: asdict(value) for key, value in made.values.items()},
        "missing": dict(made.missing),  # .* text: by `table.key`: why it matters, or how to get it
        "notes": list(made.config.notes),  # list of text: what a machine file cannot hold
        "shaper_hz": list(made.config.shaper_hz),  # list of numbers: of a delta: the input shaper's frequencies
        "model_loudest_hz": model_hz,  # number or null: beside them: the loudest vibration of the assumed machine
    }


TITLES = {
    "read": "Taken from the configuration",
    "converted": "Converted from it",
    "default": "Not in the configuration, the firmware's default",
    "assumed": "Assumed, because no firmware knows it",
}


def _print(made: MachineDraft, path: Path, model_hz: float | None) -> None:
    from ffcomp.importers.builder import by_hint, by_remedy
    from models.machine import is_assumed

    print(f"{path}: a {made.config.kinematics} machine, from a {made.config.firmware} configuration.")
    for how, title in TITLES.items():
        _print_values(title, {key: value for key, value in made.values.items() if value.how == how})
    _print_remedies("Still missing", by_remedy(made.missing))
    assumed = [key for key, value in made.values.items() if is_assumed(value.origin)]
    _print_remedies("How to know better", by_hint(assumed, made.config.firmware.lower()))
    if made.config.notes:
        print("\nNot in the machine file", *(f"  {note}" for note in made.config.notes), sep="\n")
    if model_hz is not None:
        shaper = " and ".join(f"{frequency:g}" for frequency in made.config.shaper_hz)
        print(
            f"\nThe input shaper is set to {shaper} Hz; the machine file's loudest vibration is at {model_hz:.1f} Hz,"
        )
        print(
            "in the middle of the bed. If they are far apart, the assumed numbers do not fit: measure, or try --like."
        )


def _print_values(title: str, values: Mapping[str, Value]) -> None:
    if values:
        print(f"\n{title}")
    for key, value in values.items():
        print(f"  {key:<41} {_shown(value.value):<22} {value.origin}")


def _print_remedies(title: str, remedies: Mapping[str, Collection[str]]) -> None:
    if remedies:
        print(f"\n{title}")
    for what, same in remedies.items():
        print(f"  {', '.join(same)}\n      {what}")


def _shown(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(_shown, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
