"""Values of a RepRapFirmware `config.g`.

Commands are followed in the firmware's order: M350 after M92 changes the steps per mm, M98 runs another file, M501
runs `config-override.g`. Commands under an `if` or a `while`, and formulas in braces, are not evaluated: each
relevant one is noted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from ffcomp.importers import values as v
from ffcomp.importers.values import AXES, Command, ConfigValues, PrinterConfigError, Value

KINDS = {"0": "cartesian", "1": "corexy", "3": "delta"}
KINDS |= {"cartesian": "cartesian", "corexy": "corexy", "lineardelta": "delta"}
NAMES = {"2": "CoreXZ", "4": "SCARA", "5": "CoreXYU", "6": "Hangprinter", "7": "polar", "8": "CoreXYUV"}
NAMES |= {"10": "rotary delta", "11": "MarkForged (hybrid CoreXY)"}
KEPT = {  # letters that hold until a later command sets them
    "M201": "XYZE",
    "M203": "XYZE",
    "M204": "PT",
    "M566": "XYZEP",
    "M593": "FS",
    "M595": "P",
    "M665": "BHLRXYZ",
    "M666": "AB",
}
READ = {*KEPT, "M92", "M208", "M350", "M667", "M669"}
MICROSTEPS, DAMPING_RATIO = 16.0, 0.1  # the firmware's defaults
MOST_FILES = 1000
PER_MINUTE = "mm/min over 60"


@dataclass
class ConfigSettings:
    """State of the firmware after the commands so far."""

    kept: dict[tuple[str, str], list[Value]] = field(default_factory=dict)  # (command, letter) -> its numbers
    steps_per_mm: dict[str, Value] = field(default_factory=dict)  # letter -> number
    microsteps: dict[str, Value] = field(default_factory=dict)
    ranges: dict[str, dict[str, Value]] = field(default_factory=dict)  # letter -> "low", "high" -> number
    kinematics: tuple[str, str] = ("cartesian", "neither M669 nor M665 is given: the firmware's default")
    shaper: dict[str, str] = field(default_factory=dict)  # letter -> the text after it: M593
    notes: list[str] = field(default_factory=list)
    files: int = 0  # run so far
    unread: bool = False  # a macro, or a shaper under a condition, was not read
    alone: bool = False  # no other file is read

    def first(self, code: str, letter: str) -> Value | None:
        """Return the first number of a letter of a command."""
        return next(iter(self.kept.get((code, letter), [])), None)


def from_reprapfirmware(path: Path, alone: bool = False) -> ConfigValues:
    """Collect all values of a `config.g` that a machine file can hold.

    Raises PrinterConfigError where a number is none, macros run in a circle, or the kinematics are unsupported.
    """
    settings = ConfigSettings(alone=alone)
    for command in _run(path, settings, (path.resolve(),)):
        _apply(command, settings)
    kind, origin = settings.kinematics
    of_kind = _delta(settings) if kind == "delta" else _straight(settings)
    values = v.known({**of_kind, **_limits(settings), **_planner(settings), **_steps(settings)}) | _own_shaper(settings)
    shaper = _shaper(settings) if kind == "delta" else None
    shaper_hz = () if shaper is None else (shaper.number,)
    tilts = [tilt for letter in "AB" if (tilt := settings.first("M666", letter)) is not None and tilt.number]
    notes = [f"{tilt.origin} = {tilt.number:g} % of tilt: a machine file has no place for it." for tilt in tilts]
    return ConfigValues("RepRapFirmware", kind, origin, values, (*settings.notes, *notes), shaper_hz)


# --- The firmware's order


def _run(path: Path, settings: ConfigSettings, within: tuple[Path, ...]) -> Iterator[Command]:
    """Yield the commands of a file and of those it runs."""
    for command in v.commands(v.decoded(path), path.name):
        if command.conditional and command.code in {*READ, "M98", "M501"}:
            settings.notes.append(f"{command.place}: this {command.code} stands under a condition and was not read.")
            settings.unread |= command.code in ("M98", "M501", "M593")
        elif command.code == "M98" and "P" in command.words:
            yield from _macro(command, command.words["P"], path, settings, within)
        elif command.code == "M501":
            yield from _macro(command, "config-override.g", path, settings, within)
        else:
            yield command


def _macro(
    command: Command, name: str, source: Path, settings: ConfigSettings, within: tuple[Path, ...]
) -> Iterator[Command]:
    """Find a macro in /sys, or in another folder of the same card, and yield its commands."""
    if settings.alone:
        settings.notes.append(f"{command.place}: {command.code} runs {name}; only this file is read.")
        settings.unread = True
        return
    relative = name.removeprefix("0:").removeprefix("/sys/").lstrip("/")
    places = (folder / relative for folder in (source.parent, source.parent.parent))
    file = next((place for place in places if place.is_file()), None)
    if file is None:
        settings.notes.append(f"{command.place}: {command.code} runs {name}, which is not here; it was not read.")
        settings.unread = True
        return
    settings.files += 1
    if file.resolve() in within or settings.files > MOST_FILES:
        rule = f"more than {MOST_FILES} files are run" if settings.files > MOST_FILES else "it runs itself"
        raise PrinterConfigError(f"{command.place}: {command.code} runs {name}: {rule}.")
    yield from _run(file, settings, (*within, file.resolve()))


def _apply(command: Command, settings: ConfigSettings) -> None:
    if command.code in READ:
        formulas = [letter for letter, text in command.words.items() if text.startswith("{")]
        settings.notes += [f"{command.place}: the formula of {command.code} {each} was not read." for each in formulas]
    if command.code in KEPT:
        numbers = {(command.code, letter): command.numbers(letter) for letter in KEPT[command.code]}
        settings.kept |= {key: values for key, values in numbers.items() if values}
    if command.code == "M203" and "I" in command.words:
        settings.notes.append(
            f"{command.place}: M203 I{command.words['I']}, the slowest speed of any move, has no place in a machine "
            "file; 0.5 mm/s is taken, and what a print's own M203 I says."
        )
    if command.code in APPLY:
        APPLY[command.code](command, settings)
    elif command.code == "M593":
        settings.shaper |= command.words
        settings.unread |= any(text.startswith("{") for text in command.words.values())
    elif command.code == "M665":
        settings.kinematics = ("delta", f"{command.place} M665")
    elif command.code == "M667":  # the older command; S1 is CoreXY
        _set_kind(command, command.words.get("S", "0"), settings)


def _m92(command: Command, settings: ConfigSettings) -> None:
    """Set steps per mm, at the microsteps in effect or at S."""
    meant = command.number("S", above=0)
    for letter in "XYZE":
        steps = command.number(letter, above=0)
        if steps is not None and meant is not None:
            factor = _microsteps(settings, letter).number / meant.number
            steps = v.converted(steps.number * factor, f"said for 1/{meant.number:g} steps", steps, meant)
        if steps is not None:
            settings.steps_per_mm[letter] = steps


def _m350(command: Command, settings: ConfigSettings) -> None:
    """Change microsteps: steps per mm set so far keep their meaning in mm."""
    for letter in "XYZE":
        new = command.number(letter, above=0)
        if new is None:
            continue
        ratio = new.number / _microsteps(settings, letter).number
        if letter in settings.steps_per_mm and ratio != 1:
            steps, rule = settings.steps_per_mm[letter], f"M350 {letter} changed the microsteps afterwards"
            settings.steps_per_mm[letter] = v.converted(steps.number * ratio, rule, steps, new)
        settings.microsteps[letter] = new


def _microsteps(settings: ConfigSettings, letter: str) -> Value:
    default = Value(MICROSTEPS, "default", f"M350 {letter} is not given: the firmware's default")
    return settings.microsteps.get(letter, default)


def _m208(command: Command, settings: ConfigSettings) -> None:
    """Set ranges: `M208 X0:220`, or the lowest positions with S1 and the highest with S0."""
    end = "low" if command.words.get("S") == "1" else "high"
    for letter in "XYZ":
        numbers = command.numbers(letter)
        ends = ("low", "high") if len(numbers) == 2 else (end,)
        settings.ranges.setdefault(letter, {}).update(zip(ends, numbers, strict=False))


def _m669(command: Command, settings: ConfigSettings) -> None:
    if "K" in command.words:
        _set_kind(command, command.words["K"].lower(), settings)
    if ":" in command.words.get("X", "") + command.words.get("Y", ""):
        raise v.unsupported(command.place, "this M669 gives a movement matrix")


def _set_kind(command: Command, word: str, settings: ConfigSettings) -> None:
    if word not in KINDS:
        raise v.unsupported(command.place, f"{command.code} selects {NAMES.get(word, word)} kinematics")
    settings.kinematics = (KINDS[word], f"{command.place} {command.code}")


APPLY = {"M92": _m92, "M208": _m208, "M350": _m350, "M669": _m669}


# --- Values of the machine


def _delta(settings: ConfigSettings) -> dict[str, Value | None]:
    arms = settings.kept.get(("M665", "L"), [])
    if len(arms) > 3:
        raise PrinterConfigError(f"{arms[0].origin} gives {len(arms)} arms: ffcomp has deltas of three towers.")
    of_towers = [*arms, *[arms[0]] * (3 - len(arms))] if arms else [None]  # towers without a length are as the first
    radius = settings.first("M665", "R")
    return {
        **v.arm_lengths(of_towers),
        "kinematics.delta_radius_mm": radius,
        "kinematics.tower_angles_deg": v.tower_angles([settings.first("M665", letter) for letter in "XYZ"]),
        "kinematics.print_radius_mm": v.print_radius(settings.first("M665", "B"), radius, v.least(of_towers)),
        "kinematics.print_height_mm": settings.first("M665", "H"),
    }


def _straight(settings: ConfigSettings) -> dict[str, Value | None]:
    values = {f"kinematics.{axis}_range_mm": _range(settings, axis.upper()) for axis in AXES}
    frequency = _shaper(settings)
    if frequency is not None:  # one for both axes
        default = Value(DAMPING_RATIO, "default", "M593 S is not given: the firmware's default")
        damping = settings.first("M593", "S") or default
        values |= {**v.shaped_axis("x", frequency, damping), **v.shaped_axis("y", frequency, damping)}
    return values


def _range(settings: ConfigSettings, letter: str) -> Value | None:
    limits = settings.ranges.get(letter, {})
    if "high" not in limits:
        return None
    low = limits.get("low", Value(0.0, "default", f"M208 gives no lowest {letter}: the firmware's default"))
    return v.listed([low, limits["high"]])


def _shaper(settings: ConfigSettings) -> Value | None:
    frequency = settings.first("M593", "F")
    is_on = settings.shaper.get("P", "").lower() != "none"
    return frequency if frequency and frequency.number > 0 and is_on else None


def _own_shaper(settings: ConfigSettings) -> dict[str, Value]:
    frequency = _shaper(settings)
    words = {**settings.shaper, "P": f'"{settings.shaper["P"]}"'} if "P" in settings.shaper else settings.shaper
    commands = [" ".join(["M593", *(letter + text for letter, text in words.items())])] if frequency else []
    sources = [frequency] if frequency else []
    return v.own_shaper(commands, sources, settings.unread, "M593 switches none on: there is no shaper")


def _limits(settings: ConfigSettings) -> dict[str, Value | None]:
    def per_minute(code: str, letters: str) -> Value | None:
        slowest = v.least([settings.first(code, letter) for letter in letters])
        return v.changed(slowest, lambda speed: speed / 60, PER_MINUTE)

    accelerations = [settings.first("M201", "X"), settings.first("M201", "Y"), settings.first("M204", "P")]
    return {
        "limits.velocity_mm_per_s": per_minute("M203", "XY"),
        "limits.acceleration_mm_per_s2": v.least(accelerations),
        "limits.square_corner_velocity_mm_per_s": per_minute("M566", "XY"),
        "limits.z_velocity_mm_per_s": per_minute("M203", "Z"),
        "limits.z_acceleration_mm_per_s2": settings.first("M201", "Z"),
    }


def _planner(settings: ConfigSettings) -> dict[str, Value | None]:
    """Return what the firmware's own planner needs."""

    def four(code: str) -> list[Value | None]:
        return [settings.first(code, axis) for axis in "XYZE"]

    planner = {
        "speed_mm_per_s": v.all_listed(four("M203"), 1 / 60, PER_MINUTE),
        "acceleration_mm_per_s2": v.all_listed(four("M201")),
        "jerk_mm_per_s": v.all_listed(four("M566"), 1 / 60, PER_MINUTE),
        "printing_acceleration_mm_per_s2": settings.first("M204", "P"),
        "travel_acceleration_mm_per_s2": settings.first("M204", "T"),
        "jerk_policy": v.whole(settings.first("M566", "P")),
        "queue_moves": v.whole(settings.first("M595", "P")),
    }
    return {f"firmware.reprapfirmware.{key}": value for key, value in planner.items()}


def _steps(settings: ConfigSettings) -> dict[str, Value | None]:
    steps = [settings.steps_per_mm.get(letter) for letter in "XYZ"]
    microsteps = [_microsteps(settings, letter) for letter in "XYZ"]
    return {
        "steps.steps_per_mm": v.together(steps),
        "steps.full_steps_per_mm": v.together([v.full_steps(*pair) for pair in zip(steps, microsteps, strict=True)]),
        "steps.extruder_steps_per_mm": settings.steps_per_mm.get("E"),
    }
