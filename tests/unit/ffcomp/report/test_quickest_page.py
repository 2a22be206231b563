"""The page of a comparison at equal error, and its sentences."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from ffcomp.report.quickest.page import write_quickest
from ffcomp.report.quickest.words import answer, sentences
from tests.support.quickest import made_up_quickest


def test_json_and_page(tmp_path: Path) -> None:
    found = made_up_quickest()
    told = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert told["schema"] == "ffcomp-equal-quality/1" and told["best_shaper"] == "mzv"
    assert "pieces" not in told["methods"]["faster"]
    write_quickest(found, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("<img") == 4 and "Your 5" in page and "limit of the actuators" in page
    assert "off: worst" in page


def test_the_sentence_and_its_exceptions() -> None:
    found = made_up_quickest()
    assert answer(found) == (
        "Your 5 h 12 min would take 3 h 20 min with 99 % within 30 µm; the best input shaper (MZV) would take "
        "5 h 17 min."
    )
    own, mzv = found.faster, found.methods["mzv"]
    missed = replace(found, methods={**found.methods, "faster": replace(own, reached=False)})
    assert answer(missed) == "Your 5 h 12 min would take 3 h 20 min with 99 % within 15 µm: 30 µm are not kept."
    alone = replace(found, methods={**found.methods, "mzv": replace(mzv, reached=False)})
    assert "no input shaper keeps that" in answer(alone)
    said = " ".join(sentences(found))
    assert "estimated from these slices" in said and "flow 60 %" in said
    assert "estimated" not in " ".join(sentences(replace(found, whole=True)))
