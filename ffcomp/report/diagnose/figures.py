"""Every figure of the report, with its finding: splits of the excess, the bed, overlays, spectra, similarity."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle
from matplotlib.ticker import NullLocator

from ffcomp.diagnosis.held_out import HeldOut
from ffcomp.diagnosis.words import digits, times, times_noise
from ffcomp.report.diagnose.sentences import stands_out
from ffcomp.report.diagnose.summary import Confounding, DiagnosisSummary, Overlay, Spectrum, Split
from ffcomp.report.drawing import (
    AFTER,
    BEFORE,
    GROUND,
    NOISE,
    REFERENCE,
    SOFT,
    Box,
    Drawing,
    grid,
    plain_decades,
)
from models.arrays import FloatArray

WIDTH, HEIGHT = 4.3, 2.7  # inches, of a small one: as wide as a phone
ROW, AXIS = 0.26, 0.75  # inches a row, and below them
TITLES = {
    "frequency": "By frequency",
    "signal": "By signal",
    "place": "By position",
    "window of time": "By window of time",
    "run": "By run",
    "share of the run's time": "Along the run",
    "motion": "By direction, and at reversals",
    "size of motion": "By size of motion",
    "motor's step cycle": "By the motor's phase",
}
ON_PALE, ON_DENSE = "#1f2a38", "#fefefe"  # words in cells that have the same colours on a dark screen
FEW_STEPS = 6  # steps, each with a tick of its own
LEAST_SHOWN = 0.5  # of the noise
DECADES_BELOW = 1e-4  # of a spectrum's top: below it is the band's edge, or rounding
LONGEST_NAME = 26
ROOM_MM = 12.0  # around the bed
LARGEST_SPOT = 0.2  # of the bed's radius
SMALL_SCALE = 5.0  # the least magnitude that has the largest spot: noise alone stays small
NEIGHBOUR_SHARE = 0.4  # of it: there the labels of two places need room


# ---- the figures ---------------------------------------------------------------------------------


def splits(summary: DiagnosisSummary) -> list[Drawing]:
    """Return the figures of what the excess depends on; the position as a map of the bed."""
    return [_bed(summary, split) if split.at else _split(split) for split in summary.splits]


def _split(split: Split) -> Drawing:
    height = HEIGHT if split.spans else ROW * len(split.labels) + AXIS
    return Drawing("where", TITLES[split.title], stands_out(split), "", WIDTH, height, partial(draw_split, split=split))


def _bed(summary: DiagnosisSummary, split: Split) -> Drawing:
    draw = partial(draw_bed, split=split, radius_mm=summary.bed_radius_mm)
    return Drawing("where", TITLES[split.title], stands_out(split), "", WIDTH, 4.0, draw)


def overlays(summary: DiagnosisSummary) -> list[Drawing]:
    """Return the overlays of measured and simulated signals."""
    return [_overlay(each) for each in summary.overlays]


def _overlay(each: Overlay) -> Drawing:
    draw = partial(draw_overlay, overlay=each, unit=each.unit)
    return Drawing("overlay", f"{each.signal} in {Path(each.recording).name}", _left(each), "", 5.4, 3.8, draw)


def _left(each: Overlay) -> str:
    sizes = [float(((each.measured - x) ** 2).mean()) ** 0.5 / each.noise_rms for x in (each.before, each.after)]
    return f"Error in this interval: {times(sizes[0])} the noise before, {times(sizes[1])} after."


def spectra(summary: DiagnosisSummary) -> list[Drawing]:
    """Return the spectra of the errors."""
    return [_spectrum(each) for each in summary.spectra]


def _spectrum(each: Spectrum) -> Drawing:
    worst = int((each.before / each.noise).argmax())
    finding = (
        f"The error stands highest above the noise at {each.frequency_hz[worst]:.0f} Hz: "
        f"{times(float(each.before[worst] / each.noise[worst]))} before, "
        f"{times(float(each.after[worst] / each.noise[worst]))} after."
    )
    title = f"{each.kind[0].upper()}{each.kind[1:]}"
    return Drawing("spectrum", title, finding, "", 5.4, 3.4, partial(draw_spectrum, spectrum=each))


def alike(summary: DiagnosisSummary, named: tuple[str, ...]) -> Drawing | None:
    """Return the figure of confounded effects, if there are two or more."""
    if len(summary.confounding.names) < 2:
        return None
    side = 0.27 * len(summary.confounding.names) + 2.2
    draw = partial(draw_alike, alike=summary.confounding, named=named)
    return Drawing("alike", "Confounded effects", "", "", side + 0.8, side, draw)


def held_out(places: Sequence[HeldOut], labels: Sequence[str]) -> Drawing | None:
    """Return the figure of what was left out of the fit in turn, if anything was."""
    if not places:
        return None
    label, worst = max(zip(labels, places, strict=True), key=lambda pair: pair[1].after)
    finding = (
        f"At the worst of them, {label}, the error is {times(times_noise(worst.before))} the noise before and "
        f"{times(times_noise(worst.after))} after."
    )
    draw = partial(draw_places, places=places, labels=labels)
    height = ROW * len(labels) + AXIS + 0.3
    return Drawing("held-out", "Places left out of the fit", finding, "", 6.5, height, draw)


# ---- what the excess depends on ------------------------------------------------------------------


def draw_split(box: Box, split: Split) -> None:
    """Draw the error before and after by the labels of one split."""
    axes = box.subplots()
    before, after = (np.maximum([times_noise(x) for x in part], LEAST_SHOWN) for part in (split.before, split.after))
    if split.spans:
        _steps(axes, split, before, after)
    else:
        _dumbbells(axes, split.labels, before, after)


def _steps(axes: Axes, split: Split, before: FloatArray, after: FloatArray) -> None:
    """Labels that follow one another, all equally wide; their edges are the ticks."""
    at = np.arange(len(before) + 1)
    axes.axhline(1.0, color=NOISE, linewidth=4, zorder=0)
    axes.stairs(before, at, baseline=None, color=BEFORE, linewidth=2)
    axes.stairs(after, at, baseline=None, color=AFTER, linewidth=2)
    edges = [split.spans[0][0], *(b for _, b in split.spans)]
    every = 1 if len(before) <= FEW_STEPS else 2 if len(before) <= 2 * FEW_STEPS else len(before) // 4
    axes.set_xticks(at[::every], [f"{edge:g}" for edge in edges[::every]])
    axes.set(xlabel=f"{split.title}, {split.unit}", ylabel="error, times the noise", xlim=(0, at[-1]))
    _times_scale(axes, "y", before, after)


def _dumbbells(axes: Axes, labels: Sequence[str], before: FloatArray, after: FloatArray) -> None:
    rows = np.arange(len(labels))
    axes.axvline(1.0, color=NOISE, linewidth=4, zorder=0)
    axes.hlines(rows, np.minimum(before, after), np.maximum(before, after), color=SOFT, linewidth=1, alpha=0.6)
    axes.plot(before, rows, "o", color=BEFORE, markersize=7)
    axes.plot(after, rows, "o", color=AFTER, markersize=7)
    axes.set_yticks(rows, [_short(label) for label in labels], parse_math=False)
    axes.set(xlabel="error, times the noise", ylim=(len(labels) - 0.5, -0.5))
    axes.tick_params(axis="y", length=0)
    _times_scale(axes, "x", before, after)


def _short(label: str) -> str:
    return label if len(label) <= LONGEST_NAME else f"…{label[1 - LONGEST_NAME :]}"


def _times_scale(axes: Axes, which: str, *values: FloatArray) -> None:
    """Logarithmic, and never so fine that chance looks like a difference."""
    low, high = min(float(v.min()) for v in values), max(float(v.max()) for v in values)
    limits = (min(0.8 * low, 0.7), max(1.3 * high, 2.0))
    axes.set(**{f"{which}scale": "log", f"{which}lim": limits})
    axis = getattr(axes, f"{which}axis")
    plain_decades(axis)
    axis.set_minor_locator(NullLocator())
    grid(axes)


def draw_bed(box: Box, split: Split, radius_mm: float) -> None:
    """Draw a circle a position, its radius growing with the logarithm of the error: before around after."""
    axes = box.subplots()
    axes.add_patch(Circle((0, 0), radius_mm, facecolor=GROUND, edgecolor=NOISE, linewidth=1.5))
    axes.plot(0, 0, "+", color=SOFT, markersize=10)
    both = [[times_noise(x) for x in part] for part in (split.before, split.after)]
    scale = LARGEST_SPOT * radius_mm / max(SMALL_SCALE, *(_magnitude(x) for part in both for x in part))
    for (x, y, *_), before, after in sorted(zip(split.at, *both, strict=True), key=lambda each: -each[1]):
        for value, colour, alpha in ((before, BEFORE, 0.55), (after, AFTER, 1.0)):
            axes.add_patch(Circle((x, y), scale * _magnitude(value), color=colour, alpha=alpha, linewidth=0))
        below = any(np.hypot(x - u, y - v) < NEIGHBOUR_SHARE * radius_mm and (v, u) > (y, x) for u, v, *_ in split.at)
        spot = scale * _magnitude(max(before, after))
        _label(axes, (x, y - spot if below else y + spot), f"{digits(before, 2)} → {digits(after, 2)}", below)
    reach = max(radius_mm, *(abs(c) for place in split.at for c in place[:2])) + ROOM_MM
    axes.set(aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach), xlabel="X, mm", ylabel="Y, mm")
    grid(axes)


def _label(axes: Axes, at: tuple[float, float], text: str, below: bool) -> None:
    axes.annotate(
        text,
        at,
        (0, -2 if below else 2),
        textcoords="offset points",
        ha="center",
        va="top" if below else "bottom",
        fontsize=8,
        bbox={"facecolor": "#ffffffb0", "edgecolor": "none", "pad": 1},
    )


def _magnitude(times: float) -> float:
    """Of the circle's radius: 1 for the noise, one more for each doubling."""
    return 1.0 + max(np.log2(max(times, 1.0)), 0.0)


