"""Draw the model's frequency responses, with measured ones next to them: magnitude on the left, phase on the right."""

from __future__ import annotations

from collections.abc import Iterator
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ffcomp.identification.predict import phases_deg
from ffcomp.report.drawing import RC, SOFT, grid, layout, plain_decades
from ffcomp.responses.result import FrequencyResponses, Station
from ffcomp.responses.view import Pair
from ffcomp.version import __version__

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b8860b", "#56b4e9", "#6a4c93", "#222222")
UNCOUPLED = 1e-9  # of a station's largest response: less is rounding
WIDTH, ROW, LINE, LETTERS = 7.2, 2.3, 0.17, 88  # inches: readable on a phone, a response, a line of text; its letters


def bode_figure(found: FrequencyResponses) -> Figure:
    """Draw a row for each response, and below it the modes at each place, numbered as above the panels."""
    pairs = found.view.pairs
    colours = [COLOURS[i % len(COLOURS)] for i in range(len(found.stations))]
    labels = [fill("  ".join(_said(station)), LETTERS) for station in found.stations]
    with matplotlib.rc_context(RC):
        below = LINE * sum(1 + label.count("\n") for label in labels)
        figure = Figure(figsize=(WIDTH, ROW * len(pairs) + below + 0.9), dpi=200, layout=layout())
        machine = f"{found.machine.name}, machine file sha256 {found.machine.sha256[:12]}, ffcomp {__version__}"
        text = "\n".join(fill(line, LETTERS) for line in (found.view.title, found.verdict, machine))
        figure.suptitle(text, x=0.01, ha="left", fontsize=9, parse_math=False)
        rows = figure.subplots(len(pairs), 2, squeeze=False, sharex=True)
        for (left, right), pair in zip(rows, pairs, strict=True):
            for station, colour in zip(found.stations, colours, strict=True):
                _curves(left, right, found, station, pair, colour)
            _marked(left, found, pair)
            right.set_ylabel("phase, °")
            grid(right)
        for axes in rows[-1]:
            axes.set_xlabel("frequency, Hz")
        handles = [Line2D([], [], color=colour, label=label) for colour, label in zip(colours, labels, strict=True)]
        figure.legend(handles=handles, loc="outside lower left", frameon=False, fontsize=7)
    return figure


def _curves(left: Axes, right: Axes, found: FrequencyResponses, station: Station, pair: Pair, colour: str) -> None:
    value, f = station.value[:, *pair], found.frequency_hz
    if np.abs(value).max() < UNCOUPLED * np.abs(station.value).max():
        left.text(0.5, 0.5, "no response", transform=left.transAxes, ha="center", color=colour)
        return
    left.semilogy(f, np.abs(value), color=colour, linewidth=1.5)
    right.plot(f, np.degrees(np.unwrap(np.angle(value))), color=colour, linewidth=1.5)
    dots: dict[str, Any] = {"color": colour, "markersize": 2.6, "alpha": 0.45, "markeredgewidth": 0}
    for each in station.compared:
        if each.pair == pair:
            left.plot(each.frequency_hz, np.abs(each.measured), "o", **dots)
            right.plot(each.frequency_hz, phases_deg(each.measured, each.predicted)[0], "o", **dots)
            said = f"{each.magnitude_percent:.0f} % in magnitude, {each.phase_percent:.0f} % in phase"
            line = 0.9 - 0.12 * found.stations.index(station)
            right.text(0.98, line, said, transform=right.transAxes, ha="right", color=colour, fontsize=7)


def _marked(axes: Axes, found: FrequencyResponses, pair: Pair) -> None:
    """Name the response, and number the modes of the first place at their frequencies."""
    view = found.view
    name = view.rows[pair[0]] if not view.depends_on_place else f"{view.columns[pair[1]]} to {view.rows[pair[0]]}"
    axes.set(xlim=(found.frequency_hz[0], found.frequency_hz[-1]), ylabel=f"{name}, {view.unit}")
    for mode in found.stations[0].modes:
        inside = found.frequency_hz[0] < mode.frequency_hz < found.frequency_hz[-1]
        if mode.rings and inside and mode.axis in (None, view.rows[pair[0]]):
            axes.axvline(mode.frequency_hz, color=SOFT, linewidth=0.6, linestyle=":")
            axes.text(mode.frequency_hz, 1.01, mode.sign, transform=axes.get_xaxis_transform(), ha="center", fontsize=7)
    if axes.get_yscale() == "log":
        plain_decades(axes.yaxis)
    grid(axes)


def _said(station: Station) -> Iterator[str]:
    """Yield a station's name, its modes, and how well the model agrees with its measurement."""
    yield f"{station.label}:"
    for mode in station.modes:
        sign = "D drive" if mode.sign == "D" else mode.sign
        yield f"{sign} {mode.frequency_hz:.1f} Hz, ζ {100 * mode.damping_ratio:.1f} %;"
    if station.compared:
        errors = [(each.magnitude_percent, each.phase_percent) for each in station.compared]
        magnitude, phase = np.mean(errors, axis=0)
        yield f"met to {magnitude:.0f} % in magnitude, {phase:.0f} % in phase."
