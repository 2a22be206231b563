"""Every sentence of a diagnosis is held against its numbers: they are read out of the words and computed again."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.result import DiagnosisResult, FileNumbers, Gap, Rest
from ffcomp.diagnosis.sentences import summary_sentences
from ffcomp.diagnosis.where import ResidualSize
from ffcomp.identification.uncertainty import normal
from tests.support.residual import residual_at

NUMBER = r"(?:more than )?([\d.]+) %"


def result(finding: str = "effects", **about: Any) -> DiagnosisResult:
    """The numbers of the effector-mass runs, unless others are given."""
    verdict = {"effects": "effects", "nothing": "none"}.get(finding, "unknown")
    noise = about.pop("noise", 0.0049)
    before, after = about.pop("before", 0.37), about.pop("after", 0.0051)
    name = "effector_mass"
    of_gap = {key: about.pop(key) for key in ("left_out", "unproven", "noise_guessed") if key in about}
    elsewhere = about.pop("held_out", (before, after))
    file = FileNumbers(
        retuned={"carriage.mass_kg": (0.18, 0.181)}, off=about.pop("file_off", {}), beyond=about.pop("beyond", {})
    )
    usual: dict[str, Any] = {
        "effects": {} if finding in ("nothing", "cannot_tell", "recording") else {name: {"added_kg": 0.08}},
        "intervals": {f"effects.{name}.added_kg": normal(0.08, 0.001)},
        "evidence": 800.0,
        "confidence": {name: 0.99},
        "rejections": ["12 % of the discrepancy is left"] if finding in ("unproven", "unexplained") else [],
        "fault": "Sensor acc_y is clipped." if finding == "recording" else "",
    }
    sizes = ResidualSize(before, noise), ResidualSize(after, noise)
    if finding == "dominant":
        bands, places = {(1.0, 10.0): 0.8, (10.0, 20.0): 0.2}, {(55.0, 20.0): 0.7, (0.0, 0.0): 0.3}
        left = residual_at(sizes[1], "a.csv", bands, places, (0.3, 0.6, 0.1))
        usual["rest"] = Rest(explained=0.83, left=left, rivals=[(("belt_stiffness",), 0.4)])
    gap = Gap(before=sizes[0], after=sizes[1], elsewhere=elsewhere, **of_gap)
    return DiagnosisResult(verdict=verdict, finding=finding, gap=gap, file=file, **(usual | about))


def shares(sentence: str) -> list[float]:
    return [float(x) / 100 for x in re.findall(NUMBER, sentence)]


def share_of(before: float, after: float, noise: float) -> float:
    return 1 - max(after**2 - noise**2, 0.0) / (before**2 - noise**2)


def rounded(told: float) -> Any:
    """What a printed share stands for: its last digit may be off by one half, and 99.9 says "more than"."""
    return pytest.approx(told, abs=max(0.006, 0.011 * told))


@pytest.mark.parametrize("seed", range(12))
def test_what_is_explained_follows_from_the_numbers_beside_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    noise, before = rng.uniform(0.002, 0.05), rng.uniform(0.1, 0.9)
    after, elsewhere = rng.uniform(noise, before), rng.uniform(noise, before)
    found = result(noise=noise, before=before, after=after, held_out=(before, elsewhere))
    size, there, *_ = summary_sentences(found)
    told_before, told_noise, told_after, told_share = shares(size)
    assert (told_before, told_noise, told_after) == (rounded(before), rounded(noise), rounded(after))
    assert told_share == pytest.approx(share_of(told_before, told_after, told_noise), abs=0.03)
    filed, left, explained = shares(there)
    assert (filed, left) == (rounded(before), rounded(elsewhere))
    assert explained == pytest.approx(share_of(filed, left, told_noise), abs=0.03)
