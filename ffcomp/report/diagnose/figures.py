"""List every figure of the report, with its finding."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from ffcomp.diagnose.summary import DiagnosisSummary, Overlay, Spectrum, Split
from ffcomp.report.diagnose import charts
from ffcomp.report.diagnose.standout import stands_out
from ffcomp.report.diagnose.words import times, times_noise
from ffcomp.report.drawing import Drawing

WIDTH, HEIGHT = 4.3, 2.7  # inches, of a small one: as wide as a phone
ROW, AXIS = 0.26, 0.75  # inches a row, and below them
TITLES = {
    "frequency": "By frequency",
    "signal": "By signal",
    "place": "By position",
    "window of time": "By window of time",
    "run": "By run",
    "share of the run's time": "Along the run",
    "motion": "By direction, and at reversals",
    "size of motion": "By size of motion",
    "motor's step cycle": "By the motor's phase",
}
UNITS = {"acc": "m/s²", "pos": "mm"}


def splits(found: DiagnosisSummary) -> list[Drawing]:
    """Return the figures of what the excess depends on; the position as a map of the bed."""
    return [_bed(found, split) if split.at else _split(split) for split in found.splits]


def _split(split: Split) -> Drawing:
    height = HEIGHT if split.spans else ROW * len(split.labels) + AXIS
    return Drawing(
        "where", TITLES[split.title], stands_out(split), "", WIDTH, height, partial(charts.draw_split, split=split)
    )


def _bed(found: DiagnosisSummary, split: Split) -> Drawing:
    draw = partial(charts.draw_bed, split=split, radius_mm=found.bed_radius_mm)
    return Drawing("where", TITLES[split.title], stands_out(split), "", WIDTH, 4.0, draw)


def overlays(found: DiagnosisSummary) -> list[Drawing]:
    """Return the overlays of measured and simulated signals."""
    return [_overlay(each) for each in found.overlays]


def _overlay(each: Overlay) -> Drawing:
    draw = partial(charts.draw_overlay, overlay=each, unit=UNITS[each.signal[:3]])
    return Drawing("overlay", f"{each.signal} in {Path(each.recording).name}", _left(each), "", 5.4, 3.8, draw)


def _left(each: Overlay) -> str:
    sizes = [float(((each.measured - x) ** 2).mean()) ** 0.5 / each.noise_rms for x in (each.before, each.after)]
    return f"Error in this interval: {times(sizes[0])} the noise before, {times(sizes[1])} after."


def spectra(found: DiagnosisSummary) -> list[Drawing]:
    """Return the spectra of the errors."""
    return [_spectrum(each) for each in found.spectra]


def _spectrum(each: Spectrum) -> Drawing:
    worst = int((each.before / each.noise).argmax())
    said = (
        f"The error stands highest above the noise at {each.frequency_hz[worst]:.0f} Hz: "
        f"{times(float(each.before[worst] / each.noise[worst]))} before, "
        f"{times(float(each.after[worst] / each.noise[worst]))} after."
    )
    title = f"{each.kind[0].upper()}{each.kind[1:]}"
    return Drawing("spectrum", title, said, "", 5.4, 3.4, partial(charts.draw_spectrum, spectrum=each))


def alike(found: DiagnosisSummary, named: tuple[str, ...]) -> Drawing | None:
    """Return the figure of confounded effects, if there are two or more."""
    if len(found.confounding.names) < 2:
        return None
    side = 0.27 * len(found.confounding.names) + 2.2
    draw = partial(charts.draw_alike, alike=found.confounding, named=named)
    return Drawing("alike", "Confounded effects", "", "", side + 0.8, side, draw)


def held_out(found: DiagnosisSummary, labels: list[str]) -> Drawing | None:
    """Return the figure of what was left out of the fit in turn, if anything was."""
    if not found.held_out:
        return None
    label, worst = max(zip(labels, found.held_out, strict=True), key=lambda pair: pair[1].after)
    said = (
        f"At the worst of them, {label}, the error is {times(times_noise(worst.before))} the noise before and "
        f"{times(times_noise(worst.after))} after."
    )
    draw = partial(charts.draw_places, places=found.held_out, labels=labels)
    height = ROW * len(labels) + AXIS + 0.3
    return Drawing("held-out", "Places left out of the fit", said, "", 6.5, height, draw)
