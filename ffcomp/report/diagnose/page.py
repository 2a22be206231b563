"""The report of a diagnosis as one HTML page."""

from __future__ import annotations

from ffcomp.diagnosis.sentences import what_to_do
from ffcomp.report.diagnose import figures
from ffcomp.report.diagnose.sentences import ReportInput, verdict
from ffcomp.report.diagnose.tables import (
    confounded_rows,
    effect_rows,
    evidence_rows,
    place_rows,
    promise_rows,
    retuned_rows,
    tiles,
)
from ffcomp.report.drawing import Drawing, Image, image, svg
from ffcomp.report.page import rendered, tied

WORDS = {
    "effects": "an effect is missing",
    "nothing": "nothing is missing",
    "unexplained": "something unknown is missing",
    "dominant": "most of it is one effect, and a rest is left",
    "unproven": "most of it is explained, but not proven",
    "cannot_tell": "these recordings cannot tell",
    "recording": "the recordings are at fault",
}
# what the words of the report mean, exactly
GLOSSARY = {
    "error": "Measured less simulated, inside the band that is compared. Before: with the machine file as it is; "
    "after: with the effects and retuned numbers of the best explanation.",
    "% off": "Root of the summed squares of the error by that of what was measured, all signals of all runs (nrms).",
    "noise": "What differs between two runs of the same experiment: at each frequency, for each signal. An error of 1 "
    "times the noise is noise.",
    "excess": "Mean square of the error in units of the noise, less one: 0 is noise alone, 3 an error twice the noise. "
    "Shares of the excess are shares of this, weighed by how much was compared.",
    "retuning": "Moving the file's own numbers within the uncertainty it states. What that explains is no missing "
    "effect.",
    "−2 ln Z": "Evidence: how badly a hypothesis fits plus what its numbers cost. 10 less is strong, 30 practically "
    "certain, as far as errors are noise; real effects never match the model exactly, so it is not the only test.",
    "left out of the fit": "Each position in turn: all parameters are fitted to the runs at the other positions, then "
    "this position is simulated. An effect that only bends the curves to fit fails here.",
    "90 %": "The interval in which the value lies with 90 % probability if the effect is of the kind named.",
    "cos²": "Of the angle between what two effects do to these very runs, less what retuning can do: 1 if one can be "
    "taken for the other, 0 if they have nothing in common.",
    "visible": "An effect of a usual size would stand 3 standard deviations out of the noise in these runs.",
}


def page(report: ReportInput) -> bytes:
    """Render the whole diagnosis as one HTML file."""
    result, summary, named = report.result, report.summary, tuple(report.result.effects)
    search, names = report.search, result.names
    places = search.held_out if search.best is not None else ()  # of retuning alone the page says nothing
    # places on the bed, or experiments where all are at one place
    labels = [p.label if p.experiment or len(p.position) == 1 else f"{p.label} mm" for p in places]
    return rendered(
        "diagnose",
        {"tied": tied},
        result=result,
        origin=report.origin,
        summary=summary,
        proposals=report.proposals,
        in_words=WORDS[result.finding],
        sentences=verdict(report),
        tiles=tiles(result),
        effect_rows={name: effect_rows(result, name) for name in named},
        where=[_image(each) for each in figures.splits(summary)],
        overlays=[_image(each) for each in figures.overlays(summary)],
        spectra=[_image(each) for each in figures.spectra(summary)],
        evidence=evidence_rows(search, names.catalogue),
        promises=promise_rows(search, names.catalogue),
        alike=_maybe(figures.alike(summary, named)),
        confounded=confounded_rows(result, summary.confounding),
        held_out=_maybe(figures.held_out(places, labels)),
        places=place_rows(places, labels),
        retuned=retuned_rows(search, names.quantities),
        to_do=what_to_do(result),
        gain=report.gain,
        glossary=GLOSSARY,
    )


def _image(drawing: Drawing) -> Image:
    return image(drawing, svg(drawing))


def _maybe(drawing: Drawing | None) -> Image | None:
    return None if drawing is None else _image(drawing)
