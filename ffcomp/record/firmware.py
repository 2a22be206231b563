"""The commands around an experiment, in each firmware's words: start and end of a capture, corrections off and back on.

Klipper and Kalico ignore a command that their configuration does not have, with a message; so does Marlin.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gcode.dialects import KLIPPER, MARLIN, REPRAPFIRMWARE, shaper_off

Shaper = tuple[float, float]
"""Frequencies of the firmware's own input shaper along x and y, Hz."""

FASTEST_HZ, SLOWEST_HZ = 1600.0, 1300.0  # of the chips that RepRapFirmware knows, at the usual settings
RESTORE = "FFCOMP_RESTORE"

MACRO = f"""\
[gcode_macro {RESTORE}]
description: Put back what a recording of ffcomp changes. Call it in CANCEL_PRINT as well.
gcode:
    {{% set own = printer.configfile.settings %}}
    SET_VELOCITY_LIMIT VELOCITY={{own.printer.max_velocity}} ACCEL={{own.printer.max_accel}}
    SET_VELOCITY_LIMIT SQUARE_CORNER_VELOCITY={{own.printer.square_corner_velocity}}
    SET_VELOCITY_LIMIT MINIMUM_CRUISE_RATIO={{own.printer.minimum_cruise_ratio}}
    {{% if own.input_shaper is defined %}}
    SET_INPUT_SHAPER SHAPER_FREQ_X={{own.input_shaper.shaper_freq_x}} SHAPER_FREQ_Y={{own.input_shaper.shaper_freq_y}}
    {{% endif %}}
    {{% if printer.bed_mesh is defined and 'default' in printer.bed_mesh.profiles %}}
    BED_MESH_PROFILE LOAD=default
    {{% endif %}}
"""


@dataclass(frozen=True)
class Firmware:
    """How a firmware records, and how its corrections are switched."""

    flavor: str
    chips: Sequence[str]  # Klipper's names; RepRapFirmware's addresses; ignored by Marlin
    shaper: Shaper | None = None  # to be switched on again; None: not known

    @property
    def records(self) -> bool:
        """Whether the firmware itself records."""
        return self.flavor in _START

    def start(self, name: str, lasting_s: float) -> list[str]:
        """Return the lines that begin the capture of one execution, which lasts so long, rests included."""
        make = _START.get(self.flavor)
        return [] if make is None else [make(chip, name, lasting_s) for chip in self.chips]

    def stop(self, name: str, lasting_s: float) -> list[str]:
        """Return the lines that end it."""
        if self.flavor == KLIPPER:
            return self.start(name, lasting_s)
        if self.flavor == REPRAPFIRMWARE:  # it ends when it has all samples, later the slower the chip
            return [f"G4 P{math.ceil(1e3 * lasting_s * (FASTEST_HZ / SLOWEST_HZ - 1.0)) + 200}"]
        return []

    def shaper_off(self) -> list[str]:
        """Return the lines that switch the firmware's input shaper off."""
        kept = _KEEP_SHAPER if self.flavor == REPRAPFIRMWARE else ()
        return [*kept, *(line.decode().rstrip() for line in shaper_off(self.flavor))]

    def shaper_on(self) -> list[str]:
        """Return the lines that switch it on again, as far as it is known how it was."""
        if self.flavor == REPRAPFIRMWARE:
            return list(_BACK)
        known = [] if self.shaper is None else [_SHAPER_ON[self.flavor].format(*self.shaper)]
        return [*known, *([RESTORE] if self.flavor == KLIPPER else [])]

    def corrections_off(self) -> list[str]:
        """Return the lines that switch shaper, bed mesh and skew correction off."""
        return [*self.shaper_off(), *_OFF[self.flavor]]

    def corrections_on(self) -> list[str]:
        """Return the lines that switch them on again, as far as it is known how they were."""
        return [*_MESH_ON.get(self.flavor, ()), *self.shaper_on()]

    def explained(self) -> list[str]:
        """Return the comments at the head of a file: how everything is put back, with the macro that does it."""
        return [*self.restores(), *(["", *MACRO.splitlines()] if self.flavor == KLIPPER else [])]

    def restores(self) -> list[str]:
        """Say in sentences how everything is put back, also after a cancelled run."""
        return list(_RESTORES[self.flavor]) + ([] if self.shaper or self.flavor == REPRAPFIRMWARE else [_STAYS_OFF])


def _klipper(chip: str, name: str, lasting_s: float) -> str:
    return f"ACCELEROMETER_MEASURE CHIP={chip} NAME={name}"


def _reprapfirmware(chip: str, name: str, lasting_s: float) -> str:
    return f'M956 P{chip} S{math.ceil(lasting_s * FASTEST_HZ)} A0 F"{name}.csv"'


_START = {KLIPPER: _klipper, REPRAPFIRMWARE: _reprapfirmware}
DEFAULT_CHIPS: Mapping[str, Sequence[str]] = {KLIPPER: ("adxl345",), REPRAPFIRMWARE: ("0",), MARLIN: ()}

_KEEP_SHAPER = (
    "var ffcompShaper = move.shaping.type",
    "var ffcompFrequency = move.shaping.frequency",
    "var ffcompDamping = move.shaping.damping",
)
_BACK = ("M593 P{var.ffcompShaper} F{var.ffcompFrequency} S{var.ffcompDamping}",)
_OFF: Mapping[str, Sequence[str]] = {
    KLIPPER: ("BED_MESH_CLEAR", "SET_SKEW CLEAR=1"),
    REPRAPFIRMWARE: ("G29 S2",),
    MARLIN: ("M420 S0",),
}
_MESH_ON: Mapping[str, Sequence[str]] = {REPRAPFIRMWARE: ("G29 S1",), MARLIN: ("M420 S1",)}  # Klipper: the macro
_SHAPER_ON = {
    KLIPPER: "SET_INPUT_SHAPER SHAPER_FREQ_X={:g} SHAPER_FREQ_Y={:g}",
    MARLIN: "M593 X F{:g}\nM593 Y F{:g}",
}
_STAYS_OFF = (
    "The input shaper stays off until then or until the firmware restarts, for the file does not know its "
    "frequencies: --shaper X,Y (Hz) states them."
)
_RESTORES: Mapping[str, Sequence[str]] = {
    KLIPPER: (
        f"The file puts back its limits after every experiment, and calls {RESTORE} at the end. That macro, printed "
        "at the head of the file, belongs into printer.cfg: it puts back limits, shaper and bed mesh as printer.cfg "
        "states them, and does so for a cancelled run too where CANCEL_PRINT calls it. Without it: RESTART.",
    ),
    REPRAPFIRMWARE: (
        "The file puts back limits, shaper and mesh at the end. When the run is cancelled, cancel.g must: M98 "
        'P"config.g" and G29 S1 in it, or a reset.',
    ),
    MARLIN: ("The file puts back limits and mesh at the end. When the run is cancelled: M501, or a reset.",),
}
