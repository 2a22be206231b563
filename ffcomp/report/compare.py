"""The report of `ffcomp compare`: figures of the methods' errors, and their page."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import PurePath
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ffcomp.comparison.result import FIGURES, Comparison, Family, Method, nick
from ffcomp.numerics.digits import um
from ffcomp.report.drawing import (
    AFTER,
    BEFORE,
    CALIBRATED,
    INK,
    NEIGHBOUR,
    REFERENCE,
    SHAPER,
    Box,
    Drawing,
    Line,
    close_up,
    figure_of,
    grid,
    half_width,
    plain_decades,
)
from ffcomp.report.page import Page, Section, Table
from ffcomp.result import clock
from gcode.layers import is_outer_wall

COLOURS: dict[Family, str] = {"none": BEFORE, "calibrated": CALIBRATED, "best fixed": SHAPER, "inversion": AFTER}
WIDTH, ROW = 4.6, 0.24  # inches: as wide as a phone; of one method
FLOOR_UM = 1e-3  # zeros have no position on a logarithmic axis
PASS_S = 0.4  # of the reference plan, before and after the worst instant: one pass of the nozzle
SAME_LAYER_MM = 0.05


def drawings(comparison: Comparison) -> list[Drawing]:
    """Return the figures that the comparison has numbers for."""
    rows = ROW * len(comparison.methods) + 1.0

    def of(name: str, title: str, height: float, caption: str, draw: Callable[[Axes, Comparison], None]) -> Drawing:
        return Drawing(name, title, "", caption, WIDTH, height, partial(_alone, draw=draw, comparison=comparison))

    features = ROW * len(comparison.none.by_feature) + 1.7
    return [
        of("close-up", "Largest error without compensation", 5.2, CLOSE_UP, _close_up),
        of("errors-by-layer", "Error by layer", 3.6, "", _by_layer),
        of("errors-by-feature", "Error by feature, and its share of the time", features, "", _by_feature),
        of("methods", "All methods", rows, METHODS, _errors),
    ]


CLOSE_UP = "Seen from above, true to scale. Equal waves after a corner are ringing."
METHODS = "Large dot: rms. Line: 99 %. Small dot: largest. ★: the method has the lowest error."


def _alone(box: Box, draw: Callable[[Axes, Comparison], None], comparison: Comparison) -> None:
    axes = box.subplots()
    draw(axes, comparison)
    handles, labels = axes.get_legend_handles_labels()
    if handles and axes.get_legend() is None:
        box.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)


def figure(comparison: Comparison, name: str) -> Figure:
    """Draw one figure by its name."""
    return figure_of(next(each for each in drawings(comparison) if each.name == name))


draw_methods, draw_close_up, draw_errors_by_layer, draw_errors_by_feature = (
    partial(figure, name=name) for name in FIGURES
)


# ---- where the errors are ------------------------------------------------------------------------


def _close_up(axes: Axes, comparison: Comparison) -> None:
    """Draw one pass of the nozzle through the worst place, of outer walls if there are any."""
    s = comparison.none.samples
    walls = np.array([is_outer_wall(name) for name in comparison.features], dtype=np.bool_)
    kinds = (s.extruding & walls[s.feature], s.extruding, np.ones(len(s.due), dtype=np.bool_))
    worst = int(np.argmax(np.where(next(kind for kind in kinds if kind.any()), s.contour, -1.0)))
    at, half = s.reference[worst], half_width(float(s.contour[worst]))
    lines: list[Line] = []
    for method in reversed(_shown(comparison)):
        s = method.samples
        away = np.abs(s.reference - at)
        near = (away[:, 2] < SAME_LAYER_MM) & (away[:, :2].max(axis=1) < 1.5 * half)
        now = near & (np.abs(s.due - s.due[worst]) < PASS_S)
        label = f"{clipped(nick(method), 24)}: {um(float(1e3 * s.contour[now].max(initial=0.0)))} µm"
        lines.append((s.nozzle, now, COLOURS[method.family], 1.8, label))
        if method.name == "none":
            lines = [(s.reference, near & ~now & s.extruding, NEIGHBOUR, 1.2, ""), *lines]
            lines.append((s.reference, now, REFERENCE, 0.8, "reference"))
    close_up(axes, at, half, lines)
    feature = comparison.features[int(comparison.none.samples.feature[worst])]
    axes.set_title(f"X {at[0]:.1f}  Y {at[1]:.1f}  Z {at[2]:.2f} mm, {clipped(feature)}", parse_math=False)


def _by_layer(axes: Axes, comparison: Comparison) -> None:
    for method in _shown(comparison):
        layers = sorted(method.by_layer.items())
        values = [max(error.rms_um, FLOOR_UM) for _, error in layers]
        axes.semilogy([n for n, _ in layers], values, ".-", **_look(method))
    axes.set(xlabel="layer", ylabel="contour error, µm rms")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    plain_decades(axes.yaxis)
    grid(axes)


def _by_feature(axes: Axes, comparison: Comparison) -> None:
    none = comparison.none.by_feature
    names = sorted(none, key=lambda name: none[name].share)
    for method in _shown(comparison):
        errors = method.by_feature
        rows = [(k, max(errors[name].rms_um, FLOOR_UM)) for k, name in enumerate(names) if name in errors]
        axes.semilogx([value for _, value in rows], [k for k, _ in rows], "o", **_look(method))
    labels = [f"{clipped(name)}  {none[name].share:.0%}" for name in names]
    axes.set_yticks(range(len(names)), labels, parse_math=False)
    axes.set(xlabel="contour error, µm rms", ylim=(-0.6, len(names) - 0.4))
    plain_decades(axes.xaxis)
    grid(axes)


def _shown(comparison: Comparison) -> list[Method]:
    """Return the methods of these figures: without compensation, the best fixed shaper, the compensated print."""
    return list(dict.fromkeys((comparison.none, comparison.best, comparison.ours)))


def _look(method: Method) -> dict[str, Any]:
    return {"color": COLOURS[method.family], "label": clipped(method.label)}


# ---- a row for each method -----------------------------------------------------------------------


def _errors(axes: Axes, comparison: Comparison) -> None:
    methods = list(comparison.methods.values())
    least = min(comparison.seen(method).contour_rms_um for method in methods)
    for k, method in enumerate(methods):
        t, colour = comparison.seen(method), COLOURS[method.family]
        rms, p99, most = np.maximum([t.contour_rms_um, t.contour_p99_um, t.contour_max_um], FLOOR_UM)
        axes.semilogx([rms, most], [k, k], color=colour, linewidth=1.5)
        for value, sign, size in ((rms, "o", 8), (p99, "|", 11), (most, ".", 6)):
            axes.semilogx(value, k, sign, color=colour, markersize=size, markeredgewidth=2 if sign == "|" else 0)
        best = "★ " if t.contour_rms_um == least else ""
        axes.text(0.9 * rms, k, f"{best}{um(t.contour_rms_um)}  ", ha="right", va="center", fontsize=8)
    axes.set_xlabel(f"contour error {comparison.where}, µm")
    axes.margins(x=0.25)  # for the number of the leftmost dot
    plain_decades(axes.xaxis)
    axes.set_yticks(range(len(methods)), [clipped(method.label, 26) for method in methods], parse_math=False)
    for label, method in zip(axes.get_yticklabels(), methods, strict=True):
        label.set_fontweight("bold" if method.name in (comparison.compensated, comparison.best_fixed) else "normal")
        label.set_color(INK)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(methods) - 0.4, -0.6)
    grid(axes, "x")


# ---- the page ------------------------------------------------------------------------------------


def page_of(comparison: Comparison) -> Page:
    """Return the page of a comparison."""
    about = [f"machine {comparison.machine.name}", f"evaluated on {comparison.plant.name}"]
    drawn, methods = drawings(comparison), comparison.methods.values()
    rows = [(m.label, m.name, "; ".join([m.tuning, *dict.fromkeys(m.warnings)])) for m in methods]
    tunings = Table(("method", "name for --only", "settings and warnings"), rows)
    sections = [
        Section("Where it shows", drawings=drawn[:3]),
        Section("Method by method", drawings=drawn[3:]),
        Section("How each method was set", tables=[tunings], folded=True),
        Section("Settings", tables=[Table(("setting", "value"), _settings(comparison))], folded=True),
    ]
    return Page(PurePath(comparison.print_name).name, about, sections)


def _settings(comparison: Comparison) -> list[tuple[str, str]]:
    limits = ", ".join(f"{key} {value:g}" for key, value in comparison.limits.items())
    parties = (("machine file of every method", comparison.machine), ("machine file of the printer", comparison.plant))
    return [
        ("print", f"sha256 {comparison.print_sha256}"),
        *((role, ", ".join([each.name, f"sha256 {each.sha256}", *each.effects])) for role, each in parties),
        *comparison.settings.items(),
        ("limits of the carriages", limits or "none"),
        ("computing time", clock(comparison.seconds)),
    ]


def clipped(text: str, most: int = 34) -> str:
    """Shorten a name for figures: names from files have any length."""
    return text if len(text) <= most else f"{text[: most - 1]}…"
