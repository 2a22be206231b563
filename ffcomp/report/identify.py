"""What `identify` measured and the fitted model, in three panels: a response, the modes, and the residual.

Blue is the model and dark the measurement, as everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffcomp.errors import RequestError
from ffcomp.identification.belts import BeltComparison
from ffcomp.identification.machine_fit import AxesFit, MachineFit, ParametersFit
from ffcomp.identification.output_error import Fitted
from ffcomp.identification.page.scan import ScanFit
from ffcomp.measurement.frf import FrequencyResponse
from ffcomp.report.drawing import AFTER, NOISE, RC, REFERENCE, SOFT, grid, one_panel, plain_decades
from ffcomp.report.page import Page, Section, plain
from ffcomp.responses.modes import modes_at
from ffcomp.shapers.calibration import klipper_block
from ffcomp.version import __version__
from models.arrays import ComplexArray, FloatArray

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # distinct for colour-blind readers
WIDTH, LETTERS = 7.2, 88  # inches: readable on a phone; letters across the figure
MAGNIFIED = 20.0  # the waves of a scan
DOTS: dict[str, Any] = {"color": REFERENCE, "markersize": 3, "alpha": 0.55, "markeredgewidth": 0, "zorder": 3}


def figure_of(fit: MachineFit) -> Figure:
    """Draw the measurements and the fitted model; RequestError where they hold nothing that is drawn."""
    if isinstance(fit, ScanFit):
        return page_figure(fit)
    if isinstance(fit, ParametersFit | AxesFit):
        panels = panels_of(fit.result) if isinstance(fit, ParametersFit) else _panels_of_axes(fit)
        return three_panels(fit.origin.name, fit.headline, panels, klipper_block(fit.shapers), fit.belts)
    if fit.belts is None:
        raise RequestError("These data hold no frequency responses to draw (see: --plan).")
    return belts_figure(fit.belts, fit.origin.name)


@dataclass(frozen=True, eq=False)
class Trace:
    """One measured response and the fitted one."""

    label: str
    frequency_hz: FloatArray  # (k,)
    measured: FloatArray | ComplexArray  # (k,)
    fitted: FloatArray | ComplexArray  # (k,)
    error: float  # the model's own, relative; 0: explained to the noise
    noise: FloatArray | None  # (k,) standard deviation; None: not known
    unit: str
    scale: FloatArray | float = 1.0  # levels the curve

    @property
    def said(self) -> str:
        """How well it is explained."""
        return f"{self.label}: to {f'{100 * self.error:.1f} %' if self.error else 'the noise'}"


Mode = tuple[float, float, float, float, str]  # frequency, its 90 % interval, Hz, damping ratio, name


@dataclass(frozen=True, eq=False)
class Panels:
    """What the three panels show."""

    shown: Sequence[Trace]
    modes: Sequence[Mode]
    every: Sequence[Trace]


def page_of(fit: MachineFit) -> Page:
    """Return the page of a fit: its panels, and settings of an input shaper to copy."""
    sections, has_panels = list[Section](), isinstance(fit, ParametersFit | AxesFit)
    if isinstance(fit, ScanFit) or (fit.belts is not None and not has_panels):
        return replace(plain(fit), title=fit.origin.name)
    if has_panels:
        sections.append(Section("The fit", figures=[figure_of(fit)]))
    if block := klipper_block(fit.shapers):
        sections.append(Section("If you stay with an input shaper", sentences=["Paste into printer.cfg:"], code=block))
    return Page(fit.origin.name, [f"method {fit.method}"], sections, replace(fit, output=None).answer)


def panels_of(fitted: Fitted) -> Panels:
    """Return the panels of a delta: its worst response, its modes at the centre, and the residual of all responses."""
    machine = fitted.machine
    traces = [
        Trace(_title(r), r.frequency_hz, r.value, model, float(error), np.sqrt(r.variance), _unit(r))
        for r, model, error in zip(fitted.responses, fitted.predictions, fitted.model_errors, strict=True)
    ]
    ringing = [mode for mode in modes_at(machine, np.array(machine.kinematics.centre_mm)) if mode.rings]
    modes = [(m.frequency_hz, m.frequency_hz, m.frequency_hz, m.damping_ratio, m.kind) for m in ringing]
    return Panels([max(traces, key=lambda trace: trace.error)], modes, traces)


def _panels_of_axes(fit: AxesFit) -> Panels:
    """Return the panels of straight axes: the worst response of each, their modes, and the residual of all."""
    shown, every, modes = list[Trace](), list[Trace](), list[Mode]()
    for axis in fit.result.axes:
        traces = [
            Trace(axis.name, d.frequency_hz, d.value, model, error, None, d.unit, d.level)
            for d, model, error in zip(axis.data, axis.fitted, axis.errors, strict=True)
        ]
        shown.append(max(traces, key=lambda trace: trace.error))
        every += traces
        for mode in axis.modes:
            f = mode.frequency_hz
            modes.append((f.value, f.low, f.high, mode.damping_ratio.value, axis.name))
    return Panels(shown, modes, every)


def three_panels(
    name: str, headline: str, panels: Panels, block: str = "", belts: BeltComparison | None = None
) -> Figure:
    """Draw a fit in one figure, with settings of an input shaper to copy (block); belts have their own panel."""
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(WIDTH, 7.0 + (3.2 if belts else 0.0)), dpi=200, layout="constrained")
        rows: list[Any] = [["response"] * 2, ["modes", "residual"], *([["belts"] * 2] if belts else [])]
        axes: dict[str, Axes] = figure.subplot_mosaic(rows)
        figure.suptitle(f"{name}\n{fill(headline, LETTERS)}", x=0.01, ha="left", fontsize=10, parse_math=False)
        _responses(axes["response"], panels.shown)
        _modes(axes["modes"], panels.modes)
        _residuals(axes["residual"], panels.every)
        if belts is not None:
            belts_panel(axes["belts"], belts)
        below = f"{block}\n" if block else ""
        figure.supxlabel(f"{below}ffcomp {__version__}", fontsize=7, color=SOFT, x=0.01, ha="left", family="monospace")
    return figure


def _responses(axes: Axes, shown: Sequence[Trace]) -> None:
    for trace, colour in zip(shown, (AFTER, *COLOURS[1:]), strict=False):
        f, scale = trace.frequency_hz, trace.scale
        if trace.noise is not None:
            axes.plot(f, trace.noise * scale, color=NOISE, linewidth=1, label="noise")
        axes.semilogy(f, np.abs(trace.measured) * scale, ".", **DOTS)
        axes.semilogy(f, np.abs(trace.fitted) * scale, color=colour, linewidth=1.8, label=trace.said)
    axes.set(xlabel="frequency, Hz", ylabel=shown[0].unit, title="Measured (dots) and fitted, where the fit is worst")
    axes.legend(frameon=False, fontsize=8)
    grid(axes)


def _modes(axes: Axes, modes: Sequence[Mode]) -> None:
    names = list(dict.fromkeys(name for *_, name in modes))
    for hz, low, high, damping, name in modes:
        colour = (AFTER, *COLOURS[1:])[names.index(name) % len(COLOURS)]
        axes.vlines(hz, 0.0, 100 * damping, color=colour, linewidth=1.5)
        axes.plot([low, high], [100 * damping] * 2, color=colour, linewidth=3, alpha=0.4)
        axes.plot(hz, 100 * damping, "o", color=colour, markersize=6)
    for k, name in enumerate(names):
        label = f"{name}: {', '.join(f'{hz:.1f}' for hz, *_, each in modes if each == name)} Hz"
        axes.plot([], [], "o", color=(AFTER, *COLOURS[1:])[k % len(COLOURS)], label=label)
    axes.set(xlabel="frequency, Hz", ylabel="damping ratio, %", title="Modes")
    axes.set_ylim(0.0, 130 * max((damping for *_, damping, _ in modes), default=0.1))
    axes.margins(x=0.15)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=2, frameon=False, fontsize=8)
    grid(axes)


def _residuals(axes: Axes, every: Sequence[Trace]) -> None:
    """Draw what the fit leaves: in units of the noise where it is known, else as a share of the largest value."""
    known = all(trace.noise is not None for trace in every)
    for trace in every:
        left = np.abs(trace.measured - trace.fitted)
        size = left / trace.noise if trace.noise is not None and known else 100 * left / np.abs(trace.measured).max()
        axes.semilogy(
            trace.frequency_hz,
            np.maximum(size, 1e-2),
            color=AFTER,
            linewidth=0.8,
            alpha=0.45 if len(every) > 3 else 1.0,
        )
    if known:
        axes.axhline(1.0, color=NOISE, linewidth=3, zorder=0)
    unit = "times the noise" if known else "% of the largest value"
    title = f"Residual of {len(every)} response{'s' * (len(every) > 1)}"
    axes.set(xlabel="frequency, Hz", ylabel=unit, title=title)
    plain_decades(axes.yaxis)
    grid(axes)


def _unit(response: FrequencyResponse) -> str:
    position, force = response.output.startswith("pos_"), response.input.startswith("force_")
    if force:
        return "m/N" if position else "m/s² per N"
    return "m/m" if position else "m/s² per m"


def _title(response: FrequencyResponse) -> str:
    place: Sequence[float] = response.position_mm or ()
    at = f" at ({', '.join(f'{x:g}' for x in place[:2])}) mm" if place else ""
    setup = {"assembly": "", "carriage": "carriage alone: ", "carriage+mass": "carriage with mass: "}
    return f"{setup.get(response.setup, 'effector: ')}{response.input} → {response.output}{at}"


def belts_figure(belts: BeltComparison, name: str) -> Figure:
    """Draw all tests in one panel, its finding above it."""
    finding, about = belts.sentence.partition(". ")[0], f"{name} · tests along each {belts.kind}"
    return one_panel(finding, about, (8.4, 4.7), partial(belts_panel, belts=belts))


def belts_panel(axes: Axes, belts: BeltComparison) -> None:
    """Draw each test's power, of any scale: measured, and by the fitted model; its peak is marked."""
    for number, (test, model) in enumerate((each.test, each.fitted) for each in belts.tests):
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
    highest = max(float(each.test.spectrum.frequency_hz[-1]) for each in belts.tests)
    axes.set_xlim(0.0, min(highest, 3.0 * belts.modes_hz[1].value))
    axes.plot([], [], color=SOFT, linewidth=1.0, linestyle=":", label="fitted: head on its belts")
    axes.legend(fontsize=8, frameon=False)
    grid(axes)


