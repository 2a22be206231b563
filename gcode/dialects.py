"""Which firmware and slicer a file was made for, and each firmware's words for motion limits.

A slicer can state the wrong firmware (Cura writes `FLAVOR:Marlin` for most Klipper printers), so a Klipper command in
the file outranks the declaration. `M204 S` as the only limit command means Klipper: slicers for Marlin also set limits
for each axis, or use P and T.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import nan
from typing import NamedTuple

from gcode.dialect import DIALECTS, KLIPPER, MARLIN, REPRAPFIRMWARE
from gcode.errors import UnsupportedGcode
from gcode.program import LimitCommand

# Patterns match from the start of a line. Searching for a rare substring first is ten times faster on a long print.
_KLIPPER_COMMAND = b"_", re.compile(rb"[ \t]*[A-Z]+_[A-Z_]+(?:[ \t\r\n]|\Z)")
_DECLARED = b"flavor", re.compile(rb";[ \t]*(?:gcode_)?flavor[ \t]*[=:][ \t]*([\w-]+)", re.IGNORECASE)
_RRF_COMMANDS = tuple(
    (command, re.compile(rb"[ \t]*" + command + rb"(?!\d)")) for command in (b"M566", b"M572", b"M593 P", b"G32")
)
_CURA_MARLIN = re.compile(rb";FLAVOR:Marlin\s*\Z")  # Cura writes it for everything that is not RepRap
_KLIPPER_ACCELERATION = b"M204", re.compile(rb"[ \t]*M204[ \t]+S[ \t]*\d+")
_MARLIN_LIMITS = tuple(
    (command, re.compile(rb"[ \t]*" + command + more))
    for command, more in ((b"M204", rb"[^;\n]*[PT]"), (b"M201", rb"[ \t]"), (b"M203", rb"[ \t]"), (b"M900", rb"[ \t]"))
)
_PRUSA = b"M862", re.compile(rb"[ \t]*M862(?:\.\d)?[ \t]")  # Prusa's firmware, a Marlin, has M572 too
_JERK = b"M205", re.compile(rb"[ \t]*M205[ \t]")
_CURA_RRF = b";FLAVOR:RepRap", re.compile(rb";FLAVOR:RepRap\b")  # Cura's name; Slic3r's `reprap` is old Marlin
_FLAVORS = {declared: dialect.name for dialect in DIALECTS.values() for declared in dialect.declared}

_SLICERS = str.split(
    "OrcaSlicer BambuStudio SuperSlicer PrusaSlicer Slic3r Cura_SteamEngine Simplify3D ideaMaker KISSlicer"
)
_HEAD_LINES = 200

# A mode of E, a move that extrudes on its way, or a new name for E.
_FILAMENT = re.compile(
    rb"^[ \t]*(?:(M8[23]|G91)(?!\d)"
    rb"|G0*[123](?!\d)[^;\n\r]*[XY][^;\n\r]*?E(-?(?:\d+\.?\d*|\.\d+))"
    rb"|(G92[^;\n\r]*E))",
    re.MULTILINE,
)
FILAMENT_MODE = re.compile(rb"^[ \t]*M8[23](?!\d)", re.MULTILINE)
_ENOUGH_MOVES, _FEW_MOVES, _MOST_WIPES = 40, 4, 0.25
BAMBU = b"Bambu"  # in every print for its printers, where G90 leaves M83 in force


class FlavorSign(NamedTuple):
    """Evidence in a file for the firmware that it was made for."""

    flavor: str
    text: str = ""  # the line that shows it; empty: no line does
    certain: bool = False


def flavor_sign(lines: Iterable[bytes]) -> FlavorSign:
    """Find the evidence for a firmware; Marlin if there is none."""
    text = b"".join(lines)
    if command := _first(text, *_KLIPPER_COMMAND):
        return FlavorSign(KLIPPER, _shown(command), certain=True)
    declared = _first(text, *_DECLARED)
    flavor = _FLAVORS.get(declared.group(1).lower()) if declared else None
    by_cura = declared is not None and _CURA_MARLIN.match(declared.group()) is not None
    if declared is None or by_cura:
        acceleration = _klipper_acceleration(text, by_cura)
        if acceleration is not None:
            return FlavorSign(KLIPPER, f"{_shown(acceleration)} and no limits in another firmware's syntax")
    if declared is not None and flavor:
        return FlavorSign(flavor, _shown(declared), certain=not by_cura)
    if check := _first(text, *_PRUSA):
        return FlavorSign(MARLIN, _shown(check), certain=True)
    for sign in (*_RRF_COMMANDS, _CURA_RRF):
        if match := _first(text, *sign):
            return FlavorSign(REPRAPFIRMWARE, _shown(match), certain=True)
    return FlavorSign(MARLIN)


def _klipper_acceleration(text: bytes, by_cura: bool) -> re.Match[bytes] | None:
    """Return `M204 S` if no other command of the file sets limits (apart from jerk, which Cura always sets)."""
    acceleration = _first(text, *_KLIPPER_ACCELERATION)
    others = (*_MARLIN_LIMITS, _PRUSA) if by_cura else (*_MARLIN_LIMITS, _PRUSA, _JERK)
    return None if acceleration is None or any(_first(text, *sign) for sign in others) else acceleration


def _shown(match: re.Match[bytes]) -> str:
    return " ".join(match.group().decode("ascii", "replace").split())


def sign_by_ends(head: bytes, tail: bytes) -> FlavorSign:
    """Find the evidence in a file's first and last MiB, say: slicers put start and end scripts and settings there.

    The result is wrong only if the first evidence stands in between.
    """
    _, _, whole_lines = tail.partition(b"\n")
    return flavor_sign([head, b"\n", whole_lines])


def _first(text: bytes, sign: bytes, line: re.Pattern[bytes]) -> re.Match[bytes] | None:
    """Find the first line that matches; every match contains `sign`, in lower or upper case."""
    sought = text.lower() if line.flags & re.IGNORECASE else text
    at = sought.find(sign)
    while at >= 0:
        if match := line.match(text, text.rfind(b"\n", 0, at) + 1):
            return match
        end = text.find(b"\n", at)
        at = sought.find(sign, end) if end >= 0 else -1
    return None


def filament_is_relative(text: bytes, *, until_stated: bool = False) -> bool | None:
    """Return whether E is relative, inferred from the numbers; None if it states it or extrudes too little.

    Absolute numbers grow from one extruding move to the next, except for wipes; relative numbers grow half the time.
    Files without M82 and M83 rely on the printer's start macro.

    until_stated : judge by the moves before the next M82 or M83, of which a few are enough
    """
    last, growing, others = nan, 0, 0
    for mode, number, renamed in _FILAMENT.findall(text):
        if mode and not until_stated:
            return None
        if mode:
            break
        value = nan if renamed else float(number)
        growing, others, last = growing + (value > last), others + (value <= last), value
        if growing + others >= _ENOUGH_MOVES:
            break
    moves = growing + others
    return None if moves < (_FEW_MOVES if until_stated else _ENOUGH_MOVES) else others > _MOST_WIPES * moves


def detect_slicer(lines: list[bytes]) -> str:
    """Return the slicer's name from its header comments, or "unknown"."""
    comments = [line for line in lines[:_HEAD_LINES] if line.lstrip().startswith(b";")]
    head = b"".join(comments)
    return next((name.partition("_")[0] for name in _SLICERS if name.encode() in head), "unknown")


