"""Values of a Klipper or Kalico configuration."""

from __future__ import annotations

import glob
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

from ffcomp.importers import values as v
from ffcomp.importers.values import AXES, TOWER_ANGLES_DEG, ConfigValues, PrinterConfigError, Value

SAVED_HEAD = (
    "\n#*# <---------------------- SAVE_CONFIG ---------------------->\n"
    "#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.\n"
    "#*#\n"
)
SAVED_LINE = re.compile(r"#\*#(?: (?P<text>.*))?")
COMMENT = re.compile(r"#.*|(?:^|(?<=\s));.*")
HEADER = re.compile(r"\s*\[(?P<name>.+)\]")
DELIMITER = re.compile(r"[:=]")
REFERENCE = re.compile(r"\$\{(?:(?P<section>[^.:${}]+)[.:])?(?P<option>[^${}]+)\}")
DEEPEST_REFERENCE = 10
MOST_FILES = 1000


@dataclass(frozen=True)
class Option:
    """One option of a section."""

    lines: list[str]  # the text after the name, and indented lines below
    place: str  # file:line

    @property
    def text(self) -> str:
        """Value without surrounding space."""
        return "\n".join(self.lines).strip()


@dataclass
class KlipperConfig:
    """The options of a configuration and everything it includes; filled line by line."""

    name: str
    options: dict[tuple[str, str], Option] = field(default_factory=dict)  # (section, option in small letters)
    remarks: list[str] = field(default_factory=list)  # sentences about parts that were not read
    files: int = 0  # included so far
    unread: bool = False  # an included file was not read
    alone: bool = False  # no other file is read

    def text(self, section: str, option: str) -> Option | None:
        """Return an option with Kalico's references filled in."""
        entry = self.options.get((section, option))
        for _ in range(DEEPEST_REFERENCE):
            if entry is None or not (reference := REFERENCE.search(entry.text)):
                return entry
            entry = replace(entry, lines=[self._filled(entry, reference, section)])
        raise PrinterConfigError(f"{entry.place if entry else ''}: [{section}] {option} refers to itself.")

    def number(self, section: str, option: str, *, above: float = -math.inf) -> Value | None:
        """Parse the number of an option; None if it is not given."""
        entry = self.text(section, option)
        if entry is None:
            return None
        name = f"[{section}] {option}"
        return Value(v.plain_number(entry.text, f"{entry.place}: {name}", above=above), "read", f"{entry.place} {name}")

    def _filled(self, option: Option, reference: re.Match[str], section: str) -> str:
        referred = (reference["section"] or section, reference["option"].lower())
        if referred not in self.options:
            name = f"[{referred[0]}] {referred[1]}"
            raise PrinterConfigError(f"{option.place}: {reference[0]} refers to {name}, which is not given.")
        return option.text[: reference.start()] + self.options[referred].text + option.text[reference.end() :]


def read_klipper(path: Path, alone: bool = False) -> KlipperConfig:
    """Read a `printer.cfg` with all it includes, or without if it is read alone.

    Raises PrinterConfigError for a line that is neither a section nor an option, a file that includes itself, a damaged
    SAVE_CONFIG block.
    """
    regular, head, block = v.decoded(path).partition(SAVED_HEAD)
    config, saved = KlipperConfig(path.name, alone=alone), KlipperConfig(path.name, alone=alone)
    first_line = (regular + head).count("\n") + 1
    for line_number, line in enumerate(regular.split("\n"), 1):
        if line.startswith("#*# "):
            raise PrinterConfigError(
                f"{path.name}:{line_number}: {line[:60]!r} is a saved value, but the head of the SAVE_CONFIG block "
                "does not stand above it as the firmware writes it: the firmware takes no notice of such values."
            )
    _read(regular, 1, path, config, (path.resolve(),))
    _read(_unmarked(block, first_line, path), first_line, path, saved, ())
    remarks = [*config.remarks, *_overruled(config, saved)]
    return KlipperConfig(path.name, {**saved.options, **config.options}, remarks, unread=config.unread)


def _overruled(config: KlipperConfig, saved: KlipperConfig) -> Iterator[str]:
    """Report saved options that the rest of the configuration gives differently."""
    for (section, key), option in saved.options.items():
        regular = config.options.get((section, key), option)
        if regular.text != option.text:
            yield (
                f"{option.place}: the saved {key} = {option.text!r} of [{section}] does not count, because "
                f"{regular.place} says {regular.text!r}."
            )


