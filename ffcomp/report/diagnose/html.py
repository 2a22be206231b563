"""The report of a diagnosis as one HTML page."""

from __future__ import annotations

from ffcomp.diagnose.sentences import finding_of
from ffcomp.diagnose.summary import DiagnosisSummary
from ffcomp.diagnose.what_to_do import what_to_do
from ffcomp.report.diagnose import effects, figures
from ffcomp.report.diagnose.confounded import confounded
from ffcomp.report.diagnose.glossary import GLOSSARY
from ffcomp.report.diagnose.inputs import ReportInput
from ffcomp.report.diagnose.tables import evidence_rows, place_rows, promise_rows, retuned_rows, tiles
from ffcomp.report.diagnose.verdict import verdict
from ffcomp.report.drawing import Drawing, Image, image, svg
from ffcomp.report.page import rendered, tied

WORDS = {
    "effects": "an effect is missing",
    "nothing": "nothing is missing",
    "unexplained": "something unknown is missing",
    "unproven": "most of it is explained, but not proven",
    "cannot_tell": "these recordings cannot tell",
    "recording": "the recordings are at fault",
}


def page(given: ReportInput) -> bytes:
    """Render the whole diagnosis as one HTML file."""
    found, named = given.picture, tuple(given.outcome.effects)
    labels = place_labels(found)
    return rendered(
        "diagnose",
        {"tied": tied},
        outcome=given.outcome,
        origin=given.origin,
        picture=found,
        proposals=given.proposals,
        in_words=WORDS[finding_of(given.outcome)],
        sentences=verdict(given),
        tiles=tiles(given.outcome),
        effect_rows={name: effects.rows(given.outcome, name) for name in named},
        where=[_image(each) for each in figures.splits(found)],
        overlays=[_image(each) for each in figures.overlays(found)],
        spectra=[_image(each) for each in figures.spectra(found)],
        evidence=evidence_rows(found),
        promises=promise_rows(found),
        alike=_maybe(figures.alike(found, named)),
        confounded=confounded(given),
        held_out=_maybe(figures.held_out(found, labels)),
        places=place_rows(found, labels),
        retuned=retuned_rows(found),
        to_do=what_to_do(given.outcome),
        gain=given.gain,
        glossary=GLOSSARY,
    )


def place_labels(found: DiagnosisSummary) -> list[str]:
    """Label what was left out in turn: places on the bed, or experiments where all are at one place."""
    return [p.label if p.experiment or len(p.position) == 1 else f"{p.label} mm" for p in found.held_out]


def _image(drawing: Drawing) -> Image:
    return image(drawing, svg(drawing))


def _maybe(drawing: Drawing | None) -> Image | None:
    return None if drawing is None else _image(drawing)
