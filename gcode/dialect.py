"""How firmwares read and write G-code differently: one row for each in `DIALECTS`.

Commands that differ between firmwares are in `OWN_EFFECTS` in `gcode.commands`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

KLIPPER, MARLIN, REPRAPFIRMWARE = "klipper", "marlin", "reprapfirmware"


class BareWords(Enum):
    """What a line of words without a command does."""

    REJECTED = "Klipper rejects such a line and does not move"
    OPTIONAL = "it repeats the last move command, as in Marlin with GCODE_MOTION_MODES; other builds skip it"
    REPEAT = ""  # it repeats the last move command


@dataclass(frozen=True, slots=True)
class Dialect:
    """The G-code of one firmware."""

    name: str
    declared: tuple[bytes, ...]  # names that slicers give it, in lower case
    shaper_command: bytes
    shaper_off: bytes  # empty: the command names axes
    shaper_on: tuple[str, ...]  # lines that set one, with {name}, {x} and {y} in Hz, and {damping}
    shapers: Mapping[str, str]  # its shapers' {name} by their names in `ffcomp.shapers`
    shapes_axes: bool = True  # its shaper has a frequency for x and one for y; else one for both
    jerk: tuple[str, str] = ("", "")  # command that sets jerk, and its axes; empty: limits are not set by axes
    per_minute: frozenset[str] = frozenset()  # commands that set speeds in mm/min
    refuses: bool = True  # offsets and conditions that are not followed; else such a word is a macro or a message
    g18_axes: str = "ZX"  # the first axis is Z by NIST RS274/NGC
    g91_makes_e_relative: bool = False  # whatever M82 and M83 say
    g90_sets_e: bool = False  # G90 and G91 override M82 and M83
    zero_feed_keeps: bool = True  # F0 keeps the last feed; else it is an error
    bare_g92_is_zero: bool = False  # G92 without words sets all axes to zero
    bare_words: BareWords = BareWords.REPEAT
    obeys_whole_line: bool = False  # all commands of a line, not only the first
    kept_positions: bool = False  # G0 R and G1 R begin at a saved position


DIALECTS: Mapping[str, Dialect] = {
    each.name: each
    for each in (
        Dialect(
            KLIPPER,
            (b"klipper",),
            b"SET_INPUT_SHAPER",
            b"",
            (
                "SET_INPUT_SHAPER SHAPER_TYPE_X={name} SHAPER_FREQ_X={x:.1f} DAMPING_RATIO_X={damping:g} "
                "SHAPER_TYPE_Y={name} SHAPER_FREQ_Y={y:.1f} DAMPING_RATIO_Y={damping:g}",
            ),
            {name: name for name in ("zv", "mzv", "zvd", "ei", "2hump_ei", "3hump_ei")},
            refuses=False,
            g18_axes="XZ",  # a mirrored arc
            g91_makes_e_relative=True,
            zero_feed_keeps=False,
            bare_g92_is_zero=True,
            bare_words=BareWords.REJECTED,
        ),
        Dialect(
            MARLIN,
            (b"marlin", b"marlin2"),
            b"M593",
            b"M593 F0",
            ("M593 X F{x:.1f} D{damping:g}", "M593 Y F{y:.1f} D{damping:g}"),
            {"zv": ""},
            jerk=("M205", "XY"),
            g90_sets_e=True,
            bare_words=BareWords.OPTIONAL,
        ),
        Dialect(
            REPRAPFIRMWARE,
            (b"reprapfirmware", b"rrf"),
            b"M593",
            b'M593 P"none"',
            ('M593 P"{name}" F{x:.1f} S{damping:g}',),
            {"mzv": "mzv", "zvd": "zvd", "zvdd": "zvdd", "zvddd": "zvddd", "2hump_ei": "ei2", "3hump_ei": "ei3"},
            shapes_axes=False,
            jerk=("M566", "XYZ"),
            per_minute=frozenset({"M203", "M566"}),
            obeys_whole_line=True,
            kept_positions=True,
        ),
    )
}