def limit_lines(flavor: str, commands: Iterable[LimitCommand], unit_mm: float) -> list[bytes]:
    """Return commands that set limits as a file with this unit states them: after G20, Marlin takes inches."""
    lines = []
    for code, words, _ in commands:
        numbers = ((letter, value / limit_unit(flavor, code, letter, unit_mm)) for letter, value in words.items())
        lines.append(" ".join([code, *(f"{letter}{limit_number(x)}" for letter, x in numbers)]).encode())
    return lines


def limit_unit(flavor: str, code: str, letter: str, unit_mm: float) -> float:
    """Return the unit of a limit command's number in mm, mm/s or mm/s²."""
    if (code, letter) in _NO_LENGTHS:
        return 1.0
    return unit_mm / 60.0 if code in DIALECTS[flavor].per_minute else unit_mm


_NO_LENGTHS = {("M205", "B"), ("M566", "P")}  # µs; RepRapFirmware's jerk policy
_SHAPER_FREQUENCY = re.compile(rb"(?:SHAPER|SMOOTHER)_FREQ_\w", re.IGNORECASE)


def shaper_commands(flavor: str, lines: Sequence[str] | None) -> Sequence[str] | None:
    """Return the lines that switch a firmware's own shaper on; None where they are unknown, or another firmware's."""
    command = DIALECTS[flavor].shaper_command.decode()
    return lines if lines is not None and all(each.upper().startswith(command) for each in lines) else None


