"""The head of a figure: what it shows, what was found, and of which machine."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Rectangle

from ffcomp.report.shared.style import BAND
from ffcomp.version import __version__
from models.machine import Machine

BAND_HEIGHT = 1.05  # inches
TITLE, FINDING, ABOUT = "#ffffff", "#ffd08a", "#b9c2cf"


def machine_line(machine: Machine) -> str:
    """Name the machine file and its model."""
    return f"{machine.name}  ·  machine file sha256 {machine.sha256[:12]}  ·  {machine.vibration.describe().heading}"


def band(figure: Figure, title: str, finding: str, about: str, more: str = "") -> float:
    """Draw a band with title, finding and, below, what it is about, over the figure; return its height in inches.

    more : a second line of the finding
    """
    width, height = figure.get_size_inches()
    own = BAND_HEIGHT + (0.27 if more else 0.0)
    share = own / height
    figure.add_artist(Rectangle((0, 1 - share), 1, share, color=BAND, transform=figure.transFigure, zorder=-1))
    lines = [(0.31, title, 14, "bold", TITLE), (0.6, finding, 11, "normal", FINDING)]
    if more:
        lines.append((0.86, more, 10, "normal", TITLE))
    for down, text, size, weight, colour in (
        *lines,
        (own - 0.2, f"{about}  ·  ffcomp {__version__}", 8.5, "normal", ABOUT),
    ):
        figure.text(0.35 / width, 1 - down / height, text, fontsize=size, weight=weight, color=colour, va="center")
    return own


def room_below(figure: Figure, band_inches: float) -> None:
    """Keep what a layout arranges below the band."""
    engine = figure.get_layout_engine()
    if isinstance(engine, ConstrainedLayoutEngine):
        engine.set(rect=(0.0, 0.0, 1.0, 1.0 - (band_inches + 0.08) / float(figure.get_size_inches()[1])))
