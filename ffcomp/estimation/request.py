"""The request of `estimate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ffcomp.options import FLAVOR, OFFSET, STAMPED_MACHINE, Offset
from ffcomp.request import OUTPUT, Argument, MachineLike, Option, Request


@dataclass(frozen=True, kw_only=True)
class EstimateOptions(Request):
    """How prints are read."""

    offset_mm: Annotated[Offset | None, OFFSET] = None
    flavor: Annotated[str, FLAVOR] = ""


@dataclass(frozen=True)
class EstimateRequest(EstimateOptions):
    """A print whose time is estimated; of a container with several the first."""

    file: Annotated[str | Path, Argument("Print, compensated or not.", metavar="FILE")]
    machine: Annotated[MachineLike, STAMPED_MACHINE]


@dataclass(frozen=True)
class EstimateFilesRequest(EstimateOptions):
    """Prints whose times are estimated."""

    files: Annotated[tuple[Path, ...], Argument("Prints, compensated or not.", metavar="FILE...")]
    machine: Annotated[str, STAMPED_MACHINE] = ""
    layers: Annotated[bool, Option("Print a row for every layer.", OUTPUT)] = False
