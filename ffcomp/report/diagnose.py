"""The report of `ffcomp diagnose`: where measurement and simulation differ, and the evidence, on one page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import NullLocator

from ffcomp.diagnosis.fit import intervals_of
from ffcomp.diagnosis.result import DiagnosisResult, file_key, of_machine
from ffcomp.diagnosis.verb import Diagnosis, Discrepancy
from ffcomp.diagnosis.where import Overlay, ResidualCurve, Split, overlays_of
from ffcomp.diagnosis.words import digits, evidence, interval, joined, percent, times, times_noise, title
from ffcomp.identification.machine_fit import hash_of
from ffcomp.report.drawing import AFTER, BEFORE, NOISE, REFERENCE, SOFT, Box, Drawing, grid, plain_decades
from ffcomp.report.page import Page, Section, Table
from models.arrays import FloatArray

WIDTH, HEIGHT = 4.6, 2.7  # inches: as wide as a phone
ROW, AXIS = 0.26, 0.75  # inches of a row, and below the rows
TITLES = {
    "frequency": "By frequency",
    "signal": "By signal",
    "place": "By position",
    "window of time": "By window of time",
    "motion": "By direction, and at reversals",
    "motor's step cycle": "By the motor's phase",
}
FEW_STEPS = 6  # steps, each with its own tick
LEAST_SHOWN = 0.5  # of the noise
LONGEST_NAME = 26
KEY = "Orange: with the machine file. Blue: with the best explanation. Grey: noise."


def page_of(diagnosis: Diagnosis) -> Page:
    """Return the page of a diagnosis."""
    search, proposals = diagnosis.search, diagnosis.separations
    overlaid = [overlay(each) for each in overlays_of(search.estimation, search.final.values)]
    worst = "Measured and simulated, where they differ most"
    sections = [
        Section("Where they differ", sentences=[KEY], drawings=splits(diagnosis)),
        Section(worst, sentences=[f"Dark: measured. {KEY}"], drawings=overlaid),
    ]
    if diagnosis.curves:
        shown = "with the best explanation" if diagnosis.named else "with the machine file"
        sentence = f"Mean residual {shown}, in bins of one quantity. Grey: the 90 % band of each mean."
        sections.append(Section("Not explained", sentences=[sentence], drawings=list(map(_curve, diagnosis.curves))))
    if search.best is not None and search.held_out:
        sentence = "Each was left out of the fit in turn, and simulated with the parameters of the others."
        sections.append(Section("Left out of the fit", sentences=[sentence], drawings=[_held_out(diagnosis)]))
    if proposals:
        gcode = next((each.gcode for each in proposals if each.gcode), "")
        texts = [each.sentence for each in proposals] + (["The G-code of the first:"] if gcode else [])
        sections.append(Section("What to record next", sentences=texts, code=gcode))
    sections.append(Section("Evidence", tables=[_evidence(diagnosis), _retuned(diagnosis)], folded=True))
    sections.append(Section("Files", tables=[Table(("", ""), _files(diagnosis))], folded=True))
    band = "{:g}-{:g} Hz".format(*search.estimation.whiten.band_hz)
    about = [f"verdict: {diagnosis.verdict}", f"{len(diagnosis.runs)} runs", band]
    output = None if diagnosis.output is None else Path(diagnosis.output.name)
    return Page(diagnosis.problem.machine.name, about, sections, replace(diagnosis, output=output).answer)


def gap_page(gap: Discrepancy) -> Page:
    """Return the page of a gap: the error by every quantity that it may depend on."""
    drawn = [_split(TITLES[title], split) for title, split in gap.residual.splits.items()]
    key = "Orange: with the machine file. Grey: noise."
    return Page(gap.title, sections=[Section("Where they differ", sentences=[key], drawings=drawn)])


# ---- tables --------------------------------------------------------------------------------------


def _evidence(diagnosis: Diagnosis) -> Table:
    """List the explanations that were fitted in full, the most likely first."""
    search, catalogue = diagnosis.search, diagnosis.problem.catalogue
    head = ("explanation", "error, times the noise", "behind, −2 ln Z", "parameters")
    if search.best is None:
        return Table(head, [("none was needed", "", "", "")], "Explanations")
    tried = [(each.names, each.fit, search.behind(each)) for each in search.tried]
    tried.append(((), search.base, search.base.evidence - search.best.fit.evidence))
    rows = [
        (
            joined([f"{title(name, catalogue)} ({name})" for name in names]) or "nothing added, only retuned",
            digits(times_noise(fit.discrepancy)),
            evidence(behind),
            str(len(fit.parameters)),
        )
        for names, fit, behind in sorted(tried, key=lambda each: each[2])
    ]
    return Table(head, rows, "Explanations")


def _retuned(diagnosis: Diagnosis) -> Table:
    """List the machine file's parameters, those that moved furthest first."""
    search, quantities = diagnosis.search, diagnosis.problem.quantities
    intervals = search.intervals or intervals_of(search.estimation, search.final)
    moved = [(n, (intervals[n.name].value - n.start) / n.sd) for n in search.final.parameters if of_machine(n.name)]
    rows = [
        (
            file_key(n.name, quantities),
            digits(quantities.scale(n.name) * n.start, 5),
            percent(n.sd / abs(n.start)) if n.start else digits(n.sd),
            interval(intervals[n.name].scaled(quantities.scale(n.name))),
            f"{sds:+.1f}",
        )
        for n, sds in sorted(moved, key=lambda each: -abs(each[1]))
    ]
    return Table(("parameter", "in the file", "allowed, ±", "now (90 %)", "moved by, sd"), rows, "Retuning")


