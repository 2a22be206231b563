"""The page of the diagnosis."""

from __future__ import annotations

from ffcomp.diagnose.summary import Picture
from ffcomp.report.diagnose import effects, figures
from ffcomp.report.diagnose.glossary import GLOSSARY
from ffcomp.report.diagnose.rivals import look_alikes
from ffcomp.report.diagnose.tables import evidence_rows, place_rows, promise_rows, retuned_rows, tiles
from ffcomp.report.diagnose.told import Told
from ffcomp.report.diagnose.verdict import verdict
from ffcomp.report.shared.drawing import Drawing, Image, image, svg
from ffcomp.report.shared.page import rendered, tied

WORDS = {"effects": "an effect is missing", "none": "nothing is missing", "unknown": "something unknown is missing"}


def page(told: Told) -> bytes:
    """The whole diagnosis as one HTML file."""
    found, named = told.picture, tuple(told.outcome.effects)
    labels = place_labels(found)
    return rendered(
        "diagnose",
        {"tied": tied},
        outcome=told.outcome,
        origin=told.origin,
        picture=found,
        proposals=told.proposals,
        in_words=WORDS[told.outcome.verdict],
        sentences=verdict(told),
        tiles=tiles(told.outcome),
        effect_rows={name: effects.rows(told.outcome, name) for name in named},
        where=[_image(each) for each in figures.splits(found)],
        overlays=[_image(each) for each in figures.overlays(found)],
        spectra=[_image(each) for each in figures.spectra(found)],
        evidence=evidence_rows(found),
        promises=promise_rows(found),
        alike=_maybe(figures.alike(found, named)),
        look_alikes=look_alikes(told),
        held_out=_maybe(figures.held_out(found, labels)),
        places=place_rows(found, labels),
        retuned=retuned_rows(found),
        glossary=GLOSSARY,
    )


def place_labels(found: Picture) -> list[str]:
    """Of what was left out in turn: places on the bed, or runs where all are at one place."""
    if all(len(p.place) > 1 for p in found.places):
        return ["(" + ", ".join(f"{x:g}" for x in p.place) + ") mm" for p in found.places]
    (runs,) = (split.labels for split in found.splits if split.title == "run")
    return [runs[int(p.place[0])] for p in found.places]


def _image(drawing: Drawing) -> Image:
    return image(drawing, svg(drawing))


def _maybe(drawing: Drawing | None) -> Image | None:
    return None if drawing is None else _image(drawing)
