"""Read a configuration, and build a machine file: other values are assumed, or named as missing.

The vibration parameters of a delta are a library machine's until they are measured; those of a Cartesian or CoreXY
machine come from the firmware's input shaper, from a machine that the user names, or stay missing. [provenance] holds
the origin of each.
"""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tomlkit

from ffcomp.importers.klipper import from_klipper, read_klipper
from ffcomp.importers.marlin import from_marlin
from ffcomp.importers.reprapfirmware import from_reprapfirmware
from ffcomp.importers.values import ConfigValues, PrinterConfigError, Value, commands, decoded, farthest_reach
from models.errors import MachineFileError
from models.file import LIBRARY, flat, load_machine
from models.machine import ASSUMED, MotionLimits, Steps, is_assumed

KLIPPER = re.compile(r"^\[(?:printer\]|include |stepper_\w+\]|mcu\])", re.MULTILINE)
MARLIN = re.compile(r"\becho:|\bFIRMWARE_NAME:Marlin", re.IGNORECASE)
SMOOTHIEWARE = re.compile(r"M203\.1|Max actuator feedrates|WCS settings")
MARLIN_SOURCE = re.compile(r"^\s*(?://)?\s*#define\s+[A-Z]", re.MULTILINE)
ONLY_REPRAPFIRMWARE = {"M98", "M307", "M308", "M550", "M563", "M566", "M574", "M584", "M667", "M669", "M950"}
MARLIN_ANSWER = {"M92", "M201", "M203"}  # a slicer writes the latter two as well, but not the first
MOVES = {"G0", "G1", "G28"}  # a print, whatever limits it sets


def read_printer_config(path: Path, kinematics: str | None = None, alone: bool = False) -> ConfigValues:
    """Read the configuration in a file, whichever of the firmwares it is for.

    Raises PrinterConfigError for a file that is none of them, or that says something its firmware would refuse.

    kinematics : for Marlin, whose M503 lacks it: "cartesian" or "corexy"
    alone : read no file that this one includes or runs: it comes from somebody who may not name files here
    """
    text = decoded(path)
    codes = {command.code for command in commands(text, path.name)}
    if KLIPPER.search(text):
        return from_klipper(read_klipper(path, alone))
    if MARLIN_SOURCE.search(text):
        raise PrinterConfigError(
            f"{path}: this is source code, perhaps Marlin's Configuration.h; send M503 to the printer and import its "
            "answer."
        )
    if SMOOTHIEWARE.search(text):
        raise PrinterConfigError(f"{path}: this is Smoothieware's answer to M503, whose M665 ffcomp does not read.")
    if codes & ONLY_REPRAPFIRMWARE and not MARLIN.search(text):
        return from_reprapfirmware(path, alone)
    if codes >= MARLIN_ANSWER and not codes & MOVES:
        return from_marlin(path, kinematics)
    raise PrinterConfigError(
        f"{path}: this is no printer.cfg (there is no section [printer]), no config.g of RepRapFirmware, and no answer "
        "of Marlin to M503."
    )


TABLES = ("kinematics", "carriage", "effector", "axes", "limits", "steps", "firmware")
ARMS = ("kinematics.arm_length_mm", "kinematics.arm_lengths_mm")
REQUIRED = {
    "delta": tuple(f"kinematics.{key}_mm" for key in ("arm_length", "delta_radius", "print_radius", "print_height")),
    "cartesian": (
        *(f"kinematics.{axis}_range_mm" for axis in "xyz"),
        *(f"axes.{axis}.{key}" for axis in "xy" for key in ("frequency_hz", "damping_ratio")),
    ),
}
REQUIRED["corexy"] = REQUIRED["cartesian"]
REQUIRED_OF_ALL = ("limits.velocity_mm_per_s", "limits.acceleration_mm_per_s2")
BORROWED = ("carriage", "effector", "axes")  # tables taken from the library machine where the configuration is silent
CARRIAGE_ACCELERATION = "limits.carriage_acceleration_mm_per_s2"
OPTIONAL = (  # in a machine file, but written by an import
    *("limits.square_corner_velocity_mm_per_s", "limits.carriage_velocity_mm_per_s", CARRIAGE_ACCELERATION),
    *("steps.steps_per_mm", "steps.full_steps_per_mm"),
)
DEFAULTS: Mapping[str, Any] = {f"limits.{key}": value for key, value in asdict(MotionLimits(0, 0)).items()} | {
    f"steps.{key}": value for key, value in asdict(Steps()).items()
}
PEAK = 10.0  # of a command's acceleration over the firmware's, corners included
FLAVOR = "firmware.flavor"
USUAL_MICROSTEPS = 16.0
UNCERTAIN, MEASURED_LENGTH = 0.2, 0.01  # relative standard deviations, as the library's assumed machines have them


