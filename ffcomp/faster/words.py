"""What limits a quicker print, in words: for the terminal and for pages."""

from __future__ import annotations

from collections.abc import Mapping

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
    limited_by : limit -> s, as `ffcomp.faster.shares.limited_by` gives it.
    """
    seconds = sorted(limited_by.items(), key=lambda each: -each[1])
    whole = max(sum(s for _, s in seconds), 1e-9)
    parts = [f"{LIMITS[name]} {100 * s / whole:.0f} %" for name, s in seconds if s >= LEAST_SHARE * whole]
    return f"What limits it, in shares of its time: {', '.join(parts)}." if parts else ""
