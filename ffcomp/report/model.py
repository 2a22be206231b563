"""Draw the model: Bode figures, with measured responses next to the computed ones.

Sizes are inches throughout, so that text keeps its room however many panels there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ffcomp.identification.frf_study import Compared, NumberedMode, Station, Study, verdict
from ffcomp.identification.predict import phases_deg
from ffcomp.report.drawing import (
    BAND_HEIGHT,
    INK,
    PAPER,
    SOFT,
    band,
    machine_line,
    write_figure,
)
from models.arrays import FloatArray
from models.machine import Machine

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#6a4c93", "#222222")
FAINT = "#a3a9b3"
NUMBERED_STATIONS = 3  # more, and only the first one's modes are numbered above the panels

UNCOUPLED = 1e-9  # of a station's largest response: less is rounding

MARGIN = 0.75
PANEL_WIDTH, WIDE_PANEL, MAGNITUDE_HEIGHT, PHASE_HEIGHT = 4.5, 9.0, 2.7, 1.4
ABOVE, BETWEEN, BELOW, ASIDE = 0.3, 0.12, 0.6, 0.55  # room round a panel
LABEL_HEIGHT, ROW_HEIGHT = 0.2, 0.27  # of a row of mode numbers, of a line of the table
MODE_WIDTH, STATION_WIDTH = 1.38, 2.3  # of the table's columns


def draw_bode(study: Study, target: Path, full: bool = False) -> None:
    """Write the Bode figure; the suffix of `target` names the format."""
    write_figure(bode_figure(study, full), target, dpi=110)


def bode_figure(study: Study, full: bool = False) -> Figure:
    """Draw a panel of magnitude and phase for each response, modes numbered above, and a table of them below."""
    pairs = study.view.all_pairs if full else study.view.pairs
    columns = min(3, len(pairs))
    rows = len(pairs) // columns
    panel = PANEL_WIDTH if columns > 1 else WIDE_PANEL
    labels = LABEL_HEIGHT * len(_numbered(study))
    cell = ABOVE + labels + MAGNITUDE_HEIGHT + BETWEEN + PHASE_HEIGHT + BELOW
    content = columns * panel + (columns - 1) * ASIDE
    width = max(2 * MARGIN + content, 2 * 0.35 + _table_width(study))
    height = BAND_HEIGHT + rows * cell + ROW_HEIGHT * _lines(study) + 0.35
    figure = Figure(figsize=(width, height), facecolor=PAPER)
    _band(figure, study.view.title, verdict(study), study.machine)
    left = (width - content) / 2 + 0.15
    for number, pair in enumerate(pairs):
        x = left + (number % columns) * (panel + ASIDE)
        y = height - BAND_HEIGHT - (number // columns) * cell - ABOVE - labels - MAGNITUDE_HEIGHT
        upper = _axes(figure, x, y, panel, MAGNITUDE_HEIGHT)
        lower = _axes(figure, x, y - BETWEEN - PHASE_HEIGHT, panel, PHASE_HEIGHT)
        _panel(upper, lower, study, pair, first=number % columns == 0)
    _table(figure, study)
    return figure


# --- The parts of every figure


def _axes(figure: Figure, x: float, y: float, width: float, height: float) -> Axes:
    w, h = figure.get_size_inches()
    axes = figure.add_axes((x / w, y / h, width / w, height / h))
    axes.tick_params(labelsize=8, color=SOFT, labelcolor=INK)
    for spine in axes.spines.values():
        spine.set_color("#c5cad3")
    return axes


def _band(figure: Figure, title: str, finding: str, machine: Machine) -> None:
    band(figure, title, finding, machine_line(machine))


# --- Bode panels


def _panel(upper: Axes, lower: Axes, study: Study, pair: tuple[int, int], first: bool) -> None:
    for number, (station, colour) in enumerate(zip(study.stations, _colours(study), strict=True)):
        _curves(upper, lower, study.frequency_hz, station, pair, colour)
        _accuracy(lower, [each for each in station.compared if each.pair == pair], number, colour)
    view = study.view
    name = view.rows[pair[0]] if not view.depends_on_place else f"{view.columns[pair[1]]} to {view.rows[pair[0]]}"
    upper.set_yscale("log")
    _decades(upper)
    upper.set_xticklabels([])
    upper.text(0.02, 0.04, name, transform=upper.transAxes, fontsize=12, weight="bold", color=INK)
    for axes in (upper, lower):
        axes.set_xlim(study.frequency_hz[0], study.frequency_hz[-1])
        axes.grid(color="#e6e9ee", linewidth=0.8)
        axes.set_axisbelow(True)
    lower.set_xlabel("frequency, Hz", fontsize=9, color=INK)
    lower.locator_params(axis="y", nbins=5)
    if first:
        upper.set_ylabel(f"magnitude, {view.unit}", fontsize=9, color=INK)
        lower.set_ylabel("phase, °", fontsize=9, color=INK)
    for row, (station, colour) in enumerate(reversed(_numbered(study))):
        here = [mode for mode in station.modes if mode.axis in (None, view.rows[pair[0]])]
        _mode_numbers(upper, here, colour, row)


def _decades(axes: Axes) -> None:
    """At least one decade of magnitude, labelled 0.01, 0.1, 1, 10 and not in powers while they are short."""
    low, high = axes.get_ylim()
    if high < 10 * low:
        middle = np.sqrt(low * high)
        axes.set_ylim(middle / np.sqrt(10), middle * np.sqrt(10))
    low, high = axes.get_ylim()
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0,) if high > 100 * low else (1.0, 2.0, 5.0), numticks=7))
    short = FuncFormatter(lambda v, _: f"{v:g}" if 1e-3 <= v < 1e4 else f"$10^{{{round(np.log10(v))}}}$")
    axes.yaxis.set_major_formatter(short)
    axes.yaxis.set_minor_formatter(NullFormatter())


def _colours(study: Study) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(len(study.stations))]


def _numbered(study: Study) -> list[tuple[Station, str]]:
    shown = list(zip(study.stations, _colours(study), strict=True))
    return shown if len(shown) <= NUMBERED_STATIONS else shown[:1]


def _curves(
    upper: Axes, lower: Axes, frequency_hz: FloatArray, station: Station, pair: tuple[int, int], colour: str
) -> None:
    value = station.value[:, *pair]
    if np.abs(value).max() < UNCOUPLED * np.abs(station.value).max():
        upper.text(0.5, 0.5, "no response", transform=upper.transAxes, ha="center", color=colour, fontsize=9)
        return
    upper.plot(frequency_hz, np.abs(value), color=colour, linewidth=1.7, zorder=3)
    lower.plot(frequency_hz, np.degrees(np.unwrap(np.angle(value))), color=colour, linewidth=1.7, zorder=3)
    for each in station.compared:
        if each.pair == pair:
            _measured(upper, lower, each, colour)


def _measured(upper: Axes, lower: Axes, each: Compared, colour: str) -> None:
    """Dots, on the phase branch of the model."""
    dots: dict[str, Any] = {"color": colour, "markersize": 2.6, "alpha": 0.45, "markeredgewidth": 0, "zorder": 2}
    upper.plot(each.frequency_hz, np.abs(each.measured), "o", **dots)
    lower.plot(each.frequency_hz, phases_deg(each.measured, each.predicted)[0], "o", **dots)


def _accuracy(axes: Axes, compared: list[Compared], line: int, colour: str) -> None:
    """In the corner that a falling phase leaves free: how well the model meets the dots of this colour."""
    if compared:
        magnitude, phase = _means(compared)
        axes.text(
            0.98, 0.93 - 0.14 * line, f"{magnitude:.0f} % in magnitude, {phase:.0f} % in phase", color=colour,
            transform=axes.transAxes, ha="right", va="top", fontsize=8, weight="bold", backgroundcolor="#ffffffb0",
        )  # fmt: skip


def _mode_numbers(axes: Axes, modes: list[NumberedMode], colour: str, row: int) -> None:
    """Numbers above the panel, pushed apart where modes are close, each with a line down to its frequency."""
    low, high = axes.get_xlim()
    shown = [m for m in modes if m.rings and low <= m.frequency_hz <= high]
    shown.sort(key=lambda mode: mode.frequency_hz)
    at = np.array([(m.frequency_hz - low) / (high - low) for m in shown])
    inch, width = 1 / MAGNITUDE_HEIGHT, MAGNITUDE_HEIGHT * axes.bbox.width / axes.bbox.height
    foot, head = 1.0, 1.0 + (0.16 + LABEL_HEIGHT * row) * inch
    for mode, x, label in zip(shown, at, _spread(at, 0.2 / width), strict=True):
        line: dict[str, Any] = {"color": colour, "linewidth": 0.7, "transform": axes.transAxes, "clip_on": False}
        axes.plot([x, x, label], [0.0, foot, head - 0.06 * inch], alpha=0.45, **line)
        circle = {"boxstyle": "circle,pad=0.18", "facecolor": colour, "edgecolor": "none"}
        axes.text(
            label, head, mode.sign, transform=axes.transAxes, ha="center", va="center",
            fontsize=6.5, color="#ffffff", weight="bold", bbox=circle,
        )  # fmt: skip


def _spread(at: FloatArray, gap: float) -> FloatArray:
    """Move rising positions as little as it takes to be `gap` apart: each group is centred on its mean."""
    groups = [[x] for x in at.tolist()]
    k = 1
    while k < len(groups):
        before, after = groups[k - 1], groups[k]
        room = np.mean(after) - np.mean(before) - gap * (len(before) + len(after)) / 2
        if room < 0:
            groups[k - 1 : k + 1] = [before + after]
            k = max(k - 1, 1)
        else:
            k += 1
    return np.array([np.mean(group) + gap * (i - (len(group) - 1) / 2) for group in groups for i in range(len(group))])


# --- The table under the panels


def _signs(study: Study) -> list[str]:
    """Return the table's columns: every mode of any station."""
    signs = [mode.sign for station in study.stations for mode in station.modes]
    return sorted(dict.fromkeys(signs), key=lambda sign: (not sign.isdigit(), sign))