@dataclass(frozen=True)
class MachineDraft:
    """A machine file before it is written."""

    name: str
    config: ConfigValues
    values: Mapping[str, Value]  # those found and those assumed
    missing: Mapping[str, str]  # key -> how to get it
    like: str | None  # the machine that lent values

    @property
    def is_complete(self) -> bool:
        """Whether nothing is missing."""
        return not self.missing


def build_draft(config: ConfigValues, name: str, like: Path | None = None) -> MachineDraft:
    """Fill in the values that can be assumed, and name the missing ones.

    like : machine file to take the unknown values from; for deltas the library's one with the nearest arm length,
        if none is given.
    """
    source = like or (_nearest_delta(config) if config.kinematics == "delta" else None)
    lender = {} if source is None else _lender(source, config)
    stem = "" if source is None else source.stem
    values = dict(config.values)
    for key, value in _assumed(config, lender, stem):
        values.setdefault(key, value)
    has_arms = any(key in values for key in ARMS)
    required = [key for key in (*REQUIRED[config.kinematics], *REQUIRED_OF_ALL) if not (key in ARMS and has_arms)]
    flavor, start = config.firmware.lower(), ALIKE.get(config.kinematics, "")
    missing = {key: hint(key, flavor) for key in required if key not in values}
    for key in missing:
        if start and not like and key.startswith(("axes.", "kinematics.")):
            missing[key] = f"to start: --like {start}; better: {missing[key]}"
    return MachineDraft(name, config, values, missing, stem or None)


def _nearest_delta(config: ConfigValues) -> Path:
    """Find the library's delta with the nearest arm length; the first of all where it is not known."""
    arm = _shortest_arm(config) or 0.0
    paths = sorted(LIBRARY.glob("*.toml"), key=lambda path: path.stem)
    kinematics = {path: _document(path)["kinematics"] for path in paths}
    deltas = [path for path in paths if kinematics[path]["type"] == "delta"]
    return min(deltas, key=lambda path: abs(kinematics[path].get("arm_length_mm", 0.0) - arm))


def _shortest_arm(config: ConfigValues) -> float | None:
    return next((min(config.values[key].numbers) for key in ARMS if key in config.values), None)


def _lender(path: Path, config: ConfigValues) -> dict[str, Any]:
    load_machine(path)  # raises for an invalid file
    document = _document(path)
    kind = document["kinematics"]["type"]
    if (kind == "delta") != (config.kinematics == "delta"):
        raise PrinterConfigError(f"{path}: a {kind} machine cannot lend values to a {config.kinematics} machine.")
    return document


def _document(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))


# --- Assumptions