def _unmarked(block: str, first_line: int, path: Path) -> str:
    """Strip the marks from the lines of the SAVE_CONFIG block."""
    lines = block.rstrip().split("\n") if block.strip() else []
    matches = [SAVED_LINE.fullmatch(line) for line in lines]
    for line_number, (line, match) in enumerate(zip(lines, matches, strict=True), first_line):
        if match is None:
            raise PrinterConfigError(
                f"{path.name}:{line_number}: {line[:60]!r} stands within the SAVE_CONFIG block, where every line must "
                "begin with #*#: the firmware takes no notice of such a block. Move the line up."
            )
    return "\n".join(match["text"] or "" for match in matches if match)


def _read(text: str, first_line: int, path: Path, config: KlipperConfig, within: tuple[Path, ...]) -> None:
    section, key = "", None
    for line_number, line in enumerate(text.split("\n"), first_line):
        bare, place = COMMENT.sub("", line).rstrip(), f"{path.name}:{line_number}"
        if not bare:
            continue
        if bare[0].isspace() and key is not None:
            config.options[section, key].lines.append(bare.strip())
        elif header := HEADER.match(bare):
            section, key = header["name"].strip(), None
            if section.startswith("include "):
                _include(section.removeprefix("include ").strip(), place, path, config, within)
                section = ""
        else:
            key = _take(bare.strip(), section, place, config)


def _take(line: str, section: str, place: str, config: KlipperConfig) -> str:
    key, *text = (part.strip() for part in DELIMITER.split(line, maxsplit=1))
    if not text or not section:
        rule = "must stand in a section, after a line like [printer]" if text else "is no section and no option"
        raise PrinterConfigError(f"{place}: {line[:60]!r} {rule}.")
    config.options[section, key.lower()] = Option(text, place)
    return key.lower()


def _include(pattern: str, place: str, source: Path, config: KlipperConfig, within: tuple[Path, ...]) -> None:
    if config.alone:
        config.remarks.append(f"{place}: [include {pattern}]: only this file is read, not what it includes.")
        config.unread = True
        return
    names = sorted(glob.glob(str(Path(glob.escape(str(source.parent))) / pattern), recursive=True))
    files = [Path(name) for name in names if Path(name).is_file()]
    if not files and not glob.has_magic(pattern):
        config.remarks.append(f"{place}: [include {pattern}]: there is no such file; what it sets was not read.")
        config.unread = True
    for file in files:
        config.files += 1
        if file.resolve() in within or config.files > MOST_FILES:
            rule = f"more than {MOST_FILES} files are included" if config.files > MOST_FILES else "includes itself"
            raise PrinterConfigError(f"{place}: [include {pattern}]: {file.name}: {rule}.")
        _read(v.decoded(file), 1, file, config, (*within, file.resolve()))


KINDS = {kind: kind for kind in ("delta", "cartesian", "corexy")}
KINDS |= {f"limited_{kind}": kind for kind in ("cartesian", "corexy")}
TOWERS = "abc"
FULL_STEPS_PER_ROTATION = 200.0
SQUARE_CORNER_VELOCITY_MM_PER_S = 5.0
CRUISE_RATIO = 0.5  # ffcomp plans with the firmware's default
DAMPING_RATIO = 0.1


def from_klipper(config: KlipperConfig) -> ConfigValues:
    """Collect all values of a configuration that a machine file can hold.

    Raises PrinterConfigError if it is no configuration of a printer, or of one with unsupported kinematics.
    """
    option = config.text("printer", "kinematics")
    if option is None:
        remarks = "".join(f" {sentence}" for sentence in config.remarks)
        raise PrinterConfigError(f"{config.name}: the configuration gives no kinematics in [printer].{remarks}")
    if option.text not in KINDS:
        raise v.unsupported(option.place, f"[printer] kinematics = {option.text!r}")
    kind, origin = KINDS[option.text], f"{option.place} [printer] kinematics"
    of_kind = _delta(config) if kind == "delta" else _straight(config)
    values = v.known({**of_kind, **_limits(config), **_steps(config, TOWERS if kind == "delta" else AXES)})
    values |= _own_shaper(config)
    shaped = [_shaper_frequency(config, axis) for axis in AXES] if kind == "delta" else []
    shaper_hz = tuple(each.number for each in shaped if each is not None)
    return ConfigValues("Klipper", kind, origin, values, tuple(_notes(config)), shaper_hz)


def _default(number: float, option: str) -> Value:
    return Value(number, "default", f"{option} is not given: the firmware's default")


