"""Every sentence of a diagnosis is held against its numbers: they are read out of the words and computed again."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.diagnosis import FINDINGS
from ffcomp.diagnosis.held_out import OtherMotion
from ffcomp.diagnosis.problem import MachineNames
from ffcomp.diagnosis.result import DiagnosisResult, FileNumbers, Gap, Rest
from ffcomp.diagnosis.sentences import summary_sentences, what_to_do
from ffcomp.diagnosis.verb import print_gain
from ffcomp.diagnosis.where import ResidualSize
from ffcomp.identification.uncertainty import normal
from models.effects.catalogue import CATALOGUE
from models.file import load_machine
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


def test_nothing_is_said_to_be_explained_by_0_percent_beside_a_gap_that_closed() -> None:
    """The report of the effector's mass once did: 37 -> 0.51 %, "it explains 0 % of the gap where never fitted"."""
    assert (
        "37 % off and are 0.51 % off: it explains more than 99.9 % of the gap there" in summary_sentences(result())[1]
    )


@pytest.mark.parametrize(("left_out", "words"), [("experiments", "One place only"), ("", "One experiment only")])
def test_one_place_is_not_elsewhere(left_out: str, words: str) -> None:
    text = " ".join(summary_sentences(result(left_out=left_out)))
    assert words in text and "not tested elsewhere" in text and "places it was not fitted to" not in text
    assert "places it was not fitted to" in " ".join(summary_sentences(result()))


def test_what_is_not_proven_is_said_with_its_share_and_place() -> None:
    found = result("unproven", noise=0.005, before=0.45, after=0.0359, unproven=["(55, 20)"])
    first = summary_sentences(found)[0]
    assert "99.4 % of it is explained by effector_mass; unproven at (55, 20)" in first
    assert shares(first)[2] == rounded(share_of(0.45, 0.0359, 0.005))
    assert "nothing known explains" not in first


def test_noise_that_hides_everything_cannot_tell() -> None:
    loud = summary_sentences(result("cannot_tell", noise=0.22, before=0.23, after=0.22))[0]
    assert loud.startswith("Cannot tell: the noise is 22 %")
    wrong = summary_sentences(result("cannot_tell", noise=0.09, before=0.09, after=0.03))[0]
    assert "repeats differ by 9.0 %" in wrong and "only 3.0 % are left" in wrong


def test_files_off_their_command_and_wrong_numbers_are_named() -> None:
    found = result(late_s={"a-1.csv": 2.1e-3, "a-2.csv": -0.4e-3}, file_off={"effector.nozzle_mass_kg": (0.5, 0.56)})
    text = " ".join(summary_sentences(found))
    assert "a-1.csv lies 2.1 ms late and a-2.csv lies 0.40 ms early" in text
    assert "effector.nozzle_mass_kg by +12 %" in text and "Weigh what moves" in text


def test_a_file_is_written_for_retuning_only_where_it_holds_elsewhere() -> None:
    closed = {"noise": 0.005, "before": 0.02, "after": 0.0052}
    assert result("nothing", **closed, held_out=(0.02, 0.006)).mends
    assert not result("nothing", **closed, held_out=(0.02, 0.018)).mends
    assert not result("nothing", **closed, held_out=(0.02, 0.006), left_out="").mends
    assert not result("nothing", **closed, held_out=(0.02, 0.006), late_s={"a.csv": 1e-3}).mends


def test_an_interval_that_few_motions_make_wide_is_told_from_a_number_that_nothing_determines() -> None:
    name = "effector_mass.added_kg"
    sentences = " ".join(summary_sentences(result(undetermined=[name], scattered=[name], motions=2)))
    assert "The 2 motions give different values of effector_mass.added_kg" in sentences
    assert "Record more motions." in sentences and "do not determine" not in sentences


@pytest.mark.parametrize("finding", FINDINGS)
def test_every_finding_has_sentences_and_steps(finding: str) -> None:
    found = result(finding)
    for sentence in [*summary_sentences(found), *what_to_do(found)]:
        assert sentence[0].isupper() and sentence.endswith(".")


def test_what_is_named_with_a_rest_says_what_is_left_and_where() -> None:
    found = result("dominant", before=0.37, after=0.15, undetermined=["effector_mass.added_kg"])
    first, rest, instead, open_numbers, *_ = summary_sentences(found)
    assert "effector_mass" in first and "83 % of the gap" in first
    assert "80 % of it lies at 1 to 10 Hz" in rest and "75 % of the other while it moves backwards" in rest
    assert "60 % near reversals" in rest and "70 % at (55, 20) mm" in rest and "15 % of the signals stays" in rest
    assert "belt_stiffness would explain 40 %" in instead and "do not determine effector_mass.added_kg" in open_numbers
    assert found.mends and found.named == ("effector_mass",) and not result("unproven").mends


