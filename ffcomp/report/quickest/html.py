"""A comparison at equal error as one HTML page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ffcomp.compare.quickest_result import Contender, Quickest
from ffcomp.report.compare.words import duration
from ffcomp.report.quickest.charts import COLOURS, drawings
from ffcomp.report.quickest.words import answer, nick, sentences, shown
from ffcomp.report.shared.drawing import panel
from ffcomp.report.shared.page import rendered, tied
from ffcomp.report.shared.style import ON_DARK
from gcode.atomic_write import replace_atomically


@dataclass(frozen=True, slots=True)
class Tile:
    """One of the big numbers on top."""

    label: str
    time: str
    below: str
    colour: str
    on_dark: str
    share: float  # of the longest, %


def write_quickest(found: Quickest, target: Path) -> None:
    """Write the page; an old one stays until the new one is complete."""
    figures = drawings(found)
    page = rendered(
        "quickest",
        {"duration": duration, "tied": tied},
        found=found,
        name=found.print_name.replace("\\", "/").rsplit("/", 1)[-1],
        answer=answer(found),
        sentences=sentences(found),
        tiles=_tiles(found),
        rows=[_row(found, each) for each in (found.sliced, *found.contenders.values())],
        figures=[(each, panel(each)) for each in figures],
    )
    replace_atomically(target, [page])


def _tiles(found: Quickest) -> list[Tile]:
    longest = max(each.print_time_s for each in shown(found))
    return [
        Tile(
            nick(each) if each.name != "sliced" else "as sliced",
            duration(each.print_time_s),
            f"99 % within {each.contour_p99_um:.3g} µm",
            colour,
            ON_DARK[colour],
            100 * each.print_time_s / longest,
        )
        for each, colour in zip(shown(found), COLOURS, strict=True)
    ]


def _row(found: Quickest, each: Contender) -> tuple[str, str, list[str]]:
    """Return label, tuning and cells of a row of the table."""
    change = 100 * (each.print_time_s / found.sliced.print_time_s - 1)
    cells = [
        duration(each.print_time_s),
        "" if each is found.sliced else f"{change:+.0f} %",
        f"{each.contour_p99_um:.3g}",
        f"{each.contour_max_um:.3g}",
        "" if each.feed is None else f"{each.feed:g}",
        "" if each.acceleration_mm_per_s2 is None else f"{each.acceleration_mm_per_s2:,.0f}",
        "" if each is found.sliced else "yes" if each.reached else "no",
    ]
    if found.mismatch:
        cells += [f"{np.median(each.off_p99_um):.3g}", f"{max(each.off_p99_um):.3g}"]
    return each.label, each.tuning, cells
