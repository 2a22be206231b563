"""Values of Marlin's answer to M503, with M115's answer if it is in the same text.

The text may come from a terminal: `Recv:`, `echo:` and times before the commands do no harm. M503 states neither
whether a machine without towers is Cartesian or CoreXY, nor its range: M211 and M115 state the latter.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from ffcomp.importers import values as v
from ffcomp.importers.values import AXES, Command, ConfigValues, PrinterConfigError, Value

LETTERS = {**dict.fromkeys(("M92", "M201", "M203"), "XYZE"), "M204": "PRST", "M205": "BEJSTXYZ", "M350": "XYZ"}
LETTERS |= {"M665": "ABCHLRXYZ"}
SENT = re.compile(r"\bsend(?:ing)?\s*:|>>>", re.IGNORECASE)
QUIET_MODE = re.compile(r"stealth", re.IGNORECASE)  # a second set of limits that some firmwares list
AREA = re.compile(r"area:\{full:\{min:\{(?P<low>[^}]*)\},max:\{(?P<high>[^}]*)\}")
ENDS = re.compile(r"Min:(?P<low>[^M]*)Max:(?P<high>[^M;]*)")
PLACE = re.compile(r"(?P<axis>[xyzXYZ]):?\s*(?P<number>-?\d+(?:\.\d+)?)")
DAMPING_RATIO = 0.15
RIGHT_ANGLE = math.sqrt(2.0) - 1.0

ReportedSettings = Mapping[tuple[str, str], Value]


def from_marlin(path: Path, kinematics: str | None) -> ConfigValues:
    """Collect all values of the answer that a machine file can hold; the kinematics if M503 does not state them.

    Raises PrinterConfigError for a malformed number, inches, or unknown kinematics.
    """
    text = v.decoded(path)
    received = list(_received(text, path.name))
    settings = {key: value for command in received for key, value in _words(command)}
    notes = _fixed_time(received)
    kind, origin = _kinematics(settings, kinematics, path)
    limits = {**_limits(settings), **_steps(settings), **_planner(settings), **_own_shaper(settings, bool(notes))}
    if kind != "delta":
        values = v.known({**_straight(settings, _places(text, path.name)), **limits})
        return ConfigValues("Marlin", kind, origin, values, notes)
    note = "M503 does not state DELTA_RADIUS_TRIM_TOWER: if the firmware was built with it, give delta_radii_mm."
    frequencies = (settings.get((f"M593 {axis.upper()}", "F")) for axis in AXES)
    shaper_hz = tuple(each.number for each in frequencies if each is not None and each.number > 0)
    return ConfigValues("Marlin", kind, origin, v.known({**_delta(settings), **limits}), (note, *notes), shaper_hz)


def _received(text: str, name: str) -> Iterator[Command]:
    """Yield the printer's answers, not the commands sent to it."""
    lines = text.split("\n")
    quiet = [bool(QUIET_MODE.search(before)) for before in ["", *lines[:-1]]]
    kept = ["" if SENT.search(line) or after_quiet else line for line, after_quiet in zip(lines, quiet, strict=True)]
    return v.commands("\n".join(kept), name)


def _fixed_time(received: Iterable[Command]) -> tuple[str, ...]:
    """Say that fixed-time motion is on, whose shapers a machine file cannot hold."""
    latest = [command for command in received if command.code == "M493"][-1:]
    return tuple(
        f"{command.place}: M493: fixed-time motion is on. ffcomp plans as Marlin does without it, and does not read "
        "its shapers: send M493 S0 before a compensated print, and set input_shaper = [] in [firmware]."
        for command in latest
        if command.words.get("S") != "0"
    )


def _words(command: Command) -> Iterator[tuple[tuple[str, str], Value]]:
    if command.code == "G20":
        raise PrinterConfigError(f"{command.place}: the numbers are in inches; send G21 before M503.")
    if command.code == "M593":
        yield from _shaper_words(command)
    for letter in LETTERS.get(command.code, ""):
        value = command.number(letter, above=0 if command.code == "M350" else -math.inf)
        if value is not None:
            yield (command.code, letter), value


def _shaper_words(command: Command) -> Iterator[tuple[tuple[str, str], Value]]:
    """Parse `M593 X F40 D0.15`, of both axes where it names none."""
    axes = [axis for axis in "XYZ" if axis in command.words] or ["X", "Y"]
    for letter in "FD":
        value = command.number(letter)
        if value is not None:
            yield from (((f"M593 {axis}", letter), value) for axis in axes)


def _kinematics(settings: ReportedSettings, stated: str | None, path: Path) -> tuple[str, str]:
    if ("M665", "L") in settings and ("M665", "R") in settings:
        return "delta", settings["M665", "R"].origin
    if stated is None:
        raise PrinterConfigError(
            f"{path}: M503 does not state whether the machine is Cartesian or CoreXY; set --kinematics cartesian or "
            "--kinematics corexy."
        )
    return stated, "from --kinematics"


# --- Deltas


def _delta(settings: ReportedSettings) -> dict[str, Value | None]:
    return {
        **v.arm_lengths(_arms(settings)),
        "kinematics.delta_radius_mm": settings["M665", "R"],
        "kinematics.tower_angles_deg": v.tower_angles([settings.get(("M665", letter)) for letter in "XYZ"]),
        "kinematics.print_height_mm": settings.get(("M665", "H")),
    }