def test_friction_is_told_as_a_family_first() -> None:
    found = replace(result(), effects={"stribeck_friction": {"force_n": 1.0}})
    assert "dry friction that falls with speed, stribeck_friction" in summary_sentences(found)[0]


def test_every_effect_has_a_remedy_and_uneven_towers_are_named() -> None:
    assert all(effect.remedy for effect in CATALOGUE.values())
    found = replace(result(), effects={"coulomb_friction": {"force_n": [1.0, 4.0, 1.1]}})
    assert what_to_do(found)[0].startswith("Clean and oil the rails, first of tower B;")
    slinger = replace(found, effects={"belt_stiffness": {"relative_change": [0.0, -0.2, 0.0]}})
    slinger = replace(
        slinger, names=MachineNames(carriages=("axis X", "axis Y", "axis Z"), belts=("axis X", "axis Y", "axis Z"))
    )
    assert what_to_do(slinger)[0].startswith("Check the belts' tension, first of axis Y, and tension them alike")
    assert ", first of axis Y;" in what_to_do(replace(slinger, effects=found.effects))[0]
    crossed = replace(slinger, names=replace(slinger.names, belts=("motor A", "motor B", "axis Z")))
    assert ", first of motor B, " in what_to_do(crossed)[0]
    assert ", first of axis Y;" in what_to_do(replace(crossed, effects=found.effects))[0]


@pytest.mark.slow
def test_prints_gain_by_a_heavier_effector_in_the_file() -> None:
    machine = replace(load_machine("mp-delta-pro"), flavor="klipper")  # Marlin's whole steps leave 9 µm with any file
    found = print_gain(machine, replace(result(), file=FileNumbers()))
    assert found is not None
    assert found.after_um < 0.3 * found.before_um < 0.3 * found.uncompensated_um


def test_a_number_beyond_what_the_file_says_is_named_with_nothing() -> None:
    closed = {"before": 0.37, "after": 0.0051, "held_out": (0.37, 0.0052)}
    first, *_ = summary_sentences(result("nothing", **closed))
    assert first.endswith("is noise, or retuning within the stated uncertainties.")
    off = result("nothing", **closed, beyond={"carriage.mass_kg": 3.7})
    first, second, *_ = summary_sentences(off)
    assert first.endswith("is noise, or numbers of the file that are off.")
    assert "carriage.mass_kg by 3.7 times its uncertainty (0.18 in the file, 0.181 fits)" in second


def test_sensors_and_nothing_gain_nothing() -> None:
    machine = load_machine("mp-delta-pro")
    assert print_gain(machine, result("nothing")) is None
    assert print_gain(machine, replace(result(), effects={"sensor_time_offset": {"offset_s": 1e-3}})) is None


@pytest.mark.parametrize(
    ("held_out", "words"),
    [((0.0045, 0.0041), "this proves nothing"), ((0.37, 0.0041), "the residual does not stand above the noise")],
)
def test_no_share_is_told_of_a_gap_that_does_not_stand_above_the_noise(
    held_out: tuple[float, float], words: str
) -> None:
    sentence = summary_sentences(result(held_out=held_out))[1]
    assert words in sentence
    assert "of the gap there" not in sentence


@pytest.mark.parametrize("worse", [True, False])
def test_a_file_by_which_prints_are_predicted_to_be_worse_is_not_compensated_with(worse: bool) -> None:
    told = " ".join(what_to_do(result(prints_worse=worse)))
    assert ("compensate with the original file" in told) == worse
    assert ("compensate with the better machine file" in told) != worse


@pytest.mark.parametrize("guess", [True, False])
def test_none_by_a_guessed_noise_says_what_may_be_hidden(guess: bool) -> None:
    told = " ".join(summary_sentences(result("nothing", noise_guessed=guess)))
    assert ("because no motion was repeated" in told) == guess


def test_what_speaks_against_an_answer_is_said_first_and_what_changes_beside() -> None:
    plain = summary_sentences(result())
    harms = OtherMotion("b.csv", filed=0.266, after=0.442)
    larger = OtherMotion("c.csv", 0.5, 0.057, "effector_mass.added_kg", 0.051, 0.049)
    first, *rest = summary_sentences(result(others=[OtherMotion("a.csv", 0.5, 0.1), harms, larger]))
    assert (
        first.endswith("b.csv is 27 % off with the original file and 44 % with the effects.") and "a.csv" not in first
    )
    (beside,) = (sentence for sentence in rest if sentence not in plain)
    assert shares(beside) == [0.051, 0.049, 0.057] and "c.csv effector_mass.added_kg" in beside and "larger" in beside
    smaller = replace(larger, changed=-0.051)
    assert "smaller" in summary_sentences(result(others=[smaller]))[-1]
