"""A slicer's information on a print: `SLIC3R_…` variables for post-processing scripts, and settings in the file.

PrusaSlicer, OrcaSlicer and BambuStudio (all after Slic3r) put every setting into the environment of a post-processing
script, besides `SLIC3R_PP_HOST` and `SLIC3R_PP_OUTPUT_NAME`, and write the settings into the file as comments.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path

from gcode.container import ends_of
from gcode.dialect import DIALECTS
from models.machine import Machine

KNOWN = DIALECTS.keys() | {"marlin2", "reprap"}  # slicers' names; they write `reprap` for all that is like old Marlin
FAR = 0.25  # of the bed: origins in a corner and in the middle differ by a half

_CORNER = re.compile(r"([-+.\d]+)x([-+.\d]+)")
_BED_COMMENT = re.compile(rb"^; (?:bed_shape|printable_area) = ([-+.\dx,]+)", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Bed:
    """The box around the bed, mm."""

    low: tuple[float, float]
    high: tuple[float, float]

    @property
    def centre(self) -> tuple[float, float]:
        """Return the middle of the bed, X Y mm."""
        return (self.low[0] + self.high[0]) / 2, (self.low[1] + self.high[1]) / 2

    @property
    def size(self) -> tuple[float, float]:
        """Return the width and depth of the bed, mm."""
        return self.high[0] - self.low[0], self.high[1] - self.low[1]


@dataclass(frozen=True, slots=True)
class Call:
    """The call of a slicer; all empty when it is none."""

    host: str = ""  # File, PrusaLink, OctoPrint, …
    output_name: str = ""  # the requested output: a path for a File, else a name on the host
    bed: Bed | None = None
    flavor: str = ""
    later: tuple[str, ...] = ()  # scripts that the slicer runs after us


def read_call(environment: Mapping[str, str]) -> Call:
    """Read the slicer's environment variables."""
    names = "PP_HOST PP_OUTPUT_NAME GCODE_FLAVOR POST_PROCESS BED_SHAPE PRINTABLE_AREA"
    host, output, flavor, later, bed, area = (environment.get(f"SLIC3R_{name}", "") for name in names.split())
    return Call(host, output, read_bed(bed or area), flavor, _later(later))


def read_bed(corners: str) -> Bed | None:
    """Read a bed's outline as slicers write it, `0x0,220x0,220x220,0x220`; None if it is none."""
    try:
        xs, ys = zip(*((float(x), float(y)) for x, y in _CORNER.findall(corners)), strict=True)
    except ValueError:  # no corner, or one that is no number
        return None
    bed = Bed((min(xs), min(ys)), (max(xs), max(ys)))
    return bed if all(0.0 < size < inf for size in bed.size) else None


def bed_of(source: bytes | Path) -> Bed | None:
    """Read the bed in the settings that the slicer has written at either end of a file, or of its content."""
    return bed_in(*ends_of(source)[:2])


def bed_in(head: bytes, tail: bytes) -> Bed | None:
    """Read the bed in a file's first and last bytes."""
    comment = _BED_COMMENT.search(tail) or _BED_COMMENT.search(head)
    return read_bed(comment.group(1).decode("ascii")) if comment else None


def _later(scripts: str) -> tuple[str, ...]:
    r"""Return the scripts after the last that names us; lines within one setting are written as \n."""
    lines = [line.strip().strip('"') for line in re.split(r"\\n|\\r|[;\r\n]", scripts)]
    ours = [i for i, line in enumerate(lines) if "ffcomp" in line]
    return tuple(filter(None, lines[ours[-1] + 1 :])) if ours else ()


def offset_for(bed: Bed, middle: tuple[float, float]) -> tuple[float, float]:
    """Return the offset, mm, from a print for `bed` to a machine whose bed lies about `middle`; none if they agree."""
    away = between(bed, middle)
    agree = all(abs(a) <= FAR * size for a, size in zip(away, bed.size, strict=True))
    return (0.0, 0.0) if agree else away


def between(bed: Bed, middle: tuple[float, float]) -> tuple[float, float]:
    """Return the way from a bed's middle to another's, mm."""
    return middle[0] - bed.centre[0], middle[1] - bed.centre[1]


def bed_warning(bed: Bed, machine: Machine, offset: tuple[float, float]) -> list[str]:
    """Warn if the print will not be where the machine file has its bed."""
    middle = machine.kinematics.centre_mm
    shifted = Bed(*((x + offset[0], y + offset[1]) for x, y in (bed.low, bed.high)))
    if not any(offset_for(shifted, middle)):
        return []
    there = f"shifted by {pair(offset)} " if any(offset) else ""
    return [
        f"The slicer's bed {there}lies about {place(shifted.centre)}, that of {machine.name} about {place(middle)}: "
        "one of them is another printer's, or the print belongs elsewhere, where --offset-mm "
        f"{pair(offset_for(bed, middle))} puts it."
    ]


def call_warnings(call: Call) -> list[str]:
    """Return what in a slicer's settings a user would want to know."""
    sentences = []
    if call.flavor and call.flavor not in KNOWN:
        sentences.append(
            f"The slicer's G-code flavor {call.flavor} is none that ffcomp knows ({', '.join(sorted(KNOWN))}): it is "
            "taken for marlin unless the file or --flavor says otherwise."
        )
    if call.later:
        sentences.append(
            f"The slicer runs another script after ffcomp ({call.later[0]}): what it changes is not compensated, and "
            "may undo it. Put ffcomp last."
        )
    return sentences


def pair(xy: tuple[float, float]) -> str:
    """Write an offset as `--offset-mm` takes it."""
    return f"{xy[0]:.6g},{xy[1]:.6g}"


def place(xy: tuple[float, float]) -> str:
    """Write a position as G-code does."""
    return f"X{xy[0]:.6g} Y{xy[1]:.6g}"
