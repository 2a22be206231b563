"""The answer in sentences."""

from __future__ import annotations

from ffcomp.comparison.result import Quickest, TimedMethod
from ffcomp.faster.bound import limits_in_words
from ffcomp.report.compare.words import duration


def answer(result: Quickest) -> str:
    """Return the one sentence that people want."""
    faster, sliced = result.faster, result.sliced.print_time_s
    sentence = (
        f"Your {duration(sliced)} would take {duration(faster.print_time_s)} with 99 % within {result.bound_um:g} µm"
    )
    if not faster.reached:
        return (
            f"{sentence[: sentence.index(' with')]} with 99 % within {faster.contour_p99_um:.3g} µm: "
            f"{result.bound_um:g} µm are not kept."
        )
    rival = result.best_shaper
    if not rival.reached:
        return f"{sentence}; no input shaper keeps that at any speed that was tried."
    return f"{sentence}; the best input shaper ({nick(rival)}) would take {duration(rival.print_time_s)}."


def sentences(result: Quickest) -> list[str]:
    """Return what else is to be said."""
    sentence = [
        f"As sliced and without compensation, 99 % of the print is within {result.sliced.contour_p99_um:.3g} µm.",
        f"Nothing can be quicker than {duration(result.actuator_limit_s)}, whatever the error: corners cost nothing "
        f"there, and {_flow(result)}, speeds and the carriages' acceleration are kept.",
        limits_in_words(result.faster.limited_by),
        "Shapers are judged on the very printer that they were tuned on; ffcomp's quicker print keeps the bound for "
        "printers that are off, too.",
        result.mismatch,
        result.sampling,
    ]
    if not result.whole:
        sentence.append("Times of ffcomp's quicker print are estimated from these slices, by kind of line.")
    return [each for each in sentence if each]


def _flow(result: Quickest) -> str:
    flow = result.max_flow_mm3_per_s
    return "flow" if flow is None else f"a flow of {flow:.3g} mm³/s"


def nick(timed: TimedMethod) -> str:
    """Return the label's first words: `MZV`."""
    return timed.label.split(",")[0]


def shown(result: Quickest) -> list[TimedMethod]:
    """Return what figures show beside each other: as sliced, the best shaper, ffcomp."""
    return [result.sliced, result.best_shaper, result.faster]