def draw_places(box: Box, places: Sequence[HeldOut], labels: Sequence[str]) -> None:
    """Draw the error before and after at positions left out of the fit."""
    before, after = (
        np.maximum([times_noise(getattr(p, what)) for p in places], LEAST_SHOWN) for what in ("before", "after")
    )
    _dumbbells(box.subplots(), labels, before, after)


# ---- curves --------------------------------------------------------------------------------------


def draw_overlay(box: Box, overlay: Overlay, unit: str) -> None:
    """Draw measured and simulated signals, and below their difference, with the noise's rms as a band."""
    above, below = box.subplots(2, 1, sharex=True, height_ratios=(1.4, 1))
    t = overlay.time_s
    above.plot(t, overlay.before, color=BEFORE, linewidth=1.2)
    above.fill_between(t, *_around(overlay.measured, overlay.noise_rms), color=NOISE, linewidth=0)
    above.plot(t, overlay.measured, color=REFERENCE, linewidth=2.2)
    above.plot(t, overlay.after, color=AFTER, linewidth=1.2, linestyle=(0, (4, 2)))
    below.axhspan(-overlay.noise_rms, overlay.noise_rms, color=NOISE, linewidth=0)
    below.plot(t, overlay.measured - overlay.before, color=BEFORE, linewidth=1.2)
    below.plot(t, overlay.measured - overlay.after, color=AFTER, linewidth=1.2)
    above.set(ylabel=unit, xlim=(t[0], t[-1]))
    below.set(xlabel="time in the run, s", ylabel=f"error, {unit}")
    for axes in (above, below):
        grid(axes)


