"""`ffcomp machines`: list machine files, show them, check them, and make new ones.

Heavy imports wait inside the functions: `--help` stays quick.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from ffcomp.cli.command import group, verb
from ffcomp.errors import RequestError
from ffcomp.importers.request import ImportMachineRequest
from ffcomp.numerics.serialise import keys
from ffcomp.request import MACHINE, OUTPUT, Argument, Option, Request
from ffcomp.result import Fact, Result

if TYPE_CHECKING:
    from ffcomp.importers.builder import MachineDraft
    from ffcomp.importers.values import PrinterConfigError
    from models.arrays import FloatArray
    from models.checks import Extreme, PhysicsChecks
    from models.errors import MachineFileError
    from models.file import Entry
    from models.finding import NamedMachine
    from models.machine import Machine

KINDS = ("delta", "corexy", "cartesian")  # in the order of the list
UNREADABLE = "?"  # `ffcomp machines check` says why


@verb
def list_machines() -> Result:
    """List the library's machines and your own: deltas, CoreXY, cartesian."""
    from models.finding import named_machines

    return MachineList(named_machines())


@dataclass(frozen=True, eq=False, repr=False)
class MachineList(Result):
    """The machines that have a name, in alphabetical order."""

    title = "Machines"
    schema = "ffcomp-machines-list/1"
    json_keys: ClassVar = keys("machines")

    machines: Sequence[NamedMachine]

    @property
    def headline(self) -> str:
        """How many there are of each kind."""
        counts = Counter(each.kinematics or UNREADABLE for each in self._in_groups)
        return f"{len(self.machines)} machines: {', '.join(f'{count} {kind}' for kind, count in counts.items())}."

    @property
    def facts(self) -> list[Fact]:
        """Each with its kind, its origin and its printer."""
        return [
            (each.name, f"{each.kinematics or UNREADABLE}, {each.origin}, {each.printer or UNREADABLE}")
            for each in self._in_groups
        ]

    @property
    def _in_groups(self) -> list[NamedMachine]:
        return sorted(self.machines, key=lambda each: (*KINDS, each.kinematics).index(each.kinematics))


@dataclass(frozen=True)
class MachineRequest(Request):
    """A machine file to be looked at."""

    machine: Annotated[str, Argument("A machine's name or the path of its TOML file.", metavar="MACHINE")]


@verb
def show_machine(request: MachineRequest) -> Result:
    """Show every parameter of a machine with its provenance, and its modes."""
    from models.file import entries, load_plant
    from models.machine import sources

    loaded = load_plant(request.machine)
    at = [(place, xy, loaded.vibration.modes_at(xy)) for place, xy in loaded.kinematics.sample_positions.items()]
    modes = [ModesAt(place, xy, found.frequencies_hz, found.damping_ratios) for place, xy, found in at]
    return ShownMachine(loaded, entries(Path(loaded.path)), modes, sources(loaded))


@dataclass(frozen=True, eq=False, repr=False)
class ShownMachine(Result):
    """A machine's parameters and modes."""

    title = "Machine"
    schema = "ffcomp-machine-show/1"
    json_keys: ClassVar = keys("machine", "values", "modes", "sources")

    machine: Machine
    values: Sequence[Entry]
    modes: Sequence[ModesAt]
    sources: Mapping[str, str]

    @property
    def headline(self) -> str:
        """Name and modes."""
        hz = ", ".join(f"{f:.1f}" for f in self.modes[0].frequency_hz)
        return f"{self.machine.name} has modes at {hz} Hz." if hz else f"{self.machine.name} has no modes."

    @property
    def facts(self) -> list[Fact]:
        """The file, every parameter with its provenance, sources and modes."""
        numbers = ((e.key, f"{number_text(e.value)} {e.unit}".rstrip(), e.provenance) for e in self.values)
        return [
            *(("File", self.machine.path), ("sha256", self.machine.sha256)),
            *((key, f"{number}, {origin or 'not stated'}") for key, number, origin in numbers),
            *self.sources.items(),
            *((f"Modes at {each.place}, Hz (damping ratio)", each.text) for each in self.modes),
        ]

    @property
    def warnings(self) -> list[str]:
        """Whether the modes are assumed."""
        return list(filter(None, [self.machine.assumed]))


@verb
def check_machine(request: MachineRequest) -> Result:
    """Check a machine file: mistakes, stability and passivity."""
    from ffcomp.importers.builder import still_assumed
    from models.checks import check_physics, unstable_positions
    from models.file import load_plant

    loaded = load_plant(request.machine)
    places = unstable_positions(loaded)
    problems = [
        f"At {len(places)} places of the bed, the first at X = {x:.1f}, Y = {y:.1f} mm, a vibration of the "
        "model does not decay; give it damping, or the force map 'virtual_work'."
        for x, y in places[:1]
    ]
    notes = [*filter(None, [loaded.assumed]), *still_assumed(loaded.provenance, loaded.flavor)]
    if not loaded.vibration.position_dependent:  # modes of straight axes: no forces, so no energy to account for
        return CheckedMachine(loaded, problems, notes)
    sound = check_physics(loaded)
    return CheckedMachine(loaded, problems, [*_energy_notes(loaded, sound), *notes], sound)


