"""The request of `ffcomp machines import`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from ffcomp.request import MACHINE, OUTPUT, Argument, Option, Request


@dataclass(frozen=True)
class ImportMachineRequest(Request):
    """A printer configuration to be imported."""

    file: Annotated[Path, Argument("printer.cfg, config.g, or a text with Marlin's answer to M503.", metavar="FILE")]
    output: Annotated[
        Path | None,
        Option("File to write. Default: in your own machine folder.", OUTPUT, "--output -o", metavar="FILE"),
    ] = None
    like: Annotated[
        str | None,
        Option(
            "Machine whose parameters replace unknown ones. Default for deltas: the one with the nearest arm length.",
            MACHINE,
            metavar="NAME",
        ),
    ] = None
    kinematics: Annotated[
        Literal["cartesian", "corexy"] | None,
        Option(
            "Kinematics of a Marlin printer, whose answer to M503 does not state it.",
            MACHINE,
            metavar="cartesian|corexy",
            label="Marlin only: its kinematics",
        ),
    ] = None
    alone: Annotated[
        bool, Option("Read this file only and ignore its includes. Use it for files that are not yours.", MACHINE)
    ] = False