def _around(x: FloatArray, half: float) -> tuple[FloatArray, FloatArray]:
    return x - half, x + half


def draw_spectrum(box: Box, spectrum: Spectrum) -> None:
    """Draw spectra of the measured signal, of the errors and of the noise."""
    axes = box.subplots()
    f = spectrum.frequency_hz
    top = max(float(x.max()) for x in (spectrum.measured, spectrum.before))
    low = max(min(float(x.min()) for x in (spectrum.noise, spectrum.after)), DECADES_BELOW * top)
    axes.fill_between(f, spectrum.noise, low / 10, color=NOISE, linewidth=0)
    axes.loglog(f, spectrum.measured, color=REFERENCE, linewidth=2)
    axes.loglog(f, spectrum.before, color=BEFORE, linewidth=1.5)
    axes.loglog(f, spectrum.after, color=AFTER, linewidth=1.5)
    axes.set(
        xlabel="frequency, Hz", ylabel=f"{spectrum.unit}/√Hz", xlim=(f[0], f[-1]), ylim=(low / 2, 2 * top)
    )  # fmt: skip
    plain_decades(axes.xaxis)
    plain_decades(axes.yaxis)
    grid(axes)


# ---- confounded effects -------------------------------------------------------------------


def draw_alike(box: Box, alike: Confounding, named: Sequence[str]) -> None:
    """Draw the similarity (cos²) of every pair of effects."""
    axes = box.subplots()
    names, count = alike.names, len(alike.names)
    picture = axes.imshow(alike.cos2, cmap="Blues", vmin=0, vmax=1)
    for i in range(count):
        for k in range(count):
            if i != k and alike.cos2[i, k] >= 0.1:
                colour = ON_DENSE if alike.cos2[i, k] > 0.6 else ON_PALE
                axes.text(k, i, f"{alike.cos2[i, k]:.1f}".lstrip("0"), ha="center", va="center", size=7, color=colour)
    axes.set_xticks(range(count), names, rotation=60, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(count), names)
    for axis in (axes.get_xticklabels(), axes.get_yticklabels()):
        for label in axis:
            label.set_fontweight("bold" if label.get_text() in named else "normal")
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    box.colorbar(picture, ax=axes, label="cos²", shrink=0.6)