# --- Deltas


def _delta(config: KlipperConfig) -> dict[str, Value | None]:
    radius = config.number("printer", "delta_radius", above=0)
    stated = config.number("printer", "print_radius", above=0)
    stated = stated or v.changed(radius, float, "print_radius is not given, so it is the delta_radius")
    arms = _of_towers(config, "arm_length")
    return {
        **v.arm_lengths(arms),
        "kinematics.delta_radius_mm": radius,
        "kinematics.tower_angles_deg": v.listed(_towers(config)),
        "kinematics.print_radius_mm": v.print_radius(stated, radius, v.least(arms)),
        "kinematics.print_height_mm": v.least(_of_towers(config, "position_endstop")),
    }


def _towers(config: KlipperConfig) -> list[Value]:
    """Read the towers' angles."""
    return [
        config.number(f"stepper_{tower}", "angle") or _default(angle, f"[stepper_{tower}] angle")
        for tower, angle in zip(TOWERS, TOWER_ANGLES_DEG, strict=True)
    ]


def _of_towers(config: KlipperConfig, option: str) -> list[Value | None]:
    """Read an option of each tower; towers B and C default to A."""
    first = config.number("stepper_a", option, above=0)
    return [config.number(f"stepper_{tower}", option, above=0) or first for tower in TOWERS]


# --- Cartesian and CoreXY machines


def _straight(config: KlipperConfig) -> dict[str, Value | None]:
    ranges = {f"kinematics.{axis}_range_mm": _range(config, f"stepper_{axis}") for axis in AXES}
    shaped = [_shaped_axis(config, axis) for axis in AXES]
    return {**ranges, **{key: value for axis in shaped for key, value in axis.items()}}


def _range(config: KlipperConfig, section: str) -> Value | None:
    highest = config.number(section, "position_max")
    lowest = config.number(section, "position_min") or _default(0.0, "position_min")
    return None if highest is None else v.listed([lowest, highest])


def _shaper_frequency(config: KlipperConfig, axis: str) -> Value | None:
    """Read the shaper's frequency; Kalico calls some shapers smoothers; zero switches either off."""
    return next((frequency for _, frequency in _frequencies(config, axis)), None)


def _frequencies(config: KlipperConfig, axis: str) -> Iterator[tuple[str, Value]]:
    """Yield the options that switch the shaper of an axis on, in the words of SET_INPUT_SHAPER."""
    for name in (f"shaper_freq_{axis}", f"smoother_freq_{axis}"):
        frequency = config.number("input_shaper", name)
        if frequency is not None and frequency.number > 0:
            yield name.upper(), frequency


def _own_shaper(config: KlipperConfig) -> dict[str, Value]:
    words, sources = [], []
    for axis in AXES:
        kind = config.text("input_shaper", f"shaper_type_{axis}") or config.text("input_shaper", "shaper_type")
        for name, frequency in _frequencies(config, axis):
            words += [f"SHAPER_TYPE_{axis.upper()}={kind.text}"] if kind else []
            words.append(f"{name}={frequency.number:.10g}")
            sources.append(frequency)
    commands = [" ".join(["SET_INPUT_SHAPER", *words])] if words else []
    unread = config.unread or bool(_shaper_macros(config))
    return v.own_shaper(commands, sources, unread, "[input_shaper] sets no frequency: there is no shaper")


def _shaper_macros(config: KlipperConfig) -> list[str]:
    """Return the places of macros that set the shaper, but for ours, which puts back what [input_shaper] states."""
    return [
        f"{entry.place} [{section}]"
        for (section, key), entry in config.options.items()
        if key.endswith("gcode") and "SET_INPUT_SHAPER" in entry.text.upper() and "FFCOMP_" not in section.upper()
    ]


def _shaped_axis(config: KlipperConfig, axis: str) -> dict[str, Value]:
    frequency = _shaper_frequency(config, axis)
    if frequency is None:
        return {}
    damping = config.number("input_shaper", f"damping_ratio_{axis}", above=0)
    return v.shaped_axis(axis, frequency, damping or _default(DAMPING_RATIO, f"damping_ratio_{axis}"))


# --- Limits and steps


def _limits(config: KlipperConfig) -> dict[str, Value | None]:
    corner = config.number("printer", "square_corner_velocity")
    return {
        "limits.velocity_mm_per_s": config.number("printer", "max_velocity", above=0),
        "limits.acceleration_mm_per_s2": config.number("printer", "max_accel", above=0),
        "limits.square_corner_velocity_mm_per_s": corner
        or _default(SQUARE_CORNER_VELOCITY_MM_PER_S, "square_corner_velocity"),
        "limits.z_velocity_mm_per_s": config.number("printer", "max_z_velocity", above=0),
        "limits.z_acceleration_mm_per_s2": config.number("printer", "max_z_accel", above=0),
    }


