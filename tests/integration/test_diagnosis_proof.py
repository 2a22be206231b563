"""From a hidden effect to a better print, and what keeps a wrong effect out; short runs of the independent printer."""

from __future__ import annotations

import functools
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ffcomp.diagnosis.diagnosis import Outcome, diagnose
from ffcomp.diagnosis.printer_problem import PrinterProblem
from ffcomp.diagnosis.result import DiagnosisResult
from ffcomp.diagnosis.where import overlays_of
from ffcomp.measurement.recording import Recording, read_recording
from models.effects.catalogue import with_effect
from models.file import load_machine
from models.machine import Machine
from tests.support.hidden_delta import Motions, Printer, hidden, owners_file, printed_with, record
from validation import judge

SECONDS, PRINTED_S = 1.2, 3.0
EXPERIMENTS = (Motions("multisine", (0.0, 0.0, 30.0), 1.0, 2), Motions("multisine", (70.0, 40.0, 60.0), 1.4))
TABLE, REAL = hidden("extruder_mount", 2)  # softer and more damped, in x and y


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The owner's machine file, and runs of the printer that hides another mount of the extruder."""
    made = tmp_path_factory.mktemp("proof")
    (made / "owner.toml").write_text(owners_file(load_machine(judge.MACHINE_FILE)), encoding="utf-8")
    record(made / "runs", EXPERIMENTS, REAL, SECONDS)
    return made


@cache
def asked(folder: Path, *names: str) -> tuple[PrinterProblem, Outcome]:
    runs = [read_recording(path) for path in sorted((folder / "runs").iterdir())]
    plant = PrinterProblem(load_machine(folder / "owner.toml"), runs, names)
    return plant, diagnose(plant)


def written(folder: Path, *names: str) -> Path:
    _, found = asked(folder, *names)
    path = folder / ("+".join(names) + ".toml")
    text = DiagnosisResult(search=found).better_file("better", [])
    path.write_text(text, encoding="utf-8")
    return path


def test_the_hidden_effect_is_named_and_the_print_gets_better(folder: Path) -> None:
    names = ("extruder_mount", "command_delay")
    _, found = asked(folder, *names)
    assert found.named is not None and found.named.names == ("extruder_mount",)
    for key, wanted in TABLE.items():  # of what the file says, which is 2 % off itself
        values = [found.final.values[f"effects.extruder_mount.{key}[{i}]"] for i in range(2)]
        np.testing.assert_allclose(values, wanted[:2], atol=0.1)
    truth = with_effect(load_machine(judge.MACHINE_FILE), "extruder_mount", **TABLE)
    printer = Printer(REAL, truth)
    none = printed_with(printer, folder / "owner.toml", PRINTED_S, compensate=False)
    old, better = (printed_with(printer, file, PRINTED_S) for file in (folder / "owner.toml", written(folder, *names)))
    assert old < 0.3 * none
    assert better < 0.6 * old


def test_a_wrong_effect_is_refused_for_what_it_leaves_at_places_left_out(folder: Path) -> None:
    _, found = asked(folder, "effector_mass")
    assert (found.verdict, found.named) == ("unknown", None)
    assert found.best is not None and found.best.names == ("effector_mass",)
    assert any("left out of the fit" in reason for reason in found.rejections)
    assert any("% of the discrepancy is left" in reason for reason in found.rejections)
    assert np.mean([place.after for place in found.held_out]) > 1.0  # of the noise


RATE_HZ, SECONDS_DIAGNOSE_SEARCH, NOISE = 1600.0, 0.8, 0.15
PLACES = ((0.0, 0.0, 30.0), (-60.0, 20.0, 30.0), (20.0, 60.0, 120.0))
TWO = PLACES[1:]  # enough where a search is long
Places = tuple[tuple[float, float, float], ...]
SENSORS = tuple(f"acc_{axis}" for axis in "ABCxyz")


@functools.cache
def believed() -> Machine:
    return replace(load_machine("mp-delta-pro"), uncertainty={"default": 0.02})


def command(place: tuple[float, float, float], rng: np.random.Generator) -> np.ndarray:
    """All towers shaken by tones, on top of a slow sweep."""
    t = np.arange(round(SECONDS_DIAGNOSE_SEARCH * RATE_HZ)) / RATE_HZ
    f = rng.uniform(3, 120, (14, 3))
    size = rng.uniform(25, 90) / (2 * np.pi * f) ** 1.5
    tones = np.sum(size * np.sin(2 * np.pi * f * t[:, None, None] + rng.uniform(0, 6.28, f.shape)), axis=1)
    slow = np.sin(2 * np.pi * 0.9 * t)[:, None] * np.array([12.0, -7.0, 4.0])
    fade = np.minimum(1, np.minimum(t, t[-1] - t) / 0.25)[:, None]
    return np.asarray(believed().kinematics.inverse(np.array([place])) + (tones + slow) * fade)


def recordings_of(truth: Machine, places: Places) -> list[Recording]:
    """Two repeats at each place."""
    rng = np.random.default_rng(7)
    t = np.arange(round(SECONDS_DIAGNOSE_SEARCH * RATE_HZ)) / RATE_HZ
    recordings = []
    for i, place in enumerate(places):
        q = command(place, rng)
        blank = dict.fromkeys(SENSORS, np.zeros(len(t)))
        true = PrinterProblem(truth, [Recording("x.csv", t, q, "carriage", blank, {}, {})], ()).simulate({})[0]
        for repeat in (1, 2):
            felt = dict(zip(SENSORS, (true + NOISE * rng.standard_normal(true.shape)).T, strict=True))
            recordings.append(Recording(f"p{i}-{repeat}.csv", t, q, "carriage", felt, {}, {}))
    return recordings


def found(
    candidates: tuple[str, ...], places: Places = PLACES, **hidden: dict[str, Any]
) -> tuple[PrinterProblem, Outcome]:
    truth = believed()
    for name, table in hidden.items():
        truth = with_effect(truth, name, **table)
    plant = PrinterProblem(believed(), recordings_of(truth, places), candidates)
    return plant, diagnose(plant)


def test_what_no_candidate_explains_is_unknown_and_pictured() -> None:
    _, diagnosis = found(("guide_damping",), TWO, cogging={"amplitude_mm": 0.03, "pitch_mm": 0.8})
    assert diagnosis.verdict == "unknown" and diagnosis.rejections and diagnosis.named is None
    before, _ = DiagnosisResult(search=diagnosis).residuals
    cycle = before.splits["motor's step cycle"]  # ripple follows the motor's position
    assert len(cycle.labels) == 16 and min(cycle.excess) > 10
    shown = overlays_of(diagnosis.estimation, diagnosis.final.values)[0]
    assert np.std(shown.measured - shown.before) > 5 * shown.noise_rms


def test_what_cannot_be_seen_is_said_to_be_invisible_and_noise_pictures_as_nothing() -> None:
    _, diagnosis = found(("center_of_mass", "guide_damping"))
    assert diagnosis.verdict == "none"
    assert diagnosis.invisible == ["center_of_mass"]  # by virtual work the carriages do not feel it
    for split in DiagnosisResult(search=diagnosis).residuals[1].splits.values():
        inner = np.array(split.excess[1:-1] if "time" in split.title else split.excess)  # the ends are faded out
        assert np.abs(inner).max() < 0.6, split.title  # where an effect is, hundreds
