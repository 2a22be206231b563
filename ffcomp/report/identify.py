"""Measured frequency responses beside the fitted model."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ffcomp.identify.axis_spectra import Datum
from ffcomp.identify.belts import BeltComparison
from ffcomp.identify.identify import Identified
from ffcomp.identify.modal_fit import AxisFit, IdentifiedAxes
from ffcomp.report.belts import belts_panel
from ffcomp.report.shared.drawing import write_figure
from ffcomp.version import __version__
from models.arrays import ComplexArray, FloatArray

if TYPE_CHECKING:
    from ffcomp.measurement.frf import FrequencyResponse

MEASURED, FITTED, NOISE = "#8a8f98", "#d55e00", "#0072b2"
COLUMNS = 4


def draw_fit(found: Identified, target: Path) -> None:
    """Write the figure of a fit; the suffix of `target` names the format."""
    write_figure(fit_figure(found), target, dpi=110)


def fit_figure(found: Identified) -> Figure:
    """Draw one panel for each response: measured values, the fit, and the standard deviation of the noise."""
    fitted = found.fitted
    pairs = list(zip(fitted.responses, fitted.predictions, strict=True))
    columns = min(COLUMNS, len(pairs))
    rows = -(-len(pairs) // columns)
    figure = Figure(figsize=(4.2 * columns + 0.4, 3.6 * rows + 0.9), layout="constrained")
    figure.suptitle(f"{found.machine.name} · {_verdict(found)}\nffcomp {__version__}", x=0.01, ha="left", fontsize=11)
    for box, (response, model) in zip(figure.subfigures(rows, columns, squeeze=False).ravel(), pairs, strict=False):
        upper, lower = box.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        _magnitude(upper, response, model)
        _phase(lower, response, model)
    return figure


def draw_axes(found: IdentifiedAxes, name: str, target: Path, belts: BeltComparison | None = None) -> None:
    """Write the figure of the axes' modes; the suffix of `target` names the format."""
    write_figure(axes_figure(found, name, belts), target, dpi=110)


def axes_figure(found: IdentifiedAxes, name: str, belts: BeltComparison | None = None) -> Figure:
    """Draw one panel for each file and axis: measured values, the sum of the modes, and the modes' frequencies.

    Parameters
    ----------
    belts : compared in a panel of their own
    """
    panels = [(axis, *each) for axis in found.axes for each in zip(axis.data, axis.fitted, axis.errors, strict=True)]
    count = len(panels) + (belts is not None)
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(5.2 * columns + 0.4, 3.8 * rows + 0.9), layout="constrained")
    verdict = " · ".join(_said(axis) for axis in found.axes)
    figure.suptitle(f"{name} · {verdict}\nffcomp {__version__}", x=0.01, ha="left", fontsize=11)
    boxes = figure.subplots(rows, columns, squeeze=False).ravel()
    for box, panel in zip(boxes, panels, strict=False):
        _axis_panel(box, *panel)
    if belts is not None:
        belts_panel(boxes[len(panels)], belts)
    for box in boxes[count:]:
        box.set_axis_off()
    return figure


def _said(axis: AxisFit) -> str:
    modes = (f"{m.frequency_hz.value:.1f} Hz (ζ {m.damping_ratio.value:.3f})" for m in axis.modes)
    return f"{axis.name}: {' and '.join(modes)}"


def _axis_panel(axes: Axes, axis: AxisFit, datum: Datum, model: FloatArray | ComplexArray, error: float) -> None:
    """Position or power per even acceleration, so that a resonance stands over a level line."""
    f = datum.frequency_hz
    left = f"{100 * error:.1f} %" if error else "the noise"
    axes.semilogy(f, np.abs(datum.value) * datum.level, ".", color=MEASURED, markersize=4, label="measured")
    axes.semilogy(f, np.abs(model) * datum.level, color=FITTED, linewidth=1.4, label=f"modes, to {left}")
    for mode in axis.modes:
        axes.axvline(mode.frequency_hz.value, color=NOISE, linewidth=0.9, linestyle="--")
        axes.axvspan(mode.frequency_hz.low, mode.frequency_hz.high, color=NOISE, alpha=0.15, linewidth=0)
    axes.set_title(f"{axis.name}: {Path(datum.source).name}", fontsize=9)
    axes.set_xlabel("Hz", fontsize=8)
    axes.set_ylabel(datum.unit, fontsize=8)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="best")


def _verdict(found: Identified) -> str:
    errors = found.fitted.model_errors
    if not errors.any():
        return f"the model explains every response to its noise (misfit {found.fitted.misfit:.2f})"
    exact = int(np.sum(errors == 0))
    return (
        f"the model explains {exact} of {len(errors)} responses to their noise, the worst to {100 * errors.max():.1f} %"
    )


def _magnitude(axes: Axes, response: FrequencyResponse, model: ComplexArray) -> None:
    f = response.frequency_hz
    axes.semilogy(f, np.abs(response.value), ".", color=MEASURED, markersize=3, label="measured")
    axes.semilogy(f, np.abs(model), color=FITTED, linewidth=1.4, label="fitted")
    axes.semilogy(f, np.sqrt(response.variance), color=NOISE, linewidth=0.8, alpha=0.7, label="its noise")
    axes.set_ylim(bottom=float(np.min(np.sqrt(response.variance))) / 3)  # what is below the noise is not shown
    axes.set_title(_title(response), fontsize=9)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7, loc="best")


def _phase(axes: Axes, response: FrequencyResponse, model: ComplexArray) -> None:
    """Draw the measured phase on the model's branch."""
    f = response.frequency_hz
    unwrapped = np.unwrap(np.angle(model))
    real = unwrapped + np.angle(response.value * np.exp(-1j * unwrapped))
    axes.plot(f, np.degrees(real), ".", color=MEASURED, markersize=3)
    axes.plot(f, np.degrees(unwrapped), color=FITTED, linewidth=1.4)
    axes.set_xlabel("Hz", fontsize=8)
    axes.set_ylabel("phase, °", fontsize=8)
    axes.grid(alpha=0.3)


def _title(response: FrequencyResponse) -> str:
    place: Sequence[float] = response.position_mm or ()
    at = f" at ({', '.join(f'{x:g}' for x in place[:2])}) mm" if place else ""
    setup = {"assembly": "", "carriage": "carriage alone: ", "carriage+mass": "carriage with mass: "}
    return f"{setup.get(response.setup, 'effector: ')}{response.input} → {response.output}{at}"