@dataclass(frozen=True, eq=False, repr=False)
class CheckedMachine(Result):
    """Whether a machine file can be right."""

    title = "Check of a machine file"
    schema = "ffcomp-machine-check/1"
    json_keys: ClassVar = keys("machine", "problems", "notes", "soundness")

    machine: Machine
    problems: Sequence[str]
    notes: Sequence[str]
    soundness: PhysicsChecks | None = None  # of deltas

    @property
    def headline(self) -> str:
        """The verdict."""
        if self.problems:
            return f"{self.machine.name}: the file cannot be used."
        if self.soundness is None:
            return f"{self.machine.name}: the file is valid, and its vibrations decay."
        energy = "it generates no energy" if self.soundness.is_passive else "it can generate energy"
        return f"{self.machine.name}: the file is valid, its vibrations decay all over the bed, and {energy}."

    @property
    def facts(self) -> list[Fact]:
        """The model's worst values over the bed."""
        if (sound := self.soundness) is None:
            return []
        return [
            ("Slowest decay", f"{sound.growth_per_s.value:.1f} 1/s at {_where(sound.growth_per_s)}"),
            ("Passive: smallest dissipation", f"{_percent(sound.dissipation)} at {_where(sound.dissipation)}"),
        ]

    @property
    def warnings(self) -> Sequence[str]:
        """What to know about it."""
        return self.notes

    @property
    def failure(self) -> MachineFileError | None:
        """Why it cannot be used."""
        from models.errors import MachineFileError

        return MachineFileError(self.machine.path, self.problems) if self.problems else None


@dataclass(frozen=True)
class NewMachineRequest(Request):
    """A machine file to be made of another one."""

    name: Annotated[str, Argument("Name of the new machine.", metavar="NAME")]
    output: Annotated[
        Path | None,
        Option("File to write. Default: in your own machine folder.", OUTPUT, "--output -o", metavar="FILE"),
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
        raise RequestError(
            f"{request.name!r} cannot be a machine's name: it would name a folder. Give the file with --output."
        )
    text = starting_text(request.name, Path(load_machine(request.source).path))
    path = request.output or user_folder() / f"{request.name}.toml"
    write_new(text, path, "give another name or another --output")
    print(path)


def _percent(extreme: Extreme) -> str:
    return f"{100 * extreme.value:.2g} %"


def _where(extreme: Extreme) -> str:
    place = f"X = {extreme.x_mm:.0f}, Y = {extreme.y_mm:.0f} mm"
    return place if extreme.frequency_hz is None else f"{place}, {extreme.frequency_hz:.0f} Hz"


def _energy_notes(machine: Machine, sound: PhysicsChecks) -> list[str]:
    """Describe the energy that the force map creates; none by virtual work."""
    from models.kinds import delta_vibration

    if sound.is_passive:
        return []
    power = _percent(replace(sound.dissipation, value=-sound.dissipation.value))
    return [
        f"The force map {delta_vibration(machine).effector.force_map!r} is not passive: at {_where(sound.dissipation)} "
        f"a force can get out up to {power} of the power it moves, from nowhere; compensate with 'virtual_work'."
    ]


@dataclass(frozen=True)
class ModesAt:
    """The modes at one of the places that show how they change over the bed."""

    place: str
    position_mm: FloatArray  # (2,)
    frequency_hz: FloatArray
    damping_ratio: FloatArray

    @property
    def text(self) -> str:
        """The modes for people."""
        pairs = zip(self.frequency_hz, self.damping_ratio, strict=True)
        return ", ".join(f"{frequency:.1f} ({damping:.3f})" for frequency, damping in pairs) or "none"


# ---- import --------------------------------------------------------------------------------------


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
        from ffcomp.importers.builder import by_remedy

        config, missing = self.made.config, by_remedy(self.made.missing).items()
        warnings = [*(f"Still missing: {', '.join(keys)}: {what}" for what, keys in missing), *config.notes]
        if self.model_hz is not None:
            shaper = " and ".join(f"{frequency:g}" for frequency in config.shaper_hz)
            warnings.append(
                f"The input shaper is set to {shaper} Hz; the machine file's loudest vibration is at "
                f"{self.model_hz:.1f} Hz in the middle of the bed. If they are far apart, the assumed numbers do not "
                "fit: measure, or try --like."
            )
        return warnings

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


machines = group(
    "machines",
    "List, show, check and create machine files.",
    list_machines,
    show_machine,
    check_machine,
    new_machine,
    import_machine,
)
