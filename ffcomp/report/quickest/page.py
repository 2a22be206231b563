"""A comparison at equal error as one HTML page: time of each method, where it goes, error and speed along the print."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from ffcomp.comparison.quickest_plans import TRAVEL
from ffcomp.comparison.result import Piece, Quickest, TimedMethod
from ffcomp.faster.bound import LIMITS
from ffcomp.report.compare.words import clipped, duration, outer_first
from ffcomp.report.drawing import AFTER, BEFORE, BEYOND, ON_DARK, SHAPER, SOFT, Box, Drawing, grid, panel
from ffcomp.report.page import rendered, tied
from ffcomp.report.quickest.words import answer, nick, sentences, shown
from gcode.atomic_write import replace_atomically

WIDE_INCHES = 8.6
MOST_FEATURES = 12
CLOSE_S = 3.0  # of the print as sliced that is drawn close up
COLOURS = (BEFORE, SHAPER, AFTER)  # as `shown`


def drawings(result: Quickest) -> list[Drawing]:
    """Return the figures in the order of the page."""
    rows = 0.3 * (len(result.methods) + 1) + 1.2

    def of(name: str, title: str, read: str, height: float, draw: Callable[..., None]) -> Drawing:
        return Drawing(name, title, "", read, WIDE_INCHES, height, partial(draw, result=result))

    return [
        of("times", "The whole print, at equal error", TIMES, rows, draw_times),
        of("where", "Where the time goes", WHERE, 4.4, draw_where),
        of("along", "Error and speed along the print", ALONG, 4.6, draw_along),
        of("close", "A stretch of it, close up", CLOSE, 4.6, draw_close),
    ]


TIMES = "Bars to scale; empty ones miss the bound even at their slowest. Nothing can be left of the red line."
WHERE = "Left: time by kind of line and travel. Right: what the quicker print's time is limited by."
ALONG = "One mark for each slice that was evaluated: the mean speed of the nozzle, and the error that 99 % are below."
CLOSE = (
    "Over the distance along the path, which is the same for all: speed, and distance from the path, where the "
    "quicker print's error is largest."
)


def draw_times(box: Box, result: Quickest) -> None:
    """Draw a bar for each method."""
    axes = box.subplots()
    every = [result.sliced, *result.methods.values()]
    for k, each in enumerate(every):
        colour = _colour(result, each)
        axes.barh(k, each.print_time_s / 60, color=colour if each.reached or k == 0 else "none", edgecolor=colour)
        text = f" {duration(each.print_time_s)}, 99 % within {each.contour_p99_um:.3g} µm"
        axes.text(each.print_time_s / 60, k, text, va="center", fontsize=8)
    axes.axvline(result.actuator_limit_s / 60, color=BEYOND, linewidth=1.5)
    axes.set_yticks(range(len(every)), [clipped(each.label) for each in every], parse_math=False)
    axes.set_ylim(len(every) - 0.4, -0.6)
    axes.set_xlim(0, 1.55 * max(each.print_time_s for each in every) / 60)
    axes.set_xlabel("minutes")
    axes.tick_params(axis="y", length=0)
    grid(axes, "x")


def _colour(result: Quickest, each: TimedMethod) -> str:
    if each.family == "inversion":
        return AFTER
    if each is result.sliced:
        return BEFORE
    return SHAPER if each.name == result.best_shaper.name else SOFT


def draw_where(box: Box, result: Quickest) -> None:
    """Draw time by feature, and what limits the quicker print."""
    left, right = box.subplots(1, 2, width_ratios=(1.5, 1.0))
    was = result.sliced.by_feature_s
    named = [name for name in outer_first(was, was) if name != TRAVEL]
    names = [*sorted(named, key=lambda name: -was[name])[: MOST_FEATURES - 1], TRAVEL]
    for k, (each, colour) in enumerate(zip(shown(result), COLOURS, strict=True)):
        minutes = [each.by_feature_s.get(name, 0.0) / 60 for name in names]
        left.barh(np.arange(len(names)) + 0.27 * (k - 1), minutes, 0.25, color=colour, label=nick(each))
    left.set_yticks(range(len(names)), [clipped(name, 22) for name in names], parse_math=False)
    left.invert_yaxis()
    left.set_xlabel("minutes")
    left.legend(frameon=False, fontsize=8)
    grid(left, "x")
    _limits(right, result.faster)


def _limits(axes: Axes, timed: TimedMethod) -> None:
    seconds = sorted(((s, name) for name, s in timed.limited_by.items() if s > 0.0), reverse=True)
    axes.barh([LIMITS[name] for _, name in seconds], [s / 60 for s, _ in seconds], color=AFTER)
    axes.invert_yaxis()
    axes.set(xlabel="minutes", title="limited by")
    grid(axes, "x")


def draw_along(box: Box, result: Quickest) -> None:
    """Draw the mean speed and the error of each slice, over the clock of the print as sliced."""
    speed, error = box.subplots(2, 1, sharex=True)
    for each, colour in zip(shown(result), COLOURS, strict=True):
        at = [piece.begin_s / 60 for piece in each.pieces]
        look = {"color": colour, "marker": "o", "markersize": 4, "linewidth": 0.8, "label": nick(each)}
        speed.plot(at, [_mean_speed(piece) for piece in each.pieces], **look)
        error.semilogy(at, [max(piece.p99_um, 0.1) for piece in each.pieces], **look)
    error.axhline(result.bound_um, color=BEYOND, linewidth=1.0)
    speed.set(ylabel="mm/s, mean")
    error.set(ylabel="99 % below, µm", xlabel="minutes of the print as it was sliced")
    speed.legend(frameon=False, fontsize=8, ncols=3)
    grid(speed)
    grid(error)


def _mean_speed(piece: Piece) -> float:
    return float(piece.distance_mm[-1] / max(piece.seconds, 1e-9))


def draw_close(box: Box, result: Quickest) -> None:
    """Draw speed and error over the distance, in the slice where the quicker print's error is largest."""
    speed, error = box.subplots(2, 1, sharex=True)
    pieces = result.faster.pieces
    begin_s = max(pieces, key=lambda piece: float(piece.error_um.max(initial=0.0))).begin_s
    middle, half = _stretch(result, begin_s)
    for each, colour in zip(shown(result), COLOURS, strict=True):
        piece = next((timed for timed in each.pieces if timed.begin_s == begin_s), None)
        if piece is None:
            continue
        from_end = piece.distance_mm - piece.distance_mm[-1]  # slices end at the same place, whatever was left out
        near = np.abs(from_end - middle) <= half
        speed.plot(from_end[near] - middle, piece.speed_mm_per_s[near], color=colour, linewidth=1.0, label=nick(each))
        error.semilogy(from_end[near] - middle, np.maximum(piece.error_um[near], 0.1), color=colour, linewidth=1.0)
    error.axhline(result.bound_um, color=BEYOND, linewidth=1.0)
    speed.set(ylabel="mm/s")
    error.set(ylabel="off the path, µm", xlabel="mm along the path")
    speed.legend(frameon=False, fontsize=8, ncols=3)
    grid(speed)
    grid(error)


