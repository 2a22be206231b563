"""Figures of a comparison at equal error: time of each method, where it goes, error and speed along the print."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from ffcomp.compare.quickest_plans import TRAVEL
from ffcomp.compare.quickest_result import Contender, Piece, Quickest
from ffcomp.faster.bound import LIMITS
from ffcomp.report.compare.words import clipped, duration, outer_first
from ffcomp.report.quickest.words import nick, shown
from ffcomp.report.shared.drawing import Box, Drawing
from ffcomp.report.shared.style import AFTER, BEFORE, BEYOND, SHAPER, SOFT, grid

WIDE_INCHES = 8.6
MOST_FEATURES = 12
CLOSE_S = 3.0  # of the print as sliced that is drawn close up
COLOURS = (BEFORE, SHAPER, AFTER)  # as `shown`


def drawings(found: Quickest) -> list[Drawing]:
    """Return the figures in the order of the page."""
    rows = 0.3 * (len(found.contenders) + 1) + 1.2

    def of(name: str, title: str, read: str, height: float, draw: Callable[..., None]) -> Drawing:
        return Drawing(name, title, "", read, WIDE_INCHES, height, partial(draw, found=found))

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


def draw_times(box: Box, found: Quickest) -> None:
    """Draw a bar for each method."""
    axes = box.subplots()
    every = [found.sliced, *found.contenders.values()]
    for k, each in enumerate(every):
        colour = _colour(found, each)
        axes.barh(k, each.print_time_s / 60, color=colour if each.reached or k == 0 else "none", edgecolor=colour)
        text = f" {duration(each.print_time_s)}, 99 % within {each.contour_p99_um:.3g} µm"
        axes.text(each.print_time_s / 60, k, text, va="center", fontsize=8)
    axes.axvline(found.actuator_limit_s / 60, color=BEYOND, linewidth=1.5)
    axes.set_yticks(range(len(every)), [clipped(each.label) for each in every], parse_math=False)
    axes.set_ylim(len(every) - 0.4, -0.6)
    axes.set_xlim(0, 1.55 * max(each.print_time_s for each in every) / 60)
    axes.set_xlabel("minutes")
    axes.tick_params(axis="y", length=0)
    grid(axes, "x")


def _colour(found: Quickest, each: Contender) -> str:
    if each.family == "inversion":
        return AFTER
    if each is found.sliced:
        return BEFORE
    return SHAPER if each.name == found.best_shaper.name else SOFT


def draw_where(box: Box, found: Quickest) -> None:
    """Draw time by feature, and what limits the quicker print."""
    left, right = box.subplots(1, 2, width_ratios=(1.5, 1.0))
    was = found.sliced.by_feature_s
    named = [name for name in outer_first(was, was) if name != TRAVEL]
    names = [*sorted(named, key=lambda name: -was[name])[: MOST_FEATURES - 1], TRAVEL]
    for k, (each, colour) in enumerate(zip(shown(found), COLOURS, strict=True)):
        minutes = [each.by_feature_s.get(name, 0.0) / 60 for name in names]
        left.barh(np.arange(len(names)) + 0.27 * (k - 1), minutes, 0.25, color=colour, label=nick(each))
    left.set_yticks(range(len(names)), [clipped(name, 22) for name in names], parse_math=False)
    left.invert_yaxis()
    left.set_xlabel("minutes")
    left.legend(frameon=False, fontsize=8)
    grid(left, "x")
    _limits(right, found.faster)


def _limits(axes: Axes, own: Contender) -> None:
    seconds = sorted(((s, name) for name, s in own.limited_by.items() if s > 0.0), reverse=True)
    axes.barh([LIMITS[name] for _, name in seconds], [s / 60 for s, _ in seconds], color=AFTER)
    axes.invert_yaxis()
    axes.set(xlabel="minutes", title="limited by")
    grid(axes, "x")


def draw_along(box: Box, found: Quickest) -> None:
    """Draw the mean speed and the error of each slice, over the clock of the print as sliced."""
    speed, error = box.subplots(2, 1, sharex=True)
    for each, colour in zip(shown(found), COLOURS, strict=True):
        at = [piece.begin_s / 60 for piece in each.pieces]
        look = {"color": colour, "marker": "o", "markersize": 4, "linewidth": 0.8, "label": nick(each)}
        speed.plot(at, [_mean_speed(piece) for piece in each.pieces], **look)
        error.semilogy(at, [max(piece.p99_um, 0.1) for piece in each.pieces], **look)
    error.axhline(found.bound_um, color=BEYOND, linewidth=1.0)
    speed.set(ylabel="mm/s, mean")
    error.set(ylabel="99 % below, µm", xlabel="minutes of the print as it was sliced")
    speed.legend(frameon=False, fontsize=8, ncols=3)
    grid(speed)
    grid(error)


def _mean_speed(piece: Piece) -> float:
    return float(piece.distance_mm[-1] / max(piece.seconds, 1e-9))


def draw_close(box: Box, found: Quickest) -> None:
    """Draw speed and error over the distance, in the slice where the quicker print's error is largest."""
    speed, error = box.subplots(2, 1, sharex=True)
    pieces = found.faster.pieces
    begin_s = max(pieces, key=lambda piece: float(piece.error_um.max(initial=0.0))).begin_s
    middle, half = _stretch(found, begin_s)
    for each, colour in zip(shown(found), COLOURS, strict=True):
        piece = next((own for own in each.pieces if own.begin_s == begin_s), None)
        if piece is None:
            continue
        from_end = piece.distance_mm - piece.distance_mm[-1]  # slices end at the same place, whatever was left out
        near = np.abs(from_end - middle) <= half
        speed.plot(from_end[near] - middle, piece.speed_mm_per_s[near], color=colour, linewidth=1.0, label=nick(each))
        error.semilogy(from_end[near] - middle, np.maximum(piece.error_um[near], 0.1), color=colour, linewidth=1.0)
    error.axhline(found.bound_um, color=BEYOND, linewidth=1.0)
    speed.set(ylabel="mm/s")
    error.set(ylabel="off the path, µm", xlabel="mm along the path")
    speed.legend(frameon=False, fontsize=8, ncols=3)
    grid(speed)
    grid(error)


def _stretch(found: Quickest, begin_s: float) -> tuple[float, float]:
    """Return the middle and half the length of what is drawn, mm before the slice's end."""
    own = next(piece for piece in found.faster.pieces if piece.begin_s == begin_s)
    at = int(own.error_um.argmax())
    half = 0.5 * CLOSE_S * max(_mean_speed(own), 1.0)
    return float(own.distance_mm[at] - own.distance_mm[-1]), half