def _steps(config: KlipperConfig, letters: str) -> dict[str, Value | None]:
    motors = [_motor(config, f"stepper_{motor}") for motor in letters]
    return {
        "steps.steps_per_mm": v.together([steps for steps, _ in motors]),
        "steps.full_steps_per_mm": v.together([full_steps for _, full_steps in motors]),
        "steps.extruder_steps_per_mm": _motor(config, "extruder")[0],
    }


def _motor(config: KlipperConfig, section: str) -> tuple[Value | None, Value | None]:
    """Compute microsteps and full steps for each mm."""
    microsteps = config.number(section, "microsteps", above=0)
    distance = config.number(section, "rotation_distance", above=0)
    if microsteps is None or distance is None:
        return _motor_of_old_file(config, section, microsteps)
    per_turn = config.number(section, "full_steps_per_rotation", above=0)
    full_steps = (per_turn.number if per_turn else FULL_STEPS_PER_ROTATION) * _gear_ratio(config, section)
    sources = [each for each in (distance, per_turn, microsteps) if each is not None]
    rule = f"{full_steps:g} full steps for {distance.number:g} mm"
    full_steps_per_mm = v.converted(full_steps / distance.number, rule, *sources[:-1])
    steps_per_mm = full_steps / distance.number * microsteps.number
    return v.converted(steps_per_mm, f"{rule}, {microsteps.number:g} microsteps each", *sources), full_steps_per_mm


def _motor_of_old_file(
    config: KlipperConfig, section: str, microsteps: Value | None
) -> tuple[Value | None, Value | None]:
    """Convert step_distance, which a motor had until 2021."""
    distance = config.number(section, "step_distance", above=0)
    if distance is None:
        return None, None
    steps_per_mm = v.converted(1 / distance.number, "one step for each", distance)
    if microsteps is None:
        return steps_per_mm, None
    rule = f"{microsteps.number:g} steps of {distance.number:g} mm for each full step"
    return steps_per_mm, v.converted(1 / distance.number / microsteps.number, rule, distance, microsteps)


def _gear_ratio(config: KlipperConfig, section: str) -> float:
    """Parse `80:16, 3:1`: motor turns for each turn of the pulley."""
    option = config.text(section, "gear_ratio")
    if option is None or not option.text:
        return 1.0
    place = f"{option.place}: [{section}] gear_ratio"
    pairs = [pair.split(":") for pair in option.text.split(",") if pair.strip()]
    if any(len(pair) != 2 for pair in pairs):
        raise PrinterConfigError(f"{place} = {option.text!r} must be pairs like 80:16 with commas between them.")
    return math.prod(v.plain_number(up, place, above=0) / v.plain_number(down, place, above=0) for up, down in pairs)


# --- Settings that a machine file cannot hold


def _notes(config: KlipperConfig) -> Iterator[str]:
    yield from config.remarks
    ratio = config.number("printer", "minimum_cruise_ratio")
    if ratio is not None and ratio.number != CRUISE_RATIO:
        yield (
            f"{ratio.origin} = {ratio.number:g}: ffcomp plans with {CRUISE_RATIO:g}; say "
            f"SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO={ratio.number:g} in the start G-code."
        )
    older, most = config.number("printer", "max_accel_to_decel"), config.number("printer", "max_accel")
    if ratio is None and older is not None and most is not None:
        in_older = 1.0 - min(older.number / most.number, 1.0)
        if abs(in_older - CRUISE_RATIO) > 0.01:
            yield (
                f"{older.origin} = {older.number:g}: a cruise ratio of {in_older:.3g} in Klippers before 2024, which "
                f"ffcomp plans with {CRUISE_RATIO:g}; set max_accel_to_decel: {most.number * (1 - CRUISE_RATIO):g}."
            )
    for place in _shaper_macros(config):
        yield (
            f"{place} sets the input shaper: input_shaper in [firmware] must hold the command that is in force while "
            "you print, and nothing may run this macro during a compensated print."
        )
    if (limited := config.text("printer", "kinematics")) and limited.text.startswith("limited_"):
        yield f"{limited.place}: the limits of single axes of {limited.text!r} have no place in a machine file."
