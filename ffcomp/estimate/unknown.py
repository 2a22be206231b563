"""Find commands whose time no file states: heating, homing, macros."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from gcode.program import Event, EventKind, Program
from gcode.words import commands

REMEMBERED = 50  # lines of each command that are remembered

_NO_TIME = re.compile(
    r"M2|M3|M4|M5|M17|M18|M30|M8[01]|M84|M206|M400|M420|M428|M575|M593|M66[56]|G92|SET_INPUT_SHAPER|BED_MESH_CLEAR"
    r"|BED_MESH_OFFSET|BED_MESH_PROFILE|SYNC_EXTRUDER_MOTION|SET_KINEMATIC_POSITION|(?:SAVE|RESTORE)_GCODE_STATE"
    r"|SET_GCODE_OFFSET"
)
_KINDS = {
    "heating": re.compile(r"M109|M116|M19[01]|M303|TEMPERATURE_WAIT"),
    "homing": re.compile(r"G28"),
    "probing": re.compile(
        r"G29|G3[0-4]|G38\.\d|M48|M40[12]|BED_MESH_CALIBRATE|DELTA_CALIBRATE|PROBE|QUAD_GANTRY_LEVEL|Z_TILT_ADJUST"
    ),
    "a pause": re.compile(r"M0|M1|M25|M125|M226|M28[0]|M60[0-2]|PAUSE|RESUME"),
    "a change of tool or filament": re.compile(r"T(-?\d+|\?)|M70[12]|ACTIVATE_EXTRUDER"),
    "retraction by the firmware": re.compile(r"G1[01]"),
}
_MACRO = "a macro or a command not known"
_FROM_NOWHERE = "a move from a place not known"


@dataclass(slots=True)
class Unknown:
    """Lines with one command that may take time."""

    what: str
    command: str
    count: int = 0
    lines: list[int] = field(default_factory=list)  # from 1, the first of them

    def add(self, line: int) -> None:
        """Count one more line."""
        self.count += 1
        if len(self.lines) < REMEMBERED:
            self.lines.append(line)


def unknown_in(program: Program, event: Event) -> tuple[str, str] | None:
    """Return the kind of wait and the command of a line; None for lines that take no time, or a known one."""
    if event.kind not in (EventKind.STOP, EventKind.RAW_MOVE):
        return None
    line = program.lines[event.line]
    words = commands(line, program.first_line + event.line + 1)
    name = words[0].name if words else ""
    if event.kind is EventKind.RAW_MOVE:
        return _FROM_NOWHERE, name or "G1"
    if not name or (_NO_TIME.fullmatch(name) and b"MOVE=1" not in line.upper()):
        return None
    return next((what for what, names in _KINDS.items() if names.fullmatch(name)), _MACRO), name
