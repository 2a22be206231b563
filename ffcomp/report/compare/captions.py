"""Captions: the finding of each figure in one line, and how to read it."""

from __future__ import annotations

import numpy as np

from ffcomp.compare.result import Comparison
from ffcomp.report.compare.positions import Position
from ffcomp.report.compare.words import (
    acceleration,
    contour_rms_um,
    duration,
    fastest_shaper,
    nick,
    shown,
    um,
    where_seen,
)

HOW_TO_READ = {
    "close-up": "The corners with the largest error without compensation, of outer walls if there are any, seen from "
    "above, true to scale. Dashed: the "
    "reference path; grey: its neighbours in the layer. Below, the same pass on a logarithmic scale: how far off the "
    "path the nozzle is, before and behind the corner. Equal waves behind a corner are ringing.",
    "errors-by-layer": "Root mean square of the contour error where plastic flows, if it flows anywhere. On a delta "
    "the resonance changes over the bed, so layers and features that lie elsewhere come out differently; a method that "
    "fits everywhere is flat.",
    "spectrum": "Frequencies at which the nozzle is off the path (density, so that the area under the curve squared is "
    "the mean square error). A hill inside the shaded band is ringing at the resonance; what is left at low "
    "frequencies is corners cut, what is left above is not worth compensating.",
    "bed-map": "The lowest resonance that motion along X or Y excites well, over the bed of the evaluation plant; "
    "black dots: where the evaluated part was printed. An input shaper has one frequency for the whole bed.",
    "limits": "The largest demand on any carriage, over one segment's time, and what the machine file allows (red "
    "line). What is beyond the limit no motor follows: such a method's accuracy is not to be had.",
    "methods": "Every method on the same print and the same virtual printer; left is better, and one "
    "step of the grid is ten times.",
    "mismatch": "How the methods do on printers that are not as the machine file says. A wide spread means that the "
    "method relies on exact numbers.",
    "equal-quality": "The other way round: how hard each method may accelerate before 1 % of its contour error is "
    "above the bound, and how long the whole print takes then. Empty: missed even at the lowest acceleration tried.",
}


def said(name: str, found: Comparison, positions: list[Position]) -> str:
    """Return one line for the title band of a figure."""
    if name == "close-up":
        return _close_up(positions)
    own = {"bed-map": _bed, "limits": _limits, "mismatch": _mismatch, "equal-quality": _equal_quality}
    return own.get(name, headline)(found)


def headline(found: Comparison) -> str:
    """Return `Contour error where plastic flows, rms: 110 µm (no compensation) · 4.94 µm (MZV) · 1.17 µm (ffcomp)`."""
    parts = [f"{um(contour_rms_um(found, m))} µm ({nick(m)})" for m in shown(found)]
    return f"Contour error {where_seen(found)}, rms: {' · '.join(parts)}"


def _close_up(positions: list[Position]) -> str:
    first = positions[0]
    parts = [f"{um(float(each.contour_um.max(initial=0.0)))} µm ({nick(each.method)})" for each in first.passes]
    return f"Largest error, at X {first.at[0]:.1f} Y {first.at[1]:.1f}: {' · '.join(parts)}"


def _bed(found: Comparison) -> str:
    assert found.bed is not None
    ranges = [
        f"{np.nanmin(values):.0f} to {np.nanmax(values):.0f} Hz along {axis}"
        for axis, values in zip("XY", np.moveaxis(found.bed.frequency_hz, 2, 0), strict=True)
    ]
    return f"The resonance of {found.plant.name}: {', '.join(ranges)}"


def _limits(found: Comparison) -> str:
    beyond = [method.label for method in found.methods.values() if not method.peaks.within_limits]
    return f"Beyond the limits: {', '.join(beyond)}" if beyond else "Every method stays within the machine's limits"


def _mismatch(found: Comparison) -> str:
    parts = [
        f"{um(m.spread.median_um)} to {um(m.spread.worst_um)} µm ({nick(m)})"
        for m in shown(found)
        if m.spread is not None
    ]
    return f"Contour rms, median to worst: {' · '.join(parts)}"


def _equal_quality(found: Comparison) -> str:
    methods = (found.methods["none"], fastest_shaper(found), found.methods[found.compensated])
    evaluated = [(each, each.equal_quality) for each in methods if each is not None and each.equal_quality is not None]
    parts = [
        f"{acceleration(quality.acceleration_mm_per_s2)}, {duration(quality.print_time_s)} ({method.label})"
        for method, quality in evaluated
        if quality.reached
    ]
    return f"For 99 % below {found.quality_bound_um:g} µm: {' · '.join(parts) or 'no method manages it'}"
