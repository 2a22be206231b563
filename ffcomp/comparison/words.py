"""Format numbers for people, and name methods inside a sentence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from ffcomp.comparison.evaluation import contour_numbers
from ffcomp.comparison.result import Comparison, Error, Family, Method
from ffcomp.metrics import Track
from ffcomp.numerics.digits import um
from gcode.layers import is_outer_wall
from models.arrays import IntArray

FAMILY_NAMES: dict[Family, str] = {
    "none": "no compensation",
    "calibrated": "shaper, calibrated",
    "best fixed": "shaper, best fixed",
    "inversion": "ffcomp",
}


def times(ratio: float) -> str:
    """Format a ratio: `57 times`, `6.4 times`."""
    return f"{ratio:.0f} times" if ratio >= 9.95 else f"{ratio:.1f} times"


def acceleration(mm_per_s2: float) -> str:
    """Format an acceleration in the firmware's unit and in metres: `12,400 mm/s² (12.4 m/s²)`."""
    return f"{thousands(mm_per_s2)} mm/s² ({mm_per_s2 / 1e3:.3g} m/s²)"


def thousands(value: float) -> str:
    """Format with three digits that count: `12,400`, `5,000`, `823`."""
    return f"{float(f'{value:.3g}'):,.0f}"


def clipped(text: str, most: int = 34) -> str:
    """Shorten a name for figures: names from files have any length."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def duration(seconds: float) -> str:
    """Format a time: `48 s`, `14 min 02 s`, `3 h 05 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    minutes = round(seconds / 60)
    return f"{minutes // 60} h {minutes % 60:02d} min"


def file_name(comparison: Comparison) -> str:
    """Return the print's name without its folders."""
    return comparison.print_name.replace("\\", "/").rsplit("/", 1)[-1]


def shown(comparison: Comparison) -> list[Method]:
    """Return the methods that figures show: without compensation, the best fixed shaper, the compensated print."""
    names = dict.fromkeys(
        name for name in ("none", comparison.best_fixed, comparison.compensated) if name in comparison.methods
    )
    return [comparison.methods[name] for name in names]


def outer_first(names: Iterable[str], share: Mapping[str, float]) -> list[str]:
    """Sort features: outer walls first, because they are visible, then by their share of the time."""
    return sorted(names, key=lambda name: (not is_outer_wall(name), -share.get(name, 0.0)))


def nick(method: Method) -> str:
    """Return the label without its family, where that is known: `MZV`, `MZV, z too`, `ffcomp`."""
    return method.label.removesuffix(f", {method.family}")


def shapers(comparison: Comparison) -> list[Method]:
    """Return what firmware can do today: one shaper for the whole bed, calibrated or at its best."""
    return [method for method in comparison.methods.values() if method.family in ("calibrated", "best fixed")]


def fastest_shaper(comparison: Comparison) -> Method | None:
    """Return the fastest shaper at equal quality; at the print's own speed another may have the least error."""
    evaluated = [(method.equal_quality, method) for method in shapers(comparison) if method.equal_quality is not None]
    first = sorted(evaluated, key=lambda each: (not each[0].reached, each[0].print_time_s))[:1]
    return first[0][1] if first else None


def extrudes(comparison: Comparison) -> bool:
    """Return whether the evaluated part extrudes."""
    return bool(comparison.methods[comparison.compensated].samples.extruding.any())


def rms_um(error: Error | None) -> str:
    """Format the rms of one part of the print, if there is such a part."""
    return "–" if error is None else um(error.rms_um)


def seen(comparison: Comparison, method: Method) -> Track:
    """Return the errors that show on the print: where plastic flows, or everywhere if it flows nowhere."""
    return method.extruding if extrudes(comparison) else method.track


def where_seen(comparison: Comparison) -> str:
    """Say which samples those are."""
    return "where plastic flows" if extrudes(comparison) else "over all moves"


def contour_rms_um(comparison: Comparison, method: Method) -> float:
    """Return the rms of what shows."""
    return seen(comparison, method).contour_rms_um


def contour_p99_um(comparison: Comparison, method: Method) -> float:
    """Return the 99th percentile of the same."""
    return seen(comparison, method).contour_p99_um


def layer_errors(comparison: Comparison, method: Method) -> dict[int, Error]:
    """Return the error on each layer's number."""
    return _by(comparison, method, method.samples.layer)


def feature_errors(comparison: Comparison, method: Method) -> dict[str, Error]:
    """Return the error on each feature's name; its share is that of the time that is counted."""
    return {comparison.features[k]: error for k, error in _by(comparison, method, method.samples.feature).items()}


def _by(comparison: Comparison, method: Method, labels: IntArray) -> dict[int, Error]:
    s = method.samples
    seen = s.extruding if extrudes(comparison) else np.ones(len(labels), dtype=np.bool_)
    errors = {int(k): contour_numbers(s, seen & (labels == k)) for k in np.unique(labels[seen])}
    total = max(sum(each.share for each in errors.values()), 1e-12)
    return {k: replace(each, share=each.share / total) for k, each in errors.items()}