def _lines(study: Study) -> int:
    """Of the table; the kinds of modes get a line of their own where there is room."""
    return 1 + len(study.stations) * (2 if len(study.stations) <= NUMBERED_STATIONS else 1)


def _table_width(study: Study) -> float:
    return STATION_WIDTH + MODE_WIDTH * len(_signs(study)) + (2.6 if study.compared else 0.0)


def _table(figure: Figure, study: Study) -> None:
    """Write a line a station: its colour, each mode's frequency and damping ratio, and how well it was predicted."""
    width, height = figure.get_size_inches()
    top = ROW_HEIGHT * _lines(study) + 0.1
    left = (width - _table_width(study)) / 2 + 0.1
    column = {sign: STATION_WIDTH + MODE_WIDTH * i for i, sign in enumerate(_signs(study))}
    last = STATION_WIDTH + MODE_WIDTH * len(column)
    step = (_lines(study) - 1) // len(study.stations)

    def say(x: float, line: float, text: str, colour: str = INK, weight: str = "normal", size: float = 8.5) -> None:
        y = top - ROW_HEIGHT * line
        figure.text((left + x) / width, y / height, text, fontsize=size, color=colour, weight=weight, va="center")

    say(0, 0, "line: model" + (", dots: measured" if study.compared else ""), SOFT)
    for sign, x in column.items():
        say(x, 0, "D  drive" if sign == "D" else f"mode {sign}", INK, "bold")
    if study.compared:
        say(last, 0, "accuracy: magnitude, phase", INK, "bold")
    for number, (station, colour) in enumerate(zip(study.stations, _colours(study), strict=True)):
        line = 1 + number * step
        say(0, line, f"━  {station.label}", colour, "bold")
        for mode in station.modes:
            say(column[mode.sign], line, _mode_text(mode), INK if mode.rings else FAINT)
            if step == 2 and mode.number is not None:
                say(column[mode.sign], line + 0.72, mode.kind, SOFT, size=7)
        if station.compared:
            say(last, line, _accuracy_text(station.compared))


def _mode_text(mode: NumberedMode) -> str:
    return f"{mode.frequency_hz:.1f} Hz, ζ {100 * mode.damping_ratio:.1f} %"


def _accuracy_text(compared: Sequence[Compared]) -> str:
    magnitude, phase = _means(compared)
    return f"{magnitude:.0f} %, {phase:.0f} % of {len(compared)} response{'s' * (len(compared) > 1)}"


def _means(compared: Sequence[Compared]) -> tuple[float, float]:
    """Mean accuracy in magnitude and in phase, %."""
    magnitudes, phases = zip(*((each.magnitude_percent, each.phase_percent) for each in compared), strict=True)
    return float(np.mean(magnitudes)), float(np.mean(phases))