def _assumed(config: ConfigValues, lender: Mapping[str, Any], like: str) -> Iterator[tuple[str, Value]]:
    known_axes = {key[: len("axes.x.")] for key in config.values if key.startswith("axes.")}
    for table in BORROWED:
        for key, value in flat(lender.get(table, {}), f"{table}."):
            if not key.startswith(tuple(known_axes)):  # an axis's values belong together
                yield key, Value(value, "assumed", f"{ASSUMED}: as the machine {like!r}")
    if config.kinematics == "delta":
        yield from _assumed_reach(config, lender, like)
    elif lender:
        for key in (f"{axis}_range_mm" for axis in "xyz"):
            yield (
                f"kinematics.{key}",
                Value(lender["kinematics"][key], "assumed", f"{ASSUMED}: as the machine {like!r}"),
            )
    if steps := config.values.get("steps.steps_per_mm"):
        full = [each / USUAL_MICROSTEPS for each in steps.numbers]
        rule = f"{ASSUMED}: {USUAL_MICROSTEPS:g} microsteps for each full step"
        yield "steps.full_steps_per_mm", Value(full if len(full) > 1 else full[0], "assumed", rule)
    if acceleration := config.values.get("limits.acceleration_mm_per_s2"):
        highest = PEAK * acceleration.number
        if highest < MotionLimits(0, 0).carriage_acceleration_mm_per_s2:
            rule = f"{ASSUMED}: {PEAK:g} times the firmware's acceleration"
            yield CARRIAGE_ACCELERATION, Value(highest, "assumed", rule)
    for key in OPTIONAL:
        table, _, name = key.partition(".")
        whose = f"as the machine {like!r}" if name in lender.get(table, {}) else "ffcomp's default"
        yield key, Value(lender.get(table, {}).get(name, DEFAULTS[key]), "assumed", f"{ASSUMED}: {whose}")


def _assumed_reach(config: ConfigValues, lender: Mapping[str, Any], like: str) -> Iterator[tuple[str, Value]]:
    height = lender["kinematics"]["effector_height_mm"]
    yield "kinematics.effector_height_mm", Value(height, "assumed", f"{ASSUMED}: as the machine {like!r}")
    radius, arm = config.values.get("kinematics.delta_radius_mm"), _shortest_arm(config)
    if radius is not None and arm is not None and "delta_radius_mm" in lender["kinematics"]:
        share = lender["kinematics"]["print_radius_mm"] / lender["kinematics"]["delta_radius_mm"]
        reach = min(share * radius.number, farthest_reach(arm, radius.number))
        rule = f"{ASSUMED}: the share of the delta radius that the machine {like!r} has"
        yield "kinematics.print_radius_mm", Value(round(reach, 1), "assumed", rule)


# --- Text


def machine_text(draft: MachineDraft, source: Path) -> str:
    """Write the machine file, to be loaded once nothing is missing."""
    document, config = tomlkit.document(), draft.config
    heading = [
        f"{draft.name}, imported from the {config.firmware} configuration {source.name}.",
        "A start: [provenance] marks assumed values; `ffcomp machines check` lists it.",
    ]
    if draft.missing:
        heading.append(f"{INCOMPLETE}: {', '.join(draft.missing)} must be filled in first.")
    for line in heading:
        document.add(tomlkit.comment(line))
    document.add(tomlkit.nl())
    document["format"] = "ffcomp-machine/1"
    document["name"] = draft.name
    document["kinematics"] = tomlkit.table()
    document["kinematics"]["type"] = config.kinematics
    for table in TABLES:
        for key, value in draft.values.items():
            if key.startswith(f"{table}."):
                _put(document, key, value.value)
        for key, what in draft.missing.items():
            if key.startswith(f"{table}."):
                _table_of(document, key).add(tomlkit.comment(f"{key.rpartition('.')[2]} is missing: {what}"))
    _put(document, FLAVOR, config.firmware.lower())
    lengths = (*ARMS, "kinematics.delta_radius_mm")
    document["uncertainty"] = {
        "default": UNCERTAIN,
        **{key: MEASURED_LENGTH for key in lengths if key in config.values},
    }
    digest = hashlib.sha256(source.read_bytes()).hexdigest()
    document["provenance"] = {
        "kinematics.type": config.kinematics_origin,
        **{key: value.origin for key, value in draft.values.items()},
        FLAVOR: f"the configuration is one of {config.firmware}",
        IMPORTED: {
            "from": f"{config.firmware} configuration {source.name} sha256:{digest}",
            "notes": list(config.notes),
        },
    }
    return tomlkit.dumps(document)