def _label(belts: BeltComparison, number: int) -> str:
    test = belts.tests[number].test
    peak = f"peak at {test.spectrum.frequency_hz[int(np.argmax(test.spectrum.value))]:.1f} Hz"
    along = f"axis={test.axis}"
    return f"{along if belts.kind == 'belt' else f'tower {belts.nearest(test)} ({along})'}, {peak}"


def page_figure(fit: ScanFit) -> Figure:
    """Draw the page with its waves magnified, and the line whose waves are explained worst, with its residual."""
    result, name = fit.result, fit.origin.name
    drawn = list(zip(result.lines, result.seen, result.fitted, strict=True))
    places = list(dict.fromkeys(line.stroke.place for line in result.lines))
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=(WIDTH, 9.0), dpi=200, layout="constrained")
        figure.suptitle(f"{name}\n{fill(fit.headline, LETTERS)}", x=0.01, ha="left", fontsize=10, parse_math=False)
        page, panel = figure.subplots(2, 1, height_ratios=(2, 1))
        for line, seen, model in drawn:
            for wave, colour, width in ((seen, REFERENCE, 1.4), (model, AFTER, 0.9)):
                page.plot(*line.line.at(line.s_mm, MAGNIFIED * wave).T, color=colour, lw=width)
        for number, place in enumerate(places, 1):
            lines = [line for line in result.lines if line.stroke.place == place]
            x, y = np.concatenate([line.line.at(line.s_mm) for line in lines]).max(axis=0)
            page.annotate(f"{number}", (x, y), (4, 4), textcoords="offset points", color=SOFT, fontweight="bold")
        title = f"The page, waves {MAGNIFIED:.0f} times larger"
        page.set(aspect="equal", xlabel="x, mm", ylabel="y, mm", title=title)
        page.margins(0.12)
        line, seen, model = max(drawn, key=lambda each: float(np.mean((each[1] - each[2]) ** 2)))
        for wave, colour, width, label in (
            (seen - model, NOISE, 1.2, "residual: best without waves"),
            (seen, REFERENCE, 1.8, "the line in the picture"),
            (model, AFTER, 1.4, "the fitted machine: should lie on it as long as it waves"),
        ):
            panel.plot(line.s_mm, 1e3 * wave, color=colour, lw=width, label=label)
        speed, rings = float(line.stroke.motion.speed[-1]), "xy"[int(np.argmax(np.abs(line.line.across)))]
        title = (
            f"The line that fits worst: place {places.index(line.stroke.place) + 1}, {rings} rings, {speed:.0f} mm/s"
        )
        panel.set(xlabel="along the line, mm", ylabel="across, µm", title=title)
        panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), frameon=False, fontsize=8)
        grid(panel)
        figure.supxlabel(f"ffcomp {__version__}", fontsize=7, color=SOFT, x=0.01, ha="left")
    return figure