def _arms(settings: ReportedSettings) -> list[Value | None]:
    """Add the towers' trims A B C to L; a lone B is an older firmware's calibration radius."""
    rod = settings["M665", "L"]
    trims = [settings.get(("M665", letter)) for letter in "ABC"]
    if any(trim is None for trim in trims):
        return [rod] * 3
    return [
        rod if trim is None or not trim.number else v.converted(rod.number + trim.number, "L plus the trim", rod, trim)
        for trim in trims
    ]


# --- Cartesian and CoreXY machines


def _straight(settings: ReportedSettings, places: Mapping[str, Value]) -> dict[str, Value | None]:
    ranges: dict[str, Value | None] = {f"kinematics.{axis}_range_mm": places.get(axis) for axis in AXES}
    shaped = [_shaped_axis(settings, axis) for axis in AXES]
    return {**ranges, **{key: value for axis in shaped for key, value in axis.items()}}


def _places(text: str, name: str) -> dict[str, Value]:
    """Read the range of each axis: M115's area, or M211's soft endstops."""
    for line_number, line in enumerate(text.split("\n"), 1):
        match = AREA.search(line) or ENDS.search(line)
        if match is None:
            continue
        place = f"{name}:{line_number}"
        ends = [
            {each["axis"].lower(): v.plain_number(each["number"], place) for each in PLACE.finditer(match[end])}
            for end in ("low", "high")
        ]
        if all(set(end) == set(AXES) for end in ends):
            origin = f"{place} {match[0][:4].strip('{:')}"
            return {axis: Value([ends[0][axis], ends[1][axis]], "read", origin) for axis in AXES}
    return {}


def _shaped_axis(settings: ReportedSettings, axis: str) -> dict[str, Value]:
    """Take the shaper's frequency as a start; zero switches it off."""
    frequency = settings.get((f"M593 {axis.upper()}", "F"))
    if frequency is None or frequency.number <= 0:
        return {}
    default = Value(DAMPING_RATIO, "default", "M593 D is not given: the firmware's default")
    damping = settings.get((f"M593 {axis.upper()}", "D"), default)
    return v.shaped_axis(axis, frequency, damping)


def _own_shaper(settings: ReportedSettings, unread: bool) -> dict[str, Value]:
    on = {axis: settings.get((f"M593 {axis}", "F")) for axis in "XYZ"}
    shaped = {axis: frequency for axis, frequency in on.items() if frequency is not None and frequency.number > 0}
    commands = [f"M593 {axis} F{frequency.number:.10g}" for axis, frequency in shaped.items()]
    return v.own_shaper(commands, list(shaped.values()), unread, "M593 is not in the answer: there is no shaper")


# --- Limits and steps


def _limits(settings: ReportedSettings) -> dict[str, Value | None]:
    printing = ("M204", "P") if ("M204", "P") in settings else ("M204", "S")  # older firmwares use S
    acceleration = v.least([settings.get(key) for key in (("M201", "X"), ("M201", "Y"), printing)])
    return {
        "limits.velocity_mm_per_s": v.least([settings.get(("M203", "X")), settings.get(("M203", "Y"))]),
        "limits.acceleration_mm_per_s2": acceleration,
        "limits.square_corner_velocity_mm_per_s": _corner(settings, acceleration),
        "limits.z_velocity_mm_per_s": settings.get(("M203", "Z")),
        "limits.z_acceleration_mm_per_s2": settings.get(("M201", "Z")),
    }


def _planner(settings: ReportedSettings) -> dict[str, Value | None]:
    """Return what Marlin's own planner needs, in its own terms."""

    def four(code: str) -> Value | None:
        return v.all_listed([settings.get((code, axis)) for axis in "XYZE"])

    both, shortest = settings.get(("M204", "S")), settings.get(("M205", "B"))
    planner = {
        "speed_mm_per_s": four("M203"),
        "acceleration_mm_per_s2": four("M201"),
        "printing_acceleration_mm_per_s2": settings.get(("M204", "P"), both),
        "retract_acceleration_mm_per_s2": settings.get(("M204", "R")),
        "travel_acceleration_mm_per_s2": settings.get(("M204", "T"), both),
        "junction_deviation_mm": settings.get(("M205", "J")),
        "jerk_mm_per_s": four("M205"),
        "lowest_speed_mm_per_s": settings.get(("M205", "S")),
        "lowest_travel_speed_mm_per_s": settings.get(("M205", "T")),
        "shortest_segment_s": v.changed(shortest, lambda us: 1e-6 * us, "µs to s"),
    }
    return {f"firmware.marlin.{key}": value for key, value in planner.items()}


def _corner(settings: ReportedSettings, acceleration: Value | None) -> Value | None:
    """Return the jerk of X or Y; or, of a junction deviation J, v² = J a / (√2 − 1) at a right angle."""
    deviation = settings.get(("M205", "J"))
    if deviation is None:
        jerk = v.least([settings.get(("M205", "X")), settings.get(("M205", "Y"))])
        return v.changed(jerk, float, "the jerk of one axis, as at a right angle between them")
    if acceleration is None:
        return None
    speed = math.sqrt(max(deviation.number, 0.0) * acceleration.number / RIGHT_ANGLE)
    return v.converted(round(speed, 3), "junction deviation at a right angle", deviation, acceleration)


def _steps(settings: ReportedSettings) -> dict[str, Value | None]:
    steps, microsteps = ([settings.get((code, letter)) for letter in "XYZ"] for code in ("M92", "M350"))
    return {
        "steps.steps_per_mm": v.together(steps),
        "steps.full_steps_per_mm": v.together([v.full_steps(*pair) for pair in zip(steps, microsteps, strict=True)]),
        "steps.extruder_steps_per_mm": settings.get(("M92", "E")),
    }