def _put(document: tomlkit.TOMLDocument, key: str, value: Any) -> None:
    _table_of(document, key)[key.rpartition(".")[2]] = value


def _table_of(document: tomlkit.TOMLDocument, key: str) -> Any:
    table: Any = document
    for part in key.split(".")[:-1]:
        table = table.setdefault(part, tomlkit.table())
    return table


IDENTIFY = "measure: ffcomp record plan --for identify, run its G-code with an accelerometer, then ffcomp identify fit"
HINTS = {  # the beginning of a key -> how to get its value
    "kinematics.effector_height_mm": "measure from the arms' lower joints down to the nozzle's tip",
    "kinematics.print_radius_mm": "how far from the centre the nozzle may go, from the printer's description",
    "kinematics.print_height_mm": "how high the nozzle may go, from the printer's description",
    "kinematics.arm_length": "from the printer's description, or measure from joint to joint",
    "kinematics.delta_radius": "the firmware's delta calibration finds it",
    "kinematics.": "the lowest and the highest position of the axis; Marlin answers it to M115 or M211",
    "carriage.": IDENTIFY,
    "effector.joint_radius_mm": "measure from the effector's centre to the arms' joints",
    "effector.": IDENTIFY,
    "limits.carriage_": "what the motors do without losing steps",
    "limits.": "from the printer's description, or what it prints with",
    "steps.full_steps_per_mm": "full steps of a motor's turn (200, or 400) over the mm of a turn",
    "steps.": "microsteps of a motor's turn over the mm of a turn",
}
INCOMPLETE = "NOT COMPLETE"  # begins the comment in a file that lacks values
IMPORTED = "imported"  # the entry in [provenance] that an import leaves


MEASURE_AXES = {  # flavor -> how to measure the modes of straight axes
    "klipper": "TEST_RESONANCES AXIS=X OUTPUT=raw_data, the same for Y, then ffcomp identify fit; without a sensor: "
    "ffcomp identify ringing",
    "reprapfirmware": f"{IDENTIFY} (a board with M955 records by itself)",
    "marlin": "a ringing tower and ffcomp identify ringing, or any accelerometer and ffcomp identify fit",
}
ALIKE = {"corexy": "voron-300", "cartesian": "ender-3"}  # a common machine of the library, to start from


def hint(key: str, flavor: str) -> str:
    """Say how to get the value of a key, with what the firmware offers."""
    if key.startswith("axes."):
        return MEASURE_AXES.get(flavor, IDENTIFY)
    return next(what for beginning, what in HINTS.items() if key.startswith(beginning))


def by_hint(keys: Iterable[str], flavor: str) -> dict[str, list[str]]:
    """Group keys by hint."""
    return by_remedy({key: hint(key, flavor) for key in keys})


def by_remedy(remedies: Mapping[str, str]) -> dict[str, list[str]]:
    """Group keys by what there is to do."""
    grouped: dict[str, list[str]] = {}
    for key, remedy in remedies.items():
        grouped.setdefault(remedy, []).append(key)
    return grouped


def is_incomplete(path: Path) -> bool:
    """Whether an import left a file incomplete that is not completed yet."""
    if not path.is_file() or INCOMPLETE not in path.read_text(encoding="utf-8", errors="replace"):
        return False
    try:
        load_machine(path)
    except MachineFileError:
        return True
    return False


def still_assumed(provenance: Mapping[str, Any], flavor: str) -> Iterator[str]:
    """Yield a sentence for each group of assumed values of an imported machine file."""
    if IMPORTED not in provenance:
        return
    for what, keys in by_hint((key for key, origin in provenance.items() if is_assumed(str(origin))), flavor).items():
        yield f"Not measured: {', '.join(keys)}. To know better: {what}."
