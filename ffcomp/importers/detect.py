"""Detect the firmware of a configuration by its content."""

from __future__ import annotations

import re
from pathlib import Path

from ffcomp.importers.commands import commands
from ffcomp.importers.klipper import from_klipper, read_klipper
from ffcomp.importers.marlin import from_marlin
from ffcomp.importers.reprapfirmware import from_reprapfirmware
from ffcomp.importers.values import ConfigValues, PrinterConfigError, decoded

KLIPPER = re.compile(r"^\[(?:printer\]|include |stepper_\w+\]|mcu\])", re.MULTILINE)
MARLIN = re.compile(r"\becho:|\bFIRMWARE_NAME:Marlin", re.IGNORECASE)
SMOOTHIEWARE = re.compile(r"M203\.1|Max actuator feedrates|WCS settings")
MARLIN_SOURCE = re.compile(r"^\s*(?://)?\s*#define\s+[A-Z]", re.MULTILINE)
ONLY_REPRAPFIRMWARE = {"M98", "M307", "M308", "M550", "M563", "M566", "M574", "M584", "M667", "M669", "M950"}
MARLIN_ANSWER = {"M92", "M201", "M203"}  # a slicer writes the latter two as well, but not the first
MOVES = {"G0", "G1", "G28"}  # a print, whatever limits it sets


def read_printer_config(path: Path, kinematics: str | None = None, alone: bool = False) -> ConfigValues:
    """Read the configuration in a file, whichever of the firmwares it is for.

    Parameters
    ----------
    kinematics : for Marlin, which does not tell: "cartesian" or "corexy".
    alone : read no file that this one includes or runs: it comes from somebody who may not name files here.

    Raises
    ------
    PrinterConfigError
        For a file that is none of them, or that says something its firmware would refuse.
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
