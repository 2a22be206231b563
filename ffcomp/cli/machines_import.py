"""`ffcomp machines import`: a printer's own configuration, made into a machine file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from ffcomp.cli.command import verb
from ffcomp.errors import RequestError
from ffcomp.importers.request import ImportMachineRequest
from ffcomp.numerics.serialise import keys
from ffcomp.result import Fact, Result

if TYPE_CHECKING:
    from ffcomp.importers.builder import MachineDraft
    from ffcomp.importers.values import PrinterConfigError


@verb
def import_machine(request: ImportMachineRequest) -> Result:
    """Import a Klipper, Kalico, RepRapFirmware or Marlin configuration. Overwrites only an incomplete import.

    ffcomp states the source of each parameter, which ones are assumed, and which are still missing. The file's
    content decides its kind, not its name.

    Example: ffcomp machines import printer.cfg -o my-printer.toml
    """
    from ffcomp.importers.builder import build_draft, is_incomplete, machine_text, read_printer_config
    from models.file import check_text, find_machine
    from models.finding import user_folder

    config = read_printer_config(request.file, request.kinematics, request.alone)
    path = request.output or user_folder() / f"{request.file.stem}.toml"
    made = build_draft(config, path.stem, None if request.like is None else find_machine(request.like))
    text = machine_text(made, request.file)
    if made.is_complete:
        check_text(text, str(request.file))
    write_new(text, path, "give another --output", replaced=is_incomplete(path))
    return ImportedMachine(made, path, _loudest_hz(path) if made.is_complete and made.config.shaper_hz else None)


def write_new(text: str, path: Path, remedy: str, *, replaced: bool = False) -> None:
    """Write a machine file that does not exist yet, or is replaced."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("w" if replaced else "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise RequestError(f"{path}: this file exists already; {remedy}.") from None


def _loudest_hz(path: Path) -> float:
    """Return the lower of the loudest frequencies along x and y in the middle of the new machine's bed."""
    import numpy as np

    from ffcomp.shapers.apply import dominant_frequencies
    from models.file import load_machine

    machine = load_machine(path)
    return float(dominant_frequencies(machine, np.array(machine.kinematics.centre_mm)).min())


@dataclass(frozen=True, eq=False, repr=False)
class ImportedMachine(Result):
    """A machine file that was made of a configuration."""

    schema = "ffcomp-machine-import/1"
    json_keys: ClassVar = keys(
        machine="path",
        name="made.name",
        firmware="made.config.firmware",
        kinematics="made.config.kinematics",
        like="made.like",
        complete="made.is_complete",
        values="made.values",
        missing="made.missing",
        notes="made.config.notes",
        shaper_hz="made.config.shaper_hz",
        model_loudest_hz="model_hz",
    )

    made: MachineDraft
    path: Path
    model_hz: float | None  # the loudest vibration, where the configuration has an input shaper

    @property
    def headline(self) -> str:
        """The file that was written, and its source."""
        return (
            f"{self.path}: a {self.made.config.kinematics} machine, from a {self.made.config.firmware} configuration."
        )

    @property
    def facts(self) -> list[Fact]:
        """Every value with its source: read, converted, the firmware's default or assumed."""
        values = sorted(self.made.values.items(), key=lambda item: ORDER.index(item[1].how))
        return [(key, f"{number_text(v.value)}, {v.how}: {v.origin.removeprefix(f'{v.how}: ')}") for key, v in values]

    @property
    def warnings(self) -> list[str]:
        """Missing values, settings that a machine file cannot contain, and a shaper that contradicts the modes."""
        return list(self._warnings())

    def _warnings(self) -> Iterator[str]:
        from ffcomp.importers.builder import by_remedy

        made = self.made
        yield from (f"Still missing: {', '.join(keys)}: {what}" for what, keys in by_remedy(made.missing).items())
        yield from made.config.notes
        if self.model_hz is not None:
            shaper = " and ".join(f"{frequency:g}" for frequency in made.config.shaper_hz)
            yield (
                f"The input shaper is set to {shaper} Hz; the machine file's loudest vibration is at "
                f"{self.model_hz:.1f} Hz in the middle of the bed. If they are far apart, the assumed numbers do not "
                "fit: measure, or try --like."
            )

    @property
    def next_steps(self) -> list[str]:
        """How to measure the assumed values."""
        from ffcomp.importers.builder import by_hint
        from models.machine import is_assumed

        assumed = [key for key, value in self.made.values.items() if is_assumed(value.origin)]
        hints = by_hint(assumed, self.made.config.firmware.lower())
        return [f"Assumed: {', '.join(keys)}. To measure it: {what}." for what, keys in hints.items()]

    @property
    def failure(self) -> PrinterConfigError | None:
        """The file is no machine file yet."""
        from ffcomp.importers.values import PrinterConfigError

        if self.made.is_complete:
            return None
        return PrinterConfigError(f"{self.path} is not complete: fill in {', '.join(self.made.missing)}.")


ORDER = ("read", "converted", "default", "assumed")


def number_text(value: object) -> str:
    """Return a machine file's value as people read it."""
    if isinstance(value, list):
        return ", ".join(map(number_text, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
