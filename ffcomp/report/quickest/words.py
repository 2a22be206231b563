"""The answer in sentences."""

from __future__ import annotations

from ffcomp.compare.quickest_result import Contender, Quickest
from ffcomp.faster.bound import limits_in_words
from ffcomp.report.compare.words import duration


def answer(found: Quickest) -> str:
    """Return the one sentence that people want."""
    own, sliced = found.faster, found.sliced.print_time_s
    said = f"Your {duration(sliced)} would take {duration(own.print_time_s)} with 99 % within {found.bound_um:g} µm"
    if not own.reached:
        return (
            f"{said[: said.index(' with')]} with 99 % within {own.contour_p99_um:.3g} µm: "
            f"{found.bound_um:g} µm are not kept."
        )
    rival = found.best_shaper
    if not rival.reached:
        return f"{said}; no input shaper keeps that at any speed that was tried."
    return f"{said}; the best input shaper ({nick(rival)}) would take {duration(rival.print_time_s)}."


def sentences(found: Quickest) -> list[str]:
    """Return what else is to be said."""
    said = [
        f"As sliced and without compensation, 99 % of the print is within {found.sliced.contour_p99_um:.3g} µm.",
        f"Nothing can be quicker than {duration(found.actuator_limit_s)}, whatever the error: corners cost nothing "
        f"there, and {_flow(found)}, speeds and the carriages' acceleration are kept.",
        limits_in_words(found.faster.limited_by),
        "Shapers are judged on the very printer that they were tuned on; ffcomp's quicker print keeps the bound for "
        f"printers that are off, too. {_known(found)}",
        found.mismatch,
        found.sampling,
    ]
    if not found.whole:
        said.append("Times of ffcomp's quicker print are estimated from these slices, by kind of line.")
    return [each for each in said if each]


def _known(found: Quickest) -> str:
    """Say what it would take on equal terms."""
    known = found.known
    kept = "" if known.reached else f", 99 % within {known.contour_p99_um:.3g} µm"
    return (
        f"For a machine that is just as its file says, as on the shapers' terms: {duration(known.print_time_s)}{kept}."
    )


def _flow(found: Quickest) -> str:
    flow = found.max_flow_mm3_per_s
    return "flow" if flow is None else f"a flow of {flow:.3g} mm³/s"


def nick(contender: Contender) -> str:
    """Return the label's first words: `MZV`."""
    return contender.label.split(",")[0]


def shown(found: Quickest) -> list[Contender]:
    """Return what figures show beside each other: as sliced, the best shaper, ffcomp."""
    return [found.sliced, found.best_shaper, found.faster]