def shaper_off(flavor: str, on: Iterable[bytes] = ()) -> list[bytes]:
    """Lines that switch the firmware's own input shaper off; types and damping ratios are kept.

    On Klipper this stops the motion for a moment. Without an [input_shaper] section the host only reports an unknown
    command.

    on : lines that switch it on, if known: on Klipper they name its axes
    """
    dialect = DIALECTS[flavor]
    if not dialect.shaper_off:
        named = _SHAPER_FREQUENCY.findall(b" ".join(on).upper())
        words = dict.fromkeys([b"SHAPER_FREQ_X", b"SHAPER_FREQ_Y", *named])
        return [b"%b %b\n" % (dialect.shaper_command, b" ".join(word + b"=0" for word in words))]
    return [dialect.shaper_off + b"\n"]


def shaper_on(flavor: str, kind: str, hz: tuple[float, float], damping: float) -> list[bytes]:
    """Lines that set the firmware's own input shaper.

    kind : of `Dialect.shapers`
    hz : of x and y; RepRapFirmware has one frequency, that of x
    """
    dialect = DIALECTS[flavor]
    words = {"name": dialect.shapers[kind], "x": hz[0], "y": hz[1], "damping": damping}
    return [f"{line.format(**words)}\n".encode() for line in dialect.shaper_on]


def limit_number(value: float) -> str:
    """Return a limit with three decimals at most."""
    return f"{value:.3f}".rstrip("0").rstrip(".")


REMEDY = "set --flavor NAME, or flavor in [firmware] of the machine file"


@dataclass(frozen=True, slots=True)
class FlavorChoice:
    """A firmware, and why it was chosen."""

    flavor: str
    reason: str  # a sentence for the user
    warning: str = ""  # if the print was made for another firmware


def choose_flavor(requested: str, stated: str, sign: FlavorSign, path: str = "") -> FlavorChoice:
    """Choose a firmware: the caller's request first, then the machine file, then the evidence in the print.

    requested, stated : the caller's request and the machine file's entry; empty: none
    sign : the evidence in the print;  path : its name, for errors

    UnsupportedGcode: if the requested name is not a flavor.
    """
    flavor = requested or stated
    if not flavor:
        because = f"the print holds {sign.text}" if sign.text else "nothing in the print names another"
        doubt = "" if sign.certain else f" If that is wrong: {REMEDY}."
        return FlavorChoice(sign.flavor, f"Firmware: {sign.flavor}, because {because}.{doubt}")
    if flavor not in DIALECTS:
        raise UnsupportedGcode(f"Unknown flavor {flavor!r}: use {', '.join(sorted(DIALECTS))}.", path=path)
    by = "requested" if requested else "the machine file says"
    reason = f"Firmware: {flavor}, as {by}."
    if not sign.text or sign.flavor == flavor:
        return FlavorChoice(flavor, reason)
    rule = f"The print is made for {sign.flavor} ({sign.text}), but compensated for {flavor}, as {by}"
    remedy = f"If the printer runs {sign.flavor}, many segments will be late: use --flavor {sign.flavor}"
    return FlavorChoice(flavor, reason, f"{rule}. {remedy}.")