def _files(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    return [
        ("machine file", hash_of(Path(diagnosis.problem.machine.path))),
        *(("run", hash_of(path)) for path in diagnosis.runs),
        ("noise", f"from {diagnosis.search.noise.origin}"),
        ("computing time", f"{diagnosis.seconds:.0f} s"),
    ]


# ---- figures -------------------------------------------------------------------------------------


def splits(result: DiagnosisResult) -> list[Drawing]:
    """Return a figure for each quantity that the excess may depend on."""
    before, after = (each.splits for each in result.residuals)
    return [_split(TITLES[title], split, after[title]) for title, split in before.items()]


def _split(title: str, *each: Split, more: float = 0.0) -> Drawing:
    height = HEIGHT if each[0].spans else ROW * len(each[0].labels) + AXIS + more
    return Drawing("where", title, "", "", WIDTH, height, partial(draw_split, each=each))


def overlay(each: Overlay) -> Drawing:
    """Return the figure of one signal, measured and simulated."""
    draw = partial(draw_overlay, overlay=each, unit=each.unit)
    sizes = [float(((each.measured - x) ** 2).mean()) ** 0.5 / each.noise_rms for x in (each.before, each.after)]
    said = f"The error is {times(sizes[0])} the noise before, {times(sizes[1])} after."
    return Drawing("overlay", f"{each.signal} in {Path(each.recording).name}", said, "", WIDTH, 3.6, draw)


def _held_out(diagnosis: Diagnosis) -> Drawing:
    places = diagnosis.search.held_out
    labels = tuple(p.label if p.experiment or len(p.position) == 1 else f"{p.label} mm" for p in places)
    label, worst = max(zip(labels, places, strict=True), key=lambda pair: pair[1].after)
    finding = (
        f"At the worst of them, {label}, the error is {times(times_noise(worst.before))} the noise before and "
        f"{times(times_noise(worst.after))} after."
    )
    left_out = diagnosis.gap.left_out.capitalize()
    before, after = (Split(left_out, labels, excess=tuple(getattr(p, x) for p in places)) for x in ("before", "after"))
    return replace(_split(left_out, before, after, more=0.3), name="held-out", finding=finding)


def _curve(curve: ResidualCurve) -> Drawing:
    draw = partial(draw_curve, curve=curve)
    said = f"{curve.sentence[0].upper()}{curve.sentence[1:]}."
    return Drawing("residual", f"{curve.signal} by {curve.against}", said, "", WIDTH, HEIGHT, draw)


def draw_curve(box: Box, curve: ResidualCurve) -> None:
    """Draw the mean residual in each bin with its 90 % band."""
    axes, mean, half = box.subplots(), np.array(curve.residual), np.array(curve.half_width)
    axes.axhline(0.0, color=SOFT, linewidth=1)
    axes.fill_between(curve.at, mean - half, mean + half, color=NOISE, linewidth=0)
    axes.plot(curve.at, mean, "o-", color=AFTER, linewidth=1.5, markersize=3)
    axes.set(xlabel=f"{curve.against}, {curve.against_unit}", ylabel=f"residual {curve.signal}, {curve.unit}")
    grid(axes)


def draw_split(box: Box, each: Sequence[Split]) -> None:
    """Draw the error by the labels of one split: with the machine file, and after a fit if there is one."""
    axes, split = box.subplots(), each[0]
    errors = [np.maximum([times_noise(x) for x in part.excess], LEAST_SHOWN) for part in each]
    (_steps if split.spans else _dumbbells)(axes, split, errors)


def _steps(axes: Axes, split: Split, errors: Sequence[FloatArray]) -> None:
    """Labels that follow one another, all equally wide; their edges are the ticks."""
    count = len(split.spans)
    at = np.arange(count + 1)
    axes.axhline(1.0, color=NOISE, linewidth=4, zorder=0)
    for error, colour in zip(errors, (BEFORE, AFTER), strict=False):
        axes.stairs(error, at, baseline=None, color=colour, linewidth=2)
    edges = [split.spans[0][0], *(b for _, b in split.spans)]
    every = 1 if count <= FEW_STEPS else 2 if count <= 2 * FEW_STEPS else count // 4
    axes.set_xticks(at[::every], [f"{edge:g}" for edge in edges[::every]])
    axes.set(xlabel=f"{split.title}, {split.unit}", ylabel="error, times the noise", xlim=(0, at[-1]))
    _times_scale(axes, "y", errors)


def _dumbbells(axes: Axes, split: Split, errors: Sequence[FloatArray]) -> None:
    rows = np.arange(len(split.labels))
    axes.axvline(1.0, color=NOISE, linewidth=4, zorder=0)
    axes.hlines(rows, np.min(errors, axis=0), np.max(errors, axis=0), color=SOFT, linewidth=1, alpha=0.6)
    for error, colour in zip(errors, (BEFORE, AFTER), strict=False):
        axes.plot(error, rows, "o", color=colour, markersize=7)
    axes.set_yticks(
        rows, [x if len(x) <= LONGEST_NAME else f"…{x[1 - LONGEST_NAME :]}" for x in split.labels], parse_math=False
    )
    axes.set(xlabel="error, times the noise", ylim=(len(rows) - 0.5, -0.5))
    axes.tick_params(axis="y", length=0)
    _times_scale(axes, "x", errors)


def _times_scale(axes: Axes, which: str, values: Sequence[FloatArray]) -> None:
    """Logarithmic, and never so fine that chance looks like a difference."""
    low, high = float(np.min(values)), float(np.max(values))
    limits = (min(0.8 * low, 0.7), max(1.3 * high, 2.0))
    axes.set(**{f"{which}scale": "log", f"{which}lim": limits})
    axis = getattr(axes, f"{which}axis")
    plain_decades(axis)
    axis.set_minor_locator(NullLocator())
    grid(axes)


def draw_overlay(box: Box, overlay: Overlay, unit: str) -> None:
    """Draw measured and simulated signals, and below their difference, with the noise's rms as a band."""
    above, below = box.subplots(2, 1, sharex=True, height_ratios=(1.4, 1))
    t = overlay.time_s
    above.plot(t, overlay.before, color=BEFORE, linewidth=1.2)
    near = (overlay.measured - overlay.noise_rms, overlay.measured + overlay.noise_rms)
    above.fill_between(t, *near, color=NOISE, linewidth=0)
    above.plot(t, overlay.measured, color=REFERENCE, linewidth=2.2)
    above.plot(t, overlay.after, color=AFTER, linewidth=1.2, linestyle=(0, (4, 2)))
    below.axhspan(-overlay.noise_rms, overlay.noise_rms, color=NOISE, linewidth=0)
    below.plot(t, overlay.measured - overlay.before, color=BEFORE, linewidth=1.2)
    below.plot(t, overlay.measured - overlay.after, color=AFTER, linewidth=1.2)
    above.set(ylabel=unit, xlim=(t[0], t[-1]))
    below.set(xlabel="time in the run, s", ylabel=f"error, {unit}")
    for axes in (above, below):
        grid(axes)
