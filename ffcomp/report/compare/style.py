"""The style of the comparison's figures beside the one that all reports share."""

from __future__ import annotations

from matplotlib.figure import SubFigure
from matplotlib.patches import Rectangle

from ffcomp.compare.result import Comparison, Family, Method
from ffcomp.report.compare.words import file_name
from ffcomp.report.shared.style import AFTER, BAND, BEFORE, CALIBRATED, SCHEDULED, SHAPER

NONE, BEST, COMPENSATED = BEFORE, SHAPER, AFTER
FAMILIES: dict[Family, str] = {
    "none": NONE,
    "calibrated": CALIBRATED,
    "best fixed": BEST,
    "scheduled": SCHEDULED,
    "inversion": COMPENSATED,
}


def colour_of(found: Comparison, method: Method) -> str:
    """Return the colour of one of the three methods that figures show."""
    return {found.compensated: COMPENSATED, found.best_fixed: BEST}.get(method.name, NONE)


def band(box: SubFigure, title: str, said: str, found: Comparison) -> None:
    """Draw title, finding, print, machine and program."""
    box.add_artist(Rectangle((0, 0), 1, 1, color=BAND, transform=box.transSubfigure, zorder=-1))
    of = f"{file_name(found)}  ·  {found.machine.name}, machine file sha256 {found.machine.sha256[:12]}"
    by = f"evaluated on {found.plant.name}  ·  ffcomp {found.version}"
    rows = ((0.74, title, 14, "bold", "#ffffff"), (0.44, said, 10, "normal", "#ffd08a"))
    for y, text, size, weight, colour in (*rows, (0.17, f"{of}  ·  {by}", 8, "normal", "#b9c2cf")):
        box.text(0.015, y, text, fontsize=size, weight=weight, color=colour, va="center", parse_math=False, wrap=True)