def _stretch(result: Quickest, begin_s: float) -> tuple[float, float]:
    """Return the middle and half the length of what is drawn, mm before the slice's end."""
    timed = next(piece for piece in result.faster.pieces if piece.begin_s == begin_s)
    at = int(timed.error_um.argmax())
    half = 0.5 * CLOSE_S * max(_mean_speed(timed), 1.0)
    return float(timed.distance_mm[at] - timed.distance_mm[-1]), half


@dataclass(frozen=True, slots=True)
class Tile:
    """One of the big numbers on top."""

    label: str
    time: str
    below: str
    colour: str
    on_dark: str
    share: float  # of the longest, %


def write_quickest(result: Quickest, target: Path) -> None:
    """Write the page; an old one stays until the new one is complete."""
    figures = drawings(result)
    page = rendered(
        "quickest",
        {"duration": duration, "tied": tied},
        result=result,
        name=result.print_name.replace("\\", "/").rsplit("/", 1)[-1],
        answer=answer(result),
        sentences=sentences(result),
        tiles=_tiles(result),
        rows=[_row(result, each) for each in (result.sliced, *result.methods.values())],
        figures=[(each, panel(each)) for each in figures],
    )
    replace_atomically(target, [page])


def _tiles(result: Quickest) -> list[Tile]:
    longest = max(each.print_time_s for each in shown(result))
    return [
        Tile(
            nick(each) if each.name != "sliced" else "as sliced",
            duration(each.print_time_s),
            f"99 % within {each.contour_p99_um:.3g} µm",
            colour,
            ON_DARK[colour],
            100 * each.print_time_s / longest,
        )
        for each, colour in zip(shown(result), COLOURS, strict=True)
    ]


def _row(result: Quickest, each: TimedMethod) -> tuple[str, str, list[str]]:
    change = 100 * (each.print_time_s / result.sliced.print_time_s - 1)
    cells = [
        duration(each.print_time_s),
        "" if each is result.sliced else f"{change:+.0f} %",
        f"{each.contour_p99_um:.3g}",
        f"{each.contour_max_um:.3g}",
        "" if each.feed is None else f"{each.feed:g}",
        "" if each.acceleration_mm_per_s2 is None else f"{each.acceleration_mm_per_s2:,.0f}",
        "" if each is result.sliced else "yes" if each.reached else "no",
    ]
    if result.mismatch:
        cells += [f"{np.median(each.off_p99_um):.3g}", f"{max(each.off_p99_um):.3g}"]
    return each.label, each.tuning, cells
