"""What was asked for: an error that the print may have, and what else it must keep."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gcode.layers import Labels
from models.arrays import BoolArray, FloatArray

_SETTING = re.compile(rb"^; (\w+) = ([\d.]+)", re.MULTILINE)
_FLOW = (b"filament_max_volumetric_speed", b"max_volumetric_speed")
_LAYER_TIME = (b"slowdown_below_layer_time", b"slow_down_layer_time")
_COOLING = (b"cooling", b"slow_down_for_layer_cooling")
FIRST_LAYER = "first layer"
KEPT_FEATURES = ("bridge", "overhang", "ironing", "custom")  # of whose names some word is one of these
SHORTEST_LAYER_S = 5.0  # where neither the user nor the slicer says


@dataclass(frozen=True, slots=True)
class Bound:
    """The error bound of a print, and the limits beside the machine's own."""

    max_error_um: float
    of_features_um: tuple[tuple[str, float], ...] = ()  # by feature, where it is another
    keep_speed: tuple[str, ...] = ()  # features that keep the slicer's motion
    max_flow_mm3_per_s: float | None = None  # None: the largest that the print has as it was sliced
    max_speed_mm_per_s: float | None = None  # None: the machine's
    min_layer_time_s: float | None = None  # None: what the slicer's settings say
    change_speed: tuple[str, ...] = ()  # of what keeps the slicer's motion otherwise; `FIRST_LAYER` is one of them
    safety: float = 0.05  # share of the printers, as uncertain as the machine file says, that may be beyond the bound

    def errors_mm(self, labels: Labels) -> FloatArray:
        """Return each move's own bound, (n,) mm."""
        special = {name.lower(): um for name, um in self.of_features_um}
        by_feature = np.array([special.get(name.lower(), self.max_error_um) for name in labels.features])
        return np.asarray(1e-3 * by_feature[labels.feature])

    def keeps(self, labels: Labels) -> BoolArray:
        """Tell which moves keep the slicer's motion because of their feature, (n,)."""
        kept, changed = ({name.lower() for name in names} for names in (self.keep_speed, self.change_speed))
        by_feature = np.array([_keeps(name.lower(), kept, changed) for name in labels.features])
        return np.asarray(by_feature[labels.feature])

    @property
    def keeps_first_layer(self) -> bool:
        """Whether the first layer keeps the slicer's motion."""
        return FIRST_LAYER not in {name.lower() for name in self.change_speed}


def _keeps(name: str, kept: set[str], changed: set[str]) -> bool:
    return name in kept or (name not in changed and any(word in name for word in KEPT_FEATURES))


def with_slicer_settings(bound: Bound, head: bytes, tail: bytes) -> Bound:
    """Fill in what was not asked for from the slicer's settings, which stand in a file's first or last lines."""
    settings = {key: float(value) for key, value in _SETTING.findall(head + b"\n" + tail) if value.count(b".") < 2}
    flow, shortest_s = bound.max_flow_mm3_per_s, bound.min_layer_time_s
    if flow is None:
        flow = next((settings[key] for key in _FLOW if settings.get(key)), None)
    if shortest_s is None:
        shortest_s = next((settings[key] for key in _LAYER_TIME if key in settings), SHORTEST_LAYER_S)
        if any(settings.get(key) == 0.0 for key in _COOLING):
            shortest_s = 0.0
    return replace(bound, max_flow_mm3_per_s=flow, min_layer_time_s=shortest_s)


LIMITS = {
    "flow": "the nozzle's flow",
    "error_bound": "the error bound",
    "carriage_acceleration": "the carriages' acceleration",
    "speed": "the highest speed",
    "cooling": "cooling",
    "as_sliced": "what keeps the slicer's speed",
    "filament_alone": "retractions and waits",
}
LEAST_SHARE = 0.005  # that is worth a word


def limits_in_words(limited_by: Mapping[str, float]) -> str:
    """Say where the time goes, the most first; an empty text if no time is known of.

    Parameters
    ----------
    limited_by : limit -> s, as `ffcomp.faster.program.limited_by` gives it.
    """
    seconds = sorted(limited_by.items(), key=lambda each: -each[1])
    whole = max(sum(s for _, s in seconds), 1e-9)
    parts = [f"{LIMITS[name]} {100 * s / whole:.0f} %" for name, s in seconds if s >= LEAST_SHARE * whole]
    return f"What limits it, in shares of its time: {', '.join(parts)}." if parts else ""
