"""Draw the model: Bode figures with measured responses beside, the modes over the bed, accuracy against effort.

Sizes of Bode figures are inches throughout, so that text keeps its room however many panels there are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from ffcomp.identification.frf_study import RINGS, Compared, NumberedMode, Station, Study, verdict
from ffcomp.identification.predict import phases_deg
from ffcomp.report.drawing import (
    AFTER,
    BAND_HEIGHT,
    BEYOND,
    INK,
    PAPER,
    RC,
    SOFT,
    band,
    file_of,
    grid,
    layout,
    machine_line,
    plain_decades,
    room_below,
    write_figure,
)
from gcode.atomic_write import replace_atomically
from models.arrays import FloatArray
from models.machine import Machine
from models.vibration.mode_map import ModeMap

if TYPE_CHECKING:
    from ffcomp.inverse.settings import EffortCurve

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


# --- Modes over the bed

MAP_SIZE, MAP_ASIDE, MAP_BELOW, MAP_ABOVE = 3.7, 0.85, 1.1, 0.75
SMALLEST_SPAN = 0.02  # of a frequency
TICKS = 11  # lines of direction across the bed


def draw_map(machine: Machine, modes: ModeMap, target: Path) -> None:
    """Every mode's frequency (colour), damping ratio (lines) and direction in the plane (strokes) over the bed."""
    count = len(modes.kinds)
    columns = min(3, count)
    rows = -(-count // columns)
    width = 0.8 + columns * (MAP_SIZE + MAP_ASIDE)
    height = BAND_HEIGHT + rows * (MAP_ABOVE + MAP_SIZE + MAP_BELOW) + 0.15
    figure = Figure(figsize=(width, height), facecolor=PAPER)
    key = "colour: frequency  ·  white lines: damping ratio  ·  strokes: the direction of vibration; none: vertical"
    figure.text(0.5, 0.17 / height, key, ha="center", va="center", fontsize=8.5, color=SOFT)
    _band(figure, "Modes over the bed", map_verdict(modes), machine)
    for mode in range(count):
        x = 0.8 + (mode % columns) * (MAP_SIZE + MAP_ASIDE)
        y = height - BAND_HEIGHT - (mode // columns + 1) * (MAP_ABOVE + MAP_SIZE + MAP_BELOW) + MAP_BELOW
        axes = _axes(figure, x, y, MAP_SIZE, MAP_SIZE)
        bar = _axes(figure, x + 0.25, y - 0.55, MAP_SIZE - 0.5, 0.1)
        _map_panel(axes, bar, machine, modes, mode)
    write_figure(figure, target, dpi=110)


def map_verdict(modes: ModeMap) -> str:
    """Which mode moves most over the bed, in words."""
    rings = [m for m in range(len(modes.kinds)) if np.nanmean(modes.damping_ratio[:, :, m]) < RINGS]
    if not rings:
        return "Nothing rings: every mode is damped by more than 30 %."
    span = {m: (np.nanmin(modes.frequency_hz[:, :, m]), np.nanmax(modes.frequency_hz[:, :, m])) for m in rings}
    worst = max(rings, key=lambda m: span[m][1] / span[m][0])
    low, high = span[worst]
    return (
        f"Mode {worst + 1} ({modes.kinds[worst]}) moves most: {low:.0f} to {high:.0f} Hz, by "
        f"{100 * (high / low - 1):.0f} %; a shaper tuned at one position is wrong at the others."
        if high / low > 1.05
        else f"No mode that rings moves by more than {100 * (high / low - 1):.0f} %."
    )


def _map_panel(axes: Axes, bar: Axes, machine: Machine, modes: ModeMap, mode: int) -> None:
    frequency, damping = modes.frequency_hz[:, :, mode], 100 * modes.damping_ratio[:, :, mode]
    x, round_bed = modes.x_mm, Circle((0, 0), modes.x_mm[-1], transform=axes.transData)
    levels = _levels(frequency)
    colours = axes.contourf(x, x, frequency.T, levels=levels, cmap="viridis")
    lines = axes.contour(x, x, damping.T, levels=5, colors="#ffffff", linewidths=0.8)
    dark: list[AbstractPathEffect] = [withStroke(linewidth=1.6, foreground="#00000066")]
    lines.set(path_effects=dark)
    for label in axes.clabel(lines, fmt="%.3g %%", fontsize=7):
        label.set_path_effects(dark)
        label.set_clip_path(round_bed)
    for drawn in (colours, lines):
        drawn.set_clip_path(round_bed)
    _directions(axes, modes, mode)
    _towers(axes, machine)
    digits = max(0, 1 - int(np.floor(np.log10(levels[-1] - levels[0]))))
    scale = axes.figure.colorbar(colours, cax=bar, orientation="horizontal", format=f"%.{digits}f")
    scale.locator = MaxNLocator(5)
    scale.update_ticks()
    scale.outline.set_visible(False)
    bar.set_xlabel("frequency, Hz", fontsize=8, color=INK)
    low, high, zeta = np.nanmin(frequency), np.nanmax(frequency), float(np.nanmean(damping))
    quiet = "" if zeta < 100 * RINGS else ": hardly rings"
    axes.text(0, 1.08, f"{mode + 1}  {modes.kinds[mode]}", transform=axes.transAxes, fontsize=12, weight="bold")
    text = f"{low:.1f}-{high:.1f} Hz, ζ {zeta:.1f} %{quiet}"
    axes.text(0, 1.025, text, transform=axes.transAxes, fontsize=9, color=SOFT)


def _levels(frequency: FloatArray) -> FloatArray:
    """25 levels of colour, over at least SMALLEST_SPAN, so that a frequency that stays shows one colour."""
    low, high = float(np.nanmin(frequency)), float(np.nanmax(frequency))
    half = max(high - low, SMALLEST_SPAN * high) / 2 * (1 + 1e-6)
    return np.linspace((low + high) / 2 - half, (low + high) / 2 + half, 25)


def _towers(axes: Axes, machine: Machine) -> None:
    reach = machine.kinematics.bed_radius_mm
    for name, towards in machine.kinematics.tower_directions.items():
        x, y = 1.1 * reach * towards
        axes.text(x, y, name, ha="center", va="center", weight="bold", fontsize=11, color=INK)
    limit = (-1.2 * reach, 1.2 * reach)
    axes.set(aspect="equal", xlim=limit, ylim=limit)
    axes.set_xlabel("X, mm", fontsize=8, labelpad=1, color=INK)
    axes.set_ylabel("Y, mm", fontsize=8, labelpad=1, color=INK)


def _directions(axes: Axes, modes: ModeMap, mode: int) -> None:
    """Strokes along the horizontal part of what moves most, nozzle holder or extruder; a point where it is upright."""
    every = max(1, len(modes.x_mm) // TICKS)
    at = np.arange(len(modes.x_mm) // 2 % every, len(modes.x_mm), every)
    motion = np.where(modes.on_bed[..., None], modes.motion[:, :, mode], np.nan)[np.ix_(at, at)]
    part = motion[..., 3:] if modes.kinds[mode].startswith("extruder") else motion[..., :3]
    flat = part[..., :2] * np.exp(-0.5j * np.angle(np.sum(part[..., :2] ** 2, axis=-1, keepdims=True)))  # longest real
    length = np.linalg.norm(part, axis=-1, keepdims=True)
    stroke = 0.35 * (modes.x_mm[every] - modes.x_mm[0]) * flat.real / length
    x, y = np.meshgrid(modes.x_mm[at], modes.x_mm[at], indexing="ij")
    ends = np.stack([np.stack([x, y], axis=-1) - stroke, np.stack([x, y], axis=-1) + stroke])
    axes.plot(*ends.reshape(2, -1, 2).transpose(2, 0, 1), color="#00000099", linewidth=1.4, solid_capstyle="round")


LINES, MARKS = ("-", "--", ":", "-."), ("o", "s", "^", "D")  # all are ffcomp, so all are blue


def draw_effort(curves: Mapping[float, EffortCurve], machine: Machine, path: Path) -> None:
    """Draw one curve for each number of segments a second into `path`, which ends in .png or .svg."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(8.2, 5.6), layout=layout())
        room_below(figure, band(figure, "Accuracy against effort", effort_verdict(curves), machine_line(machine)))
        axes = figure.subplots()
        for number, (rate, curve) in enumerate(curves.items()):
            _curve(axes, rate, curve, number)
        limit = machine.limits.carriage_acceleration_mm_per_s2 / 1e3
        if limit < 2 * axes.get_xlim()[1]:
            axes.axvline(limit, color=BEYOND, linewidth=1.2, label=f"limit of the machine file: {limit:g} m/s²")
        for axis in (axes.xaxis, axes.yaxis):
            plain_decades(axis)
        axes.set_xlabel("peak acceleration of the carriages' command, m/s²")
        axes.set_ylabel("tracking error, µm rms")
        axes.legend(title="circle: the knee, where ffcomp works", frameon=False, alignment="left")
        grid(axes)
        replace_atomically(path, [file_of(figure, "svg" if path.suffix == ".svg" else "png")])


def effort_verdict(curves: Mapping[float, EffortCurve]) -> str:
    """Say in a sentence what the knee of the first curve asks for, and what more would win."""
    rate, curve = next(iter(curves.items()))
    at, knee = curve.peak_mm_per_s2[curve.knee] / 1e3, curve.error_um[curve.knee]
    most, least = curve.peak_mm_per_s2.max() / 1e3, curve.error_um.min()
    at_knee = f"At the knee ({rate:g} segments/s) {at:.1f} m/s² leave {knee:.2g} µm"
    if least > 0.95 * knee:
        return f"{at_knee}; more acceleration wins nothing."
    return f"{at_knee}; up to {most:.0f} m/s² would leave {least:.2g} µm."


def _curve(axes: Axes, rate: float, curve: EffortCurve, number: int) -> None:
    peak, knee = curve.peak_mm_per_s2 / 1e3, curve.knee
    look = {"linestyle": LINES[number % len(LINES)], "marker": MARKS[number % len(MARKS)]}
    label = f"{rate:g} segments/s, bandwidth {curve.knee_hz:.0f} Hz"
    axes.loglog(peak, curve.error_um, color=AFTER, markersize=3.5, linewidth=1.4, label=label, **look)
    axes.loglog(peak[knee], curve.error_um[knee], "o", ms=11, mfc="none", mew=1.8, color=AFTER)
    axes.annotate(
        f"{peak[knee]:.1f} m/s², {curve.error_um[knee]:.2g} µm", (peak[knee], curve.error_um[knee]),
        xytext=(12, 12 + 13 * number), textcoords="offset points", fontsize=8, color=SOFT,
    )  # fmt: skip
