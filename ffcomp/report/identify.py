"""What `identify` measured beside the fitted model: responses, spectra, belts, the lines of a page.

Blue is the model, as everywhere; what was measured is dark, its noise grey. Peaks of the model are marked.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.signal import find_peaks

from ffcomp.errors import RequestError
from ffcomp.identification.axes import IdentifiedAxes
from ffcomp.identification.axis_spectra import Datum
from ffcomp.identification.belts import BeltComparison
from ffcomp.identification.direct import Identified
from ffcomp.identification.machine_fit import AxesFit, MachineFit, ParametersFit, ScanFit
from ffcomp.identification.modal_fit import AxisFit
from ffcomp.report.drawing import (
    AFTER,
    BAND,
    BAND_HEIGHT,
    NOISE,
    RC,
    REFERENCE,
    SOFT,
    band,
    grid,
    machine_line,
    room_below,
)
from ffcomp.shapers.calibration import in_words
from ffcomp.version import __version__
from models.arrays import ComplexArray, FloatArray

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # told apart by colour-blind people too


def figure_of(fit: MachineFit) -> Figure:
    """Draw the measurements next to the fitted model; RequestError where they hold nothing that is drawn."""
    more = in_words(fit.shapers)
    match fit:
        case ScanFit():
            return page_figure(fit)
        case ParametersFit():
            return fit_figure(fit.result, more)
        case AxesFit():
            return axes_figure(fit.result, fit.name, fit.belts, more)
    if fit.belts is None:
        raise RequestError("These data hold no frequency responses to draw (see: --plan).")
    return belts_figure(fit.belts, fit.name)


def belts_figure(belts: BeltComparison, name: str) -> Figure:
    """Draw all tests in one panel, its finding above it."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(8.4, 4.7), dpi=130, layout="constrained")
        finding = belts.sentence.partition(". ")[0]
        figure.suptitle(finding, x=0.01, ha="left", fontsize=12, fontweight="bold", color=BAND)
        axes = figure.add_subplot()
        belts_panel(axes, belts)
        axes.set_title(f"{name} · tests along each {belts.kind} · ffcomp {__version__}", fontsize=8, color=SOFT)
    return figure


def belts_panel(axes: Axes, belts: BeltComparison) -> None:
    """Draw each test's power, of any scale: measured, and by the fitted model; its peak is marked."""
    for number, (test, model) in enumerate(zip(belts.tests, belts.fitted, strict=True)):
        colour = COLOURS[number % len(COLOURS)]
        f, scale = test.spectrum.frequency_hz, 1.0 / float(model.max())
        axes.plot(f, scale * test.spectrum.value, color=colour, linewidth=1.8, label=_label(belts, number))
        axes.plot(f, scale * model, color=colour, linewidth=1.0, linestyle=":")
        top = int(np.argmax(test.spectrum.value))
        height = float(scale * test.spectrum.value[top])
        axes.plot(f[top], height, "v", color=colour, markersize=7)
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel("power of the acceleration, of its largest")
    axes.set_ylim(bottom=0.0)
    highest = max(float(test.spectrum.frequency_hz[-1]) for test in belts.tests)
    axes.set_xlim(0.0, min(highest, 3.0 * belts.modes_hz[1].value))
    axes.plot([], [], color=SOFT, linewidth=1.0, linestyle=":", label="fitted: head on its belts")
    axes.legend(fontsize=8, frameon=False)
    grid(axes)


def _label(belts: BeltComparison, number: int) -> str:
    test = belts.tests[number]
    peak = f"peak at {test.spectrum.frequency_hz[int(np.argmax(test.spectrum.value))]:.1f} Hz"
    if belts.kind == "belt":
        return f"axis={test.axis}, {peak}"
    return f"tower {belts.nearest(test)} (axis={test.axis}), {peak}"


if TYPE_CHECKING:
    from ffcomp.measurement.frf import FrequencyResponse

