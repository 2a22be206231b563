"""The request of `estimate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from ffcomp.options import FLAVOR, OFFSET, PLATE, STAMPED_MACHINE, Offset
from ffcomp.request import OUTPUT, Argument, MachineLike, Option, Request


@dataclass(frozen=True)
class EstimateRequest(Request):
    """A print whose time is estimated."""

    file: Annotated[str | Path, Argument("Print, compensated or not.", metavar="FILE")]
    machine: Annotated[MachineLike, STAMPED_MACHINE] = ""
    offset_mm: Annotated[Offset | None, OFFSET] = None
    flavor: Annotated[str, FLAVOR] = ""
    plate: Annotated[int | None, PLATE] = None
    layers: Annotated[bool, Option("Print a row for every layer.", OUTPUT)] = False