COLUMNS = 3
PAGE_COLUMNS, MAGNIFIED = 5, 20.0
PANEL, HIGH, AXIS_HIGH = 4.4, 3.7, 3.6  # inches
GOOD_FIT, FAIR_FIT = 0.05, 0.20  # model error of the worst response, up to which a fit is called so
PEAK_PROMINENCE = 0.08  # decades by which a peak stands above its surroundings
PEAKS = 4  # that are marked in a panel, the largest
MOST_PEAKS = 12  # of a printer in this band
HEADROOM, NAME_WIDE = 8.0, 0.14  # above the curves for the names of peaks; of the panel's width
AXES_KEY = "dots: measured  ·  blue: the fitted modes together  ·  dashed: a mode, with its 90 % interval"
DOTS: dict[str, Any] = {"color": REFERENCE, "markersize": 3, "alpha": 0.55, "markeredgewidth": 0}


def fit_figure(identified: Identified, more: str = "") -> Figure:
    """Draw one panel for each response: measured values, the fit, and the standard deviation of the noise.

    Where every input has all its outputs, a column is an input and a row an output.

    Parameters
    ----------
    more : A sentence below the verdict
    """
    pairs = list(
        zip(identified.fitted.responses, identified.fitted.predictions, identified.fitted.model_errors, strict=True)
    )
    order, columns = _in_a_grid([response for response, _, _ in pairs])
    rows = -(-len(order) // columns)
    with matplotlib.rc_context(RC):
        size = (PANEL * columns + 0.4, HIGH * rows + BAND_HEIGHT + 0.6)
        figure = Figure(figsize=size, dpi=110, layout="constrained")
        key = "dots: measured  ·  blue: the model  ·  grey: noise of the measurement"
        of = f"{machine_line(identified.machine)}  ·  {key}"
        room_below(figure, band(figure, "Measured responses and the fitted model", _verdict(identified), of, more))
        boxes = figure.subfigures(rows, columns, squeeze=False).ravel()
        for box, which in zip(boxes, order, strict=False):
            response, model, error = pairs[which]
            upper, lower = box.subplots(2, 1, sharex=True, height_ratios=(2, 1))
            _magnitude(upper, response, model, float(error))
            _phase(lower, response, model)
    return figure


def _in_a_grid(responses: Sequence[FrequencyResponse]) -> tuple[list[int], int]:
    where = [(r.setup, r.position_mm or (), r.output, r.input) for r in responses]
    inputs = {(setup, place, source) for setup, place, _, source in where}
    outputs = {(setup, place, target) for setup, place, target, _ in where}
    places = {(setup, place) for setup, place, _, _ in where}
    across = {sum(1 for each in inputs if each[:2] == place) for place in places}
    complete = len(set(where)) == len(where) and all(
        sum(1 for each in where if each[:2] == place)
        == sum(1 for each in inputs if each[:2] == place) * sum(1 for each in outputs if each[:2] == place)
        for place in places
    )
    if complete and len(across) == 1 and 1 < (columns := across.pop()) <= COLUMNS:
        return sorted(range(len(where)), key=lambda k: where[k]), columns
    return list(range(len(where))), min(COLUMNS, len(where))


def axes_figure(identified: IdentifiedAxes, name: str, belts: BeltComparison | None = None, more: str = "") -> Figure:
    """Draw one panel for each file and axis: measured values, the sum of the modes, and the modes' frequencies.

    Parameters
    ----------
    name : of the machine
    belts : compared in a panel of their own
    more : A sentence below the verdict
    """
    panels = [
        (axis, *each) for axis in identified.axes for each in zip(axis.data, axis.fitted, axis.errors, strict=True)
    ]
    count = len(panels) + (belts is not None)
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    with matplotlib.rc_context(RC):
        size = (max(PANEL * columns, 8.5) + 0.4, AXIS_HIGH * rows + BAND_HEIGHT + 0.6)
        figure = Figure(figsize=size, dpi=110, layout="constrained")
        finding = "  ·  ".join(_modes_text(axis) for axis in identified.axes)
        room_below(
            figure, band(figure, "Measured resonances and the fitted modes", finding, f"{name}  ·  {AXES_KEY}", more)
        )
        boxes = figure.subplots(rows, columns, squeeze=False).ravel()
        for box, panel in zip(boxes, panels, strict=False):
            _axis_panel(box, *panel)
        if belts is not None:
            belts_panel(boxes[len(panels)], belts)
        for box in boxes[count:]:
            box.set_axis_off()
    return figure


def _modes_text(axis: AxisFit) -> str:
    modes = (f"{m.frequency_hz.value:.1f} Hz (ζ {100 * m.damping_ratio.value:.1f} %)" for m in axis.modes)
    return f"{axis.name}: {' and '.join(modes)}"


def _axis_panel(axes: Axes, axis: AxisFit, datum: Datum, model: FloatArray | ComplexArray, error: float) -> None:
    """Position or power per even acceleration, so that a resonance stands over a level line."""
    f = datum.frequency_hz
    left = f"to {100 * error:.1f} %" if error else "to the noise"
    axes.semilogy(f, np.abs(datum.value) * datum.level, ".", **DOTS)
    axes.semilogy(f, np.abs(model) * datum.level, color=AFTER, linewidth=1.6)
    axes.set_ylim(top=HEADROOM * float(np.max(np.abs(datum.value) * datum.level)))
    for mode in axis.modes:
        at = mode.frequency_hz
        axes.axvline(at.value, color=AFTER, linewidth=0.9, linestyle="--")
        axes.axvspan(at.low, at.high, color=AFTER, alpha=0.15, linewidth=0)
    _named(axes, sorted(mode.frequency_hz.value for mode in axis.modes))
    axes.set_title(f"{axis.name}: {Path(datum.source).name}, explained {left}", fontsize=9)
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel(datum.unit)
    grid(axes)


def _named(axes: Axes, at_hz: Sequence[float]) -> None:
    low, high = axes.get_xlim()
    row, before = 0, -np.inf
    for at in at_hz:
        row = row + 1 if (at - before) < NAME_WIDE * (high - low) else 0
        before = at
        axes.annotate(
            f"{at:.1f} Hz", (at, 0.985), xycoords=axes.get_xaxis_transform(), xytext=(2, -9 * row),
            textcoords="offset points", ha="left", va="top", fontsize=7.5, color=AFTER,
        )  # fmt: skip


def _verdict(identified: Identified) -> str:
    """Judge the fit in words: what is left of the worst response, and how many are explained to their noise."""
    errors = identified.fitted.model_errors
    count, exact, worst = len(errors), int(np.sum(errors == 0)), float(errors.max(initial=0.0))
    if worst == 0.0:
        misfit = f"misfit {identified.fitted.misfit:.2f}, 1 is ideal"
        return f"A good fit: the model follows every response to its noise ({misfit})"
    word = "A good fit" if worst <= GOOD_FIT else "A fair fit" if worst <= FAIR_FIT else "A poor fit"
    return (
        f"{word}: the model follows {exact} of {count} responses to their noise, and the worst to {100 * worst:.1f} %"
    )


def _magnitude(axes: Axes, response: FrequencyResponse, model: ComplexArray, error: float) -> None:
    f, noise = response.frequency_hz, np.sqrt(response.variance)
    bottom = float(np.min(noise)) / 3  # what is below the noise is not shown
    axes.fill_between(f, np.full(len(f), bottom), noise, color=NOISE, linewidth=0, zorder=0)
    axes.semilogy(f, np.abs(response.value), ".", **DOTS)
    axes.semilogy(f, np.abs(model), color=AFTER, linewidth=1.6)
    top = HEADROOM * float(max(np.abs(response.value).max(), np.abs(model).max()))
    axes.set_ylim(bottom, top)
    peaks = _peaks(np.abs(model))
    for k in peaks:
        axes.plot([f[k], f[k]], [np.abs(model[k]), top], color=SOFT, linewidth=0.7)
    axes.set_xlim(0.0, float(f[-1]))
    _named(axes, f[peaks].tolist())
    left = f"to {100 * error:.1f} %" if error else "to its noise"
    axes.set_title(f"{_title(response)}, {left}", fontsize=9)
    axes.set_ylabel(f"magnitude, {_unit(response)}")
    grid(axes)


def _peaks(magnitude: FloatArray) -> list[int]:
    """Return where the model has its largest peaks."""
    at, about = find_peaks(np.log10(np.maximum(magnitude, 1e-300)), prominence=PEAK_PROMINENCE)
    if len(at) > MOST_PEAKS:  # rounding, where nothing answers
        return []
    largest = np.argsort(about["prominences"])[-PEAKS:]
    return sorted(at[largest].tolist())


def _unit(response: FrequencyResponse) -> str:
    position, force = response.output.startswith("pos_"), response.input.startswith("force_")
    if force:
        return "m/N" if position else "m/s² per N"
    return "m/m" if position else "m/s² per m"


def _phase(axes: Axes, response: FrequencyResponse, model: ComplexArray) -> None:
    """Draw the measured phase on the model's branch."""
    f = response.frequency_hz
    unwrapped = np.unwrap(np.angle(model))
    real = unwrapped + np.angle(response.value * np.exp(-1j * unwrapped))
    axes.plot(f, np.degrees(real), ".", **DOTS)
    axes.plot(f, np.degrees(unwrapped), color=AFTER, linewidth=1.6)
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel("phase, °")
    grid(axes)


def _title(response: FrequencyResponse) -> str:
    place: Sequence[float] = response.position_mm or ()
    at = f" at ({', '.join(f'{x:g}' for x in place[:2])}) mm" if place else ""
    setup = {"assembly": "", "carriage": "carriage alone: ", "carriage+mass": "carriage with mass: "}
    return f"{setup.get(response.setup, 'effector: ')}{response.input} → {response.output}{at}"


def page_figure(fit: ScanFit) -> Figure:
    """Draw where the lines lie, their waves magnified, and below each line with the fit over it and what is left."""
    result = fit.result
    rows = -(-len(result.lines) // PAGE_COLUMNS)
    places = list(dict.fromkeys(line.stroke.place for line in result.lines))
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(11.0, 5.4 + 1.15 * rows), dpi=110, layout="constrained")
        figure.suptitle(
            f"{fit.name}: {len(result.lines)} lines, {100 * result.explained:.0f} % of their waves explained",
            x=0.01, ha="left", fontsize=12, fontweight="bold", color=BAND,
        )  # fmt: skip
        parts = figure.add_gridspec(rows + 1, PAGE_COLUMNS, height_ratios=[4.0, *[1.0] * rows])
        page = figure.add_subplot(parts[0, :])
        most = 1e3 * max(float(np.abs(seen).max()) for seen in result.seen)
        for k, (line, seen, model) in enumerate(zip(result.lines, result.seen, result.fitted, strict=True)):
            panel = figure.add_subplot(parts[1 + k // PAGE_COLUMNS, k % PAGE_COLUMNS])
            panel.plot(line.s_mm, 1e3 * (seen - model), color=NOISE, lw=1.2, label="what is left: best without waves")
            for wave, colour, width, label in (
                (seen, REFERENCE, 1.4, "the line in the picture"),
                (model, AFTER, 0.9, "the fitted machine: should lie on it as long as it waves"),
            ):
                page.plot(*line.line.at(line.s_mm, MAGNIFIED * wave).T, color=colour, lw=width)
                panel.plot(line.s_mm, 1e3 * wave, color=colour, lw=width, label=label)
            panel.set_ylim(-most, most)
            speed, rings = float(line.stroke.motion.speed[-1]), "xy"[int(np.argmax(np.abs(line.line.across)))]
            place = places.index(line.stroke.place) + 1
            panel.set_title(f"place {place} · {rings} rings · {speed:.0f} mm/s", fontsize=7, color=SOFT)
            panel.tick_params(labelsize=6)
            if k == 0:
                panel.set_xlabel("mm along the line", fontsize=6, color=SOFT)
                panel.set_ylabel("µm across", fontsize=6, color=SOFT)
                handles = panel.get_lines()
            grid(panel)
        for number, place in enumerate(places, 1):
            lines = [line for line in result.lines if line.stroke.place == place]
            x, y = np.concatenate([line.line.at(line.s_mm) for line in lines]).max(axis=0)
            page.annotate(f"{number}", (x, y), (4, 4), textcoords="offset points", color=SOFT, fontweight="bold")
        page.set_aspect("equal")
        page.margins(0.12)
        page.set_xlabel("x, mm", fontsize=8, color=SOFT)
        page.set_ylabel("y, mm", fontsize=8, color=SOFT)
        page.set_title(f"the page, waves {MAGNIFIED:.0f} times larger · ffcomp {__version__}", fontsize=8, color=SOFT)
        figure.legend(handles=handles, loc="outside lower left", ncols=len(handles), fontsize=8, frameon=False)
    return figure
